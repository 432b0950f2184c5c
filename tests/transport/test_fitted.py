"""Fitted materials from a scene file to a picture."""

from typing import Any

import jax.numpy as jnp
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.brdf.factored import Factored
from jaxrelight.brdf.factors import factor
from jaxrelight.brdf.files.fitted import write_factors, write_lobes
from jaxrelight.brdf.lobes import lobe, lobe_sum
from jaxrelight.brdf.separable import Separable, separable
from jaxrelight.lighting.transport import TransportRelighter
from jaxrelight.methods import Transport
from jaxrelight.precomputation.precompute import precompute
from tests.transport.stores import open_transport

LIGHT = np.random.default_rng(6).gamma(0.4, size=(6 * 8**2, 3)).astype(np.float32)
SCENE = """
[camera]
origin = [0.4, 1.2, 1.8]
target = [0, 0, 0]
width = 16
height = 12
[[mesh]]
primitive = "plane"
resolution = 3
material = "paint"
[material.paint]
type = "fitted"
file = "paint.{}"
"""
BRDF = lobe_sum([0.3, 0.2, 0.1], [lobe([-1, -1, 0.9], 3, peak=[0.2, 0.3, 0.4])])


@pytest.fixture
def factors(tmp_path):
    """Those of a material, in a file."""
    made = separable(factor(BRDF, 5, 12))
    write_factors(tmp_path / "paint.npz", made)
    return made


def _scene(folder, kind: str, more: str = "") -> jr.Scene:
    (folder / "scene.toml").write_text(SCENE.format(kind) + more)
    return jr.load_scene(folder / "scene.toml")


def _method(receivers: Any) -> Transport:
    return Transport(receivers, resolution=8, coefficients="all", terms=2, factor_resolution=6)


def _relighter(scene, receivers: str, folder) -> TransportRelighter:
    return open_transport(precompute(scene, _method(receivers), folder).folder)


def _radiance(relighter: TransportRelighter) -> np.ndarray:
    return np.asarray(relighter.shade_terms(relighter.terms(LIGHT), relighter.view()))


@pytest.mark.parametrize("receivers", ["vertices", "pixels"])
def test_lobes_are_those_of_the_file(tmp_path, receivers):
    write_lobes(tmp_path / "paint.toml", BRDF)
    scene = _scene(tmp_path, "toml")
    by_code = jr.Scene(scene.parts, {"paint": BRDF}, scene.camera)
    from_file, from_code = (
        _radiance(_relighter(one, receivers, tmp_path / name)) for name, one in (("a", scene), ("b", by_code))
    )
    np.testing.assert_array_equal(from_file, from_code)
    assert from_file.max() > 0.01


def test_vertices_take_given_factors_as_they_are(tmp_path, factors):
    """Whatever number and resolution the method asks of others."""
    (block,) = _relighter(_scene(tmp_path, "npz"), "vertices", tmp_path / "store").transport.blocks
    assert isinstance(block.reflection, Factored)
    assert block.reflection.terms == 5
    np.testing.assert_array_equal(block.reflection.light_maps, factors.light_maps)
    np.testing.assert_array_equal(block.reflection.view_maps, factors.view_maps)


def test_vertices_and_pixels_show_the_same_material(tmp_path, factors):
    """Receivers of a plane under a distant sky all see the same light: no interpolation sets them apart."""
    pictures = {
        receivers: _radiance(_relighter(_scene(tmp_path, "npz"), receivers, tmp_path / receivers))
        for receivers in ("vertices", "pixels")
    }
    np.testing.assert_allclose(pictures["vertices"], pictures["pixels"], rtol=1e-4, atol=1e-6)
    (block,) = _relighter(_scene(tmp_path, "npz"), "pixels", tmp_path / "pixels").transport.blocks
    assert isinstance(block.brdf, Separable)
    omega_i, omega_o = jnp.asarray([0.6, 0, 0.8]), jnp.asarray([-0.48, 0.36, 0.8])
    np.testing.assert_array_equal(block.brdf.evaluate(omega_i, omega_o), factors.evaluate(omega_i, omega_o))


def test_other_factors_are_baked_anew(tmp_path, factors):
    before = _radiance(_relighter(_scene(tmp_path, "npz"), "vertices", tmp_path / "store"))
    write_factors(tmp_path / "paint.npz", separable(factor(jr.lambert(0.5))))
    after = _radiance(_relighter(_scene(tmp_path, "npz"), "vertices", tmp_path / "store"))
    assert np.abs(after - before).max() > 0.01


@pytest.mark.parametrize(("key", "value"), [("terms", "3"), ("form", '"symmetric"')])
def test_others_cannot_be_asked_of_given_factors(tmp_path, factors, key, value):
    with pytest.raises(jr.InputError, match=rf"\[paint\]: '{key}' is that of the file of factors"):
        _scene(tmp_path, "npz", f"{key} = {value}")
    write_lobes(tmp_path / "paint.toml", BRDF)
    assert set(_scene(tmp_path, "toml", f"{key} = {value}").factors) == {"paint"}


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ('file = "paint.npz"', "", r"\[paint\]: 'file' is missing"),
        ("paint.npz", "absent.npz", r"\[paint\]: .*absent.npz: cannot be read as factors: No such file"),
        ("paint.npz", "scene.toml", "'type' is missing"),
        ('file = "paint.npz"', 'file = "paint.npz"\nscale = 2.0', "'scale' is not known"),
    ],
)
def test_scenes_that_name_no_fitted_material_are_refused(tmp_path, factors, old, new, what):
    (tmp_path / "scene.toml").write_text(SCENE.format("npz").replace(old, new))
    with pytest.raises(jr.InputError, match=what):
        jr.load_scene(tmp_path / "scene.toml")
