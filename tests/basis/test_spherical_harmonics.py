"""Spherical harmonics: against SciPy, orthonormal, turned poles, and filtered by lobes as quadrature has it."""

import jax
import numpy as np
import pytest
from scipy.special import sph_harm_y

from jaxrelight.basis import cubemap
from jaxrelight.basis.spherical_harmonics import count, filtered_by_lobe, harmonics, lobe_bands

ORDER = 8
_harmonics = jax.jit(harmonics, static_argnames="order")
_bands = jax.jit(lobe_bands, static_argnames="order")
_filtered = jax.jit(jax.vmap(filtered_by_lobe, in_axes=(None, 0, 0)))


def unit_vectors(number: int, seed: int = 0) -> np.ndarray:
    vectors = np.random.default_rng(seed).normal(size=(number, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_they_are_scipys(x64):
    direction = unit_vectors(50)
    polar, azimuth = np.arccos(direction[:, 2]), np.arctan2(direction[:, 1], direction[:, 0])
    values = np.asarray(_harmonics(direction, ORDER))
    assert values.shape == (50, count(ORDER))
    for degree in range(ORDER + 1):
        for m in range(-degree, degree + 1):
            theirs = (-1) ** m * sph_harm_y(degree, abs(m), polar, azimuth) * (np.sqrt(2) if m else 1)
            wanted = theirs.imag if m < 0 else theirs.real
            np.testing.assert_allclose(values[:, degree**2 + degree + m], wanted, atol=1e-12)


def test_they_are_orthonormal():
    direction, area = cubemap.directions(64), cubemap.solid_angles(64)
    values = np.asarray(_harmonics(direction.astype(np.float32), ORDER), float)
    np.testing.assert_allclose((values * area[:, None]).T @ values, np.eye(count(ORDER)), atol=2e-3)


@pytest.mark.parametrize("exponent", [0.0, 1.0, 7.3, 300.0, 1e5])
def test_bands_are_integrals_of_legendre_polynomials(x64, exponent: float):
    t, w = np.polynomial.legendre.leggauss(400)
    # The lobe is a polynomial near its peak alone: the variable is spread there.
    s, ds = 1 - ((1 - t) / 2) ** 6, w * 3 * ((1 - t) / 2) ** 5
    weight = (exponent + 1) * s**exponent * ds
    wanted = [np.sum(weight * np.polynomial.legendre.Legendre.basis(degree)(s)) for degree in range(ORDER + 1)]
    np.testing.assert_allclose(_bands(np.asarray(exponent), ORDER), wanted, atol=1e-7)


@pytest.mark.parametrize("exponent", [2.0, 20.0])
def test_a_function_filtered_is_its_mean_under_the_lobe(exponent: float):
    """Of a function of the same order: exact, whatever the lobe."""
    coefficients = np.random.default_rng(1).normal(size=count(ORDER)).astype(np.float32)
    direction, area = cubemap.directions(64), cubemap.solid_angles(64)
    function = np.asarray(_harmonics(direction.astype(np.float32), ORDER)) @ coefficients
    peaks = unit_vectors(7, 2)
    lobes = np.maximum(peaks @ direction.T, 0) ** exponent * area
    wanted = lobes @ function / lobes.sum(axis=1)
    filtered = _filtered(coefficients, peaks.astype(np.float32), np.full(7, exponent, np.float32))
    np.testing.assert_allclose(filtered, wanted, atol=2e-3 * np.abs(function).max())


def test_derivatives_are_finite_at_the_poles_and_for_the_widest_lobe():
    coefficients = np.ones(count(ORDER), np.float32)
    slopes = jax.jit(jax.grad(filtered_by_lobe, argnums=(0, 1, 2)))
    for peak in ([0, 0, 1.0], [0, 0, -1.0], [0, 1.0, 0], [0, 0, 0.0]):
        for exponent in (0.0, 1e5):
            for slope in slopes(coefficients, np.asarray(peak, np.float32), np.float32(exponent)):
                assert np.isfinite(slope).all()
