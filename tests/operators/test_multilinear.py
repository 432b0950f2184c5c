"""Products as a primitive: both modes to second order, and every transformation, against the same in plain JAX."""

import dataclasses
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.operators.multilinear import Multilinear
from tests.operators.derivatives import check_derivatives

ROWS, KEPT, COLUMNS, CHANNELS = 7, 5, 9, 3
RANDOM = np.random.default_rng(0)
INDICES = RANDOM.integers(0, COLUMNS, (ROWS, KEPT)).astype(np.int32)


@dataclasses.dataclass(frozen=True)
class Sparse(Multilinear):
    """Rows, as a pytree of two arrays that are added, times light; light has an adjoint of its own."""

    many: bool = False

    def product(self, fixed, rows, light):
        return jnp.einsum("rn,rnc->rc", rows["a"] + rows["b"], light[fixed])

    def adjoint(self, number, fixed, arguments, like):
        if number != 1:
            return super().adjoint(number, fixed, arguments, like)
        rows, _, radiance = arguments
        updates = (rows["a"] + rows["b"])[..., None] * radiance[:, None]
        return jnp.zeros(like.shape, like.dtype).at[fixed].add(updates)

    def product_many(self, number, fixed, *arguments):
        rows, lights = arguments
        return jax.vmap(lambda light: self.product(fixed, rows, light))(lights) if self.many and number == 1 else None


def values() -> Any:
    return {"a": RANDOM.normal(size=(ROWS, KEPT)), "b": RANDOM.normal(size=(ROWS, KEPT))}


def lights(*shape: int) -> np.ndarray:
    return RANDOM.normal(size=(*shape, COLUMNS, CHANNELS))


ROW_VALUES, LIGHT = values(), lights()


def product(rows, light):
    return Sparse()(INDICES, rows, light)


def plain(rows, light):
    return jnp.einsum("rn,rnc->rc", rows["a"] + rows["b"], light[INDICES])


def test_derivatives_of_both_orders(x64):
    """The gradient of a function that is not linear has second derivatives in both arguments at once."""
    check_derivatives(product, (ROW_VALUES, LIGHT))
    check_derivatives(jax.grad(lambda *arguments: jnp.sum(product(*arguments) ** 3), (0, 1)), (ROW_VALUES, LIGHT))


@pytest.mark.parametrize(
    "transformed",
    [
        lambda f: jax.hessian(lambda x: jnp.sum(f(ROW_VALUES, x) ** 2))(LIGHT),
        lambda f: jax.jacfwd(lambda x: f(ROW_VALUES, x))(LIGHT),
        lambda f: jax.jacrev(lambda rows: f(rows, LIGHT))(ROW_VALUES)["a"],
        lambda f: jax.grad(jax.checkpoint(lambda x: jnp.sum(f(ROW_VALUES, x) ** 2)))(LIGHT),
        lambda f: jax.grad(
            lambda x: jax.lax.scan(lambda c, _: (c * 0.5, jnp.sum(f(ROW_VALUES, c) ** 2)), x, None, length=3)[1].sum()
        )(LIGHT),
        lambda f: jax.vmap(jax.grad(lambda x: jnp.sum(f(ROW_VALUES, x) ** 2)))(MANY),
        lambda f: jax.vmap(f, (0, 0))({"a": MANY[:, :ROWS, :1] + 0 * ROW_VALUES["a"][None], "b": BOTH}, MANY),
        lambda f: jax.vmap(f, ({"a": None, "b": 0}, None), 1)({"a": ROW_VALUES["a"], "b": BOTH}, LIGHT),
        lambda f: jax.linear_transpose(lambda x: f(ROW_VALUES, x), LIGHT)(MANY[0, :ROWS])[0],
    ],
    ids=[
        "hessian",
        "jacfwd",
        "jacrev",
        "checkpoint",
        "scan",
        "vmap-grad",
        "vmap-both",
        "vmap-leaf",
        "linear-transpose",
    ],
)
def test_transformation_is_that_of_plain_code(x64, transformed):
    np.testing.assert_allclose(jax.jit(lambda: transformed(product))(), transformed(plain), rtol=1e-12, atol=1e-12)


MANY = lights(4)
BOTH = RANDOM.normal(size=(4, ROWS, KEPT))


@pytest.mark.parametrize("many", [False, True], ids=["one by one", "at once"])
def test_many_lights(x64, many):
    of_many = jax.vmap(lambda light: Sparse(many)(INDICES, ROW_VALUES, light), 0, 1)(MANY)
    assert of_many.shape == (ROWS, 4, CHANNELS)
    np.testing.assert_allclose(of_many, jax.vmap(lambda x: plain(ROW_VALUES, x), 0, 1)(MANY), rtol=1e-12)


def test_what_does_not_reach_the_result_has_no_gradient(x64):
    gradient = jax.grad(lambda x: jnp.sum(product(ROW_VALUES, jax.lax.stop_gradient(x))))(LIGHT)
    assert not np.asarray(gradient).any()
