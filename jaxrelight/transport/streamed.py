"""The exact operator: rows are baked from visibility when they are needed and never stored."""

from collections.abc import Callable

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt8

from jaxrelight.basis.cubemap import Texels
from jaxrelight.brdf.reflection import Reflection, of_group
from jaxrelight.numerics.arrays import as_array
from jaxrelight.operators.contract import Operator
from jaxrelight.transport import bake


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

    def _groups(self):
        for group in range(len(self.frames)):
            bits = as_array(self.read_bits(group))
            yield bits, self.frames[group], of_group(self.reflection, group), self.directions

    def apply(self, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        """Radiance of every row."""
        c = light.shape[1]
        return jnp.concatenate([bake.bake_and_apply(*group, light).reshape(-1, c) for group in self._groups()])

    def transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
        """The adjoint."""
        m, k, c = self.frames.shape[1], self.reflection.terms, radiance.shape[1]
        blocks = radiance.reshape(-1, m, k, c)
        parts = [bake.bake_and_transpose(*group, block) for group, block in zip(self._groups(), blocks, strict=True)]
        return jnp.sum(jnp.stack(parts), axis=0)

    def rows(self, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
        """The chosen rows. Bakes the groups that they lie in."""
        _, d, c = self.shape
        per_group = self.frames.shape[1] * self.reflection.terms
        out = []
        for index in np.asarray(indices):
            group = int(index) // per_group
            bits, frames = as_array(self.read_bits(group)), self.frames[group]
            baked = bake.bake_rows(
                bits, frames, of_group(self.reflection, group), self.directions, Texels(round((d / 6) ** 0.5))
            )
            out.append(baked.reshape(per_group, c, d)[int(index) % per_group])
        return jnp.stack(out)
