"""Operators made of others."""

import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrelight.operators.contract import Basis, Operator


class Summed(Operator):
    """The sum of operators of one shape, but for channels: each has one, or as many as the others."""

    operators: tuple[Operator, ...]

    @property
    def shape(self) -> tuple[int, int, int]:
        """(r, d, c): c of the one that has most."""
        r, d, _ = self.operators[0].shape
        return r, d, max(operator.shape[2] for operator in self.operators)

    @property
    def nbytes(self) -> int:
        """Bytes of all of them."""
        return sum(operator.nbytes for operator in self.operators)

    def _apply(self, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        first, *others = (operator.apply(light) for operator in self.operators)
        return sum(others, first)

    def _apply_many(self, lights: Float[Array, "n d c"]) -> Float[Array, "n r c"]:
        first, *others = (operator.apply_many(lights) for operator in self.operators)
        return sum(others, first)

    def _transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
        first, *others = (operator.transpose(radiance) for operator in self.operators)
        return sum(others, first)

    def _rows(self, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
        first, *others = (operator.rows(indices) for operator in self.operators)
        return sum(others, first)


class InBasis(Operator):
    """An operator on coefficients of an orthonormal basis, as one on the numbers that the basis encodes."""

    operator: Operator
    basis: Basis

    @property
    def shape(self) -> tuple[int, int, int]:
        """That of the operator."""
        return self.operator.shape

    @property
    def nbytes(self) -> int:
        """Bytes of the operator."""
        return self.operator.nbytes

    def _apply(self, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        return self.operator.apply(self.basis.encode(light.T).T)

    def _apply_many(self, lights: Float[Array, "n d c"]) -> Float[Array, "n r c"]:
        return self.operator.apply_many(jnp.swapaxes(self.basis.encode(jnp.swapaxes(lights, 1, 2)), 1, 2))

    def _transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
        # Decoding is the transpose of encoding.
        return self.basis.decode(self.operator.transpose(radiance).T).T

    def _rows(self, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
        return self.basis.decode(self.operator.rows(indices))


def parts_of(operator: Operator) -> tuple[Operator, ...]:
    """The operators of a sum; of any other, itself."""
    return operator.operators if isinstance(operator, Summed) else (operator,)
