"""Matrices that are held by rows and by columns, against SciPy's."""

import jax
import numpy as np
import pytest
from scipy import sparse

from jaxrelight.operators.sparse_matrix import sparse_matrix
from tests.operators.derivatives import check_derivatives

# Rows of many numbers, of few, and of none; columns of none.
SPARSE = sparse.random_array((11, 8), density=0.4, rng=np.random.default_rng(0), format="csr")
MATRIX = sparse.csr_array(sparse.diags_array(np.arange(11) % 4.0) @ SPARSE @ sparse.diags_array(np.arange(8) % 3.0))
X, Y = np.random.default_rng(1).normal(size=(8, 3)), np.random.default_rng(2).normal(size=(11, 3))


@pytest.mark.parametrize(("dtype", "rtol"), [(np.float32, 1e-5), (np.float64, 1e-13)])
def test_products_are_those_of_scipy(x64, dtype, rtol):
    matrix = sparse_matrix(MATRIX, dtype)
    given = X.astype(dtype), Y.astype(dtype)
    assert matrix.apply(given[0]).dtype == matrix.transpose(given[1]).dtype == dtype
    np.testing.assert_allclose(matrix.apply(given[0]), MATRIX @ X, rtol=rtol, atol=rtol)
    np.testing.assert_allclose(matrix.transpose(given[1]), MATRIX.T @ Y, rtol=rtol, atol=rtol)


def test_derivatives(x64):
    matrix = sparse_matrix(MATRIX, np.float64)
    check_derivatives(lambda x, y: (matrix.apply(x), matrix.transpose(y)), (X, Y))


def test_gradient_is_the_other_product_without_a_scatter():
    matrix = sparse_matrix(MATRIX)
    back = jax.jit(lambda x, y: jax.vjp(matrix.apply, x)[1](y)[0])
    x, y = X.astype(np.float32), Y.astype(np.float32)
    np.testing.assert_array_equal(back(x, y), matrix.transpose(y))
    assert "scatter" not in back.lower(x, y).as_text()
