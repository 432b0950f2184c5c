"""What is taken off a light as its sun."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.basis import cubemap, latlong
from jaxrelight.lights.environment import coarsened, encode
from jaxrelight.lights.sun import MOST, split_sun
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
    assert len(split.texels) == MOST


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
    pixels = jnp.asarray(coarsened(jr.load_environment(shared("data", "env", name)).pixels, 64))
    split = jax.jit(lambda turn: split_sun(encode(pixels, turn, jnp.ones(()), resampling, cubemap.Texels(64))))
    resampling = latlong.area_resampling(*pixels.shape[:2], 64)
    for degrees in (0.0, 0.7, 33.3):
        assert np.asarray(split(degrees).radiance).any() == has_sun
