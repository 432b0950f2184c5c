"""Columns in blocks of an image, of which those are left out that light hardly reaches (Hašan 2006 §5)."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.buckets import bucket
from jaxrelight.operators.clustered import Cluster
from jaxrelight.operators.contract import check_light
from jaxrelight.operators.quantised import Quantised, quantised

# This many blocks of a group are added up at once; where fewer are left over, empty blocks fill up.
_BLOCKS_PER_SUM = 8


class ColumnBlocks:
    """A block for every coefficient and every group of rows that it reaches: that part of its column, in codes.

    A product takes the blocks that it needs by the light of the moment, on the host, and adds up those alone; so it is
    not for inside a compiled function. `Clustered` has fewer numbers to read than even the blocks that are left.

    Attributes:
        shape: (r, d, c), as of an `Operator`.
        count: number of blocks.
    """

    def __init__(self, clusters: Sequence[Cluster], columns: int, bits: int = 8):
        """Writes out the blocks of the groups.

        Args:
            clusters: one for each group of rows.
            columns: d, the number of light coefficients.
            bits: size of a code.
        """
        channels, _, rows = clusters[0].weights.shape
        self.shape = len(clusters) * rows, columns, channels
        written = [np.einsum("cqr,qs->scr", one.weights, one.basis, optimize=True) for one in clusters]
        self._support = np.concatenate([one.support for one in clusters]).astype(np.int32)
        self._group = np.repeat(np.arange(len(clusters), dtype=np.int32), [len(one.support) for one in clusters])
        tiles = np.concatenate(written).astype(np.float32).reshape(len(self._support), channels * rows)
        # The last block is empty: it fills up sums of fewer blocks.
        tiles = np.concatenate([tiles, np.zeros((1, channels * rows), np.float32)])
        self.count, self._size = len(self._support), np.linalg.norm(tiles, axis=1)
        self._tiles: Quantised = jax.device_put(quantised(tiles, bits))

    @property
    def nbytes(self) -> int:
        """Bytes of codes, scales, and what is known of each block: its column, group and size."""
        known = self._support, self._group, self._size
        return sum(array.nbytes for array in (*jax.tree.leaves(self._tiles), *known))

    def apply(self, light: Float[Array, "d c"], culling: float = 0.0) -> tuple[Float[Array, "r c"], int]:
        """Radiance of every row, and how many blocks it took.

        Args:
            light: coefficients.
            culling: ε: a block is left out where what it would add, |light| times its size, is less than this times
                the root-mean-square over all blocks.

        Raises:
            ValueError: for light of another shape than the operator takes.
        """
        check_light(light, self.shape)
        strength = np.abs(np.asarray(light)).max(axis=1)
        added = strength[self._support] * self._size[:-1]
        chosen = np.arange(self.count)
        if culling > 0:
            chosen = np.flatnonzero(added > culling * np.sqrt(np.mean(added**2)))
        few, group = self._by_group(chosen)
        column = np.append(self._support, 0)[few]
        few, column, group = (as_array(numbers) for numbers in (few, column, group))
        return _added(self._tiles, light, few, column, group, self.shape), len(chosen)

    def _by_group(self, chosen: Int[np.ndarray, " n"]) -> tuple[Int[np.ndarray, "b t"], Int[np.ndarray, " b"]]:
        """Blocks in lines, a few of the same group in each, and the lines' groups; the number of lines is bucketed."""
        groups = self.shape[0] * self.shape[2] // self._tiles.codes.shape[1]
        counts = np.bincount(self._group[chosen], minlength=groups)
        lines = -(-counts // _BLOCKS_PER_SUM)
        total = bucket(max(int(lines.sum()), 1), 256)
        few = np.full((total, _BLOCKS_PER_SUM), self.count)
        first_line, first = np.cumsum(lines) - lines, np.cumsum(counts) - counts
        own = self._group[chosen]
        nth = np.arange(len(chosen)) - first[own]
        few[first_line[own] + nth // _BLOCKS_PER_SUM, nth % _BLOCKS_PER_SUM] = chosen
        group = np.full(total, groups - 1)
        group[: lines.sum()] = np.repeat(np.arange(groups), lines)
        return few.astype(np.int32), group.astype(np.int32)


@eqx.filter_jit
def _added(
    tiles: Quantised,
    light: Float[Array, "d c"],
    few: Int[Array, "b t"],
    column: Int[Array, "b t"],
    group: Int[Array, " b"],
    shape: tuple[int, int, int],
) -> Float[Array, "r c"]:
    r, _, channels = shape
    factors = light.at[column].get(mode="promise_in_bounds") * tiles.scale[few]
    width = tiles.codes.shape[1] // channels
    codes = tiles.codes[few].reshape(*few.shape, channels, width)
    out = light.shape[1]
    by_channel = [jnp.sum(codes[:, :, min(c, channels - 1)] * factors[:, :, c, None], axis=1) for c in range(out)]
    lines = jnp.stack(by_channel, axis=2)
    sums = jax.ops.segment_sum(lines, group, num_segments=r // width, indices_are_sorted=True)
    return sums.reshape(r, out)
