"""Even numbers: they fill a disc, shifted ones as well, and neighbours have nothing in common."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy.spatial import KDTree

from jaxrelight.numerics.random_numbers import MAX_POINTS, random_rotation, vogel_points


@jax.jit
def many_rotations(seed):
    return random_rotation(jnp.arange(4096), seed)


@jax.jit
def numbers(count):
    """For each of several rotations; those from `count` on are none."""
    return jax.vmap(lambda one: vogel_points(jnp.arange(MAX_POINTS), count, one))(many_rotations(0)[:7])


@pytest.mark.parametrize("count", [16, 48, 256, MAX_POINTS])
def test_steps_have_one_each(count: int):
    for points in np.asarray(numbers(count))[:, :count]:
        assert (points >= 0).all()
        assert (points < 1).all()
        # But for what rounding takes across an edge.
        np.testing.assert_allclose(np.floor(points[:, 0] * count + 1e-3), np.arange(count), atol=1)
        assert np.ptp(points[:, 0] * count - np.arange(count)) < 2e-3


@pytest.mark.parametrize("count", [16, 48, 128, 256, 1024])
def test_a_disc_is_filled_evenly(count: int):
    """Points share it: the closest two are three quarters as far apart as those of the densest grid would be."""
    for one in np.asarray(numbers(count), float)[:, :count]:
        u, v = one.T
        points = np.sqrt(u)[:, None] * np.stack([np.cos(2 * np.pi * v), np.sin(2 * np.pi * v)], axis=1)
        densest = np.sqrt(2 * np.pi / (np.sqrt(3) * count))
        # Near the middle, how far apart the first ones are depends on where in their steps they are.
        outer = points[u > 4 / count]
        nearest = KDTree(outer).query(outer, 2)[0][:, 1]
        assert nearest.min() > 0.75 * densest
        assert np.abs(points.mean(axis=0)).max() < 2 / count


def test_rotations_are_as_good_as_random():
    rotations = np.asarray(many_rotations(3), float) / 2**32
    np.testing.assert_allclose(rotations.mean(axis=0), 0.5, atol=0.02)
    np.testing.assert_allclose(rotations.std(axis=0), 12**-0.5, atol=0.01)
    assert np.abs(np.corrcoef(rotations.T) - np.eye(2)).max() < 0.05
    assert np.abs(np.corrcoef(rotations[:-1].T, rotations[1:].T)[:2, 2:]).max() < 0.05
    assert not np.array_equal(rotations, np.asarray(many_rotations(4), float) / 2**32)
    np.testing.assert_array_equal(rotations, np.asarray(many_rotations(3), float) / 2**32)
