"""The row-sparse operator: a fixed number of coefficients in every row (Wang 2006 §4.1.1, §4.3)."""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Integer

from jaxrelight.operators.contract import Operator
from jaxrelight.operators.quantised import Quantised, decoded, decoded_type

# The most rows of a block of the product: what a block gathers should stay in cache.
_BLOCK = 4096

# The same where there are many lights, and from how many on that is quicker than one light after the other.
_FEW = 32
_MANY = 8

# Indices [b, m, n] in blocks, and such values of each channel.
Blocks = tuple[Any, tuple[Any, ...]]


class SparseRows(Operator):
    """n coefficients a row, at indices shared by the channels. Made by `sparse_rows`.

    Rows are held in blocks of m, as few as can be, the last one filled up with zeros. Every channel has an array of
    its own: a slice of a common one would be copied at each use.

    Attributes:
        indices: ascending coefficient numbers, in the smallest unsigned type that holds them.
        values: the coefficients of c channels, or of 1 where the rows are the same in all of them (grey); as they are,
            or quantised (§4.1.2), to be decoded block by block.
        row_count: r, without the filling.
        columns: d, the number of light coefficients.
    """

    indices: Integer[Array, "*p b m n"]
    values: tuple[Float[Array, "*p b m n"] | Quantised, ...]
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

    @jax.jit
    def _apply(self, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        """For each row a gather of light and a short sum, block by block."""
        channels = range(light.shape[1])
        # One contiguous vector of light for each channel.
        by_channel = tuple(light[:, c] for c in channels)

        def block(part):
            indices, values = part[0].astype(jnp.int32), [decoded(channel) for channel in part[1]]
            gathered = [by_channel[c].at[indices].get(mode="promise_in_bounds") for c in channels]
            return jnp.stack([_sum(values[c % len(values)] * gathered[c]) for c in channels])

        products = jax.lax.map(block, (self.indices, self.values))
        # blocks b, channels c, rows m of a block
        return jnp.moveaxis(products, 1, 2).reshape(-1, len(channels))[: self.row_count]

    @jax.jit
    def _apply_many(self, lights: Float[Array, "n d c"]) -> Float[Array, "n r c"]:
        """Gathers each coefficient once for all lights, a few rows at a time."""
        n, _, c = lights.shape
        if n < _MANY:
            return super()._apply_many(lights)
        # Each column is one run of numbers to gather: of c channels and n lights.
        side_by_side = jnp.transpose(lights, (1, 2, 0)).reshape(self.columns, c * n)
        rows = jax.tree.map(lambda x: x.reshape(-1, x.shape[-1]), (self.indices, self.values))
        held = len(rows[0])
        few = min(_FEW, held)

        def some(out, start):
            indices, channels = jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, start, few), rows)
            gathered = side_by_side.at[indices.astype(jnp.int32)].get(mode="promise_in_bounds")
            values = [decoded(channel) for channel in channels]
            if len(values) == 1:
                radiance = jnp.einsum("ri,ril->rl", values[0], gathered, precision="highest").reshape(few, c, n)
            else:
                apart = gathered.reshape(*indices.shape, c, n)
                by_channel = [
                    jnp.einsum("ri,ril->rl", values[i], apart[:, :, i], precision="highest") for i in range(c)
                ]
                radiance = jnp.stack(by_channel, axis=1)
            return jax.lax.dynamic_update_slice_in_dim(out, jnp.transpose(radiance, (2, 0, 1)), start, axis=1), None

        # The last slice overlaps the one before it, so that nothing has to be cut off, which would copy it.
        starts = np.minimum(np.arange(0, held, few), held - few).astype(np.int32)
        dtype = jnp.result_type(lights, *(decoded_type(channel) for channel in self.values))
        out, _ = jax.lax.scan(some, jnp.zeros((n, held, c), dtype), starts)
        return out[:, : self.row_count]

    @jax.jit
    def _transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
        """A scatter-add. Float32 sums here are serial: rounding grows with rows per coefficient."""
        b, m, _ = self.indices.shape
        indices = self.indices.astype(jnp.int32)
        filled = jnp.pad(radiance, ((0, b * m - self.row_count), (0, 0))).reshape(b, m, 1, -1)
        values = [decoded(channel) for channel in self.values]
        out = jnp.zeros((self.columns,), jnp.result_type(radiance, values[0]))
        sums = [
            out.at[indices].add(values[c % len(values)] * filled[..., c], mode="promise_in_bounds")
            for c in range(radiance.shape[1])
        ]
        return jnp.stack(sums, axis=-1)

    @jax.jit
    def _rows(self, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
        """Rows are zero where nothing was kept."""
        kept, channels = jax.tree.map(lambda x: x.reshape(-1, x.shape[-1])[indices], (self.indices, self.values))
        kept, values = kept.astype(jnp.int32), jnp.stack([decoded(channel) for channel in channels], axis=1)
        empty = jnp.zeros((*values.shape[:2], self.columns), values.dtype)
        return jax.vmap(lambda row, i, v: row.at[:, i].add(v))(empty, kept, values)


def _sum(products: Float[Array, "m n"]) -> Float[Array, " m"]:
    """Sums of rows, as a product with ones: XLA makes the products in one loop then, in two before a sum."""
    return jnp.matmul(products, jnp.ones(products.shape[-1], products.dtype), precision="highest")


def sparse_rows(
    indices: Integer[Array | np.ndarray, "r n"],
    values: Float[Array | np.ndarray, "r c n"] | Quantised,
    columns: int,
    held: int = 0,
) -> SparseRows:
    """A row-sparse operator over `columns` light coefficients; indices must be below that.

    At least `held` rows are held, those past r filled with zeros, so that operators of many sizes have few shapes.
    NumPy arrays are put into blocks by NumPy, so that nothing is compiled for their shapes.
    """
    r = len(indices)
    held = max(held, r)
    b = -(-held // _BLOCK)
    m = -(-held // b)
    host = all(isinstance(array, np.ndarray) for array in jax.tree.leaves((indices, values)))

    if host:
        in_blocks, by_channel = jax.device_put(_blocks(np, indices, values, b, m, columns))
    else:
        in_blocks, by_channel = _compiled_blocks(indices, values, b, m, columns)
    return SparseRows(in_blocks, by_channel, r, columns)


def _blocks(
    xp: Any,
    indices: Integer[Array | np.ndarray, "r n"],
    values: Float[Array | np.ndarray, "r c n"] | Quantised,
    b: int,
    m: int,
    columns: int,
) -> Blocks:
    """Indices, and values of each channel, in b blocks of m rows."""

    def block(rows):
        return xp.pad(rows, ((0, b * m - len(rows)), (0, 0))).reshape(b, m, rows.shape[-1])

    channels = tuple(jax.tree.map(lambda rows, i=i: block(rows[:, i]), values) for i in range(values.shape[1]))
    return block(indices.astype(smallest_index_type(columns))), channels


@functools.partial(jax.jit, static_argnames=("b", "m", "columns"))
def _compiled_blocks(
    indices: Integer[Array, "r n"], values: Float[Array, "r c n"] | Quantised, b: int, m: int, columns: int
) -> Blocks:
    return _blocks(jnp, indices, values, b, m, columns)


def smallest_index_type(columns: int) -> np.dtype:
    """The unsigned integer type for indices below `columns`."""
    return np.dtype(np.uint16 if columns <= 2**16 else np.uint32)
