"""Measured materials from a scene file to a picture: exact at pixels, by factors at vertices, kept by the store."""

import json

import jax.numpy as jnp
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.brdf.files import load_brdf
from jaxrelight.brdf.tabulated import Tabulated
from jaxrelight.files import store
from jaxrelight.lighting.transport import TransportRelighter
from jaxrelight.methods import Transport
from jaxrelight.precomputation.load import load
from jaxrelight.precomputation.precompute import precompute
from tests.brdf.files import writers
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
type = "measured"
file = "paint.bsdf"
"""


@pytest.fixture
def scene(tmp_path) -> jr.Scene:
    """With a material whose arrays are too long for JSON."""
    (tmp_path / "paint.bsdf").write_bytes(writers.rgl(size=24))
    (tmp_path / "scene.toml").write_text(SCENE)
    return jr.load_scene(tmp_path / "scene.toml")


def _method(receivers: str) -> Transport:
    return Transport(receivers, resolution=8, coefficients="all", terms=12, factor_resolution=12)


def _radiance(relighter: TransportRelighter) -> np.ndarray:
    return np.asarray(relighter.shade_terms(relighter.terms(LIGHT), relighter.view()))


def test_pixels_are_lit_by_the_brdf_of_the_file_itself(tmp_path, scene):
    relighter = open_transport(precompute(scene, _method("pixels"), tmp_path / "store").folder)
    (block,) = relighter.transport.blocks
    brdf = load_brdf(tmp_path / "paint.bsdf").brdf
    omega_i, omega_o = jnp.asarray([0.6, 0, 0.8]), jnp.asarray([-0.48, 0.36, 0.8])
    np.testing.assert_array_equal(block.brdf.evaluate(omega_i, omega_o), brdf.evaluate(omega_i, omega_o))
    pictures = {"measured": _radiance(relighter)}
    shade = jr.Scene(scene.parts, {"paint": jr.lambert(0.5)}, scene.camera)
    grey = open_transport(precompute(shade, _method("pixels"), tmp_path / "other").folder)
    pictures["lambert"] = _radiance(grey)
    assert np.isfinite(pictures["measured"]).all()
    assert pictures["measured"].max() > 0.01
    assert np.abs(pictures["measured"] - pictures["lambert"]).max() > 0.01


def test_the_store_keeps_long_arrays_in_layers_and_short_ones_in_its_header(tmp_path, scene):
    summary = precompute(scene, _method("pixels"), tmp_path / "store")
    record = summary.header["materials"][0]["brdf"]
    layers = {name for name, entry in record["arrays"].items() if "layer" in entry}
    assert layers == {"samples"}
    assert set(store.layers_of(summary.header)) >= {record["arrays"]["samples"]["layer"]}
    assert summary.nbytes["table"] > 0
    assert (tmp_path / "store" / "store.json").stat().st_size < 200_000
    first = _radiance(open_transport(summary.folder))
    again = precompute(scene, _method("pixels"), tmp_path / "store")
    assert again.header["materials"] == summary.header["materials"]
    np.testing.assert_array_equal(_radiance(open_transport(again.folder)), first)


def test_a_damaged_table_is_told_and_made_again(tmp_path, scene):
    summary = precompute(scene, _method("pixels"), tmp_path / "store")
    (table,) = (tmp_path / "store").glob("table-*/000000")
    table.write_bytes(table.read_bytes()[:-4])
    with pytest.raises(jr.InputError, match="damaged"):
        load(summary.folder)
    precompute(scene, _method("pixels"), tmp_path / "store")
    load(summary.folder)


def test_vertices_are_lit_by_factors_of_it(tmp_path, scene):
    """With as many terms as make a picture of the exact one, nearly."""
    smooth = np.ones((4, 4, 8, 3)) * [0.3, 0.2, 0.1]
    smooth *= np.linspace(1.5, 0.5, 4)[:, None, None, None]
    materials = {"paint": Tabulated(jnp.asarray(smooth, jnp.float32))}
    scene = jr.Scene(scene.parts, materials, scene.camera)
    pictures = {
        receivers: _radiance(open_transport(precompute(scene, _method(receivers), tmp_path / receivers).folder))
        for receivers in ("pixels", "vertices")
    }
    apart = np.linalg.norm(pictures["vertices"] - pictures["pixels"]) / np.linalg.norm(pictures["pixels"])
    assert apart < 0.05


def test_what_was_mended_is_told(tmp_path):
    fields = writers.rgl_fields(size=24)
    fields["rgb"][0, 1, :, 2, 2] = -0.01
    (tmp_path / "paint.bsdf").write_bytes(writers.tensor_file(fields))
    (tmp_path / "scene.toml").write_text(SCENE)
    notes = jr.load_scene(tmp_path / "scene.toml").notes
    assert "material paint: paint.bsdf: 3 of 6,912 values were negative, down to -0.01, and are taken as 0" in notes
    json.dumps(notes)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ('file = "paint.bsdf"', "", "'file' is missing"),
        ("paint.bsdf", "absent.bsdf", "absent.bsdf: cannot be read"),
        ("paint.bsdf", "scene.toml", "is no BRDF file"),
        ('file = "paint.bsdf"', 'file = "paint.bsdf"\nscale = 2.0', "'scale' is not known"),
    ],
)
def test_scenes_that_name_no_measured_brdf_are_refused(tmp_path, old, new, what):
    (tmp_path / "paint.bsdf").write_bytes(writers.rgl(size=24))
    (tmp_path / "scene.toml").write_text(SCENE.replace(old, new))
    with pytest.raises(jr.InputError, match=what):
        jr.load_scene(tmp_path / "scene.toml")
