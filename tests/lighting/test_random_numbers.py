"""Even numbers: whole sequences fill the square, shifted ones as well, and neighbours have nothing in common."""

import jax.numpy as jnp
import numpy as np

from jaxrelight.lighting.random_numbers import even_numbers, shifts


def test_runs_are_even():
    """Each of 256 parts of the square holds one, however they are cut."""
    for one in shifts(jnp.arange(7), 0):
        for first in (0, 1024, 4096):
            found = np.asarray(even_numbers(first + jnp.arange(256), one))
            assert (found >= 0).all()
            assert (found < 1).all()
            for k in range(9):
                assert (np.histogramdd(found, (2**k, 2 ** (8 - k)), [(0, 1)] * 2)[0] == 1).all()


def test_shifts_are_as_good_as_random():
    found = np.asarray(shifts(jnp.arange(4096), 3), float) / 2**32
    np.testing.assert_allclose(found.mean(axis=0), 0.5, atol=0.02)
    np.testing.assert_allclose(found.std(axis=0), 12**-0.5, atol=0.01)
    assert np.abs(np.corrcoef(found.T) - np.eye(2)).max() < 0.05
    assert np.abs(np.corrcoef(found[:-1].T, found[1:].T)[:2, 2:]).max() < 0.05
    assert not np.array_equal(found, np.asarray(shifts(jnp.arange(4096), 4), float) / 2**32)
    np.testing.assert_array_equal(found, np.asarray(shifts(jnp.arange(4096), 3), float) / 2**32)
