"""Triangles of polygons."""

import numpy as np
from jaxtyping import Bool, Float, Int

# A triangle of a fan that faces this much against the whole, relative to its area, makes a polygon concave.
_AGAINST = 1e-6


def triangulated(
    points: Float[np.ndarray, "v 3"], corners: Int[np.ndarray, " n"], lengths: Int[np.ndarray, " p"]
) -> tuple[Int[np.ndarray, "t 3"], Int[np.ndarray, " t"]]:
    """Triangles of polygons in space, wound as these are.

    Convex polygons become fans around their first corner. Others are cut into ears in their own plane, so that their
    notches stay open.

    Args:
        points: positions.
        corners: vertex numbers of all polygons, one after the other; those with numbers out of range make fans.
        lengths: how many corners each has, at least three.

    Returns:
        The corners of each triangle as places in its polygon, and the number of its polygon.
    """
    owner = np.repeat(np.arange(len(lengths)), lengths - 2)
    starts, triangle_starts = np.cumsum(lengths) - lengths, np.cumsum(lengths - 2) - (lengths - 2)
    nth = np.arange(len(owner)) - triangle_starts[owner]
    fans = np.stack([np.zeros_like(nth), nth + 1, nth + 2], axis=1)
    is_concave = _is_concave(points, corners, lengths, starts, owner, fans)
    if not is_concave.any():
        return fans, owner
    triangles, owners = [fans[~is_concave[owner]]], [owner[~is_concave[owner]]]
    for number in np.flatnonzero(is_concave):
        ears = _ears(points[corners[starts[number] : starts[number] + lengths[number]]])
        triangles.append(ears)
        owners.append(np.full(len(ears), number))
    order = np.argsort(np.concatenate(owners), kind="stable")
    return np.concatenate(triangles)[order], np.concatenate(owners)[order]


def _is_concave(points, corners, lengths, starts, owner, fans) -> Bool[np.ndarray, " p"]:
    """Which polygons have a fan triangle that faces against the whole."""
    is_concave = np.zeros(len(lengths), bool)
    if not (lengths > 3).any():
        return is_concave
    is_inside = np.logical_and.reduceat((corners >= 0) & (corners < len(points)), starts)
    rows = np.flatnonzero(is_inside[owner] & (lengths[owner] > 3))
    owner = owner[rows]
    a, b, c = np.moveaxis(points[corners[starts[owner][:, None] + fans[rows]]], 1, 0)
    areas = np.cross(b - a, c - a)
    whole = np.stack([np.bincount(owner, areas[:, axis], len(lengths)) for axis in range(3)], axis=1)[owner]
    against = (areas * whole).sum(axis=1) < -_AGAINST * (whole**2).sum(axis=1)
    is_concave[owner[against]] = True
    return is_concave


def _ears(corners: Float[np.ndarray, "n 3"]) -> Int[np.ndarray, "t 3"]:
    """Triangles of a polygon that is not convex, wound as it is; its fan if it has no plane."""
    import mapbox_earcut

    ahead = np.roll(corners, -1, axis=0)
    # Newell's normal: as long as twice the area of the polygon's projection onto its plane.
    normal = np.cross(corners - corners[0], ahead - corners[0]).sum(axis=0)
    length = np.linalg.norm(normal)
    fan = np.stack([np.zeros(len(corners) - 2, int), np.arange(1, len(corners) - 1), np.arange(2, len(corners))], 1)
    if not (np.isfinite(length) and length > 0):
        return fan
    normal /= length
    across = np.cross(normal, np.eye(3)[np.argmin(np.abs(normal))])
    across /= np.linalg.norm(across)
    plane = np.stack([(corners - corners[0]) @ across, (corners - corners[0]) @ np.cross(normal, across)], axis=1)
    ears = mapbox_earcut.triangulate_float64(plane, np.array([len(corners)], np.uint32)).reshape(-1, 3).astype(np.int64)
    if not len(ears):
        return fan
    (au, av), (bu, bv), (cu, cv) = (plane[ears[:, k]].T for k in range(3))
    backwards = (bu - au) * (cv - av) - (bv - av) * (cu - au) < 0
    return np.where(backwards[:, None], ears[:, ::-1], ears)
