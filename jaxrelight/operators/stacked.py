"""Several operators over the same light, one below the other."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.operators.contract import Operator


class Stacked(Operator):
    """The rows of the first operator, then those of the second, and so on: one for each material."""

    operators: tuple[Operator, ...]

    @property
    def shape(self) -> tuple[int, int, int]:
        """(r, d, c): all rows, and the channels of the one that has most."""
        shapes = [operator.shape for operator in self.operators]
        return sum(r for r, _, _ in shapes), shapes[0][1], max(c for _, _, c in shapes)

    @property
    def nbytes(self) -> int:
        """Bytes of all of them."""
        return sum(operator.nbytes for operator in self.operators)

    @property
    def starts(self) -> list[int]:
        """The first row of each operator, and the end of the last."""
        return [0, *(int(end) for end in np.cumsum([operator.shape[0] for operator in self.operators]))]

    def apply(self, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        """Radiance of every row."""
        return jnp.concatenate([operator.apply(light) for operator in self.operators])

    def apply_many(self, lights: Float[Array, "n d c"]) -> Float[Array, "n r c"]:
        """Radiance of every row under each light."""
        return jnp.concatenate([operator.apply_many(lights) for operator in self.operators], axis=1)

    def transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
        """The adjoint."""
        parts = zip(self.operators, self.starts[:-1], self.starts[1:], strict=True)
        return jnp.sum(jnp.stack([part.transpose(radiance[start:end]) for part, start, end in parts]), axis=0)

    def rows(self, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
        """The chosen rows; an operator of one channel is spread over all. Looks into every operator for every row."""
        _, d, c = self.shape
        out = jnp.zeros((len(indices), c, d))
        for operator, start, end in zip(self.operators, self.starts[:-1], self.starts[1:], strict=True):
            mine = (indices >= start) & (indices < end)
            found = operator.rows(jnp.clip(indices - start, 0, end - start - 1))
            out = jnp.where(mine[:, None, None], found, out)
        return out
