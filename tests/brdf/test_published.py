"""Published Lafortune fits, through the scene file, against their own formula and the albedos noted with them."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.brdf.lobes import LobeSum, lobe, lobe_sum
from jaxrelight.scene.scene_file import load_scene
from tests.brdf.test_lobes import PAIRS, albedo, at, hemisphere
from tests.shared_data import shared

# Clay and dark skin are BRDFs of Wang 2006 §5; the others have single lobes, retro-reflection, and C beyond 1.
NAMES = ["clay", "skin", "felt", "primer", "bluepaint", "brushedmetal", "merl_gold-metallic-paint_ngan2005"]

SCENE = """
[camera]
origin = [0, 1, 2]
target = [0, 0, 0]
[[mesh]]
primitive = "plane"
material = "published"
[material.published]
type = "lafortune"
diffuse = {diffuse}
"""


def published(name: str) -> dict:
    return json.loads(shared("data", "published", "lafortune_published.json").read_text())["materials"][name]


def loaded(folder, material: dict):
    text = SCENE.format(diffuse=material["diffuse"])
    for one in material["lobes"]:
        C = [[xy, xy, z] for xy, z in zip(one["Cxy"], one["Cz"], strict=True)]
        text += f"[[material.published.lobes]]\nC = {C}\nexponent = {one['n']}\nspecular = 1.0\n"
    path = folder / "scene.toml"
    path.write_text(text)
    brdf = load_scene(path).materials["published"]
    assert isinstance(brdf, LobeSum)
    return brdf


def formula(material: dict, omega_i, omega_o) -> np.ndarray:
    """As the notes beside the numbers give it, in float64."""
    x, y, z = (omega_i * omega_o).T
    total = np.tile(np.array(material["diffuse"]) / np.pi, (len(omega_i), 1))
    for one in material["lobes"]:
        Cxy, Cz, n = (np.array(one[key]) for key in ("Cxy", "Cz", "n"))
        dot = np.maximum(0, np.outer(x + y, Cxy) + np.outer(z, Cz))
        total += dot**n
    return total


@pytest.mark.parametrize("name", NAMES)
def test_a_published_material_loads_exactly(tmp_path, name):
    material = published(name)
    brdf = loaded(tmp_path, material)
    omega_i, omega_o = np.concatenate([PAIRS[:, 0], hemisphere(300)]), np.concatenate([PAIRS[:, 1], hemisphere(300, 1)])
    expected = formula(material, omega_i, omega_o)
    # float32 rounds the base of the power; the largest exponent multiplies that.
    largest = max(max(one["n"]) for one in material["lobes"])
    np.testing.assert_allclose(
        at(brdf, omega_i, omega_o), expected, rtol=4e-7 * max(largest, 10), atol=1e-6 * expected.max()
    )
    np.testing.assert_allclose(at(brdf, omega_i, omega_o), at(brdf, omega_o, omega_i), rtol=1e-6)


@pytest.mark.parametrize("name", NAMES)
def test_a_published_material_has_the_albedo_that_was_checked(x64, name):
    material = published(name)
    lobes = [
        lobe(np.stack([one["Cxy"], one["Cxy"], one["Cz"]], axis=-1), one["n"], specular=1) for one in material["lobes"]
    ]
    brdf = lobe_sum(material["diffuse"], lobes, jnp.float64)
    for degrees, expected in material["directional_albedo_checked"].items():
        angle = np.radians(float(degrees))
        reflectance = albedo(brdf, np.array([np.sin(angle), 0, np.cos(angle)]))
        np.testing.assert_allclose(reflectance, expected, atol=5e-3, err_msg=degrees)


def test_the_tightest_published_lobe_is_stable(tmp_path):
    """An exponent of 16,600, through the scene file, by its peak."""
    path = tmp_path / "scene.toml"
    path.write_text(
        SCENE.format(diffuse=0.0)
        + "[[material.published.lobes]]\nC = [-0.577, -0.577, 0.577]\nexponent = 16600\npeak = 3.0\n"
    )
    brdf = load_scene(path).materials["published"]
    assert isinstance(brdf, LobeSum)
    omega = hemisphere(50)
    np.testing.assert_allclose(at(brdf, omega, omega * [-1, -1, 1]), 3, rtol=5e-3)
    values = at(brdf, PAIRS[:, 0], PAIRS[:, 1])
    assert np.isfinite(values).all()
    assert values.max() <= 3.02
