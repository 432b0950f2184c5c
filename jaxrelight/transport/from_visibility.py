"""Rows over kept coefficients that are baked from visibility at every use: what changes with a material.

What they give is what the stored rows of that material give, had the same coefficients been kept. Visibility is held in
memory, so that the operator is a pytree and everything about it may be traced.
"""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Integer, UInt8

from jaxrelight.brdf.reflection import Reflection
from jaxrelight.errors import InputError
from jaxrelight.files import store
from jaxrelight.geometry.receivers import GROUP, Receivers
from jaxrelight.methods import Transport
from jaxrelight.numerics.arrays import as_array, is_traced
from jaxrelight.operators.clustered import Clustered
from jaxrelight.operators.contract import Basis, Operator
from jaxrelight.operators.sparse_rows import SparseRows
from jaxrelight.transport import bake
from jaxrelight.transport.model import Block, frames_of
from jaxrelight.transport.streamed import Streamed


class FromVisibility(Operator):
    """Visibility × reflection over kept coefficients, group by group, never written out.

    Differentiable in the reflection and in light; visibility and kept sets are held fixed.

    Attributes:
        bits: visibility of all receivers, lowest bit first.
        frames: their tangent frames.
        reflection: theirs; arrays of which each receiver has its own lead with g, m.
        directions: what the bits stand for.
        basis: of the light.
        kept: numbers of the coefficients that count: of each group, or of each row; those beyond the last are filling.
            None for all of them.
    """

    bits: UInt8[Array, "g m bytes"]
    frames: Float[Array, "g m 3 3"]
    reflection: Reflection
    directions: bake.Directions
    basis: Basis
    kept: Int[Array, "g n"] | Integer[Array, "g m k n"] | None

    @property
    def shape(self) -> tuple[int, int, int]:
        """(r, d, c), rows in the order group, receiver, term."""
        groups, m = self.frames.shape[:2]
        return groups * m * self.reflection.terms, self.basis.size, self.reflection.channels

    @property
    def nbytes(self) -> int:
        """Bytes of visibility and kept sets."""
        return self.bits.nbytes + (0 if self.kept is None else self.kept.nbytes)

    @jax.jit
    def _apply(self, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        own, shared = eqx.partition(self.reflection, self.reflection.per_receiver)
        by_channel = light.T

        def group(part):
            bits, frames, own, kept = part
            given = bits, frames, eqx.combine(own, shared), self.directions
            if kept is not None and kept.ndim == 3:
                return bake.bake_kept_and_apply(*given, self.basis, light, kept)
            texels = self.basis.decode(by_channel) if kept is None else bake.kept_light(self.basis, by_channel, kept)
            return bake.bake_and_apply(*given, texels.T)

        terms = jax.lax.map(group, (self.bits, self.frames, own, self.kept))
        return terms.reshape(-1, light.shape[1])

    @jax.jit
    def _transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
        still = jnp.zeros((self.shape[1], radiance.shape[1]), radiance.dtype)
        return jax.vjp(self._apply, still)[1](radiance)[0]

    @jax.jit
    def _rows(self, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
        """Each row is the adjoint of a one among zeros: for few rows, and for tests."""
        rows, _, channels = self.shape

        def row(index):
            one = jnp.zeros((rows, channels), self.frames.dtype).at[index].set(1)
            return self._transpose(one).T

        return jax.lax.map(row, indices)


def from_visibility(
    operator: Operator,
    reflection: Reflection,
    block: Block,
    visibility: store.Layer,
    receivers: Receivers,
    method: Transport,
    basis: Basis,
) -> FromVisibility:
    """The direct light of one block by another reflection, over the coefficients that its operator keeps.

    Args:
        operator: of direct light; one that is of this kind already is taken as it is, but for the reflection.
        reflection: of as many terms as the block's.
        block: whose receivers they are.
        visibility: the layer of visibility bits.
        receivers: all of them.
        method: the dials of the store.
        basis: of the light.

    Raises:
        InputError: for a traced operator whose kept coefficients are not known, or rows that are spread over devices.
    """
    if isinstance(operator, FromVisibility):
        return eqx.tree_at(lambda of: of.reflection, operator, reflection)
    if is_traced(operator):
        raise InputError(
            "rows of a prepared scene that is traced cannot be baked anew; call with_materials once outside of jit, "
            "with any materials of the same kinds, and hand its result to the compiled function"
        )
    groups = block.groups
    bits = as_array(np.stack([visibility.read("bits", int(group)) for group in groups]))
    directions = bake.directions_for(method.resolution, method.samples_per_side)
    return FromVisibility(
        bits,
        as_array(frames_of(receivers, groups)),
        reflection,
        directions,
        basis,
        _kept_by(operator, len(groups), reflection.terms, basis.size),
    )


def _kept_by(operator: Operator, groups: int, terms: int, columns: int) -> Array | None:
    if isinstance(operator, Streamed):
        return None
    if isinstance(operator, SparseRows):
        n = operator.indices.shape[-1]
        rows = np.asarray(operator.indices).reshape(-1, n)[: operator.row_count]
        return as_array(rows.reshape(groups, GROUP, terms, n))
    if not isinstance(operator, Clustered):
        raise InputError(f"rows of {type(operator).__name__} cannot be baked anew; change materials before 'sharded'")
    supports = operator.supports()
    kept = np.full((groups, max(1, max(map(len, supports)))), columns, np.int32)
    for group, support in enumerate(supports):
        kept[group, : len(support)] = support
    return as_array(kept)
