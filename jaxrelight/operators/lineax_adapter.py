"""Linear maps between arrays as operators of lineax, whose transposes are the maps' own."""

from typing import Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
from jaxtyping import Array, Float


@runtime_checkable
class LinearMap(Protocol):
    """What is needed of a map from [d, c] to [r, c] that acts on every channel by itself: a pytree, with these."""

    @property
    def shape(self) -> tuple[int, int, int]: ...  # noqa: D102

    def apply(self, light: Float[Array, "d c"]) -> Float[Array, "r c"]: ...  # noqa: D102

    def transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]: ...  # noqa: D102

    def to_matrix(self) -> Float[Array, "r c d"]: ...  # noqa: D102


class LineaxOperator(lx.AbstractLinearOperator):
    """A linear map as an operator of lineax.

    `lineax.FunctionLinearOperator` would transpose the map by automatic differentiation, and trace it anew at every
    construction; this calls the map's own methods, which are compiled once.

    Attributes:
        map: from [d, c] to [r, c].
        dtype: of both.
        is_transposed: whether it is the transpose, from [r, c] to [d, c].
    """

    map: LinearMap
    dtype: np.dtype = eqx.field(static=True)
    is_transposed: bool = eqx.field(static=True, default=False)

    def mv(self, vector: Array) -> Array:
        """The product of the map, or of its transpose, with an array of two axes."""
        return self.map.transpose(vector) if self.is_transposed else self.map.apply(vector)

    def transpose(self) -> "LineaxOperator":
        """The transpose, by the map's own."""
        return LineaxOperator(self.map, self.dtype, not self.is_transposed)

    def as_blocks(self) -> Float[Array, "a c b c"]:
        """All numbers, 0 between channels: output rows a and channels, then input rows b and channels."""
        rows = self.map.to_matrix().astype(self.dtype)
        # rows r, channels c and e, coefficients d
        blocks = jnp.einsum("rcd,ce->rcde", rows, jnp.eye(rows.shape[1], dtype=self.dtype), precision="highest")
        return jnp.transpose(blocks, (2, 3, 0, 1)) if self.is_transposed else blocks

    def as_matrix(self) -> Float[Array, "a b"]:
        """All numbers, as a matrix of two axes."""
        return self.as_blocks().reshape(self.out_size(), self.in_size())

    def in_structure(self) -> jax.ShapeDtypeStruct:
        """[d, c], or [r, c] of the transpose."""
        r, d, c = self.map.shape
        return jax.ShapeDtypeStruct((r if self.is_transposed else d, c), self.dtype)

    def out_structure(self) -> jax.ShapeDtypeStruct:
        """[r, c], or [d, c] of the transpose."""
        r, d, c = self.map.shape
        return jax.ShapeDtypeStruct((d if self.is_transposed else r, c), self.dtype)


# Functions of lineax on operators are looked up by type.


def _itself(operator: LineaxOperator) -> LineaxOperator:
    return operator


def _has_no_mark(operator: LineaxOperator) -> bool:
    del operator
    return False


lx.linearise.register(LineaxOperator)(_itself)
# Numbers are real.
lx.conj.register(LineaxOperator)(_itself)

for _mark in (
    *(lx.is_symmetric, lx.is_diagonal, lx.is_tridiagonal, lx.has_unit_diagonal),
    *(lx.is_lower_triangular, lx.is_upper_triangular, lx.is_positive_semidefinite, lx.is_negative_semidefinite),
):
    _mark.register(LineaxOperator)(_has_no_mark)


@lx.materialise.register(LineaxOperator)
def _(operator: LineaxOperator) -> lx.PyTreeLinearOperator:
    return lx.PyTreeLinearOperator(operator.as_blocks(), operator.out_structure())


@lx.diagonal.register(LineaxOperator)
def _(operator: LineaxOperator) -> Array:
    return jnp.diag(operator.as_matrix())


@lx.tridiagonal.register(LineaxOperator)
def _(operator: LineaxOperator) -> tuple[Array, Array, Array]:
    return lx.tridiagonal(lx.materialise(operator))
