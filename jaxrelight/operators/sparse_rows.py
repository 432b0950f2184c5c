"""The row-sparse operator: a fixed number of coefficients in every row (Wang 2006 §4.1.1, §4.3)."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.operators.contract import Operator

# Rows of a block of the product: what a block gathers should stay in cache.
_BLOCK = 2048


class SparseRows(Operator):
    """n coefficients a row, at indices shared by the channels. Made by `sparse_rows`.

    Rows are held in blocks of m, the last one filled up with zeros. Every channel has an array of its own: a slice of
    a common one would be copied at each use.

    Attributes:
        indices: ascending coefficient numbers, in the smallest unsigned type that holds them.
        values: the coefficients of c channels, or of 1 where the rows are the same in all of them (grey).
        row_count: r, without the filling.
        columns: d, the number of light coefficients.
    """

    indices: Int[Array, "b m n"]
    values: tuple[Float[Array, "b m n"], ...]
    row_count: int = eqx.field(static=True)
    columns: int = eqx.field(static=True)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(r, d, c)."""
        return self.row_count, self.columns, len(self.values)

    def with_filling(self) -> "SparseRows":
        """The same, its filling counted among its rows: of one shape for many row counts."""
        b, m, _ = self.indices.shape
        return SparseRows(self.indices, self.values, b * m, self.columns)

    @property
    def nbytes(self) -> int:
        """Bytes of indices and values."""
        return self.indices.nbytes + sum(channel.nbytes for channel in self.values)

    def apply(self, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        """Radiance of every row: a gather of light and a short sum, block by block."""
        channels = range(light.shape[1])
        if len(self.values) not in (1, len(channels)):
            raise ValueError(f"light has {len(channels)} channels, the operator {len(self.values)}")
        # One contiguous vector of light for each channel.
        by_channel = tuple(light[:, c] for c in channels)

        def block(part):
            indices, values = part[0].astype(jnp.int32), part[1]
            gathered = [by_channel[c].at[indices].get(mode="promise_in_bounds") for c in channels]
            return jnp.stack([jnp.sum(values[c % len(values)] * gathered[c], axis=-1) for c in channels])

        products = jax.lax.map(block, (self.indices, self.values))
        # blocks b, channels c, rows m of a block
        return jnp.moveaxis(products, 1, 2).reshape(-1, len(channels))[: self.row_count]

    def transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
        """The adjoint, by scatter-add. Float32 sums here are serial: rounding grows with rows per coefficient."""
        b, m, _ = self.indices.shape
        indices = self.indices.astype(jnp.int32)
        filled = jnp.pad(radiance, ((0, b * m - self.row_count), (0, 0))).reshape(b, m, 1, -1)
        out = jnp.zeros((self.columns,), jnp.result_type(radiance, self.values[0]))
        sums = [
            out.at[indices].add(self.values[c % len(self.values)] * filled[..., c], mode="promise_in_bounds")
            for c in range(radiance.shape[1])
        ]
        return jnp.stack(sums, axis=-1)

    def rows(self, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
        """The chosen rows, zero where nothing was kept."""
        n = self.indices.shape[-1]
        kept = self.indices.reshape(-1, n)[indices].astype(jnp.int32)
        values = jnp.stack([channel.reshape(-1, n)[indices] for channel in self.values], axis=1)
        empty = jnp.zeros((*values.shape[:2], self.columns), values.dtype)
        return jax.vmap(lambda row, i, v: row.at[:, i].add(v))(empty, kept, values)


def sparse_rows(
    indices: Int[Array | np.ndarray, "r n"], values: Float[Array | np.ndarray, "r c n"], columns: int, held: int = 0
) -> SparseRows:
    """A row-sparse operator over `columns` light coefficients; indices must be below that.

    At least `held` rows are held, those past r filled with zeros, so that operators of many sizes have few shapes.
    NumPy arrays are put into blocks by NumPy, so that nothing is compiled for their shapes.
    """
    r, c, n = values.shape
    held = max(held, r)
    m = min(_BLOCK, held)
    b = -(-held // m)
    host = isinstance(indices, np.ndarray) and isinstance(values, np.ndarray)

    def blocks(rows) -> Array:
        padding = (0, b * m - r), (0, 0)
        return (
            jax.device_put(np.pad(rows, padding).reshape(b, m, n)) if host else jnp.pad(rows, padding).reshape(b, m, n)
        )

    indices = indices.astype(smallest_index_type(columns))
    return SparseRows(blocks(indices), tuple(blocks(values[:, i]) for i in range(c)), r, columns)


def smallest_index_type(columns: int) -> np.dtype:
    """The unsigned integer type for indices below `columns`."""
    return np.dtype(np.uint16 if columns <= 2**16 else np.uint32)
