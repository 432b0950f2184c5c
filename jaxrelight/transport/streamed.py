"""The exact operator: rows are baked from visibility when they are needed and never stored."""

from collections.abc import Callable, Iterator

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float, Int, UInt8

from jaxrelight.basis.cubemap import Texels
from jaxrelight.brdf.reflection import Reflection, of_group
from jaxrelight.numerics.arrays import as_array
from jaxrelight.operators.contract import Operator
from jaxrelight.transport import bake

# Visibility bits, tangent frames and reflection of one group, and the directions that the bits stand for.
BakeInputs = tuple[UInt8[Array, "m bytes"], Float[Array, "m 3 3"], Reflection, bake.Directions]


class Streamed(Operator):
    """Visibility × reflection over all texels, group by group: what every compressed operator approximates.

    Attributes:
        read_bits: gives the visibility bits [m, bytes] of a group; from a store or from memory.
        frames: tangent frames of groups of m receivers.
        reflection: of all receivers; arrays of which each has its own lead with g, m.
        directions: what the bits stand for.
    """

    read_bits: Callable[[int], UInt8[np.ndarray, "m bytes"]] = eqx.field(static=True)
    frames: Float[Array, "g m 3 3"]
    reflection: Reflection
    directions: bake.Directions

    @property
    def shape(self) -> tuple[int, int, int]:
        """(r, d, c), rows in the order group, receiver, term."""
        groups, m = self.frames.shape[:2]
        f, s = len(self.directions.vectors), self.directions.samples
        return groups * m * self.reflection.terms, f // s**2, self.reflection.channels

    @property
    def nbytes(self) -> int:
        """Bytes of the visibility that it reads at every use."""
        return self.frames.shape[0] * self.frames.shape[1] * len(self.directions.vectors) // 8

    def _group(self, group: int) -> BakeInputs:
        """What a group's rows are baked from."""
        bits = as_array(self.read_bits(group))
        return bits, self.frames[group], of_group(self.reflection, group), self.directions

    def _groups(self) -> Iterator[BakeInputs]:
        return (self._group(group) for group in range(len(self.frames)))

    def _apply(self, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        c = light.shape[1]
        return jnp.concatenate([bake.bake_and_apply(*group, light).reshape(-1, c) for group in self._groups()])

    def _transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
        m, k, c = self.frames.shape[1], self.reflection.terms, radiance.shape[1]
        blocks = radiance.reshape(-1, m, k, c)
        parts = [bake.bake_and_transpose(*group, block) for group, block in zip(self._groups(), blocks, strict=True)]
        return jnp.sum(jnp.stack(parts), axis=0)

    def _rows(self, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
        """Bakes the groups that rows lie in, each once; all groups where indices are traced, and so not known."""
        _, d, c = self.shape
        per_group = self.frames.shape[1] * self.reflection.terms
        texels = Texels(round((d / 6) ** 0.5))

        def baked(group: int) -> Float[Array, "n c d"]:
            return bake.bake_rows(*self._group(group), texels).reshape(per_group, c, d)

        if isinstance(indices, Tracer) or not len(indices):
            rows = jnp.zeros((len(indices), c, d), self.frames.dtype)
            for group in range(len(self.frames)):
                mine = indices // per_group == group
                rows = jnp.where(mine[:, None, None], baked(group)[indices % per_group], rows)
            return rows
        group_of, row_of = np.divmod(np.asarray(indices), per_group)
        chosen: dict[int, Float[Array, "c d"]] = {}
        for group in np.unique(group_of):
            of_this = baked(int(group))
            chosen |= {int(i): of_this[int(row_of[i])] for i in np.flatnonzero(group_of == group)}
        return jnp.stack([chosen[i] for i in range(len(indices))])
