"""Skies as directions: the irradiance of the whole sphere, in sums."""

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import InputError
from jaxrelight.basis import latlong
from jaxrelight.lights.sky import even_sky, sky_of
from tests.shared_data import shared

NORMALS = np.array([[0.0, 1, 0], [0, -1, 0], [1, 0, 0], [0, 0, -1], [0.6, 0.8, 0]])


def irradiance(sky) -> np.ndarray:
    return np.maximum(NORMALS @ np.asarray(sky.directions).T, 0) @ np.asarray(sky.irradiance)


def by_pixels(environment) -> np.ndarray:
    h, w = environment.pixels.shape[:2]
    v, u = (np.indices((h, w)) + 0.5) / np.array([[[h]], [[w]]])
    directions = latlong.directions(u - environment.rotate_y / 360, v).reshape(-1, 3)
    light = (environment.pixels * latlong.solid_angles(h, w)[:, None, None]).reshape(-1, 3) * environment.scale
    return np.maximum(NORMALS @ directions.T, 0) @ light


def test_an_even_sky_lights_by_how_much_of_it_is_seen():
    """π L facing up, half of it on a wall, nothing facing down."""
    received = irradiance(even_sky([1, 2, 3], 512))
    np.testing.assert_allclose(received[0], np.pi * np.array([1, 2, 3]), rtol=1e-2)
    np.testing.assert_allclose(received[2:4], np.pi / 2 * np.array([[1, 2, 3]] * 2), rtol=2e-2)
    np.testing.assert_allclose(received[1], 0)


@pytest.mark.parametrize(("rotate_y", "scale"), [(0.0, 1.0), (70.0, 0.5)])
def test_a_map_lights_as_its_pixels_do(rotate_y, scale):
    environment = jr.load_environment(shared("data", "env", "grace_latlong.exr"), rotate_y, scale)
    wanted = by_pixels(environment)
    few, many = (irradiance(sky_of(environment, count)) for count in (64, 1024))
    assert np.linalg.norm(many - wanted) < 0.01 * np.linalg.norm(wanted)
    assert np.linalg.norm(many - wanted) < np.linalg.norm(few - wanted) < 0.1 * np.linalg.norm(wanted)


def test_more_directions_than_a_map_has_pixels_are_nearer_to_its_light():
    """Of which a single one for a pixel of 22° is 2 % off, however many there are."""
    environment = jr.environment(np.ones((8, 16, 3)), 70.0, 10.0)
    off = [np.abs(irradiance(sky_of(environment, count)) / (10 * np.pi) - 1).max() for count in (128, 512, 4096)]
    assert off[0] > 0.015
    assert off[1] < 0.01
    assert off[2] < 0.002


def test_each_direction_is_a_light():
    sky = even_sky(1.0, 16)
    parts = sky.parts()
    assert len(parts) == 16
    np.testing.assert_allclose([-part.direction for part in parts], sky.directions)


def test_a_black_map_is_a_black_sky():
    sky = sky_of(jr.environment(np.zeros((4, 8, 3))))
    np.testing.assert_array_equal(sky.irradiance, 0)


@pytest.mark.usefixtures("wrong_types")
@pytest.mark.parametrize("make", [lambda: even_sky(1.0, 0), lambda: even_sky(1.0, 2.5), lambda: even_sky(-1.0)])  # pyright: ignore[reportArgumentType]
def test_what_is_no_sky_is_refused(make):
    with pytest.raises(InputError, match=r"samples must be 1 or more|radiance must be"):
        make()
