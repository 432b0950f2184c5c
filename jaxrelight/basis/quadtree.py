"""Surface points laid out as an image, so that its square blocks hold points that are alike (Hašan 2006 §3.4, §4.2).

The points are split into equal halves of near position and normal, again and again: two splits make the four children
of a node, and a node of 4^h points is a block of 2^h×2^h texels. `haar` does the rest.
"""

import numpy as np
from jaxtyping import Float, Int

# The number of steps of a split, which hardly moves after a few.
_STEPS = 20


def flattened(
    positions: Float[np.ndarray, "p 3"], normals: Float[np.ndarray, "p 3"], balance: float = 30.0
) -> Int[np.ndarray, " p"]:
    """The number of the point at each texel of a 2ⁿ×2ⁿ image, row by row.

    Halves are found by k-means with two centroids, of which each gets half of the points: those that are nearer to it
    than to the other, by K²‖p − p_c‖² + d²‖n − n_c‖² (eq. 9), d being the diagonal of their bounding box. It starts
    from a split across the direction in which points vary most.

    Args:
        positions: of p points, a power of four.
        normals: theirs, of unit length.
        balance: K, how much positions count against normals; 20 to 40 is right in the paper.
    """
    diagonal = np.linalg.norm(np.ptp(positions, axis=0))
    features = np.concatenate([balance * positions, diagonal * normals], axis=1)
    sets = np.arange(len(positions))[None]
    while sets.shape[1] > 1:
        sets = _halved(sets, features)
    order = np.empty(len(positions), np.int64)
    order[z_curve(round(len(positions) ** 0.5))] = sets[:, 0]
    return order


def z_curve(side: int) -> Int[np.ndarray, " p"]:
    """The texels of a side×side image, row by row, in the order of the tree: the points of a node follow each other.

    Of four children the second is to the right of the first, and the third below it.
    """
    place = np.arange(side * side)
    y, x = np.zeros_like(place), np.zeros_like(place)
    for bit in range(side.bit_length() - 1):
        x |= ((place >> 2 * bit) & 1) << bit
        y |= ((place >> 2 * bit + 1) & 1) << bit
    return y * side + x


def _halved(sets: Int[np.ndarray, "s m"], features: Float[np.ndarray, "p f"]) -> Int[np.ndarray, "s2 m2"]:
    """Twice as many sets of half as many points; the halves of a set follow each other."""
    s, m = sets.shape
    points = features[sets]
    points = points - points.mean(axis=1, keepdims=True)
    _, axes = np.linalg.eigh(np.einsum("smi,smj->sij", points, points))
    value, before = np.einsum("smi,si->sm", points, axes[:, :, -1]), None
    for _ in range(_STEPS):
        order = np.argsort(value, axis=1, kind="stable")
        second = np.zeros((s, m), bool)
        np.put_along_axis(second, order[:, m // 2 :], True, axis=1)
        if before is not None and (second == before).all():
            break
        # Points are centred, so that the halves' means are opposite: one tells which is nearer.
        mean = np.einsum("sm,smi->si", second, points)
        value, before = np.einsum("smi,si->sm", points, mean), second
    return np.take_along_axis(sets, order, axis=1).reshape(2 * s, m // 2)
