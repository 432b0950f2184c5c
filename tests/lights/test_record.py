"""Local lights as a store holds them."""

import jax
import numpy as np

import jaxrelight as jr
from jaxrelight.lights.area import area
from jaxrelight.lights.local import Point, directional, point, spot
from jaxrelight.lights.projector import projector
from jaxrelight.lights.record import from_records, to_records
from jaxrelight.lights.shaped import shaped
from jaxrelight.lights.sky import even_sky
from jaxrelight.precomputation.precompute import precompute

LIGHTS = (
    point([0, 1, 2], 3.0),
    spot([0, 1, 2], [0, 0, 0], [1, 2, 3], 40.0),
    directional([0, -1, 0], 1.0),
    projector([0, 1, 2], [0, 0, 0], np.random.default_rng(0).uniform(size=(3, 4, 3)), 30.0),
    shaped([0, 1, 2], [0, 0, 0], 1.0, 20.0),
    area([0, 1, 0], [1, 0, 0], [0, 0, 1], 2.0, 3),
    even_sky(0.5, 8),
)


def test_every_kind_comes_back():
    records, arrays = to_records(LIGHTS)
    assert all(isinstance(value, (str, int)) for record in records for value in record.values())
    found = from_records(records, arrays.__getitem__)
    for one, other in zip(found, LIGHTS, strict=True):
        assert jax.tree.structure(one) == jax.tree.structure(other)
        for mine, theirs in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
            np.testing.assert_array_equal(mine, theirs)


def test_lights_of_a_class_of_ones_own_are_left_out():
    class Own(Point):
        """Somebody's."""

    own = Own(LIGHTS[0].position, LIGHTS[0].intensity)
    records, arrays = to_records([own, LIGHTS[2]])
    assert [record["type"] for record in records] == ["Directional"]
    assert set(arrays) == {"0.direction", "0.irradiance"}


def test_a_store_keeps_the_lights_of_its_scene(tmp_path):
    floor = jr.Part(jr.plane((2, 2), 4), "floor")
    camera = jr.Camera((0, 1, 0.5), (0, 0, 0), width=6, height=5)
    scene = jr.Scene([floor], {"floor": jr.lambert(0.5)}, camera, lights=LIGHTS[:4])
    precompute(scene, jr.Indirect(gather_samples=64, bounces=1), tmp_path)
    found = jr.open_store(tmp_path).scene_lights().local
    assert [type(one) for one in found] == [type(one) for one in LIGHTS[:4]]
    np.testing.assert_array_equal(found[3].image, LIGHTS[3].image)
