"""The clustered operator: rows of near receivers as mixtures of a few (Sloan et al. 2003; Liu et al. 2004)."""

import collections
import dataclasses
import math
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int, Integer, PyTree

from jaxrelight.operators.contract import Operator
from jaxrelight.operators.multilinear import Multilinear
from jaxrelight.operators.quantised import Quantised, decoded, decoded_type, quantised
from jaxrelight.operators.sparse_rows import smallest_index_type

# Numbers that buckets may be filled up with to have one bucket less: reading them takes as long as what it costs.
_FILLING = 2**16

# Groups of a step of the product with many lights: what a step gathers should stay in cache.
_GROUP_BATCH = 4
# Terms of a sum that are written out, so that what is next to each other in memory is worked on at once: a sum over
# neighbours would be made one by one, which takes eight times as long.
_WRITTEN_OUT = 16


class Cluster(NamedTuple):
    """The rows of one group, weights · basis on s coefficients and 0 elsewhere. Made by `clustering.cluster`.

    Attributes:
        support: numbers of the coefficients, ascending.
        basis: the q shared rows over them, of all channels.
        weights: of each of the r rows, by channel.
    """

    support: Int[np.ndarray, " s"]
    basis: Float[np.ndarray, "q s"]
    weights: Float[np.ndarray, "c q r"]


class Bucket(eqx.Module):
    """Clusters of about the same size, filled up with zeros to the same.

    Attributes:
        groups: whose rows they are, ascending.
        support: as in `Cluster`.
        basis: as in `Cluster`; quantised, each coefficient has a scale.
        weights: as in `Cluster`; quantised, each shared row has a scale in each channel.
    """

    groups: Int[Array, "*p b"]
    support: Integer[Array, "*p b s"]
    basis: Float[Array, "*p b q s"] | Quantised
    weights: Float[Array, "*p b c q r"] | Quantised


