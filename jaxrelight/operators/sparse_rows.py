"""The row-sparse operator: a fixed number of coefficients in every row (Wang 2006 §4.1.1, §4.3)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from jaxrelight.operators.contract import Operator

# Rows of one block of the product. Gathered light of a block stays in cache; measured best of 256 … 4,096.
_BLOCK = 2048


class SparseRows(Operator):
    """n coefficients a row, at indices shared by the channels.

    Attributes:
        indices: ascending coefficient numbers, in the smallest unsigned type that holds them.
        values: the coefficients, for c channels, or for 1 where the rows are the same in all of them (grey).
        columns: d, the number of light coefficients.
    """

    indices: Int[Array, "r n"]
    values: Float[Array, "r c n"]
    columns: int = eqx.field(static=True)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(r, d, c)."""
        return self.values.shape[0], self.columns, self.values.shape[1]

    @property
    def nbytes(self) -> int:
        """Bytes of indices and values."""
        return self.indices.nbytes + self.values.nbytes

    def apply(self, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        """Radiance of every row: a gather of light and a short sum, block by block."""
        # One contiguous vector of light for each channel.
        by_channel = light.T

        def block(rows):
            indices, values = rows
            indices = indices.astype(jnp.int32)
            products = []
            for c, channel in enumerate(by_channel):
                gathered = channel.at[indices].get(mode="promise_in_bounds")
                products.append(jnp.sum(values[:, c % values.shape[1]] * gathered, axis=-1))
            return jnp.stack(products, axis=-1)

        r = self.values.shape[0]
        whole = r - r % _BLOCK
        parts = []
        if whole:
            blocks = jax.tree.map(lambda x: x[:whole].reshape(-1, _BLOCK, *x.shape[1:]), (self.indices, self.values))
            parts.append(jax.lax.map(block, blocks).reshape(whole, -1))
        if whole < r:
            parts.append(block((self.indices[whole:], self.values[whole:])))
        return jnp.concatenate(parts) if len(parts) > 1 else parts[0]

    def transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
        """The adjoint, by scatter-add. Float32 sums here are serial: rounding grows with rows per coefficient."""
        c = radiance.shape[1]
        values = jnp.broadcast_to(self.values, (self.values.shape[0], c, self.values.shape[2]))
        products = jnp.moveaxis(values * radiance[:, :, None], 1, -1)
        out = jnp.zeros((self.columns, c), products.dtype)
        return out.at[self.indices.astype(jnp.int32)].add(products, mode="promise_in_bounds")

    def rows(self, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
        """The chosen rows, zero where nothing was kept."""
        kept, values = self.indices[indices].astype(jnp.int32), self.values[indices]
        empty = jnp.zeros((*values.shape[:2], self.columns), values.dtype)
        return jax.vmap(lambda row, i, v: row.at[:, i].add(v))(empty, kept, values)


def smallest_index_type(columns: int):
    """The unsigned integer type for indices below `columns`."""
    return jnp.uint16 if columns <= 2**16 else jnp.uint32
