"""Operators within lineax: products and solvers use the operator's own transpose, and compile once."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
import pytest

from jaxrelight.operators.contract import Operator, as_lineax
from jaxrelight.operators.dense import Dense
from tests.compilations import compilations

R, D = 9, 6


def random(*shape: int, seed: int = 0, dtype: Any = np.float32) -> Any:
    return np.random.default_rng(seed).normal(size=shape).astype(dtype)


class Recording(Operator):
    """A matrix that notes what it is asked for."""

    operator: Dense
    calls: list[str] = eqx.field(static=True)

    @property
    def shape(self):
        return self.operator.shape

    @property
    def nbytes(self):
        return self.operator.nbytes

    def _apply(self, light):
        self.calls.append("apply")
        return self.operator.apply(light)

    def _transpose(self, radiance):
        self.calls.append("transpose")
        return self.operator.transpose(radiance)

    def _rows(self, indices):
        return self.operator.rows(indices)


def recording(c: int = 3) -> tuple[Recording, np.ndarray]:
    matrix = random(R, c, D)
    return Recording(Dense(jax.device_put(matrix)), []), matrix.astype(float)


def least_squares(matrix: np.ndarray, radiance: np.ndarray) -> np.ndarray:
    """By channel."""
    return np.stack([np.linalg.lstsq(matrix[:, c], radiance[:, c])[0] for c in range(matrix.shape[1])], axis=1)


def test_the_transpose_is_the_operators_own():
    operator, matrix = recording()
    light, radiance = random(D, 3), random(R, 3, seed=1)
    adapted = as_lineax(operator)
    np.testing.assert_allclose(adapted.mv(light), np.einsum("rcd,dc->rc", matrix, light), rtol=1e-5, atol=1e-5)
    assert operator.calls == ["apply"]
    np.testing.assert_allclose(adapted.T.mv(radiance), np.einsum("rcd,rc->dc", matrix, radiance), rtol=1e-5, atol=1e-5)
    assert operator.calls == ["apply", "transpose"]
    adapted.T.T.mv(light)
    assert operator.calls == ["apply", "transpose", "apply"]
    assert eqx.tree_equal(adapted.T.T, adapted)


@pytest.mark.parametrize("solver", [lx.Normal(lx.CG(1e-6, 1e-6)), lx.LSMR(1e-6, 1e-6)])
def test_least_squares(solver):
    operator, matrix = recording()
    radiance = random(R, 3, seed=1)
    solution = eqx.filter_jit(lx.linear_solve)(as_lineax(operator), radiance, solver)
    np.testing.assert_allclose(solution.value, least_squares(matrix, radiance), rtol=1e-3, atol=1e-3)
    assert {"apply", "transpose"} == set(operator.calls)


def test_solutions_are_differentiable_in_the_numbers():
    """x = (MᵀM)⁻¹ Mᵀ y, against finite differences in float64."""
    with jax.enable_x64(True):
        matrix, radiance = random(R, 1, D, dtype=float), random(R, 1, seed=1, dtype=float)
        change, weight = random(R, 1, D, seed=2, dtype=float), random(D, 1, seed=3, dtype=float)

        @jax.jit
        @jax.grad
        def gradient(matrix):
            solver = lx.Normal(lx.Cholesky())
            return jnp.vdot(weight, lx.linear_solve(as_lineax(Dense(matrix), float), radiance, solver).value)

        slope = np.vdot(gradient(matrix), change)
    ends = [np.vdot(weight, least_squares(matrix + h * change, radiance)) for h in (1e-6, -1e-6)]
    np.testing.assert_allclose(slope, (ends[0] - ends[1]) / 2e-6, rtol=1e-5)


@pytest.mark.parametrize("c", [1, 3])
def test_matrices(c):
    """Channels apart, in the order of the arrays."""
    operator, matrix = recording(c)
    adapted = as_lineax(operator)
    wanted = np.einsum("rcd,ce->rcde", matrix, np.eye(c)).reshape(R * c, D * c)
    np.testing.assert_allclose(adapted.as_matrix(), wanted, rtol=1e-6)
    np.testing.assert_allclose(adapted.T.as_matrix(), wanted.T, rtol=1e-6)
    whole = lx.materialise(adapted.T)
    np.testing.assert_allclose(whole.as_matrix(), wanted.T, rtol=1e-6)
    assert (whole.in_structure(), whole.out_structure()) == (adapted.out_structure(), adapted.in_structure())
    np.testing.assert_allclose(lx.diagonal(adapted), np.diagonal(wanted), rtol=1e-6)
    for diagonal, offset in zip(lx.tridiagonal(adapted), (0, -1, 1), strict=True):
        np.testing.assert_allclose(diagonal, np.diagonal(wanted, offset), rtol=1e-6)


def test_the_algebra_of_lineax():
    operator, matrix = recording()
    adapted, light = as_lineax(operator), random(D, 3)
    squared = np.einsum("rcd,rce,ec->dc", matrix, matrix, light)
    product = lx.conj(lx.linearise(2.0 * (adapted.T @ adapted))).mv(light)
    np.testing.assert_allclose(product, 2 * squared, rtol=1e-4, atol=1e-4)
    marks = lx.is_symmetric, lx.is_diagonal, lx.is_tridiagonal, lx.has_unit_diagonal, lx.is_lower_triangular
    marks += lx.is_upper_triangular, lx.is_positive_semidefinite, lx.is_negative_semidefinite
    assert not any(mark(adapted) for mark in marks)


def test_products_compile_once():
    def products(seed: int):
        adapted = as_lineax(Dense(jax.device_put(random(R, 3, D, seed=seed))))
        return adapted.mv(random(D, 3, seed=seed)), adapted.T.mv(random(R, 3, seed=seed))

    products(0)
    with compilations() as compiled:
        products(1)
    assert not compiled


def test_structures_follow_the_precision():
    adapted = as_lineax(recording()[0], np.float16)
    assert adapted.in_structure() == jax.ShapeDtypeStruct((D, 3), np.float16)
    assert adapted.T.in_structure() == jax.ShapeDtypeStruct((R, 3), np.float16)
