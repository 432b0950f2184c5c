"""The clustered operator: rows of near receivers as mixtures of a few (Sloan et al. 2003; Liu et al. 2004)."""

import collections
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.linalg
from jaxtyping import Array, Float, Int

from jaxrelight.operators.contract import Operator
from jaxrelight.operators.quantised import decoded
from jaxrelight.operators.sparse_rows import SparseRows, smallest_index_type


class Cluster(NamedTuple):
    """The rows of one group, weights · basis on s coefficients and 0 elsewhere. Made by `cluster`.

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
        groups: whose rows they are; 0 for filling.
        support: as in `Cluster`.
        basis: as in `Cluster`.
        weights: as in `Cluster`.
    """

    groups: Int[Array, " b"]
    support: Int[Array, "b s"]
    basis: Float[Array, "b q s"]
    weights: Float[Array, "b c q r"]


class Clustered(Operator):
    """Groups of r rows, each the product of weights and q shared rows, over s coefficients that the group shares.

    Where a row of n coefficients of its own gathers n numbers of light, a group of r rows gathers s, once: what follows
    is two dense products, of q·s and of q·r for every channel. Groups of no energy hold nothing. Made by `clustered`.

    Attributes:
        buckets: all clusters.
        place: of each group among the clusters of all buckets; past their end where the group holds nothing.
        group_rows: r.
        channels: c; 1 where rows are the same in all of them (grey).
        columns: d, the number of light coefficients.
    """

    buckets: tuple[Bucket, ...]
    place: Int[Array, " g"]
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
        return Clustered(self.buckets, place, self.group_rows, self.channels, self.columns)

    @property
    def nbytes(self) -> int:
        """Bytes of supports, shared rows and weights, with their filling."""
        return sum(array.nbytes for array in jax.tree.leaves(self))

    def apply(self, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        """Radiance of every row: per group one gather of light and two small products."""
        channels = light.shape[1]
        if self.channels not in (1, channels):
            raise ValueError(f"light has {channels} channels, the operator {self.channels}")
        # Channels apart: a product with vectors reads its matrix at the speed of memory, one with few columns does not.
        by_channel = [light[:, c] for c in range(channels)]
        parts = []
        for part in self.buckets:
            support = part.support.astype(jnp.int32)
            found = [x.at[support].get(mode="promise_in_bounds") for x in by_channel]
            shared = [jnp.einsum("bqs,bs->bq", part.basis, x, precision="highest") for x in found]
            if self.channels == 1:
                b, _, q, r = part.weights.shape
                weights = part.weights.reshape(b, q, r)
                mixed = [jnp.einsum("bqr,bq->br", weights, x, precision="highest") for x in shared]
                parts.append(jnp.stack(mixed, axis=-1))
            else:
                mixed = jnp.einsum("bcqr,bcq->bcr", part.weights, jnp.stack(shared, axis=1), precision="highest")
                parts.append(jnp.moveaxis(mixed, 1, 2))
        nothing = jnp.zeros((1, self.group_rows, channels), light.dtype)
        return jnp.concatenate([*parts, nothing]).at[self.place].get(mode="promise_in_bounds").reshape(-1, channels)

    def transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
        """The adjoint: the two products the other way round, and one scatter for each group."""
        channels = radiance.shape[1]
        by_group = radiance.reshape(-1, self.group_rows, channels)
        out = jnp.zeros((self.columns, channels), radiance.dtype)
        for part in self.buckets:
            b, _, q, r = part.weights.shape
            mine = by_group.at[part.groups].get(mode="promise_in_bounds")
            weights = jnp.broadcast_to(part.weights, (b, channels, q, r))
            shared = jnp.einsum("bcqr,brc->bcq", weights, mine, precision="highest")
            found = jnp.einsum("bqs,bcq->bsc", part.basis, shared, precision="highest")
            out = out.at[part.support.astype(jnp.int32)].add(found, mode="promise_in_bounds")
        return out

    def rows(self, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
        """The chosen rows, zero off their group's coefficients. Looks into every bucket for every row."""
        indices = jnp.asarray(indices)
        place, row = self.place[indices // self.group_rows], indices % self.group_rows
        out, start = jnp.zeros((len(indices), self.channels, self.columns)), 0
        for part in self.buckets:
            b = len(part.groups)
            mine, i = (place >= start) & (place < start + b), jnp.clip(place - start, 0, b - 1)
            values = jnp.einsum("icq,iqs->ics", part.weights[i, :, :, row], part.basis[i], precision="highest")
            written = jax.vmap(lambda support, v: jnp.zeros((v.shape[0], self.columns), v.dtype).at[:, support].add(v))
            out = jnp.where(mine[:, None, None], written(part.support[i].astype(jnp.int32), values), out)
            start += b
        return out


def clustered(clusters: Sequence[Cluster], columns: int) -> Clustered:
    """The operator of groups that each are a cluster, over `columns` light coefficients.

    Sizes are rounded up to few, so that few shapes are compiled and little is filled up; groups of no shared row are
    left out. Put together by NumPy.
    """
    c, _, r = clusters[0].weights.shape
    members = collections.defaultdict(list)
    for group, (_, basis, _) in enumerate(clusters):
        if len(basis):
            members[_rounded(basis.shape[1], 64), _rounded(len(basis), 8)].append(group)
    place, buckets, start = np.full(len(clusters), -1, np.int32), [], 0
    for (s, q), groups in sorted(members.items()):
        b = _rounded(len(groups), 8)
        support = np.zeros((b, s), smallest_index_type(columns))
        basis, weights = np.zeros((b, q, s), np.float32), np.zeros((b, c, q, r), np.float32)
        for i, group in enumerate(groups):
            found = clusters[group]
            n, m = len(found.support), len(found.basis)
            support[i, :n], basis[i, :m, :n], weights[i, :, :m] = found
        whose = np.zeros(b, np.int32)
        whose[: len(groups)] = groups
        place[groups] = start + np.arange(len(groups))
        buckets.append(Bucket(*jax.device_put((whose, support, basis, weights))))
        start += b
    place[place < 0] = start
    return Clustered(tuple(buckets), jax.device_put(place), r, c, columns)


def as_clusters(operator: SparseRows, group_rows: int, tolerance: float = 1e-3) -> Clustered:
    """Clusters of rows that each have coefficients of their own, as near to them as a tolerance."""
    n = operator.indices.shape[-1]
    indices = np.asarray(operator.indices).reshape(-1, n)[: operator.row_count].reshape(-1, group_rows, n)
    values = [np.asarray(decoded(channel)).reshape(-1, n)[: operator.row_count] for channel in operator.values]
    by_group = np.stack(values, axis=1).reshape(len(indices), group_rows, len(values), n)
    found = []
    for kept, coefficients in zip(indices, by_group, strict=True):
        columns, place = np.unique(kept, return_inverse=True)
        rows = np.zeros((*coefficients.shape[:2], len(columns)), np.float32)
        np.put_along_axis(
            rows, np.broadcast_to(place.reshape(kept.shape)[:, None], coefficients.shape), coefficients, 2
        )
        (support, basis, weights), _ = cluster(rows, np.ones(len(columns), np.float32), tolerance)
        found.append(Cluster(columns[support], basis, weights))
    return clustered(found, operator.columns)


def _rounded(count: int, least: int) -> int:
    """The next of least · 1, 1.5, 2, 3, 4, 6 and so on."""
    size = least
    while size < count:
        size = size * 3 // 2 if size.bit_count() == 1 else size // 3 * 4
    return size


def cluster(
    rows: Float[np.ndarray, "r c d"], spectrum: Float[np.ndarray, " d"], tolerance: float
) -> tuple[Cluster, Float[np.ndarray, "r c"]]:
    """One group: the fewest coefficients and shared rows that leave out tolerance² of its energy under natural light.

    The error of a row's product with light whose coefficients have standard deviations σ, none depending on another, is
    Σ_d σ_d² δ_d² in the mean, so that energy is counted after a product with σ: half of what may be left out are
    coefficients of least energy, the other half is left out by the singular value decomposition of the rest.

    Args:
        rows: of the group, written out.
        spectrum: σ; see `natural_spectrum`.
        tolerance: largest root-mean-square error relative to the group's radiance. 0 keeps all.

    Returns:
        The cluster, and the energy, not weighted, that it leaves out of every row.
    """
    r, c, _ = rows.shape
    power = np.einsum("rcd,rcd->d", rows, rows, dtype=np.float64) * np.square(spectrum)
    energy = np.einsum("rcd,rcd->rc", rows, rows, dtype=np.float64)
    order = np.argsort(power)
    may = tolerance**2 / 2 * power.sum()
    support = np.sort(order[np.searchsorted(np.cumsum(power[order]), may, side="right") :])
    if not len(support):
        nothing = np.zeros((0, 0), np.float32), np.zeros((c, 0, r), np.float32)
        return Cluster(support, *nothing), energy.astype(np.float32)
    inside = rows[:, :, support].reshape(r * c, -1)
    sigma = spectrum[support]
    weights, basis = _principal_components(inside * sigma, may)
    basis /= sigma
    outside = energy - np.sum(np.square(inside, dtype=np.float64), axis=1).reshape(r, c)
    dropped = np.maximum(outside, 0) + np.sum(np.square(inside - weights @ basis), axis=1).reshape(r, c)
    return Cluster(support, basis, np.moveaxis(weights.reshape(r, c, -1), 0, 2)), dropped.astype(np.float32)


def _principal_components(
    matrix: Float[np.ndarray, "r s"], may: float
) -> tuple[Float[np.ndarray, "r q"], Float[np.ndarray, "q s"]]:
    """The fewest whose product leaves out `may` of the matrix's energy; both sides of about the same size.

    By the eigenvectors of the smaller Gram matrix: in double precision they serve to 1e-7 of the largest singular
    value, and cost a fifth of a singular value decomposition.
    """
    wide = matrix.shape[0] < matrix.shape[1]
    whole = matrix.astype(np.float64)
    energies, vectors = scipy.linalg.eigh(whole @ whole.T if wide else whole.T @ whole)
    kept = vectors[:, np.cumsum(np.maximum(energies, 0)) > may][:, ::-1]
    weights, basis = (kept, kept.T @ whole) if wide else (whole @ kept, kept.T)
    root = np.sqrt(np.linalg.norm(basis, axis=1) if wide else np.linalg.norm(weights, axis=0))
    weights, basis = (weights * root, basis / root[:, None]) if wide else (weights / root, basis * root[:, None])
    return weights.astype(np.float32), basis.astype(np.float32)
