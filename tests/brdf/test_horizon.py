"""Lobes cut by the horizon: integrals, means, limits."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxrelight.brdf import horizon

_cut = jax.jit(horizon.clip_lobe)


def clip_lobe(peak, exponent):
    clipped = _cut(np.asarray(peak, np.float32), np.float32(exponent))
    return jax.tree.map(np.asarray, clipped)


def at(degrees: float, azimuth: float = 0.7) -> np.ndarray:
    polar = np.radians(degrees)
    return np.array([np.sin(polar) * np.cos(azimuth), np.sin(polar) * np.sin(azimuth), np.cos(polar)])


@pytest.mark.parametrize("exponent", [0.0, 1.0, 7.3, 80.0])
@pytest.mark.parametrize("degrees", [0, 25, 60, 85, 100])
def test_share_and_mean_are_those_of_the_product(exponent, degrees):
    peak = at(degrees)
    z, around = (np.arange(400) + 0.5) / 400, (np.arange(800) + 0.5) / 800 * 2 * np.pi
    z, around = (part.ravel() for part in np.meshgrid(z, around))
    omega = np.stack([np.sqrt(1 - z**2) * np.cos(around), np.sqrt(1 - z**2) * np.sin(around), z])
    lobe = np.where(peak @ omega > 0, np.maximum(peak @ omega, 0) ** exponent, 0) * z
    share = lobe.mean() * (exponent + 1)
    mean = omega @ lobe / lobe.sum()
    length = np.linalg.norm(mean)
    clipped = clip_lobe(peak, exponent)
    np.testing.assert_allclose(clipped.share, share, rtol=4e-3 if degrees < 90 else 2e-2, atol=1e-6)
    np.testing.assert_allclose(clipped.peak, mean / length, atol=3e-3)
    # A cosine lobe's mean is (n + 1)/(n + 2) long.
    np.testing.assert_allclose((clipped.exponent + 1) / (clipped.exponent + 2), length, atol=2e-3)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 31.0, 1e4])
def test_along_the_normal_the_cosine_is_one_more_in_the_exponent(exponent):
    clipped = clip_lobe([0, 0, 1], exponent)
    np.testing.assert_allclose(clipped.exponent, exponent + 1, rtol=2e-3)
    np.testing.assert_allclose(clipped.share, (exponent + 1) / (exponent + 2), rtol=1e-3)
    np.testing.assert_allclose(clipped.peak, [0, 0, 1], atol=1e-6)


def test_a_sharp_lobe_above_the_horizon_is_weighed_by_its_cosine_and_stays():
    clipped = clip_lobe(at(40), 5000)
    np.testing.assert_allclose(clipped.share, np.cos(np.radians(40)), rtol=1e-3)
    np.testing.assert_allclose(clipped.peak, at(40), atol=1e-3)


def test_below_the_horizon_little_is_left_and_none_of_it_comes_from_below():
    for degrees in (95, 120, 170, 180):
        for exponent in (0.0, 5.0, 200.0):
            clipped = clip_lobe(at(degrees), exponent)
            assert 0 <= clipped.share < 0.25
            assert clipped.peak[2] >= 0


def test_everything_is_finite_and_differentiable():
    peaks = np.asarray([[0, 0, 1], [0, 0, -1], [1, 0, 0], [0, -1, 0], at(30), at(135)], np.float32)

    def flat(peak, exponent):
        share, moved, sharpness = horizon.clip_lobe(peak, exponent)
        return jnp.concatenate([jnp.stack([share, sharpness]), moved])

    slopes = jax.jit(jax.vmap(jax.vmap(jax.jacobian(flat, (0, 1)), (None, 0)), (0, None)))
    gradients = slopes(peaks, np.asarray([0, 1e-3, 20, 1e4, 1e9], np.float32))
    assert all(np.isfinite(np.asarray(part)).all() for part in gradients)


def test_gradients_are_right(x64):
    check_grads(_cut, (at(52.0), np.asarray(9.4)), order=1, modes=["rev"])
