"""Where rays leave surfaces: lifted off the face by its rounding, and as high as the smooth surface that it stands for.

A mesh with interpolated normals stands for a smooth surface, which bulges over its faces. Rays that start on a face and
are above the interpolated normal's horizon are hidden by the face itself or by its neighbours, which leaves black
pixels along the terminator. The remedy is that of Hanika (Hacking the shadow terminator, Ray Tracing Gems II, 2021):
the point is projected onto the tangent planes of the face's corners, and the projections are interpolated.
"""

import numpy as np
from jaxtyping import Bool, Float

from jaxrelight.geometry.gbuffer import GBuffer
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import OFFSET, Tracer
from jaxrelight.numerics.threads import in_parts

# Points in each part.
_POINT_CHUNK = 16384


def ray_origins(surfaces: Surfaces, tracer: Tracer, points: GBuffer) -> Float[np.ndarray, "p 3"]:
    """Origins, in scene space, of rays that leave surface points.

    They lie above the smooth surface on the side that is seen; on the face itself where that bends inwards, where its
    mesh asks for shading normals as they are, and where something stands between the face and the smooth surface.
    Points of sensors may lie on any surface.
    """
    if points.is_of_sensors:
        return points.positions + OFFSET * points.face_normals

    def of_part(rows: slice) -> Float[np.ndarray, "r 3"]:
        lift = surfaces.face_lift[points.face[rows]]
        origins = points.positions[rows] + lift[:, None] * points.face_normals[rows]
        bulge = _bulge(surfaces, points, rows)
        height = np.linalg.norm(bulge, axis=1)
        raised = np.flatnonzero((height > lift) & ~surfaces.pure_normals[points.mesh[rows]])
        if len(raised):
            raised = raised[_is_clear(tracer, origins[raised], bulge[raised], height[raised])]
            origins[raised] += bulge[raised]
        return origins

    return np.concatenate([np.zeros((0, 3)), *in_parts(of_part, len(points.positions), _POINT_CHUNK)])


def _bulge(surfaces: Surfaces, points: GBuffer, rows: slice) -> Float[np.ndarray, "r 3"]:
    """From some points to the mean, by barycentric weights, of their projections onto the corners' tangent planes.

    Corners whose tangent plane the point is above count as if it were in it.
    """
    positions, side = points.positions[rows], np.where(points.back[rows], -1.0, 1.0)
    bulge = np.zeros_like(positions)
    for corner in range(3):
        number = points.corners[rows, corner]
        normals = surfaces.normals[number]
        towards = surfaces.vertices[number] - positions
        below = np.maximum(np.einsum("px,px->p", towards, normals) * side, 0)
        bulge += (points.barycentric[rows, corner] * below * side)[:, None] * normals
    return bulge


def _is_clear(
    tracer: Tracer, start: Float[np.ndarray, "p 3"], along: Float[np.ndarray, "p 3"], length: Float[np.ndarray, " p"]
) -> Bool[np.ndarray, " p"]:
    """Whether nothing stands on the way from the face to the smooth surface above it."""
    return ~tracer.blocked(start, along / length[:, None], length)
