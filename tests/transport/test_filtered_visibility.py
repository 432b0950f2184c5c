"""Filtered visibility: of open and closed hemispheres and of half of one, between receivers, and its slopes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxrelight.basis import cubemap
from jaxrelight.basis.cube_grid import point_count
from jaxrelight.geometry.frame import tangent_frame
from jaxrelight.transport.bake import directions_for
from jaxrelight.transport.filtered_visibility import CELLS, FilteredVisibility, visibility_distances

RESOLUTION = 16
DIRECTIONS = directions_for(RESOLUTION)
VECTORS = cubemap.directions(RESOLUTION)
NORMALS = np.array([[0, 1, 0], [0.6, 0.8, 0], [0, 0, -1], [-0.48, 0.6, 0.64]], np.float32)
SIDE = np.cross(NORMALS, [0.3, -0.2, 0.9])
SIDE /= np.linalg.norm(SIDE, axis=1, keepdims=True)


def filtered(visible: np.ndarray) -> FilteredVisibility:
    """Of the visibility [m, f] of receivers with `NORMALS`."""
    bits = np.packbits(visible & (NORMALS @ VECTORS.T > 0), axis=1, bitorder="little")
    return FilteredVisibility(visibility_distances(bits, np.asarray(tangent_frame(NORMALS)), DIRECTIONS))


@jax.jit
def _shares(visibility, receivers, weights, peaks, exponent):
    return jax.vmap(visibility.share, in_axes=(0, 0, 0, None))(receivers, weights, peaks, exponent)


def shares(visibility: FilteredVisibility, peaks: np.ndarray, exponent: float) -> np.ndarray:
    """At each receiver, of a lobe of its own."""
    receivers, weights = np.arange(len(peaks))[:, None], np.ones((len(peaks), 1), np.float32)
    return np.asarray(_shares(visibility, receivers, weights, peaks.astype(np.float32), np.float32(exponent)))


@pytest.mark.parametrize("exponent", [10.0, 50.0, 1e5])
def test_what_nothing_blocks_is_seen_and_what_all_blocks_is_not(exponent: float):
    """At the horizon as well, below which nothing is known."""
    every = np.ones((len(NORMALS), len(VECTORS)), bool)
    for peaks in (NORMALS, SIDE):
        np.testing.assert_allclose(shares(filtered(every), peaks, exponent), 1, atol=2e-3)
        np.testing.assert_allclose(shares(filtered(~every), peaks, exponent), 0, atol=2e-3)


def test_a_straight_edge_parts_a_lobe_as_quadrature_does():
    """A wall to one side, at many distances from the lobe."""
    visibility, fine = filtered(SIDE @ VECTORS.T > 0), cubemap.directions(64)
    for exponent in (30.0, 200.0):
        for towards in (-0.35, -0.1, 0.0, 0.1, 0.35):
            peaks = NORMALS + towards * SIDE
            peaks /= np.linalg.norm(peaks, axis=1, keepdims=True)
            lobes = np.maximum(peaks @ fine.T, 0) ** exponent * cubemap.solid_angles(64)
            wanted = (lobes * (SIDE @ fine.T > 0)).sum(axis=1) / lobes.sum(axis=1)
            # Angles are known to a cell of the coarse map, 6°, whose share of the lobe this is.
            width = np.radians(6) * np.sqrt(exponent / (2 * np.pi))
            np.testing.assert_allclose(shares(visibility, peaks, exponent), wanted, atol=0.5 * width)


def test_shares_never_fall_as_an_opening_widens():
    peaks, before = NORMALS, np.zeros(4)
    for half_angle in (0.1, 0.3, 0.5, 0.8):
        share = shares(filtered(np.cos(half_angle) < NORMALS @ VECTORS.T), peaks, 60.0)
        assert (share >= before - 1e-6).all()
        before = share
    assert before.min() > 0.95


def test_angles_are_a_byte_each_and_vary_linearly_between_receivers():
    visibility = filtered(np.random.default_rng(1).random((4, len(VECTORS) // 64)).repeat(64, axis=1) > 0.5)
    assert visibility.nbytes == 4 * point_count(CELLS)
    one, other = np.asarray(visibility.codes, float)[:2]
    between = FilteredVisibility(jnp.asarray(np.rint([0.25 * one + 0.75 * other]), jnp.int8))
    peaks = NORMALS[:1]
    wanted = shares(between, peaks, 20.0)
    weights = np.array([[0.25, 0.75]], np.float32)
    actual = _shares(visibility, np.array([[0, 1]]), weights, peaks.astype(np.float32), np.float32(20))
    np.testing.assert_allclose(actual, wanted, atol=0.01)


def test_slopes_are_those_of_differences_and_finite_where_shares_end(x64):
    visibility = filtered(SIDE @ VECTORS.T > 0.2)
    receivers = jnp.asarray([0, 1, 3])

    def share(weights, direction, exponent):
        return visibility.share(receivers, weights, direction, exponent)

    weights, direction = np.array([0.5, 0.3, 0.2]), np.array([0.36, 0.8, 0.48])
    check_grads(jax.jit(share), (weights, direction, 9.0), order=1, modes=["fwd", "rev"], rtol=1e-4)
    slopes = jax.jit(jax.grad(share, argnums=(0, 1, 2)))
    for exponent in (0.0, 1e5):
        assert all(np.isfinite(slope).all() for slope in slopes(weights, direction, exponent))
