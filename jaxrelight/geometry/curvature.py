"""One-dimensional curvature of what pixels show (Bagher 2011 §2.3)."""

import numpy as np
from jaxtyping import Float, Int

from jaxrelight.geometry.gbuffer import GBuffer


def curvature(
    gbuffer: GBuffer, radius: float = 1.0, points: Int[np.ndarray, " p"] | None = None
) -> Float[np.ndarray, " p"]:
    """How fast the shading normal turns along the surface, in radians per metre; of bent normals, too.

    From each pixel to its neighbours: the smaller of both sides, so that an edge counts on neither, and the larger of
    the directions rightwards and downwards. Gaussian curvature would be 0 on a cylinder.

    Args:
        gbuffer: of an image.
        radius: length of scene space's unit in the world.
        points: numbers of those to find it of; None for all.
    """
    h, w = gbuffer.covered.shape
    count = len(gbuffer.positions)
    number = np.full((h + 2, w + 2), -1, np.int32)
    number[1:-1, 1:-1][gbuffer.covered] = np.arange(count)
    own = np.arange(count) if points is None else points
    y, x = np.divmod(np.flatnonzero(gbuffer.covered)[own], w)
    largest = np.zeros(len(own))
    for axis in ((0, 1), (1, 0)):
        sides = []
        for sign in (-1, 1):
            other = number[y + 1 + sign * axis[0], x + 1 + sign * axis[1]]
            along = np.linalg.norm(gbuffer.positions[other] - gbuffer.positions[own], axis=1) * radius
            turned = np.linalg.norm(gbuffer.normals[other] - gbuffer.normals[own], axis=1)
            same = (other >= 0) & (gbuffer.mesh[other] == gbuffer.mesh[own]) & (along > 0)
            sides.append(np.where(same, turned / np.where(same, along, 1), np.inf))
        smaller = np.minimum(*sides)
        largest = np.maximum(largest, np.where(np.isfinite(smaller), smaller, 0))
    return largest
