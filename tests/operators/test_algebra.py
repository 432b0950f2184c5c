"""The algebra of operators: laws on their matrices, and what is refused. `test_operators` has what each gives."""

import operator
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.basis.cubemap import Texels
from jaxrelight.basis.haar import HaarFaces
from jaxrelight.operators.contract import Composed, InBasis, Scaled, Summed
from jaxrelight.operators.dense import Dense
from jaxrelight.operators.stacked import Stacked
from tests.compilations import compilations

D = 24  # texels of a 6×2² cube map


def random(*shape: int, seed: int = 0) -> Any:
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


def indices(*numbers: int) -> Any:
    return np.array(numbers, np.int32)


def dense(r: int, d: int, c: int = 3, seed: int = 0) -> Dense:
    return Dense(jax.device_put(random(r, c, d, seed=seed)))


A, B, C = dense(D, D, seed=1), dense(D, D, seed=2), dense(D, D, seed=3)
BASIS = HaarFaces(2)


@jax.jit
def matrices(*operators):
    return [one.to_matrix() for one in operators]


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ((A @ B) @ C, A @ (B @ C)),
        ((A + B) @ C, A @ C + B @ C),
        (A @ (B + C), A @ B + A @ C),
        (2.0 * (A + B), 2.0 * A + 2.0 * B),
        ((2.0 * A) @ B, A @ (B * 2.0)),
        ((A + B) @ BASIS, A @ BASIS + B @ BASIS),
        (A @ (B @ BASIS), (A @ B) @ BASIS),
        (A @ Texels(2), 1.0 * A),
        (A + B, B + A),
    ],
)
def test_laws(one, other):
    matrix, wanted = matrices(one, other)
    np.testing.assert_allclose(matrix, wanted, rtol=1e-4, atol=1e-4)


def test_order_matters():
    one, other = matrices(A @ B, B @ A)
    assert np.abs(one - other).max() > 1


def test_each_is_of_its_class_and_sums_are_flat():
    assert isinstance(A @ B, Composed)
    assert isinstance(A @ BASIS, InBasis)
    assert isinstance(2 * A, Scaled)
    total = A + B + (C + A)
    assert isinstance(total, Summed)
    assert len(total.operators) == 4


def test_shapes_and_bytes():
    grey, wide = dense(5, 7, 1), dense(7, D, 3)
    assert (grey @ wide).shape == (5, D, 3)
    assert (grey @ wide).nbytes == grey.nbytes + wide.nbytes
    assert (np.ones(3, np.float32) * grey).shape == (5, 7, 3)
    assert (np.ones(1, np.float32) * wide).shape == (7, D, 3)
    assert (2.0 * grey).nbytes == grey.nbytes + 4
    assert (grey + dense(5, 7, 3)).shape == (5, 7, 3)


@pytest.mark.parametrize(
    "factor", [2, 2.0, np.float32(2), np.full((), 2, np.float32), np.full(3, 2, np.float32), np.array(2), True]
)
def test_numbers_of_any_kind_scale_from_both_sides(factor):
    """NumPy would take an operator for an object, and make an array of it."""
    for scaled in (factor * A, A * factor, jnp.asarray(factor) * A):
        assert isinstance(scaled, Scaled)
        assert scaled.shape == A.shape
        np.testing.assert_allclose(scaled.factor, np.float32(factor))
        assert scaled.apply(random(D, 3)).dtype == np.float32


def test_a_number_leaves_the_precision_to_the_operator(x64):
    scaled = 2.0 * Dense(jnp.asarray(random(4, 3, D)))
    assert scaled.rows(indices(0)).dtype == np.float32


def test_factors_are_traced_and_differentiable():
    light, radiance = random(D, 3), random(D, 3, seed=1)
    traces = []

    @jax.jit
    def product(factor, unscaled):
        traces.append(factor)
        return jnp.vdot(radiance, (factor * unscaled).apply(light))

    expected = np.vdot(radiance, A.apply(light))
    for factor in (2.0, 3.0):
        np.testing.assert_allclose(product(factor, A), factor * expected, rtol=1e-4)
    assert len(traces) == 1
    np.testing.assert_allclose(jax.grad(product)(2.0, A), expected, rtol=1e-4)
    by_channel = jax.grad(product)(np.ones(3, np.float32), A)
    np.testing.assert_allclose(by_channel, np.sum(radiance * A.apply(light), axis=0), rtol=1e-4, atol=1e-4)


def test_other_numbers_compile_nothing():
    def everything(seed: int):
        one, other = dense(D, D, seed=seed), dense(D, D, seed=seed + 1)
        made = (float(seed) * one) @ other @ BASIS + other
        return made.apply(random(D, 3)), made.transpose(random(D, 3)), made.rows(indices(seed, 3))

    everything(0)
    with compilations() as compiled:
        everything(1)
    assert not compiled


@pytest.mark.parametrize(
    ("call", "shapes"),
    [
        (lambda: dense(5, 7) @ dense(8, D), ("(5, 7, 3)", f"(8, {D}, 3)")),
        (lambda: dense(5, 7, 2) @ dense(7, D), ("(5, 7, 2)", f"(7, {D}, 3)")),
        (lambda: dense(5, 7) @ BASIS, ("(5, 7, 3)", "24")),
        (lambda: dense(5, 7) @ Texels(2), ("(5, 7, 3)", "24")),
        (lambda: dense(5, 7) + dense(6, 7), ("(5, 7, 3)", "(6, 7, 3)")),
        (lambda: dense(5, 7) + dense(5, 8), ("(5, 7, 3)", "(5, 8, 3)")),
        (lambda: dense(5, 7) + dense(5, 7, 2), ("(5, 7, 3)", "(5, 7, 2)")),
        (lambda: random(2) * dense(5, 7), ("(5, 7, 3)", "(2,)")),
        (lambda: dense(5, 7) * random(3, 1), ("(5, 7, 3)", "(3, 1)")),
        (lambda: Stacked((dense(5, 7), dense(5, 8))), ("(5, 7, 3)", "(5, 8, 3)")),
        (lambda: Stacked((dense(5, 7), dense(5, 7, 2))), ("(5, 7, 3)", "(5, 7, 2)")),
    ],
)
def test_what_does_not_fit_is_refused_with_both_shapes(call, shapes):
    with pytest.raises(ValueError, match=r"cannot|does not fit") as error:
        call()
    message = str(error.value)
    assert "\n" not in message
    for shape in shapes:
        assert shape in message


@pytest.mark.usefixtures("wrong_types")
@pytest.mark.parametrize(
    ("one", "function", "other"),
    [
        (A, operator.matmul, jnp.ones((D, 3))),
        (A, operator.matmul, random(D, 3)),
        (A, operator.matmul, 2),
        (BASIS, operator.matmul, A),
        (A, operator.add, 1),
        (A, operator.add, BASIS),
        (A, operator.mul, B),
    ],
)
def test_what_is_no_operator_is_refused(one, function, other):
    with pytest.raises(TypeError, match=r"unsupported operand|does not support"):
        function(one, other)
