"""From rows to clusters: few shared rows over few coefficients, within a tolerance of light of a spectrum."""

import numpy as np
import scipy.linalg
from jaxtyping import Bool, Float

from jaxrelight.operators.clustered import Cluster
from jaxrelight.operators.quantised import decoded
from jaxrelight.operators.sparse_rows import SparseRows


def as_clusters(operator: SparseRows, group_rows: int, tolerance: float = 1e-3) -> list[Cluster]:
    """Clusters rows that each have coefficients of their own; the clusters are as near to them as the tolerance."""
    n = operator.indices.shape[-1]
    indices = np.asarray(operator.indices).reshape(-1, n)[: operator.row_count].reshape(-1, group_rows, n)
    values = [np.asarray(decoded(channel)).reshape(-1, n)[: operator.row_count] for channel in operator.values]
    by_group = np.stack(values, axis=1).reshape(len(indices), group_rows, len(values), n)
    clusters = []
    for kept, coefficients in zip(indices, by_group, strict=True):
        columns, place = np.unique(kept, return_inverse=True)
        rows = np.zeros((*coefficients.shape[:2], len(columns)), np.float32)
        np.put_along_axis(
            rows, np.broadcast_to(place.reshape(kept.shape)[:, None], coefficients.shape), coefficients, 2
        )
        (support, basis, weights), _ = cluster(rows, np.ones(len(columns), np.float32), tolerance)
        clusters.append(Cluster(columns[support], basis, weights))
    return clusters


def cluster(
    rows: Float[np.ndarray, "r c d"],
    spectrum: Float[np.ndarray, " d"],
    tolerance: float,
    constant: Bool[np.ndarray, " d"] | None = None,
) -> tuple[Cluster, Float[np.ndarray, "r c"]]:
    """One group: the fewest coefficients and shared rows that leave out tolerance² of its energy under natural light.

    The error of a row's product with light whose coefficients have standard deviations σ, none depending on another, is
    Σ_d σ_d² δ_d² in the mean, so that energy is counted after a product with σ: half of what may be left out are
    coefficients of least energy, the other half is left out by the singular value decomposition of the rest.

    What a row reflects of constant light is kept exactly: a shared row is the constant, and the others are of what is
    left across it. As nearly all rows reflect some, that takes hardly more shared rows than without.

    Args:
        rows: of the group, written out.
        spectrum: σ; see `natural_spectrum`.
        tolerance: largest root-mean-square error relative to the group's radiance. 0 keeps all.
        constant: which coefficients constant light has, all of them alike; by default none is kept exactly.

    Returns:
        The cluster, and the energy, not weighted, that it leaves out of every row.
    """
    r, c, _ = rows.shape
    power = np.einsum("rcd,rcd->d", rows, rows, dtype=np.float64) * np.square(spectrum)
    energy = np.einsum("rcd,rcd->rc", rows, rows, dtype=np.float64)
    order = np.argsort(power)
    may = tolerance**2 / 2 * power.sum()
    constant = np.zeros(len(spectrum), bool) if constant is None else constant
    kept = (power > 0) & constant
    kept[order[np.searchsorted(np.cumsum(power[order]), may, side="right") :]] = True
    support = np.flatnonzero(kept)
    if not len(support):
        nothing = np.zeros((0, 0), np.float32), np.zeros((c, 0, r), np.float32)
        return Cluster(support, *nothing), energy.astype(np.float32)
    inside = rows[:, :, support].reshape(r * c, -1)
    sigma = spectrum[support]
    exact = _constant_part(inside * sigma, constant[support] / sigma)
    weights, basis = _principal_components(inside * sigma - exact[0] @ exact[1], may)
    weights, basis = np.concatenate([exact[0], weights], axis=1), np.concatenate([exact[1], basis])
    basis /= sigma
    outside = energy - np.sum(np.square(inside, dtype=np.float64), axis=1).reshape(r, c)
    dropped = np.maximum(outside, 0) + np.sum(np.square(inside - weights @ basis), axis=1).reshape(r, c)
    return Cluster(support, basis, np.moveaxis(weights.reshape(r, c, -1), 0, 2)), dropped.astype(np.float32)


def _constant_part(
    matrix: Float[np.ndarray, "r s"], along: Float[np.ndarray, " s"]
) -> tuple[Float[np.ndarray, "r q"], Float[np.ndarray, "q s"]]:
    """What rows have along a vector, as a product whose sides are of about the same size; q is 1, or 0 for nothing."""
    length = np.linalg.norm(along)
    unit = along / (length if length > 0 else 1)
    share = matrix.astype(np.float64) @ unit
    root = np.sqrt(np.linalg.norm(share))
    if not root > 0:
        return np.zeros((len(matrix), 0), np.float32), np.zeros((0, len(along)), np.float32)
    return (share / root)[:, None].astype(np.float32), (unit * root)[None].astype(np.float32)


def _principal_components(
    matrix: Float[np.ndarray, "r s"], may: float
) -> tuple[Float[np.ndarray, "r q"], Float[np.ndarray, "q s"]]:
    """The fewest whose product leaves out `may` of the matrix's energy; both sides of about the same size.

    By the eigenvectors of the smaller Gram matrix: in double precision they serve to 1e-7 of the largest singular
    value, and cost a fifth of a singular value decomposition.
    """
    wide = matrix.shape[0] < matrix.shape[1]
    precise = matrix.astype(np.float64)
    energies, vectors = scipy.linalg.eigh(precise @ precise.T if wide else precise.T @ precise)
    kept = vectors[:, np.cumsum(np.maximum(energies, 0)) > may][:, ::-1]
    weights, basis = (kept, kept.T @ precise) if wide else (precise @ kept, kept.T)
    root = np.sqrt(np.linalg.norm(basis, axis=1) if wide else np.linalg.norm(weights, axis=0))
    weights, basis = (weights * root, basis / root[:, None]) if wide else (weights / root, basis * root[:, None])
    return weights.astype(np.float32), basis.astype(np.float32)
