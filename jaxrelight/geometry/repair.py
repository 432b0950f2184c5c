"""Repair of triangle meshes where no guess is needed, and a count of every change."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import sparse
from scipy.sparse import csgraph

from jaxrelight.errors import InputError
from jaxrelight.geometry.creases import BY_ANGLE, CREASE_ANGLE, smooth_normals, split_vertices
from jaxrelight.geometry.raw_mesh import RawMesh
from jaxrelight.numerics.unique_rows import unique_rows

MAX_COORDINATE = 1e30  # float32 ends at 3e38, and areas square what they are given
FACES_INWARD = "closed mesh faces inward: surfaces are one-sided, so it will look black"
FLAT = 1e-12  # a triangle lower than this part of its longest side is no surface
ROUNDING = 1e-15  # nor is one lower than what float64 resolves at its place


class Repaired(NamedTuple):
    """Faces that can be used, and their vertices.

    Attributes:
        vertices: positions.
        faces: vertex numbers.
        normals: of unit length.
        notes: one line for each change made or doubt left.
        source: which vertex of the file each one was.
    """

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "v 3"]
    notes: tuple[str, ...]
    source: Int[np.ndarray, " v"]


def repaired(raw: RawMesh, crease_angle: float | None = None) -> Repaired:
    """Drops unusable faces, merges identical vertices, orients faces alike and completes the normals.

    Normals that the file does not have follow from the faces, see `smooth_normals`. A vertex at a sharp edge becomes
    one for each of its normals.

    Args:
        raw: the content of a file.
        crease_angle: in degrees, between 0 and 180, instead of what the file says of smoothing; by default that holds,
            and CREASE_ANGLE where it says nothing.

    Raises:
        InputError: no face, or more than half of the faces unusable.
    """
    vertices, faces, lost = raw.vertices, raw.faces, dict(raw.lost)
    smoothing = np.full(len(faces), BY_ANGLE) if raw.smoothing is None or crease_angle is not None else raw.smoothing
    total = len(faces) + sum(lost.values())
    if total == 0:
        what = "points or lines only, no faces" if len(vertices) else "empty, no vertices and no faces"
        raise InputError(f"{what}; export a triangle mesh")

    def drop(reason: str, good: Bool[np.ndarray, " f"]) -> None:
        nonlocal faces, smoothing
        lost[reason] = lost.get(reason, 0) + int((~good).sum())
        faces, smoothing = faces[good], smoothing[good]

    drop("index out of range", ((faces >= 0) & (faces < len(vertices))).min(axis=1))
    referenced = np.unique(faces)
    sound = np.less_equal(np.abs(vertices).max(axis=1, initial=0), MAX_COORDINATE)  # false for NaN
    drop("NaN, infinite or beyond 1e30", sound[faces].min(axis=1))
    drop("zero area", _has_area(vertices[faces]))
    place = unique_rows(vertices)[1]
    drop("repeated", _first_of_kind(place[faces]))
    lost = {reason: count for reason, count in lost.items() if count}
    gone = sum(lost.values())
    if 2 * gone > total or not len(faces):
        reasons = ", ".join(f"{reason}: {count:,}" for reason, count in lost.items())
        raise InputError(f"{gone:,} of {total:,} faces are unusable ({reasons}); repair it in a mesh editor")
    notes = [*raw.notes, *(f"dropped {count:,} of {total:,} faces: {reason}" for reason, count in lost.items())]

    used = np.unique(faces)
    if len(used) < len(referenced):
        notes.append(f"dropped {len(referenced) - len(used):,} vertices that only dropped faces used")
    usable = raw.stated & np.isfinite(raw.normals).all(axis=1)
    file_normals = unit(np.where(usable[:, None], raw.normals, 0.0), np.zeros(3))  # zero where the file has none
    apart = raw.uv if raw.colours is None else np.column_stack([raw.uv, raw.colours])
    seams = np.column_stack([raw.part, np.round(np.nan_to_num(apart, nan=np.inf) * 1e6)])
    first, same = unique_rows(np.column_stack([vertices, seams, np.round(file_normals * 100)])[used])
    rank = np.argsort(first)  # vertices keep the order of the file
    number = np.empty(len(vertices), np.int64)
    number[used] = np.argsort(rank)[same]
    source = used[first[rank]]
    vertices, faces, file_normals = vertices[source], number[faces], file_normals[source]

    faces, doubts = _wound_alike(vertices, faces, file_normals)
    notes += doubts
    faces, file_normals, opposed, doubts = _normals_by_winding(vertices, faces, file_normals)
    notes += doubts
    missing = np.equal(np.abs(file_normals).max(axis=1, initial=0), 0)
    if (missing & raw.stated[source]).any():
        notes.append(f"normals computed for {(missing & raw.stated[source]).sum():,} vertices: the file's are unusable")
    if _faces_inward(vertices, unique_rows(vertices)[1][faces], faces):
        notes.append(FACES_INWARD)
    computed = missing[faces] | opposed[:, None]
    if not computed.any():
        if crease_angle is not None:
            notes.append("crease_angle changes nothing: the file has normals")
        return Repaired(vertices, np.ascontiguousarray(faces), file_normals, tuple(notes), source)
    angle = CREASE_ANGLE if crease_angle is None else crease_angle
    normals, edges = smooth_normals(vertices, faces, smoothing, angle)
    sharp = np.count_nonzero(computed.any(axis=1)[edges].all(axis=1))
    if sharp:
        notes.append(f"normals computed: {sharp:,} edges sharper than {angle:g} degrees are creases (crease_angle)")
    at_corners = np.where(computed[..., None], normals, file_normals[faces])
    faces, of_vertex, normals = split_vertices(faces, at_corners, computed)
    return Repaired(vertices[of_vertex], np.ascontiguousarray(faces), normals, tuple(notes), source[of_vertex])


def _normals_by_winding(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], file_normals: Float[np.ndarray, "v 3"]
) -> tuple[Int[np.ndarray, "f 3"], Float[np.ndarray, "v 3"], Bool[np.ndarray, " f"], list[str]]:
    """Faces and normals of which most agree in every connected piece, and which faces the normals still oppose.

    Where most of a piece's normals oppose its winding, its faces are turned, as the normals say more of what an author
    saw; but where it is closed and wound so that it faces outwards, the normals are.
    """
    area = area_vectors(vertices[faces])
    along = np.sum(area * file_normals[faces].sum(axis=1), axis=1)
    against = along < 0
    if not against.any():
        return faces, file_normals, against, []
    welded = unique_rows(vertices)[1][faces]
    graph = sparse.coo_matrix((np.ones(welded.size), (welded[:, [0, 1, 2]].ravel(), welded[:, [1, 2, 0]].ravel())))
    size = int(welded.max()) + 1
    graph.resize(size, size)
    piece = csgraph.connected_components(graph.tocsr(), directed=False)[1][welded[:, 0]]
    weight = np.linalg.norm(area, axis=1) * np.sign(along)
    contrary = np.bincount(piece, weight) < 0
    turned, mirrored = np.zeros(len(faces), bool), np.zeros(len(vertices), bool)
    order = np.argsort(piece, kind="stable")
    ends = np.cumsum(np.bincount(piece))
    for number in np.flatnonzero(contrary):
        mine = order[ends[number - 1] if number else 0 : ends[number]]
        if _signed_volume(vertices, welded[mine], faces[mine]) > 0:
            mirrored[faces[mine]] = True
        else:
            turned[mine] = True
    notes = []
    if turned.any():
        notes.append(f"turned {turned.sum():,} of {len(faces):,} faces: they faced away from the file's normals")
    if mirrored.any():
        notes.append(f"turned {mirrored.sum():,} normals of the file: they pointed into closed surfaces")
    faces = np.where(turned[:, None], faces[:, ::-1], faces)
    file_normals = np.where(mirrored[:, None], -file_normals, file_normals)
    opposed = np.where(contrary[piece], along > 0, against)
    if opposed.any():
        notes.append(f"normals computed for {opposed.sum():,} faces: the file's point to their other side")
    return faces, file_normals, opposed, notes


def _has_area(corners: Float[np.ndarray, "f 3 3"]) -> Bool[np.ndarray, " f"]:
    """Whether triangles are higher than rounding of their coordinates can explain."""
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1, initial=0)
    reach = np.abs(corners).max(axis=(1, 2), initial=0)
    return np.linalg.norm(area_vectors(corners), axis=1) > longest * np.maximum(FLAT * longest, ROUNDING * reach)


def _first_of_kind(faces: Int[np.ndarray, "f 3"]) -> Bool[np.ndarray, " f"]:
    """Marks all but repetitions: the same three corners in the same turning direction."""
    turned = np.take_along_axis(faces, (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    first = np.zeros(len(faces), bool)
    first[unique_rows(turned)[0]] = True
    return first


def _wound_alike(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], file_normals: Float[np.ndarray, "v 3"]
) -> tuple[Int[np.ndarray, "f 3"], list[str]]:
    """Turns faces so that neighbours run along their common edge in opposite directions, and tells how many.

    Only edges of exactly two faces count, and only connected pieces with a contradiction are touched. Such a piece
    keeps the side of the file's normals, else of the clear majority of its area, else of its outside.
    """
    left, right, alike = _neighbours(faces)
    if not alike.any():
        return faces, []
    count = len(faces)
    # A spanning tree that prefers agreeing neighbours (weight 1) to contradicting ones (2) can always be made
    # consistent. In its double cover, nodes f (as is) and f + count (turned), a face's two states lie in two parts.
    pairs, chosen = np.unique(np.stack([left, right], axis=1), axis=0, return_index=True)
    graph = sparse.coo_matrix((1.0 + alike[chosen], pairs.T), shape=(count, count)).tocsr()
    piece = csgraph.connected_components(graph, directed=False)[1]
    tree = csgraph.minimum_spanning_tree(graph).tocoo()
    turn = np.where(tree.data > 1.5, count, 0)
    cover = sparse.coo_matrix(
        (np.ones(2 * tree.nnz), (np.r_[tree.row, tree.row + count], np.r_[tree.col + turn, tree.col + count - turn])),
        shape=(2 * count, 2 * count),
    )
    state = csgraph.connected_components(cover.tocsr(), directed=False)[1]
    root = np.unique(piece, return_index=True)[1][piece]
    flip = state[:count] != state[root]

    remaining = alike ^ flip[left] ^ flip[right]
    better = np.bincount(piece[left], 1.0 * alike) > np.bincount(piece[left], 1.0 * remaining)
    touched = np.zeros(piece.max() + 1, bool)
    touched[: len(better)] = better
    flip &= touched[piece]
    remaining = alike ^ flip[left] ^ flip[right]

    area = area_vectors(vertices[faces])
    size = np.linalg.norm(area, axis=1)
    sign = np.where(flip, -1.0, 1.0)
    total = np.bincount(piece, size)
    middle = vertices[faces].mean(axis=1)
    centre = np.stack([np.bincount(piece, size * middle[:, k]) for k in range(3)], axis=1) / total[:, None]
    by_normals = np.bincount(piece, sign * (area * file_normals[faces].sum(axis=1)).sum(axis=1))
    by_area = np.bincount(piece, sign * size)
    outward = np.bincount(piece, sign * (area * (middle - centre[piece])).sum(axis=1))
    vote = np.where(by_normals != 0, by_normals, np.where(np.abs(by_area) > 0.2 * total, by_area, outward))
    flip ^= (touched & (vote < 0))[piece]

    notes = [f"turned {flip.sum():,} of {count:,} faces: inconsistent winding"] if flip.any() else []
    if remaining.any():
        notes.append(f"winding stays inconsistent along {remaining.sum():,} edges: no choice of sides fits them all")
    return np.where(flip[:, None], faces[:, ::-1], faces), notes


def _neighbours(
    faces: Int[np.ndarray, "f 3"],
) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"], Bool[np.ndarray, " p"]]:
    """Pairs of faces (lower number first) at edges that exactly two share, and whether both run the same way there."""
    edges = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    edge = unique_rows(np.sort(edges, axis=1))[1]
    order = np.argsort(edge, kind="stable")
    two = order[(np.bincount(edge) == 2)[edge[order]]].reshape(-1, 2)
    rising = edges[:, 0] < edges[:, 1]
    return two[:, 0] // 3, two[:, 1] // 3, rising[two[:, 0]] == rising[two[:, 1]]


def _faces_inward(
    vertices: Float[np.ndarray, "v 3"], welded: Int[np.ndarray, "f 3"], faces: Int[np.ndarray, "f 3"]
) -> bool:
    """Whether a surface is closed, wound consistently and encloses negative volume."""
    return _signed_volume(vertices, welded, faces) < 0


def _signed_volume(
    vertices: Float[np.ndarray, "v 3"], welded: Int[np.ndarray, "f 3"], faces: Int[np.ndarray, "f 3"]
) -> float:
    """The volume that a closed surface encloses, negative if it faces inwards; 0 if it is open or has next to none."""
    _, right, alike = _neighbours(welded)
    if 2 * len(right) != 3 * len(faces) or alike.any():
        return 0.0
    corners = vertices[faces]
    corners = corners - corners.mean(axis=(0, 1))
    volume = float((area_vectors(corners) * corners[:, 0]).sum() / 6)
    return volume if abs(volume) > 1e-9 * np.prod(np.ptp(corners, axis=(0, 1))) else 0.0


def area_vectors(corners: Float[np.ndarray, "f 3 3"]) -> Float[np.ndarray, "f 3"]:
    """Normals as long as twice the area."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def unit(vectors: Float[np.ndarray, "n 3"], otherwise: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "n 3"]:
    """Vectors scaled to length one, in two steps so that neither tiny nor huge ones are lost; zeros are replaced."""
    largest = np.abs(vectors).max(axis=1, keepdims=True, initial=0)
    scaled = vectors / np.where(largest > 0, largest, 1.0)
    length = np.linalg.norm(scaled, axis=1, keepdims=True)
    return np.where(length > 0, scaled / np.where(length > 0, length, 1.0), otherwise)
