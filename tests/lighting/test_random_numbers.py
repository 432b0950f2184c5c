"""Even numbers: whole sequences fill the cube, shifted ones as well, and neighbours have nothing in common."""

import jax.numpy as jnp
import numpy as np

from jaxrelight.lighting.random_numbers import even_numbers, shifts


def test_runs_are_even():
    """Each of 256 parts of every axis, and each of 64 boxes, holds its share."""
    for one in shifts(jnp.arange(7), 0):
        for first in (0, 1024, 4096):
            found = np.asarray(even_numbers(first + jnp.arange(256), one))
            assert (found >= 0).all()
            assert (found < 1).all()
            for axis in range(3):
                assert (np.histogram(found[:, axis], 256, (0, 1))[0] == 1).all()
            boxes = np.histogramdd(found, (4, 4, 4), [(0, 1)] * 3)[0]
            assert (boxes == 4).all()


def test_shifts_are_as_good_as_random():
    found = np.asarray(shifts(jnp.arange(4096), 3), float) / 2**32
    np.testing.assert_allclose(found.mean(axis=0), 0.5, atol=0.02)
    np.testing.assert_allclose(found.std(axis=0), 12**-0.5, atol=0.01)
    assert np.abs(np.corrcoef(found.T) - np.eye(3)).max() < 0.05
    assert np.abs(np.corrcoef(found[:-1].T, found[1:].T)[:3, 3:]).max() < 0.05
    assert not np.array_equal(found, np.asarray(shifts(jnp.arange(4096), 4), float) / 2**32)
    np.testing.assert_array_equal(found, np.asarray(shifts(jnp.arange(4096), 3), float) / 2**32)
