"""Faces split until they are small enough to carry light at their vertices, without cracks."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxrelight.errors import InputError
from jaxrelight.geometry.mesh import Mesh
from jaxrelight.geometry.triangles import area_vectors, unit
from jaxrelight.numerics.unique_rows import unique_rows

_MAX_FACES = 20_000_000
# Middles of edges in the same place, as those of two meshes at their border, differ by less, relative to the scene.
_SAME_PLACE = 1e-6


def subdivided(mesh: Mesh, max_edge: float) -> Mesh:
    """The same surface with no edge longer than `max_edge` metres.

    Every longer edge is halved, in all faces that share it, so that no crack and no vertex inside another's edge comes
    to be; again until none is left. Positions, normals, texture coordinates and colours are interpolated. Faces that
    are small enough stay as they are.

    Raises:
        InputError: `max_edge` is not a positive number, or the faces would be too many.
    """
    if not (isinstance(max_edge, int | float) and np.isfinite(max_edge) and max_edge > 0):
        raise InputError(f"max_edge is {max_edge!r}; give a positive number of metres")
    # No face whose edges are that short has more than an equilateral one's area.
    area = np.linalg.norm(area_vectors(mesh.vertices[mesh.faces]), axis=1).sum() / 2
    if area > _MAX_FACES * max_edge**2 * 3**0.5 / 4:
        raise _too_many(max_edge)
    while True:
        edges = edges_of(mesh)
        long = np.linalg.norm(np.diff(mesh.vertices[edges.ends], axis=1)[:, 0], axis=-1) > max_edge
        if not long.any():
            return mesh
        mesh = halved(mesh, edges, long)
        if len(mesh.faces) > _MAX_FACES:
            raise _too_many(max_edge)


class Edges(NamedTuple):
    """Edges of a mesh, each once.

    Attributes:
        ends: vertex numbers, ascending.
        of_sides: the number of the edge that each face's side 0–1, 1–2 and 2–0 is.
    """

    ends: Int[np.ndarray, "e 2"]
    of_sides: Int[np.ndarray, "f 3"]


def edges_of(mesh: Mesh) -> Edges:
    """All edges, by their ends."""
    sides = np.sort(np.stack([mesh.faces, np.roll(mesh.faces, -1, axis=1)], axis=-1), axis=-1).reshape(-1, 2)
    key, edge_of_side = np.unique(sides[:, 0] * len(mesh.vertices) + sides[:, 1], return_inverse=True)
    return Edges(np.stack(np.divmod(key, len(mesh.vertices)), axis=-1), edge_of_side.reshape(-1, 3))


def halved(mesh: Mesh, edges: Edges, chosen: Bool[np.ndarray, " e"]) -> Mesh:
    """The same surface with a vertex in the middle of each chosen edge, in all faces that share it.

    New vertices follow those of the mesh, in the order of the edges.
    """
    nothing = np.zeros((len(mesh.vertices), 0))
    uv, colours = (nothing if columns is None else columns for columns in (mesh.uv, mesh.colours))
    # One row a vertex, so that all that a vertex has is interpolated alike: position, normal, texture coordinates and
    # colour.
    corners = np.concatenate([mesh.vertices, mesh.normals, uv, colours], axis=1)
    colours_start = 6 + uv.shape[1]
    middle = np.full(len(chosen), -1)
    middle[chosen] = len(corners) + np.arange(chosen.sum())
    corners = np.concatenate([corners, corners[edges.ends[chosen]].mean(axis=1)])
    return dataclasses.replace(
        mesh,
        vertices=corners[:, :3],
        normals=unit(corners[:, 3:6], np.array([0.0, 1.0, 0.0])),
        uv=None if mesh.uv is None else corners[:, 6:colours_start],
        colours=None if mesh.colours is None else corners[:, colours_start:],
        faces=_split(mesh.faces, middle[edges.of_sides], corners[:, :3]),
    )


def _too_many(max_edge: float) -> InputError:
    return InputError(f"max_edge {max_edge:g} gives more than {_MAX_FACES:,} faces; choose a larger one")


def _split(
    faces: Int[np.ndarray, "f 3"], middle: Int[np.ndarray, "f 3"], positions: Float[np.ndarray, "v 3"]
) -> Int[np.ndarray, "g 3"]:
    """Each face as 1 to 4, given the new vertex in the middle of each of its edges, −1 for none."""
    count = (middle >= 0).sum(axis=1)
    parts = [faces[count == 0]]

    def turned(halved: int, first: np.ndarray):
        """Corners a, b, c and middles ab, bc, ca of the faces with so many halved edges, turned to a first corner."""
        chosen = count == halved
        order = (first[chosen, None] + np.arange(3)) % 3
        return (*np.take_along_axis(faces[chosen], order, 1).T, *np.take_along_axis(middle[chosen], order, 1).T)

    a, b, c, ab, *_ = turned(1, np.argmax(middle >= 0, axis=1))
    parts += [np.stack(corners, axis=1) for corners in ((a, ab, c), (ab, b, c))]

    # ab and bc are halved; the rest is a square, cut along its shorter diagonal.
    a, b, c, ab, bc, _ = turned(2, np.argmax(middle < 0, axis=1) + 1)
    length_a, length_c = (np.linalg.norm(positions[p] - positions[q], axis=-1)[:, None] for p, q in ((a, bc), (ab, c)))
    by_a = [np.stack(corners, axis=1) for corners in ((a, ab, bc), (a, bc, c))]
    by_c = [np.stack(corners, axis=1) for corners in ((a, ab, c), (ab, bc, c))]
    parts += [np.stack([ab, b, bc], axis=1)]
    parts += [np.where(length_a <= length_c, one, other) for one, other in zip(by_a, by_c, strict=True)]

    a, b, c, ab, bc, ca = turned(3, np.zeros(len(faces), int))
    parts += [np.stack(corners, axis=1) for corners in ((a, ab, ca), (ab, b, bc), (ca, bc, c), (ab, bc, ca))]
    return np.concatenate(parts)


def conforming(
    meshes: Sequence[Mesh],
    edges: Sequence[Edges],
    lengths: Sequence[Float[np.ndarray, " _"]],
    chosen: Sequence[Bool[np.ndarray, " _"]],
    radius: float,
) -> list[Bool[np.ndarray, " _"]]:
    """The chosen edges of several meshes, with those that have to be halved because others are.

    That is the longest side of every face of which another one is halved, or faces would become needles whose sides
    never get shorter (Rivara 1984), and what lies in the same place in another mesh.

    Args:
        meshes: of a scene.
        edges: of each.
        lengths: of its edges.
        chosen: which of them are to be halved.
        radius: of the scene, in the units of the meshes.
    """
    place_of = _places(meshes, edges, radius)
    while True:
        count = sum(one.sum() for one in chosen)
        chosen = _shared(chosen, place_of)
        for one, of, length in zip(chosen, edges, lengths, strict=True):
            touched = of.of_sides[one[of.of_sides].any(axis=1)]
            one[np.take_along_axis(touched, length[touched].argmax(axis=1)[:, None], axis=1)] = True
        if sum(one.sum() for one in chosen) == count:
            return chosen


def _places(meshes, edges, radius: float) -> Int[np.ndarray, " _"]:
    """A number for the place of each edge's middle, of all meshes one after the other."""
    middles = [mesh.vertices[of.ends].mean(axis=1) for mesh, of in zip(meshes, edges, strict=True)]
    return unique_rows(np.rint(np.concatenate(middles) / (radius * _SAME_PLACE)).astype(np.int64))[1]


def _shared(chosen, place_of: Int[np.ndarray, " _"]) -> list[Bool[np.ndarray, " _"]]:
    """The same with edges in the same place as one that is halved, so that no vertex lies inside another's edge."""
    wanted = np.zeros(place_of.max(initial=-1) + 1, bool)
    wanted[place_of[np.concatenate(chosen)]] = True
    return [one.copy() for one in np.split(wanted[place_of], np.cumsum([len(one) for one in chosen])[:-1])]
