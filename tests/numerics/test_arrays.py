"""Numbers of the host on the device: what `jnp.asarray` makes of them, and nothing compiled."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.numerics.arrays import as_array
from tests.compilations import compilations

GIVEN = [
    (np.arange(7.0).reshape(7, 1), jnp.float32),
    (np.arange(11), None),
    (np.arange(13) > 4, None),
    ([[1.0, 2.0, 3.0, 4.0, 5.0]], jnp.float32),
    (0.25, jnp.float32),
    (np.asfortranarray(np.arange(34.0).reshape(2, 17)), None),
]


@pytest.mark.parametrize(("values", "dtype"), GIVEN)
def test_it_is_what_jax_makes_and_compiles_nothing(values, dtype):
    with compilations() as compiled:
        array = as_array(values, dtype)
    assert not compiled
    wanted = jnp.asarray(values, dtype)
    assert array.dtype == wanted.dtype
    np.testing.assert_array_equal(array, wanted)


def test_double_precision_is_kept_where_it_is_enabled(x64):
    assert as_array(np.ones(3)).dtype == np.float64


def test_what_is_traced_passes_through():
    np.testing.assert_array_equal(jax.grad(lambda x: jnp.sum(as_array(x) ** 2))(jnp.arange(3.0)), [0, 2, 4])
