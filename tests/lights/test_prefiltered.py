"""Prefiltered environments: against quadrature, across seams, and at the extremes."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxrelight.basis import latlong
from jaxrelight.errors import InputError
from jaxrelight.lights.environment import Environment, environment, load_environment
from jaxrelight.lights.prefiltered import exponents, maps_of, prefilter
from jaxrelight.numerics.arrays import is_traced
from tests.shared_data import shared

# Rows of the finest maps in most tests, of three channels: programs are the same.
FINEST = 128


def sphere(count: int, seed: int = 0) -> np.ndarray:
    omega = np.random.default_rng(seed).normal(size=(count, 3))
    return omega / np.linalg.norm(omega, axis=1, keepdims=True)


def looked_up(maps, omega, exponent) -> np.ndarray:
    """In up to 4096 directions."""
    padded = np.pad(np.asarray(omega, np.float32), [(0, 4096 - len(omega)), (0, 0)], mode="edge")
    return np.asarray(_look_up(maps, padded, np.float32(exponent)))[: len(omega)]


@jax.jit
def _look_up(maps, omega, exponent):
    return jax.vmap(maps.look_up, (0, None))(omega, exponent)


@jax.jit
def _total_and_slopes(maps, omega, exponent):
    def total(texels, omega, n):
        return jnp.sum(jax.vmap(dataclasses.replace(maps, texels=texels).look_up, (0, None))(omega, n))

    return jax.value_and_grad(total, (0, 1, 2))(maps.texels, omega, exponent)


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
    return prefilter(pixels, FINEST)


@pytest.mark.parametrize(
    ("name", "finest", "exponents"),
    [
        ("grace_latlong.exr", FINEST, (1, 4, 16, 64, 2.3, 90)),
        pytest.param("grace_latlong.exr", 256, (256,), marks=pytest.mark.slow),
        pytest.param("blender_sunset.exr", 256, (1, 4, 16, 64, 256, 2.3, 90), marks=pytest.mark.slow),
    ],
)
def test_maps_are_within_one_percent_of_quadrature(name, finest, exponents):
    """Two of the exponents, 2.3 and 90, lie between maps."""
    pixels = latlong.resized(load_environment(shared("data", "env", name)).pixels, 128, 256)
    maps, omega = prefilter(pixels, finest), sphere(100)
    for exponent in exponents:
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
    omega = np.asarray([*np.eye(3), *-np.eye(3), *sphere(9)], np.float32)
    value, slopes = _total_and_slopes(maps, omega, np.float32(exponent))
    assert np.isfinite(value)
    assert all(np.isfinite(slope).all() for slope in map(np.asarray, slopes))


def test_a_constant_is_seen_everywhere_and_maps_are_linear():
    omega = sphere(20)
    constant = prefilter(np.full((4, 8, 3), 2.5, np.float32), FINEST)
    for n in (0, 0.7, 33, 1e5):
        np.testing.assert_allclose(looked_up(constant, omega, n), 2.5, rtol=1e-5)
    one, two = (np.random.default_rng(seed).uniform(size=(8, 16, 3)).astype(np.float32) for seed in (1, 2))
    both, first, second = (np.asarray(prefilter(sky, FINEST).texels) for sky in (one + 2 * two, one, two))
    np.testing.assert_allclose(both, first + 2 * second, rtol=1e-4)


def test_sizes_follow_exponents_or_are_all_alike():
    assert exponents()[0] == 0
    assert exponents()[-1] == 2**14 - 1
    chain, equal = (prefilter(np.ones((4, 8, 3), np.float32), FINEST, equal) for equal in (False, True))
    assert chain.heights == tuple(sorted(chain.heights))
    assert (chain.heights[0], chain.heights[-1]) == (32, FINEST)
    assert set(equal.heights) == {FINEST}
    assert equal.map(5).shape == (FINEST, 2 * FINEST, 3)
    assert chain.exponents == exponents()
    with pytest.raises(ValueError, match="power of two from 32"):
        prefilter(np.ones((4, 8, 1), np.float32), 48)


def test_gradients_in_direction_and_exponent_are_right(maps, x64):
    exact = dataclasses.replace(maps, texels=jnp.asarray(np.asarray(maps.texels, float)))
    given = sphere(1)[0], np.asarray(5.3)
    check_grads(jax.jit(lambda *given: exact.look_up(*given)), given, order=1, modes=["rev"])


def test_an_environment_that_is_turned_or_scaled_has_the_same_maps():
    pixels = np.random.default_rng(0).uniform(size=(8, 16, 3)).astype(np.float32)
    sky = environment(pixels)
    maps = maps_of(sky, FINEST)
    assert maps_of(sky.with_(rotate_y=30.0, scale=2.0), FINEST) is maps
    assert maps_of(sky, FINEST, (1.0, 1.0)) is not maps
    # The same numbers elsewhere are another array, and other numbers other maps.
    np.testing.assert_array_equal(maps_of(environment(pixels), FINEST).texels, maps.texels)
    assert np.abs(np.asarray(maps_of(environment(2 * pixels), FINEST).texels) - np.asarray(maps.texels)).max() > 0.1


def test_maps_of_traced_pixels_are_not_remembered():
    pixels = jnp.asarray(np.random.default_rng(0).uniform(size=(8, 16, 3)).astype(np.float32))
    slope = jax.grad(lambda x: jnp.sum(maps_of(Environment(x), FINEST, (1.0, 1.0)).texels))(pixels)
    assert np.isfinite(slope).all()
    assert np.asarray(slope).min() > 0
    assert not is_traced(maps_of(environment(np.asarray(pixels)), FINEST, (1.0, 1.0)).texels)


def test_pixels_that_are_not_finite_are_refused():
    pixels = np.ones((32, 64, 3), np.float32)
    pixels[3, 5, 1] = np.nan
    with pytest.raises(InputError, match="1 NaN or infinite pixels, the first in row 3, column 5"):
        prefilter(pixels, FINEST)
