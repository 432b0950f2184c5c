"""Zonal means: against sums over all pairs of directions, and what any mean must do."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxrelight.basis import latlong
from jaxrelight.basis.zonal import zonal_means


def sky(height: int = 16, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.1, 1, (height, 2 * height, 3)).astype(np.float32) ** 4


def directions(height: int) -> np.ndarray:
    u, v = np.meshgrid((np.arange(2 * height) + 0.5) / (2 * height), (np.arange(height) + 0.5) / height)
    return latlong.directions(u, v).reshape(-1, 3)


@pytest.mark.parametrize(("exponent", "height"), [(0, 32), (1, 32), (7.5, 32), (1000, 32)])
def test_means_are_the_sums_over_all_directions(exponent, height):
    pixels, omega = sky(height), directions(height)
    cosine = omega @ omega.T
    kernel = np.where(cosine > 1e-7, np.maximum(cosine, 0) ** exponent, 0)
    kernel *= np.repeat(latlong.solid_angles(height, 2 * height), 2 * height)
    kernel /= kernel.sum(axis=1, keepdims=True)
    wanted = (kernel @ pixels.reshape(-1, 3)).reshape(pixels.shape)
    means = zonal_means(jnp.asarray(pixels), exponent)
    # Whether a direction in the plane of the horizon is above it is a matter of rounding.
    np.testing.assert_allclose(means, wanted, rtol=2e-4 if exponent else 3e-2)


def test_a_sharp_kernel_is_followed_as_far_as_it_goes():
    """Over a fine map only the rows near by are looked at."""
    pixels, omega = sky(128), directions(128)
    some = np.random.default_rng(1).choice(len(omega), 40, replace=False)
    kernel = np.maximum(omega[some] @ omega.T, 0) ** 400 * np.repeat(latlong.solid_angles(128, 256), 256)
    wanted = (kernel / kernel.sum(axis=1, keepdims=True)) @ pixels.reshape(-1, 3)
    means = np.asarray(zonal_means(jnp.asarray(pixels), 400.0)).reshape(-1, 3)[some]
    np.testing.assert_allclose(means, wanted, rtol=2e-4)


@pytest.mark.parametrize("exponent", [0, 0.3, 20, 1e4])
def test_a_constant_stays_and_nothing_becomes_negative(exponent):
    np.testing.assert_allclose(zonal_means(jnp.asarray(np.full((32, 64, 3), 3, np.float32)), exponent), 3, rtol=1e-5)
    sun = np.zeros((32, 64, 3), np.float32)
    sun[3, 60] = 1e5
    for channel in np.moveaxis(np.asarray(zonal_means(jnp.asarray(sun), exponent)), -1, 0):
        assert channel.min() >= -1e-6 * channel.max()
        assert channel.argmax() == sun[..., 0].argmax() or exponent == 0


def test_turning_commutes_and_the_map_upside_down_gives_means_upside_down():
    pixels = sky(32)
    means, turned, upside_down = (
        np.asarray(zonal_means(jnp.asarray(each), 5)) for each in (pixels, np.roll(pixels, 7, axis=1), pixels[::-1])
    )
    np.testing.assert_allclose(turned, np.roll(means, 7, axis=1), rtol=1e-4)
    np.testing.assert_allclose(upside_down, means[::-1], rtol=1e-4)


def test_gradients_are_right(x64):
    check_grads(jax.jit(lambda p: zonal_means(p, 3.0)), (sky(4).astype(float),), order=1)


def test_an_odd_number_of_rows_is_refused():
    with pytest.raises(ValueError, match="even number of rows, not 5"):
        zonal_means(jnp.asarray(np.ones((5, 10, 3))), 1)
