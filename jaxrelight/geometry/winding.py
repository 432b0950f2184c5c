"""Which way faces are wound: alike within a surface, and as its normals say."""

import numpy as np
from jaxtyping import Bool, Float, Int
from scipy import sparse
from scipy.sparse import csgraph

from jaxrelight.geometry.triangles import area_vectors, half_edges
from jaxrelight.numerics.unique_rows import unique_rows


def wind_alike(
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


def match_normals(
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


def faces_inward(
    vertices: Float[np.ndarray, "v 3"], welded: Int[np.ndarray, "f 3"], faces: Int[np.ndarray, "f 3"]
) -> bool:
    """Whether a surface is closed, wound consistently and encloses negative volume."""
    return _signed_volume(vertices, welded, faces) < 0


def _neighbours(
    faces: Int[np.ndarray, "f 3"],
) -> tuple[Int[np.ndarray, " p"], Int[np.ndarray, " p"], Bool[np.ndarray, " p"]]:
    """Pairs of faces (lower number first) at edges that exactly two share, and whether both run the same way there."""
    edge, rising = half_edges(faces)
    order = np.argsort(edge, kind="stable")
    two = order[(np.bincount(edge) == 2)[edge[order]]].reshape(-1, 2)
    return two[:, 0] // 3, two[:, 1] // 3, rising[two[:, 0]] == rising[two[:, 1]]


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