class Clustered(Operator):
    """Groups of r rows, each the product of weights and q shared rows, over s coefficients that the group shares.

    Where a row of n coefficients of its own gathers n numbers of light, a group of r rows gathers s, once: what follows
    is two dense products, of q·s and of q·r for every channel. Groups of no energy hold nothing. Made by `clustered`.

    Attributes:
        buckets: all clusters.
        place: of each group among the clusters of all buckets; past their end where the group holds nothing.
        holders: the places of coefficients among the supports of all buckets, one after the other, a row for each
            column; the columns of about as many holders in one array, filled up with the supports' end.
        column_place: of each column among the rows of all `holders`; past their end where no group holds it.
        group_rows: r.
        channels: c; 1 where rows are the same in all of them (grey).
        columns: d, the number of light coefficients.
    """

    buckets: tuple[Bucket, ...]
    place: Int[Array, "*p g"]
    holders: tuple[Int[Array, "*p _ _"], ...]
    column_place: Int[Array, "*p d"]
    group_rows: int = eqx.field(static=True)
    channels: int = eqx.field(static=True)
    columns: int = eqx.field(static=True)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(r, d, c)."""
        return len(self.place) * self.group_rows, self.columns, self.channels

    def with_filling(self, groups: int) -> "Clustered":
        """The same, followed by groups of nothing up to a number: of one shape for many numbers of groups."""
        end = sum(len(part.groups) for part in self.buckets)
        place = jnp.pad(self.place, (0, groups - len(self.place)), constant_values=end)
        return eqx.tree_at(lambda one: one.place, self, place)

    @property
    def nbytes(self) -> int:
        """Bytes of all arrays, with their filling."""
        return sum(array.nbytes for array in jax.tree.leaves(self))

    def supports(self) -> list[Int[np.ndarray, " s"]]:
        """The coefficients of each group, on the host; none where it holds nothing."""
        supports: list[np.ndarray] = [np.zeros(0, int)] * len(self.place)
        for part in self.buckets:
            for group, support in zip(np.asarray(part.groups), np.asarray(part.support), strict=True):
                # Ascending, then filled up with zeros.
                supports[group] = support[: 1 + np.count_nonzero(support[1:])].astype(int)
        return supports

    def clusters(self) -> list[Cluster]:
        """Each group by itself, on the host, in floating point and without filling."""
        nothing = np.zeros((0, 0), np.float32), np.zeros((self.channels, 0, self.group_rows), np.float32)
        supports = self.supports()
        clusters = [Cluster(support, *nothing) for support in supports]
        for part in self.buckets:
            basis, weights = (
                np.asarray(_basis_of(part, jnp.arange(len(part.groups)))),
                np.asarray(decoded(part.weights)),
            )
            for i, group in enumerate(np.asarray(part.groups)):
                group_basis = basis[i, :, : len(supports[group])]
                used = group_basis.any(axis=1)
                clusters[group] = Cluster(supports[group], group_basis[used], weights[i][:, used])
        return clusters

    @jax.jit
    def _apply(self, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        """Per group one gather of light and two small products."""
        fixed, bases, weights = self._split()
        return self._product(fixed, bases, weights, light)

    @jax.jit
    def _apply_many(self, lights: Float[Array, "n d c"]) -> Float[Array, "n r c"]:
        """Products of matrices, a few groups at a time."""
        return jax.vmap(self._apply)(lights)

    @jax.jit
    def _transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
        """The two products the other way round; every column is a sum over its holders."""
        fixed, bases, weights = self._split()
        light = jax.ShapeDtypeStruct((self.columns, radiance.shape[1]), jnp.result_type(radiance, self._dtype))
        return self._product.partial(2, fixed, (bases, weights, None, radiance), light)

    @property
    def _product(self) -> "_Product":
        return _Product(self.group_rows, self.columns)

    def _split(self) -> tuple["Clustered", Any, Any]:
        """The operator with what is held fixed alone, and the numbers of bases and weights."""
        numbers, fixed = eqx.partition(self, eqx.is_inexact_array)
        return fixed, [part.basis for part in numbers.buckets], [part.weights for part in numbers.buckets]

    @property
    def _dtype(self) -> np.dtype:
        """The precision of rows; single where no group holds anything."""
        numbers = [decoded_type(array) for part in self.buckets for array in (part.basis, part.weights)]
        return jnp.result_type(*numbers) if numbers else np.dtype(np.float32)

    @jax.jit
    def _rows(self, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
        """Rows are zero off their group's coefficients. Every row is looked up in every bucket."""
        place, row = self.place[indices // self.group_rows], indices % self.group_rows
        out, start = jnp.zeros((len(indices), self.channels, self.columns), self._dtype), 0
        for part in self.buckets:
            b = len(part.groups)
            in_bucket, i = (place >= start) & (place < start + b), jnp.clip(place - start, 0, b - 1)
            values = jnp.einsum("icq,iqs->ics", _weights_of(part, i, row), _basis_of(part, i), precision="highest")
            written = jax.vmap(lambda support, v: jnp.zeros((v.shape[0], self.columns), v.dtype).at[:, support].add(v))
            out = jnp.where(in_bucket[:, None, None], written(part.support[i].astype(jnp.int32), values), out)
            start += b
        return out


@dataclasses.dataclass(frozen=True)
class _Product(Multilinear):
    """Weights · basis · light: linear in each of the three, and in the radiance of the rows."""

    group_rows: int
    columns: int

    def product(self, fixed: PyTree, bases: PyTree, weights: PyTree, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        """Radiance: per group one gather of light and two small products."""
        channels = light.shape[1]
        nothing = jnp.zeros((1, self.group_rows, channels), light.dtype)
        mixed = jnp.concatenate(
            [*(_by_channel(part, light) for part in _joined_buckets(fixed, bases, weights)), nothing]
        )
        return mixed.at[fixed.place].get(mode="promise_in_bounds").reshape(-1, channels)

    def adjoint(self, number: int, fixed: PyTree, arguments: Sequence[PyTree], like: PyTree) -> PyTree:
        """Of light, the sum over the holders of a column is in parallel, and as accurate as any.

        A scatter from the supports is neither.
        """
        if number != 2:
            return super().adjoint(number, fixed, arguments, like)
        bases, weights, _, radiance = arguments
        channels = radiance.shape[1]
        by_group = jnp.moveaxis(radiance.reshape(-1, self.group_rows, channels), 2, 1)
        products = []
        for part in _joined_buckets(fixed, bases, weights):
            group_radiance = by_group.at[part.groups].get(mode="promise_in_bounds")
            back = _mixtures(_of_one_channel(part.basis), _products(part.weights, group_radiance))
            products.append(jnp.moveaxis(back, 1, 0).reshape(channels, -1))
        held = jnp.concatenate([*products, jnp.zeros((channels, 1), radiance.dtype)], axis=1)
        return jnp.stack([_sums(fixed, held[c]) for c in range(channels)], axis=-1)

    def product_many(self, number: int, fixed: PyTree, *arguments: PyTree) -> PyTree | None:
        """Products of matrices, a few groups at a time, to stay in cache.

        Light is multiplied with the shared rows in all channels at once, and with the weights in each.
        """
        if number != 2:
            return None
        bases, weights, lights = arguments
        n, _, channels = lights.shape
        # Each column is one run of numbers to gather: of c channels and n lights.
        side_by_side = jnp.transpose(lights, (1, 2, 0)).reshape(self.columns, channels * n)
        dtype = jnp.result_type(lights, *jax.tree.leaves((bases, weights)))
        out = jnp.zeros((n, len(fixed.place), self.group_rows, channels), dtype)
        for part in _joined_buckets(fixed, bases, weights):
            b = len(part.groups)
            few = min(_GROUP_BATCH, b)

            def some(out, start, part=part, few=few):
                chosen = jax.tree.map(lambda x: jax.lax.dynamic_slice_in_dim(x, start, few), part)
                radiance = jax.vmap(lambda group: _at_once(group, side_by_side, channels))(chosen)
                # Radiance is written where it belongs at once: all of it is larger than the operator, and slow to move.
                for i in range(few):
                    out = jax.lax.dynamic_update_slice_in_dim(out, radiance[i][:, None], chosen.groups[i], axis=1)
                return out, None

            # The last ones overlap those before, so that no bucket is cut, which would copy it.
            out, _ = jax.lax.scan(some, out, np.minimum(np.arange(0, b, few), b - few).astype(np.int32))
        return out.reshape(n, -1, channels)


def _joined_buckets(fixed: PyTree, bases: PyTree, weights: PyTree) -> list[Bucket]:
    """Buckets of what is held fixed and of numbers."""
    parts = zip(fixed.buckets, bases, weights, strict=True)
    return [
        Bucket(one.groups, one.support, *eqx.combine((one.basis, one.weights), (basis, of))) for one, basis, of in parts
    ]


def _sums(fixed: Clustered, held: Float[Array, " e"]) -> Float[Array, " d"]:
    """Sums what the holders of every column hold, as products with ones; see `SparseRows`."""
    sums = []
    for places in fixed.holders:
        gathered = held.at[places].get(mode="promise_in_bounds")
        sums.append(jnp.matmul(gathered, jnp.ones(places.shape[1], held.dtype), precision="highest"))
    sums.append(jnp.zeros(1, held.dtype))
    return jnp.concatenate(sums).at[fixed.column_place].get(mode="promise_in_bounds")


def _by_channel(part: Bucket, light: Float[Array, "d c"]) -> Float[Array, "b r c"]:
    """The rows' radiance, channels apart: products with vectors read matrices at the speed of memory."""
    support, is_real = part.support.astype(jnp.int32), _is_real(part.support)
    gathered = [
        jnp.where(is_real, light[:, c].at[support].get(mode="promise_in_bounds"), 0) for c in range(light.shape[1])
    ]
    shared = _products(_of_one_channel(part.basis), jnp.stack(gathered, axis=1))
    return jnp.moveaxis(_mixtures(part.weights, shared), 1, 2)


def _at_once(part: Bucket, lights: Float[Array, "d cn"], channels: int) -> Float[Array, "n r c"]:
    """Radiance of the rows of one group, a bucket without its first axis, under many lights."""
    basis = decoded(part.basis)
    gathered = lights.at[part.support.astype(jnp.int32)].get(mode="promise_in_bounds")
    gathered = jnp.where(_is_real(part.support)[:, None], gathered, 0)
    shared = jnp.matmul(basis, gathered, precision="highest").reshape(len(basis), channels, -1)
    weights = decoded(part.weights)
    if len(weights) == 1:
        mixed = jnp.einsum("qcl,qr->clr", shared, weights[0], precision="highest")
    else:
        mixed = jnp.einsum("qcl,cqr->clr", shared, weights, precision="highest")
    return jnp.moveaxis(mixed, 0, 2)


def _is_real(support: Integer[Array, "*b s"]) -> Bool[Array, "*b s"]:
    """Which places are no filling: no light reaches that, so that nothing depends on the numbers that lie there."""
    first = jnp.arange(support.shape[-1]) == 0
    return (support > 0) | jnp.broadcast_to(first, support.shape)


def _of_one_channel(basis: Float[Array, "b i n"] | Quantised) -> Float[Array, "b 1 i n"] | Quantised:
    return jax.tree.map(lambda x: x[:, None], basis)


def _products(rows: Float[Array, "b k i n"] | Quantised, x: Float[Array, "b c n"]) -> Float[Array, "b c i"]:
    """Products of rows, the same for all channels where k = 1, with a vector for each channel.

    Codes are taken as they are read; a product of matrices would have them decoded in memory.
    """
    codes, by_row, by_column = _scaled(rows)
    *_, i, n = codes.shape
    steps = math.gcd(n, _WRITTEN_OUT)
    parts = codes.reshape(*codes.shape[:2], i, steps, n // steps)
    light = (x * by_column).reshape(*x.shape[:2], steps, n // steps)
    sums = sum(parts[:, :, :, k] * light[:, :, None, k] for k in range(steps))
    # Else both sums become one again.
    sums = jax.lax.optimization_barrier(sums)
    return jnp.matmul(sums, jnp.ones(n // steps, x.dtype), precision="highest") * by_row


def _mixtures(rows: Float[Array, "b k i n"] | Quantised, x: Float[Array, "b c i"]) -> Float[Array, "b c n"]:
    """Sums of rows, the same for all channels where k = 1, each times a number for each channel."""
    codes, by_row, by_column = _scaled(rows)
    x = x * by_row
    return sum(codes[:, :, k] * x[:, :, k, None] for k in range(codes.shape[2])) * by_column


def _scaled(rows: Float[Array, "b k i n"] | Quantised) -> tuple[Any, Any, Any]:
    """Codes and factors on their rows [b, k, i] and columns [b, k, n], of which one is 1."""
    if not isinstance(rows, Quantised):
        return rows, 1.0, 1.0
    if rows.scale.shape[-1] == 1:
        return rows.codes, rows.scale[..., 0], 1.0
    return rows.codes, 1.0, rows.scale[..., 0, :]


def _basis_of(part: Bucket, i: Int[Array, " i"]) -> Float[Array, "i q s"]:
    return decoded(jax.tree.map(lambda x: x[i], part.basis))


def _weights_of(part: Bucket, i: Int[Array, " i"], row: Int[Array, " i"]) -> Float[Array, "i c q"]:
    weights = part.weights
    if isinstance(weights, Quantised):
        return jnp.multiply(weights.codes[i, :, :, row], weights.scale[i, :, :, 0])
    return weights[i, :, :, row]


def clustered(clusters: Sequence[Cluster], columns: int) -> Clustered:
    """The operator of groups that each are a cluster, over `columns` light coefficients.

    Clusters of about the same size are filled up to the same; groups of no shared row are left out. Put together by
    NumPy.
    """
    c, _, r = clusters[0].weights.shape
    members = collections.defaultdict(list)
    for group, (_, basis, _) in enumerate(clusters):
        if len(basis):
            members[_multiple(basis.shape[1], 32), _multiple(len(basis), 4)].append(group)
    place, buckets, start = np.full(len(clusters), -1, np.int32), [], 0
    held: list[np.ndarray] = []
    for (s, q), groups in sorted(_joined(members, c * r).items()):
        b = len(groups)
        support = np.zeros((b, s), smallest_index_type(columns))
        basis, weights = np.zeros((b, q, s), np.float32), np.zeros((b, c, q, r), np.float32)
        # Padding belongs to no column.
        column = np.full((b, s), columns)
        for i, group in enumerate(sorted(groups)):
            source = clusters[group]
            n, m = len(source.support), len(source.basis)
            support[i, :n], basis[i, :m, :n], weights[i, :, :m] = source
            column[i, :n] = source.support
            place[group] = start + i
        held.append(column.reshape(-1))
        buckets.append(Bucket(*jax.device_put((np.array(sorted(groups), np.int32), support, basis, weights))))
        start += b
    place[place < 0] = start
    holders, column_place = find_holders(np.concatenate([np.zeros(0, int), *held]), columns)
    place, holders, column_place = jax.device_put((place, holders, column_place))
    return Clustered(tuple(buckets), place, holders, column_place, r, c, columns)


def quantised_clusters(operator: Clustered, bits: int) -> Clustered:
    """The same in codes of 8 or 16 bits.

    The basis has a scale for each coefficient of a group, over its q shared rows: coefficients of coarse and fine
    levels differ by orders of magnitude, those of one do not. Weights have a scale for each shared row. All scales are
    factors on vectors, none on a matrix.
    """

    def coded(part: Bucket) -> Bucket:
        basis, weights = np.asarray(part.basis), np.asarray(part.weights)
        turned = quantised(np.swapaxes(basis, 1, 2), bits)
        codes, scale = (np.ascontiguousarray(np.swapaxes(x, 1, 2)) for x in (turned.codes, turned.scale))
        coded = Quantised(codes, scale, 1), quantised(weights, bits)
        return Bucket(part.groups, part.support, *jax.device_put(coded))

    return eqx.tree_at(lambda one: one.buckets, operator, tuple(coded(part) for part in operator.buckets))


def _multiple(count: int, of: int) -> int:
    """The next multiple."""
    return -(-count // of) * of


def _joined(members: dict[tuple[int, int], list[int]], width: int) -> dict[tuple[int, int], list[int]]:
    """Groups by the size (s, q) they are filled up to: sizes are joined, two at a time, while that fills up little.

    Args:
        members: the same, each to its own size.
        width: of the weights of a shared row, c·r.
    """
    members = collections.defaultdict(list, members)
    while len(members) > 1:
        sizes = list(members)
        s, q = np.array(sizes).T
        count = np.array([len(groups) for groups in members.values()])
        joined = np.add.outer(count, count) * np.maximum.outer(q, q) * (np.maximum.outer(s, s) + width)
        filling = joined - np.add.outer(count * q * (s + width), count * q * (s + width))
        filling[np.diag_indices(len(s))] = np.iinfo(filling.dtype).max
        first, second = np.unravel_index(np.argmin(filling), filling.shape)
        if filling[first, second] > _FILLING:
            break
        groups = members.pop(sizes[first]) + members.pop(sizes[second])
        members[int(max(s[first], s[second])), int(max(q[first], q[second]))] += groups
    return members


def count_holders(held: Int[np.ndarray, " e"], columns: int) -> Int[np.ndarray, " d"]:
    """How many hold each column, from the column of every place; `columns` where it is filling."""
    return np.bincount(held, minlength=columns)[:columns]


def find_holders(
    held: Int[np.ndarray, " e"], columns: int, most: Int[np.ndarray, " d"] | None = None
) -> tuple[tuple[Int[np.ndarray, "_ _"], ...], Int[np.ndarray, " d"]]:
    """`Clustered.holders` and `column_place`.

    Args:
        held: the column of every place; `columns` where it is filling.
        columns: d.
        most: no column has more holders than this, which alone decides on shapes; by default as many as it has.
    """
    order = np.argsort(held, kind="stable").astype(np.int32)
    count = count_holders(held, columns)
    most = count if most is None else most
    first = np.cumsum(count) - count
    # Arrays are as wide as the next power of two of their columns' counts.
    width = np.where(most > 0, 1 << np.ceil(np.log2(np.maximum(most, 1))).astype(int), 0)
    holders, column_place, start = [], np.full(columns, -1, np.int32), 0
    for n in np.unique(width[width > 0]):
        of_width = np.flatnonzero(width == n)
        nth = np.arange(most[of_width].max())
        places = order[np.minimum(first[of_width, None] + nth, len(held) - 1)]
        holders.append(np.where(nth < count[of_width, None], places, np.int32(len(held))))
        column_place[of_width] = start + np.arange(len(of_width))
        start += len(of_width)
    column_place[column_place < 0] = start
    return tuple(holders), column_place
