"""Several operators over the same light, one below the other."""

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.operators.contract import Operator, check_channels


class Stacked(Operator):
    """The rows of the first operator, then those of the second, and so on: one for each material.

    Raises:
        ValueError: for operators of other coefficients than the first, or of other channels, one aside.
    """

    operators: tuple[Operator, ...]

    def __check_init__(self) -> None:
        first = self.operators[0].shape
        for operator in self.operators[1:]:
            if operator.shape[1] != first[1]:
                raise ValueError(f"operators of shapes {first} and {operator.shape} cannot be stacked")
        check_channels("stacked", self.operators)

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

    def _apply(self, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        return jnp.concatenate([operator.apply(light) for operator in self.operators])

    def _apply_many(self, lights: Float[Array, "n d c"]) -> Float[Array, "n r c"]:
        return jnp.concatenate([operator.apply_many(lights) for operator in self.operators], axis=1)

    def _transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
        parts = zip(self.operators, self.starts[:-1], self.starts[1:], strict=True)
        return jnp.sum(jnp.stack([part.transpose(radiance[start:end]) for part, start, end in parts]), axis=0)

    def _rows(self, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
        """Looks up every row in every operator; a row of one channel is the same in all channels of the others."""
        _, d, c = self.shape
        parts = list(zip(self.operators, self.starts[:-1], self.starts[1:], strict=True))
        every = [part.rows(jnp.clip(indices - start, 0, end - start - 1)) for part, start, end in parts]
        rows = jnp.zeros((len(indices), c, d), jnp.result_type(*every))
        for (_, start, end), part_rows in zip(parts, every, strict=True):
            in_part = (indices >= start) & (indices < end)
            rows = jnp.where(in_part[:, None, None], part_rows, rows)
        return rows
