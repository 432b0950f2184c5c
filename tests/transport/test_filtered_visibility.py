"""Filtered visibility: of open and closed hemispheres and of half of one, in codes, between receivers, its slopes."""

import jax
import numpy as np
import pytest

from jaxrelight.basis import cubemap
from jaxrelight.basis.spherical_harmonics import count
from jaxrelight.geometry.frame import tangent_frame
from jaxrelight.transport.bake import directions_for
from jaxrelight.transport.filtered_visibility import ORDER, coded, project_visibility, visible_share

RESOLUTION = 16
DIRECTIONS = directions_for(RESOLUTION)
VECTORS = cubemap.directions(RESOLUTION)
NORMALS = np.array([[0, 1, 0], [0.6, 0.8, 0], [0, 0, -1], [-0.48, 0.6, 0.64]], np.float32)
_shares = jax.jit(jax.vmap(visible_share))


def projected(visible: np.ndarray) -> np.ndarray:
    """Harmonics of the visibility [m, f] of receivers with `NORMALS`."""
    bits = np.packbits(visible & (NORMALS @ VECTORS.T > 0), axis=1, bitorder="little")
    return np.asarray(project_visibility(bits, np.asarray(tangent_frame(NORMALS)), DIRECTIONS, ORDER))


def share(coefficients: np.ndarray, peaks: np.ndarray, exponent: float) -> np.ndarray:
    return np.asarray(_shares(coefficients, peaks.astype(np.float32), np.full(len(peaks), exponent, np.float32)))


@pytest.mark.parametrize("exponent", [0.0, 3.0, 50.0, 1e5])
def test_what_nothing_blocks_is_seen_and_what_all_blocks_is_not(exponent: float):
    """At the horizon as well, where half of the lobe lies below it."""
    horizon = np.stack([np.cross(normal, [0.3, -0.2, 0.9]) for normal in NORMALS])
    horizon /= np.linalg.norm(horizon, axis=1, keepdims=True)
    every = np.ones((len(NORMALS), len(VECTORS)), bool)
    for peaks in (NORMALS, horizon):
        # Sums over so coarse a cube map are no integrals.
        np.testing.assert_allclose(share(projected(every), peaks, exponent), 1, atol=5e-3)
        np.testing.assert_array_equal(share(projected(~every), peaks, exponent), 0)


def test_half_of_a_hemisphere_is_half_of_a_lobe_along_its_edge():
    """A wall to one side: half at its edge, all far from it, nothing behind it."""
    side = np.stack([np.cross(normal, [0.3, -0.2, 0.9]) for normal in NORMALS])
    side /= np.linalg.norm(side, axis=1, keepdims=True)
    coefficients = projected(side @ VECTORS.T > 0)
    np.testing.assert_allclose(share(coefficients, NORMALS, 40.0), 0.5, atol=0.03)
    for towards, wanted in ((1, 1.0), (-1, 0.0)):
        peaks = NORMALS + 0.7 * towards * side
        peaks /= np.linalg.norm(peaks, axis=1, keepdims=True)
        np.testing.assert_allclose(share(coefficients, peaks, 60.0), wanted, atol=0.06)


def test_wide_lobes_see_what_quadrature_sees():
    visible = np.random.default_rng(0).random((4, 6 * RESOLUTION**2 // 64)) > 0.4
    visible = np.repeat(visible, 64, axis=1)
    coefficients, area = projected(visible), cubemap.solid_angles(RESOLUTION)
    lobes = np.maximum(NORMALS @ VECTORS.T, 0) ** 6 * area
    wanted = (lobes * visible).sum(axis=1) / lobes.sum(axis=1)
    np.testing.assert_allclose(share(coefficients, NORMALS, 6.0), wanted, atol=0.01)


def test_codes_are_near_and_small():
    coefficients = projected(np.random.default_rng(1).random((4, len(VECTORS))) > 0.5)
    held = coded(coefficients)
    assert held.nbytes == 4 * count(ORDER) + 4 * (ORDER + 1)
    assert held.order == ORDER
    again = held.at(np.arange(4)[:, None], np.ones((4, 1), np.float32))
    for degree in range(ORDER + 1):
        band = slice(degree**2, (degree + 1) ** 2)
        most = np.abs(coefficients[:, band]).max()
        assert np.abs(again - coefficients)[:, band].max() <= 0.51 * most / 127
    middle = held.at(np.array([[0, 1], [2, 2]]), np.array([[0.25, 0.75], [0.5, 0.5]], np.float32))
    np.testing.assert_allclose(middle, [0.25 * again[0] + 0.75 * again[1], again[2]], rtol=1e-5, atol=1e-6)


def test_nothing_is_coded_and_numbers_that_make_no_square_are_refused():
    assert not np.asarray(coded(np.zeros((2, 81), np.float32)).at(np.array([[1]]), np.ones((1, 1), np.float32))).any()
    with pytest.raises(ValueError, match="squares, not by 80"):
        coded(np.zeros((2, 80), np.float32))


def test_slopes_are_those_of_differences_and_finite_where_shares_end(x64):
    coefficients = projected(np.random.default_rng(2).random((4, len(VECTORS))) > 0.3).astype(float)
    peak, exponent = np.array([0.36, 0.8, 0.48]), np.asarray(9.0)
    slopes = jax.jit(jax.value_and_grad(visible_share, argnums=(0, 1, 2)))
    value, (by_coefficient, by_peak, by_exponent) = slopes(coefficients[0], peak, exponent)
    assert 0.1 < value < 0.9
    np.testing.assert_allclose(np.vdot(by_coefficient, coefficients[0]), value, rtol=1e-9)
    way, step = np.array([0.3, -0.5, 0.2]), 1e-6
    ends = [slopes(coefficients[0], peak + by * way, exponent)[0] for by in (step, -step)]
    np.testing.assert_allclose(np.vdot(by_peak, way), (ends[0] - ends[1]) / (2 * step), rtol=1e-6)
    ends = [slopes(coefficients[0], peak, exponent + by)[0] for by in (1e-4, -1e-4)]
    np.testing.assert_allclose(by_exponent, (ends[0] - ends[1]) / 2e-4, rtol=1e-5)
    for numbers in (np.zeros(81), 10 * coefficients[0]):
        assert all(np.isfinite(slope).all() for slope in slopes(numbers, peak, exponent)[1])
