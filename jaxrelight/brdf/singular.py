"""The largest singular vectors and eigenvectors of a matrix, with signs that do not depend on chance."""

from typing import Any

import numpy as np
import scipy.linalg
import scipy.sparse.linalg
from jaxtyping import Float


def asymmetry(matrix: Float[np.ndarray, "n n"], rows: int = 256) -> float:
    """Largest |M − Mᵀ| over largest |M|."""
    starts = range(0, len(matrix), rows)
    apart = max(np.abs(matrix[s : s + rows] - matrix[:, s : s + rows].T).max() for s in starts)
    largest = max(np.abs(matrix[s : s + rows]).max() for s in starts)
    return float(apart / largest) if largest else 0.0


def largest_singular(
    matrix: Float[np.ndarray, "m n"], terms: int
) -> tuple[Float[np.ndarray, "m k"], Float[np.ndarray, " k"], Float[np.ndarray, "n k"]]:
    """(u [m, k], σ [k] descending, v [n, k]), with signs such that every u sums to no less than 0.

    The eigenvectors of a symmetric matrix are found sooner than singular vectors, and more precisely.
    """
    if asymmetry(matrix) < 1e-5:
        value, q = largest_eigen(matrix, terms)
        return q, np.abs(value), q * np.where(value < 0, -1, 1)
    if terms > min(matrix.shape) // 4:
        u, sigma, vt = np.linalg.svd(matrix)
        u, sigma, vt = u[:, :terms], sigma[:terms], vt[:terms]
    else:
        triplets: Any = scipy.sparse.linalg.svds(matrix, terms, v0=_start(matrix), rng=0)
        u, sigma, vt = triplets[0][:, ::-1], triplets[1][::-1], triplets[2][::-1]
    sign = np.where(u.sum(axis=0) < 0, -1, 1)
    return u * sign, sigma, vt.T * sign


def largest_eigen(
    matrix: Float[np.ndarray, "n n"], terms: int
) -> tuple[Float[np.ndarray, " k"], Float[np.ndarray, "n k"]]:
    """(eigenvalues [k], vectors [n, k]) by falling magnitude, with signs such that every vector sums to at least 0."""
    if terms > len(matrix) // 4 or not matrix.any():
        value, q = scipy.linalg.eigh(matrix)
    else:
        value, q = scipy.sparse.linalg.eigsh(matrix, terms, v0=_start(matrix))
    order = np.argsort(-np.abs(value), kind="stable")[:terms]
    value, q = value[order], q[:, order]
    return value, q * np.where(q.sum(axis=0) < 0, -1, 1)


def _start(matrix: np.ndarray) -> np.ndarray:
    """A vector to iterate from: of no symmetry, since iteration would keep it and miss vectors that lack it."""
    return np.random.default_rng(0).standard_normal(min(matrix.shape)).astype(matrix.dtype)
