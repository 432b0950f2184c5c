"""Numbers that users give: which floating type they ask for, and what is checked of them."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.numerics.numbers import as_numbers, float_dtype, given_dtype, holds, is_known, module_of, shown
from tests.compilations import compilations

SINGLE, DOUBLE = np.float32(0.5), np.ones(3)


@pytest.mark.parametrize(
    ("values", "wanted"),
    [
        ((), np.float64),
        ((0.5, [1, 2.0], None), np.float64),
        ((SINGLE,), np.float32),
        ((SINGLE, 0.5, [1, 2]), np.float32),
        (([SINGLE, 0.5],), np.float32),
        ((SINGLE, DOUBLE), np.float64),
        ((np.arange(3),), np.float64),
        ((np.arange(3), SINGLE), np.float32),
        ((np.ones(2, np.float16), np.float16(1)), np.float32),
    ],
)
def test_arrays_have_a_type_and_numbers_of_python_follow_it(values, wanted):
    assert given_dtype(*values) == wanted
    assert float_dtype(*values) == np.float32
    with jax.enable_x64(True):
        assert float_dtype(*values) == wanted


def test_a_number_of_python_that_is_traced_asks_for_no_type(x64):
    dtypes = []
    jax.eval_shape(lambda x: dtypes.append(float_dtype(x, SINGLE)), 0.5)
    jax.eval_shape(lambda x: dtypes.append(float_dtype(x, SINGLE)), np.float64(0.5))
    jax.eval_shape(lambda x: dtypes.append(float_dtype(x)), 0.5)
    assert dtypes == [np.float32, np.float64, np.float64]


def test_what_is_known_stays_on_the_host_and_compiles_nothing():
    given = jax.device_put(np.arange(19, dtype=np.int32).reshape(1, 19))
    with compilations() as compiled:
        array = as_numbers(given)
    assert not compiled
    assert type(array) is np.ndarray
    assert array.dtype == np.float64
    assert module_of(array) is np


def test_what_is_traced_passes_all_conditions_and_nothing_else_does():
    def check(x):
        numbers = as_numbers([x, 2, 3.0])
        assert not is_known([x, 2], 1.0)
        assert module_of(numbers, np.ones(3)) is jnp
        assert holds(lambda numbers: numbers < 0, numbers)
        assert not holds(lambda known: known < 0, np.ones(3))
        assert shown([x, 2]) == "a traced array of the shape (2,)"
        return numbers

    assert jax.eval_shape(check, 1.0).shape == (3,)
    assert holds(lambda a, b: a < b, np.zeros(2), np.ones(2))
    assert not holds(lambda a, b: a < b, np.zeros(2), np.array([1, np.nan]))
