"""Vertices inside other closed surfaces: no eye sees them, and what lies between vertices is not darkened by them.

A vertex inside a closed surface sees nothing but backs of faces; one in a dark crevice sees fronts.
"""

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxrelight.basis import cubemap
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import Tracer

# A vertex is enclosed if more than this share of its rays, which go through the texels of a cube map of this size,
# first meet the back of a face that has a front alone.
_SHARE, _RESOLUTION = 0.5, 4
# Vertices whose rays are cast at a time.
_VERTEX_CHUNK = 4096


def enclosed_vertices(
    surfaces: Surfaces, tracer: Tracer, origins: Float[np.ndarray, "r 3"], normals: Float[np.ndarray, "r 3"]
) -> Bool[np.ndarray, " r"]:
    """Which vertices, or backs of vertices, lie inside closed surfaces.

    Most have a single ray, along their normal.

    Args:
        surfaces: of the scene.
        tracer: of them.
        origins: of the vertices' rays, lifted off the surface.
        normals: of the faces there.
    """
    enclosed = np.zeros(len(origins), bool)
    if surfaces.two_sided.all():
        return enclosed
    possible = np.flatnonzero(_meet_backs(surfaces, tracer, origins, normals))
    directions = cubemap.directions(_RESOLUTION)
    for start in range(0, len(possible), _VERTEX_CHUNK):
        some = possible[start : start + _VERTEX_CHUNK]
        vertex, direction = np.nonzero(normals[some] @ directions.T > 0)
        met = _meet_backs(surfaces, tracer, origins[some[vertex]], directions[direction])
        shares = np.bincount(vertex, met, len(some)) / np.bincount(vertex, minlength=len(some))
        enclosed[some] = shares > _SHARE
    return enclosed


def _meet_backs(surfaces: Surfaces, tracer: Tracer, origins, directions) -> Bool[np.ndarray, " r"]:
    """Which rays first meet the back of a face that has a front alone."""
    face, _ = tracer.first_hits(origins, directions)
    mesh = surfaces.mesh_of_vertex[surfaces.faces[face, 0]]
    away = np.sum(surfaces.face_normals(face) * directions, axis=1) > 0
    return (face >= 0) & away & ~surfaces.two_sided[mesh]


def weights_in_the_open(
    weights: Float[np.ndarray, "p 3"], corners: Int[np.ndarray, "p 3"], enclosed: Bool[np.ndarray, " r"]
) -> Float[np.ndarray, "p 3"]:
    """Weights of corners without those that are enclosed, unless all are of which a point has any.

    Args:
        weights: of each point's corners, which add up to 1.
        corners: numbers among vertices and their backs.
        enclosed: which of those are.
    """
    if not enclosed.any():
        return weights
    shown = np.where(enclosed[corners], 0, weights)
    total = shown.sum(axis=1, keepdims=True)
    return np.where(total > 0, shown / np.where(total > 0, total, 1), weights)
