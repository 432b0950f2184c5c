"""The row-sparse operator: a fixed number of coefficients in every row (Wang 2006 §4.1.1, §4.3)."""

import dataclasses
import functools
from collections.abc import Sequence
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Integer, PyTree

from jaxrelight.operators.contract import Operator
from jaxrelight.operators.multilinear import Multilinear
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
        fixed, values = self._split()
        return _Product(self.row_count, self.columns)(fixed, values, light)

    @jax.jit
    def _apply_many(self, lights: Float[Array, "n d c"]) -> Float[Array, "n r c"]:
        """Gathers each coefficient once for all lights, a few rows at a time."""
        return jax.vmap(self._apply)(lights)

    @jax.jit
    def _transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
        """A scatter-add, block by block. Float32 sums here are serial: rounding grows with rows per coefficient."""
        fixed, values = self._split()
        dtype = jnp.result_type(radiance, *(decoded_type(channel) for channel in self.values))
        light = jax.ShapeDtypeStruct((self.columns, radiance.shape[1]), dtype)
        return _Product(self.row_count, self.columns).partial(1, fixed, (values, None, radiance), light)

    def _split(self) -> tuple[Any, Any]:
        """What is held fixed, indices and codes, and the numbers that products are differentiable in."""
        values, codes = eqx.partition(self.values, eqx.is_inexact_array)
        return (self.indices, codes), values

    @jax.jit
    def _rows(self, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
        """Rows are zero where nothing was kept."""
        kept, channels = jax.tree.map(lambda x: x.reshape(-1, x.shape[-1])[indices], (self.indices, self.values))
        kept, values = kept.astype(jnp.int32), jnp.stack([decoded(channel) for channel in channels], axis=1)
        empty = jnp.zeros((*values.shape[:2], self.columns), values.dtype)
        return jax.vmap(lambda row, i, v: row.at[:, i].add(v))(empty, kept, values)


@dataclasses.dataclass(frozen=True)
class _Product(Multilinear):
    """Rows times light: linear in the values, the light and the radiance of the rows."""

    row_count: int
    columns: int

    def product(self, fixed: PyTree, values: PyTree, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        """Radiance, by a gather of light and a short sum for each row."""
        channels = range(light.shape[1])
        # One contiguous vector of light for each channel.
        by_channel = tuple(light[:, c] for c in channels)

        def block(part):
            indices, values = _decoded_block(part)
            gathered = [by_channel[c].at[indices].get(mode="promise_in_bounds") for c in channels]
            return jnp.stack([_sum(values[c % len(values)] * gathered[c]) for c in channels])

        products = jax.lax.map(block, _blocks_of(fixed, values))
        # blocks b, channels c, rows m of a block
        return jnp.moveaxis(products, 1, 2).reshape(-1, len(channels))[: self.row_count]

    def adjoint(self, number: int, fixed: PyTree, arguments: Sequence[PyTree], like: PyTree) -> PyTree:
        """Of light, all channels of a coefficient are added at once, and a block's sums stay in cache."""
        if number != 1:
            return super().adjoint(number, fixed, arguments, like)
        values, _, radiance = arguments
        (b, m, _), channels = fixed[0].shape, radiance.shape[1]
        radiance = jnp.pad(radiance, ((0, b * m - self.row_count), (0, 0))).reshape(b, m, channels)

        def add(light, part):
            indices, values = _decoded_block(part[0])
            by_channel = [values[c % len(values)] * part[1][:, None, c] for c in range(channels)]
            return light.at[indices].add(jnp.stack(by_channel, axis=-1), mode="promise_in_bounds"), None

        blocks = _blocks_of(fixed, values), radiance
        return jax.lax.scan(add, jnp.zeros(like.shape, like.dtype), blocks)[0]

    def product_many(self, number: int, fixed: PyTree, *arguments: PyTree) -> PyTree | None:
        """Many lights share the gathers."""
        values, lights = arguments
        if number != 1 or len(lights) < _MANY:
            return None
        n, _, c = lights.shape
        # Each column is one run of numbers to gather: of c channels and n lights.
        side_by_side = jnp.transpose(lights, (1, 2, 0)).reshape(self.columns, c * n)
        rows = jax.tree.map(lambda x: x.reshape(-1, x.shape[-1]), _blocks_of(fixed, values))
        held = len(rows[0])
        few = min(_FEW, held)

        def some(out, start):
            indices, values = _decoded_block(jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, start, few), rows))
            gathered = side_by_side.at[indices].get(mode="promise_in_bounds")
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
        dtype = jnp.result_type(lights, *jax.tree.leaves(values))
        out, _ = jax.lax.scan(some, jnp.zeros((n, held, c), dtype), starts)
        return out[:, : self.row_count]


def _blocks_of(fixed: PyTree, values: PyTree) -> Blocks:
    indices, codes = fixed
    return indices, eqx.combine(values, codes)


def _decoded_block(block: Blocks) -> tuple[Int[Array, "m n"], list[Float[Array, "m n"]]]:
    indices, channels = block
    return indices.astype(jnp.int32), [decoded(channel) for channel in channels]


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
