"""Stores for local lights: what they hold, which dials make other layers, and what is not baked again."""

import dataclasses
import pathlib

import jax
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import InputError, Scene
from jaxrelight.files import store
from jaxrelight.precomputation.load import load
from jaxrelight.precomputation.material_rows import MaterialRows
from jaxrelight.precomputation.precompute import precompute
from jaxrelight.transport.model import PrecomputedIndirect
from jaxrelight.transport.rebake import exact, rebake
from tests.scenes import ball_over_floor
from tests.transport.stores import reflections_of

METHOD = jr.Indirect(gather_samples=64, bounces=2)
LAMP = jr.point([0.2, 1.5, 0.5], [3.0, 2.0, 1.0])


def _scene() -> Scene:
    camera = jr.Camera((0, 1, 3), (0, 0, 0), width=8, height=8)
    gloss = jr.phong(0.1, 0.3, 5)
    return ball_over_floor(gloss, camera, LAMP, paper=jr.lambert(0.5), quads=(2, 2), radius=0.4, height=0.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> pathlib.Path:
    folder = tmp_path_factory.mktemp("indirect")
    precompute(_scene(), METHOD, folder)
    return folder


@pytest.fixture(scope="module")
def precomputed(folder) -> PrecomputedIndirect:
    loaded = load(folder)
    assert isinstance(loaded, PrecomputedIndirect)
    return loaded


def test_a_store_holds_transport_from_a_cloud_and_the_cloud(folder, precomputed):
    assert precomputed.method == precomputed.transport.method == METHOD
    assert store.read_header(folder)["method"] == {"name": "indirect", "dials": dataclasses.asdict(METHOD)}
    cloud, count = precomputed.cloud, METHOD.gather_samples
    assert cloud.albedo.shape == cloud.emission.shape == precomputed.points.positions.shape == (count, 3)
    assert cloud.between is not None
    assert cloud.between.shape[1] == precomputed.transport.operator.shape[1] == count
    # Albedos are those of the surfaces that the points lie on: half, or what a lobe adds to a tenth.
    albedo = np.asarray(cloud.albedo)[:, 0]
    assert np.isclose(albedo, 0.5, atol=1e-5).any()
    assert (albedo[~np.isclose(albedo, 0.5, atol=1e-5)] > 0.1).all()
    lights = precomputed.stored.lights()
    assert lights.environment is None
    np.testing.assert_array_equal(lights.local[0].position, LAMP.position)  # pyright: ignore[reportAttributeAccessIssue]


def test_it_is_a_pytree_of_arrays(folder, precomputed):
    again = load(folder)
    assert all(isinstance(leaf, jax.Array) for leaf in jax.tree.leaves(again))
    assert jax.tree.structure(again) == jax.tree.structure(precomputed)


def test_rows_that_are_not_of_visibility_are_not_baked_again(precomputed):
    transport = precomputed.transport
    for bake in (exact, lambda transport: rebake(transport, reflections_of(transport))):
        with pytest.raises(InputError, match="a store for local lights, whose rows are not baked from visibility"):
            bake(transport)


@pytest.mark.parametrize(
    ("change", "new"),
    [
        ({"gather_samples": 256}, {"cloud", "albedo", "between", "indirect"}),
        ({"seed": 1}, {"cloud", "albedo", "between", "indirect"}),
        ({"importance": True}, {"cloud", "albedo", "between", "indirect"}),
        ({"sky": True}, {"cloud", "albedo", "between", "indirect"}),
        ({"solid_angle": 0.2}, {"between", "indirect"}),
        ({"near": "clamp"}, {"between", "indirect"}),
        ({"coefficients": 16}, {"between", "indirect"}),
        ({"compression_tolerance": 0.1}, {"between", "indirect"}),
        ({"bits": 8}, {"between", "indirect"}),
        ({"photons": 1000}, {"between"}),
        ({"peak": 0.1}, {"indirect"}),
        ({"bounces": 1}, set()),
        ({"bounces": 5}, set()),
        ({"sky_samples": 16}, set()),
    ],
    ids=lambda value: str(value) if isinstance(value, dict) else "",
)
def test_changed_dials_use_other_layers(tmp_path, monkeypatch, change: dict, new: set):
    """A key that left out a dial would give the layer of another."""
    # Which layers are asked for shows without gathering them.
    monkeypatch.setattr(MaterialRows, "_complete", lambda *_: None)
    precompute(_scene(), METHOD, tmp_path)
    old = {path.name for path in tmp_path.iterdir()}
    changed = dataclasses.replace(METHOD, **change)
    precompute(_scene(), changed, tmp_path)
    assert {path.name.partition("-")[0] for path in tmp_path.iterdir() if path.name not in old} == new
    assert store.read_header(tmp_path)["method"] == {"name": "indirect", "dials": dataclasses.asdict(changed)}
