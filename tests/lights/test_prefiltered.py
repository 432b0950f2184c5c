"""Prefiltered environments: against quadrature, across seams, and at the extremes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxrelight.basis import latlong
from jaxrelight.lights.environment import load_environment
from jaxrelight.lights.prefiltered import exponents, prefilter
from tests.shared_data import shared

ENVIRONMENTS = "grace_latlong.exr", pytest.param("blender_sunset.exr", marks=pytest.mark.slow)


def sphere(count: int, seed: int = 0) -> np.ndarray:
    omega = np.random.default_rng(seed).normal(size=(count, 3))
    return omega / np.linalg.norm(omega, axis=1, keepdims=True)


def looked_up(maps, omega, exponent) -> np.ndarray:
    find = jax.jit(jax.vmap(maps.look_up, (0, None)))
    return np.asarray(find(jnp.asarray(omega, jnp.float32), jnp.float32(exponent)))


def quadrature(pixels, omega, exponent) -> np.ndarray:
    """∫ max(0, p·ω)ⁿ L(ω) dω (n + 1)/2π over all pixels."""
    height, width = pixels.shape[:2]
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    weight = np.repeat(latlong.solid_angles(height, width), width)
    cosine = np.maximum(omega @ latlong.directions(u, v).reshape(-1, 3).T, 0)
    return (cosine**exponent * weight) @ pixels.reshape(-1, 3) * ((exponent + 1) / (2 * np.pi))


@pytest.fixture(scope="module")
def maps():
    """Of a random sky with a sun."""
    pixels = np.random.default_rng(0).uniform(0.1, 1, (32, 64, 3)).astype(np.float32)
    pixels[5, 9] = 300
    return prefilter(pixels, 128)


@pytest.mark.parametrize("name", ENVIRONMENTS)
def test_maps_are_within_one_percent_of_quadrature(name):
    pixels = latlong.resized(load_environment(shared("data", "env", name)).pixels, 128, 256)
    maps, omega = prefilter(pixels, 256), sphere(100)
    # The last two lie between maps.
    for exponent in (1, 4, 16, 64, 256, 2.3, 90):
        wanted = quadrature(pixels, omega, exponent)
        error = looked_up(maps, omega, exponent) - wanted
        assert np.sqrt(np.mean(error**2)) <= 0.01 * np.sqrt(np.mean(wanted**2)), exponent


def test_no_step_at_seams_and_poles_is_larger_than_elsewhere(maps):
    angle = np.linspace(0, 2 * np.pi, 4001)
    for n in (2.0, 150.0):
        across = [
            np.stack([np.sin(angle), np.cos(angle), 0 * angle], axis=1),  # over both poles
            np.stack([np.sin(angle), 0.1 + 0 * angle, np.cos(angle)], axis=1) / np.sqrt(1.01),  # over the seam
        ]
        for omega in across:
            steps = np.abs(np.diff(looked_up(maps, omega, n), axis=0)).max(axis=1)
            apart = np.minimum(np.abs(np.mod(angle[1:] + np.pi / 2, np.pi) - np.pi / 2), np.pi)
            assert steps[apart < 0.01].max() <= 1.01 * steps[apart >= 0.01].max()


@pytest.mark.parametrize("exponent", [0, 1e-3, 1e4, 1e9])
def test_values_and_gradients_are_finite_everywhere(maps, exponent):
    omega = jnp.asarray([*np.eye(3), *-np.eye(3), *sphere(9)], jnp.float32)

    def total(texels, omega, n):
        return jnp.sum(jax.vmap(type(maps)(texels, maps.heights).look_up, (0, None))(omega, n))

    value, slopes = jax.jit(jax.value_and_grad(total, (0, 1, 2)))(maps.texels, omega, jnp.float32(exponent))
    assert np.isfinite(value)
    assert all(np.isfinite(slope).all() for slope in slopes)


def test_a_constant_is_seen_everywhere_and_maps_are_linear():
    omega = sphere(20)
    constant = prefilter(np.full((4, 8, 1), 2.5, np.float32), 32)
    for n in (0, 0.7, 33, 1e5):
        np.testing.assert_allclose(looked_up(constant, omega, n), 2.5, rtol=1e-5)
    one, two = (np.random.default_rng(seed).uniform(size=(8, 16, 2)).astype(np.float32) for seed in (1, 2))
    both = prefilter(one + 2 * two, 32).texels
    np.testing.assert_allclose(both, prefilter(one, 32).texels + 2 * prefilter(two, 32).texels, rtol=1e-4)


def test_sizes_follow_exponents_or_are_all_alike():
    assert exponents()[0] == 0
    assert exponents()[-1] == 2**14 - 1
    chain, equal = (prefilter(np.ones((4, 8, 1), np.float32), 64, equal) for equal in (False, True))
    assert chain.heights == tuple(sorted(chain.heights))
    assert (chain.heights[0], chain.heights[-1]) == (32, 64)
    assert set(equal.heights) == {64}
    assert equal.map(5).shape == (64, 128, 1)
    assert chain.most == exponents()[-1]
    with pytest.raises(ValueError, match="power of two from 32"):
        prefilter(np.ones((4, 8, 1), np.float32), 48)


def test_gradients_in_direction_and_exponent_are_right(x64):
    maps = prefilter(np.random.default_rng(3).uniform(size=(4, 8, 1)), 32)
    given = jnp.asarray(sphere(1)[0]), jnp.asarray(5.3)
    check_grads(jax.jit(lambda *given: maps.look_up(*given)), given, order=1, modes=["rev"])
