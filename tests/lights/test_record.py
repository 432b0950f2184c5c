"""Local lights as a store holds them."""

import json

import jax
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import InputError
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
    restored = from_records(records, arrays.__getitem__)
    for one, other in zip(restored, LIGHTS, strict=True):
        assert jax.tree.structure(one) == jax.tree.structure(other)
        for mine, theirs in zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True):
            np.testing.assert_array_equal(mine, theirs)


class Own(Point):
    """Somebody's."""


def test_lights_of_a_class_of_ones_own_come_back():
    """By the name of its module, so that none of the package's is taken for it."""
    own = Own(LIGHTS[0].position, LIGHTS[0].intensity)
    records, arrays = to_records([own, LIGHTS[2]])
    assert [record["type"] for record in records] == [f"{__name__}:Own", "Directional"]
    assert set(arrays) == {"0.position", "0.intensity", "1.direction", "1.irradiance"}
    restored = from_records(json.loads(json.dumps(records)), arrays.__getitem__)
    assert [type(light) for light in restored] == [Own, type(LIGHTS[2])]
    for one, other in zip(jax.tree.leaves(restored), jax.tree.leaves((own, LIGHTS[2])), strict=True):
        np.testing.assert_array_equal(one, other)


def test_positions_come_back_in_double_precision():
    """Without float64 in JAX, too."""
    far = point([1e6 + 0.3, 0, 0], 1), Own(np.array([1e6 + 0.3, 0, 0]), LIGHTS[0].intensity)
    records, arrays = to_records(far)
    for light in from_records(records, arrays.__getitem__):
        assert isinstance(light, Point)
        np.testing.assert_array_equal(light.position, [1e6 + 0.3, 0, 0])


def test_a_light_that_is_not_known_is_named():
    with pytest.raises(InputError, match="the store's light 1 is of the class 'Lamp' of the module 'my_lights'"):
        from_records([{"type": "my_lights:Lamp", "fields": {}}], {}.__getitem__)
    with pytest.raises(InputError, match="light 1 is of the class 'system'"):
        from_records([{"type": "os:system", "fields": {}}], {}.__getitem__)


def test_double_precision_comes_back(x64):
    lights = point([0, 1, 1 / 3], 3.0), area([0, 1, 0], [1, 0, 0], [0, 0, 1], 0.1, 3)
    records, arrays = to_records(lights)
    restored = from_records(records, arrays.__getitem__)
    for one, other in zip(jax.tree.leaves(restored), jax.tree.leaves(lights), strict=True):
        assert one.dtype == other.dtype == np.float64
        np.testing.assert_array_equal(one, other)


def test_a_store_keeps_the_lights_of_its_scene(tmp_path):
    floor = jr.Part(jr.plane((2, 2), 4), "floor")
    camera = jr.Camera((0, 1, 0.5), (0, 0, 0), width=6, height=5)
    scene = jr.Scene([floor], {"floor": jr.lambert(0.5)}, camera, lights=LIGHTS[:4])
    precompute(scene, jr.Indirect(gather_samples=64, bounces=1), tmp_path)
    stored = jr.open_store(tmp_path).scene_lights().local
    assert [type(one) for one in stored] == [type(one) for one in LIGHTS[:4]]
    np.testing.assert_array_equal(stored[3].image, LIGHTS[3].image)
