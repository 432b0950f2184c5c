"""Sharp edges: which faces share a smooth normal where they meet, and the normals that follow."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import sparse
from scipy.sparse import csgraph

from jaxrelight.geometry.triangles import area_vectors, half_edges, unit
from jaxrelight.numerics.unique_rows import unique_rows

# The angle between neighbours' normals, in degrees, beyond which an edge is sharp where a file says nothing.
CREASE_ANGLE = 40.0
# What a face's smoothing may be besides the number of a group: flat, or smooth up to the crease angle.
FLAT_FACE, BY_ANGLE = 0, -1
# Faces of one edge; further ones are not compared with each other.
_MAX_FACES_OF_EDGE = 8


def smooth_normals(
    vertices: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    smoothing: Int[np.ndarray, " f"],
    crease_angle: float,
) -> tuple[Float[np.ndarray, "f 3 3"], Int[np.ndarray, "s 2"]]:
    """Unit normals at the corners of faces: means over the faces that are smooth around a corner, weighted by angle.

    Two faces that run along an edge in opposite directions are smooth there if both are of one smoothing group, or if
    both go by angle and their normals differ by no more than the crease angle. Vertices at one place count as one, of
    whatever material they are. Which faces a corner shares its normal with is passed on from edge to edge around it,
    so that an edge that ends on a smooth surface fades out.

    Args:
        vertices: positions.
        faces: vertex numbers, wound alike.
        smoothing: of each face: FLAT_FACE, BY_ANGLE or the number of a smoothing group, from 1 on.
        crease_angle: in degrees.

    Returns:
        The normals, and the pairs of faces between which edges are sharp because of the crease angle.
    """
    corners = vertices[faces]
    normals, angles = unit(area_vectors(corners), np.array([0.0, 1.0, 0.0])), _corner_angles(corners)
    place = unique_rows(vertices)[1][faces]
    first, second, at_first, at_second = _meeting(place)
    cosines = np.sum(normals[first] * normals[second], axis=1)
    by_angle = (smoothing[first] == BY_ANGLE) & (smoothing[second] == BY_ANGLE)
    grouped = (smoothing[first] == smoothing[second]) & (smoothing[first] > 0)
    blunt = cosines >= np.cos(np.radians(crease_angle)) - 1e-9
    smooth = np.flatnonzero(grouped | (by_angle & blunt))
    # Both ends of a smooth edge join the corners that its two faces have there.
    ends = [(3 * first[smooth] + at_first[smooth, k], 3 * second[smooth] + at_second[smooth, k]) for k in (0, 1)]
    pairs = np.concatenate([np.stack(pair) for pair in ends], axis=1)
    graph = sparse.coo_matrix((np.ones(pairs.shape[1]), tuple(pairs)), shape=(3 * len(faces),) * 2)
    count, member = csgraph.connected_components(graph.tocsr(), directed=False)
    weighted = (angles[:, :, None] * normals[:, None]).reshape(-1, 3)
    sums = np.stack([np.bincount(member, weighted[:, axis], count) for axis in range(3)], axis=1)[member]
    length = np.linalg.norm(sums, axis=1, keepdims=True)
    own = np.repeat(normals, 3, axis=0)
    means = np.where(length > 1e-9, sums / np.where(length > 1e-9, length, 1), own)
    sharp = by_angle & ~blunt
    return means.reshape(-1, 3, 3), np.stack([first[sharp], second[sharp]], axis=1)


def split_vertices(
    faces: Int[np.ndarray, "f 3"], normals: Float[np.ndarray, "f 3 3"], split: Bool[np.ndarray, "f 3"]
) -> tuple[Int[np.ndarray, "f 3"], Int[np.ndarray, " u"], Float[np.ndarray, "u 3"]]:
    """Vertices with one normal each, from normals at corners.

    Args:
        faces: vertex numbers.
        normals: at the corners.
        split: which corners may have another normal than their vertex has elsewhere.

    Returns:
        The faces by new numbers; which vertex each new one was; and its normal. New ones follow the order of the old.
    """
    told_apart = np.where(split[..., None], np.round(normals * 1e4), 0.0).reshape(-1, 3)
    first, number = unique_rows(np.column_stack([faces.reshape(-1), split.reshape(-1), told_apart]))
    return number.reshape(-1, 3), faces.reshape(-1)[first], normals.reshape(-1, 3)[first]


def _meeting(place: Int[np.ndarray, "f 3"]):
    """Pairs of faces that run along an edge in opposite directions, and the numbers of their corners at both ends."""
    edge, rising = half_edges(place)
    order = np.argsort(edge, kind="stable")
    first, second = [], []
    for step in range(1, min(_MAX_FACES_OF_EDGE, int(np.bincount(edge).max(initial=1)))):
        one, other = order[:-step], order[step:]
        pairs = (edge[one] == edge[other]) & (rising[one] != rising[other])
        first.append(one[pairs])
        second.append(other[pairs])
    none = np.zeros(0, np.int64)
    one, other = np.concatenate([none, *first]), np.concatenate([none, *second])
    # The one's start is the other's end.
    at_one = np.stack([one % 3, (one + 1) % 3], axis=1)
    at_other = np.stack([(other + 1) % 3, other % 3], axis=1)
    return one // 3, other // 3, at_one, at_other


def _corner_angles(corners: Float[np.ndarray, "f 3 3"]) -> Float[np.ndarray, "f 3"]:
    ahead, behind = np.roll(corners, -1, axis=1) - corners, np.roll(corners, 1, axis=1) - corners
    return np.arctan2(np.linalg.norm(np.cross(ahead, behind), axis=2), (ahead * behind).sum(axis=2))
