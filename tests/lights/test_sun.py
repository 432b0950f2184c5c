"""What is taken off a light as its sun."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.basis import cubemap, latlong
from jaxrelight.lights.environment import coarsened, encode
from jaxrelight.lights.sun import MAX_TEXELS, split_sun, without_sun
from tests.shared_data import shared

SKY = np.random.default_rng(3).uniform(0.5, 1.5, (6 * 8**2, 3)).astype(np.float32)


def test_rest_and_sun_are_the_light():
    light = SKY.copy()
    light[[5, 100, 101]] = [[1e5, 9e4, 8e4], [50, 60, 70], [20, 0, 0]]
    split = split_sun(jnp.asarray(light))
    np.testing.assert_allclose(np.asarray(split.rest) + np.asarray(split.sun), light, rtol=1e-6)
    radiance = np.asarray(split.radiance)
    assert set(np.asarray(split.texels)[radiance.any(axis=1)]) == {5, 100, 101}
    # As bright as what is not split, and of the same colour.
    rest = np.asarray(split.rest)
    assert np.linalg.norm(rest, axis=1).max() == pytest.approx(np.linalg.norm(SKY, axis=1).max(), rel=0.1)
    np.testing.assert_allclose(rest[5] / rest[5, 0], light[5] / light[5, 0], rtol=1e-5)


@pytest.mark.parametrize(
    "light",
    [
        SKY,
        np.zeros_like(SKY),
        np.ones_like(SKY),
        SKY * np.float32(1e30),
        np.where(np.arange(384)[:, None] < 40, 9, SKY),
    ],
    ids=["no sun", "black", "even", "bright", "a large lamp"],
)
def test_what_has_no_sun_is_left_as_it_is(light):
    light = light.astype(np.float32)
    split = split_sun(jnp.asarray(light))
    np.testing.assert_array_equal(split.rest, light)
    assert not np.asarray(split.radiance).any()


@pytest.mark.parametrize("scale", [1e-30, 1.0, 1e30])
def test_a_single_texel_is_all_sun(scale):
    light = np.zeros_like(SKY)
    light[77] = [scale, 2 * scale, 0]
    split = split_sun(jnp.asarray(light))
    assert not np.asarray(split.rest).any()
    np.testing.assert_array_equal(split.sun, light)
    assert len(split.texels) == MAX_TEXELS


@pytest.mark.parametrize("sky", [SKY, np.zeros_like(SKY)], ids=["over a sky", "alone"])
def test_derivatives_are_those_of_the_light(sky):
    """Rest and sun together are the light, so what both give is its derivative; finite where all else is black."""
    light = sky.copy()
    light[[5, 100]] = [[1e5, 9e4, 8e4], [5e4, 6e4, 7e4]]
    weights = np.random.default_rng(0).uniform(size=light.shape).astype(np.float32)

    @jax.jit
    @jax.grad
    def slope(light):
        split = split_sun(light)
        return jnp.sum(weights * (split.rest + split.sun))

    np.testing.assert_allclose(slope(light), weights, rtol=1e-5)


@pytest.mark.parametrize(
    ("name", "has_sun"),
    [
        ("blender_city.exr", True),
        ("grace_latlong.exr", False),
        pytest.param("blender_sunset.exr", True, marks=pytest.mark.slow),
        pytest.param("pmndrs_venice.exr", False, marks=pytest.mark.slow),
    ],
)
def test_suns_of_photographs(name, has_sun):
    """At any rotation, though that spreads a sun over several texels."""
    pixels = coarsened(jr.load_environment(shared("data", "env", name)).pixels, 64)
    resampling = latlong.area_resampling(*pixels.shape[:2], 64)
    for degrees in (0.0, 0.7, 33.3):
        assert np.asarray(_split(pixels, np.float32(degrees), resampling)).any() == has_sun


@jax.jit
def _split(pixels, turn, resampling):
    return split_sun(encode(pixels, turn, jnp.ones(()), resampling, cubemap.Texels(64))).radiance


def sunny(rows: int, width: float = 0.53, polar: float = 50.0, longitude: float = 30.0) -> np.ndarray:
    """A map of random radiance with a disc of 1e5, so many degrees wide."""
    v, u = (np.indices((rows, 2 * rows)) + 0.5) / np.array([[[rows]], [[2 * rows]]])
    towards = latlong.directions(u, v)
    a, b = np.radians([polar, longitude])
    sun = np.array([np.sin(a) * np.sin(b), np.cos(a), np.sin(a) * np.cos(b)])
    close = towards @ sun
    pixels = np.random.default_rng(0).uniform(0.5, 1.5, (rows, 2 * rows, 3))
    pixels[close >= min(np.cos(np.radians(width / 2)), close.max())] = 1e5, 9e4, 8e4
    return pixels.astype(np.float32)


# Large maps take their time.
SHARP = pytest.param(1024, 110.0, marks=pytest.mark.slow)


@pytest.mark.parametrize(("rows", "polar"), [(16, 50.0), (64, 50.0), (512, 50.0), (512, 110.0), (512, 0.3), SHARP])
def test_a_map_is_its_rest_and_few_directions(rows: int, polar: float):
    pixels = sunny(rows, polar=polar)
    rest, sun = without_sun(pixels)
    area = latlong.solid_angles(rows, 2 * rows)[:, None, None]
    taken = ((pixels - rest.astype(float)) * area).sum(axis=(0, 1))
    np.testing.assert_allclose(np.asarray(sun.irradiance).sum(axis=0), taken, rtol=1e-4)
    # All that shone, and nothing else; no more of it is left than of a bright pixel.
    bright = pixels.max(axis=2) > 1e4
    assert rest[bright].max() < 4
    np.testing.assert_array_equal(rest[rest != pixels], rest[np.any(rest != pixels, axis=2)].ravel())
    assert len(sun.directions) == 64
    assert np.asarray(sun.irradiance).any()
    a, b = np.radians([polar, 30.0])
    towards = np.array([np.sin(a) * np.sin(b), np.cos(a), np.sin(a) * np.cos(b)])
    mean = np.asarray(sun.irradiance).sum(axis=1) @ np.asarray(sun.directions)
    angle = np.arccos(np.clip(towards @ mean / np.linalg.norm(mean), -1, 1))
    assert angle < 0.75 * np.pi / rows


def test_a_sun_in_a_fine_map_is_taken_wherever_it_is():
    """Pixels of half the width of those that it is looked for in lie in the cells of these."""
    pixels = np.full((1024, 2048, 3), 1e-3, np.float32)
    # Across the border of a texel of 256² from the middle of the coarser pixel.
    pixels[853, 1304] = 1e6
    _, sun = without_sun(pixels)
    energy = 1e6 * latlong.solid_angles(1024, 2048)[853]
    np.testing.assert_allclose(np.asarray(sun.irradiance).sum(axis=0), energy, rtol=1e-3)


def test_a_wide_pixel_is_several_directions():
    _, sun = without_sun(sunny(16))
    directions = np.asarray(sun.directions, float)
    apart = np.arccos(np.clip(directions @ directions.T, -1, 1))
    assert np.asarray(sun.irradiance).all(axis=1).sum() == 64
    assert apart.max() > 0.1


@pytest.mark.parametrize("rows", [1, 2, 8, 256])
def test_a_map_without_a_sun_stays(rows: int):
    for pixels in (np.random.default_rng(0).random((rows, 2 * rows, 3)), np.zeros((rows, 2 * rows, 3))):
        rest, sun = without_sun(pixels.astype(np.float32))
        np.testing.assert_array_equal(rest, pixels.astype(np.float32))
        assert sun.directions.shape == sun.irradiance.shape == (64, 3)
        assert not np.asarray(sun.irradiance).any()


def test_a_light_of_few_texels_is_split_as_well():
    """Of those of one face there are not as many as a sun may have."""
    light = np.full((6, 3), 0.5, np.float32)
    light[2] = 400
    split = split_sun(jnp.asarray(light))
    np.testing.assert_allclose(split.rest, np.full((6, 3), 0.5), rtol=1e-6)
    np.testing.assert_allclose(np.asarray(split.rest) + np.asarray(split.sun), light, rtol=1e-6)
