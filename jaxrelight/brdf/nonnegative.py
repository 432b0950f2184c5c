"""Non-negative matrix factorisation by hierarchical alternating least squares (Cichocki and Phan 2009)."""

import numpy as np
from jaxtyping import Float

# Sweeps at most, and the relative change of the squared error in one at which iteration stops.
_SWEEPS, _STILL = 400, 1e-5


def nonnegative_factors(
    matrix: Float[np.ndarray, "m n"],
    u: Float[np.ndarray, "m k"],
    sigma: Float[np.ndarray, " k"],
    v: Float[np.ndarray, "n k"],
) -> tuple[Float[np.ndarray, "m k"], Float[np.ndarray, "n k"]]:
    """Two non-negative matrices g [m, k], h [n, k] of small ‖matrix − g hᵀ‖ and ‖g_k‖ = ‖h_k‖.

    Alternating least squares, one column after the other, from singular vectors u, v and their values.
    """
    g, h = _positive_parts(u, sigma, v)
    square, before = np.vdot(matrix, matrix), np.inf
    for _ in range(_SWEEPS):
        g = nonnegative_rows(matrix @ h, h.T @ h, g, 1)
        products, gram = matrix.T @ g, g.T @ g
        h = nonnegative_rows(products, gram, h, 1)
        left = square - 2 * np.vdot(products, h) + np.vdot(gram, h.T @ h)
        if before - left < _STILL * left:
            break
        before = left
    size_g, size_h = np.linalg.norm(g, axis=0), np.linalg.norm(h, axis=0)
    both = np.sqrt(size_g * size_h)
    return g * (both / np.where(size_g > 0, size_g, 1)), h * (both / np.where(size_h > 0, size_h, 1))


def _positive_parts(u: np.ndarray, sigma: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """The positive or the negative part of each singular pair, whichever is larger, where iteration begins.

    A floor keeps what is 0 from staying 0 (Boutsidis and Gallopoulos 2008).
    """
    parts = [(np.maximum(sign * u, 0), np.maximum(sign * v, 0)) for sign in (1, -1)]
    sizes = [np.linalg.norm(g, axis=0) * np.linalg.norm(h, axis=0) for g, h in parts]
    larger = sizes[0] >= sizes[1]
    g, h = (np.where(larger, *(part[side] for part in parts)) for side in (0, 1))
    root = np.sqrt(sigma)
    floor = 1e-3 * root.max() / np.sqrt(len(u))
    return np.maximum(root * g, floor), np.maximum(root * h, floor)


def nonnegative_rows(
    products: Float[np.ndarray, "m k"],
    gram: Float[np.ndarray, "k k"],
    start: Float[np.ndarray, "m k"] | None = None,
    sweeps: int = _SWEEPS,
) -> Float[np.ndarray, "m k"]:
    """Rows x ≥ 0 of least ‖M − x hᵀ‖ from products M h and gram hᵀh, one column after the other.

    A term whose h is 0 stays as it is.
    """
    x = np.zeros_like(products) if start is None else start.copy()
    for _ in range(sweeps):
        for k in range(x.shape[1]):
            if gram[k, k] > 0:
                x[:, k] = np.maximum(x[:, k] + (products[:, k] - x @ gram[:, k]) / gram[k, k], 0)
    return x
