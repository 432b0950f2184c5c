"""The operator with every coefficient: the reference that the others are tested against."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrelight.operators.contract import Operator


class Dense(Operator):
    """A whole matrix for each channel."""

    matrix: Float[Array, "r c d"]

    @property
    def shape(self) -> tuple[int, int, int]:
        """(r, d, c)."""
        r, c, d = self.matrix.shape
        return r, d, c

    @property
    def nbytes(self) -> int:
        """Bytes of the matrix."""
        return self.matrix.nbytes

    @jax.jit
    def _apply(self, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        return jnp.einsum("rcd,dc->rc", self.matrix, light, precision="highest")

    @jax.jit
    def _transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
        return jnp.einsum("rcd,rc->dc", self.matrix, radiance, precision="highest")

    @jax.jit
    def _rows(self, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
        return self.matrix[indices]
