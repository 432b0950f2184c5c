"""Ray queries: the only file that knows embree."""

import functools
import hashlib
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, Real

from jaxrelight.geometry.surfaces import LIFT, Surfaces
from jaxrelight.numerics.unique_rows import unique_rows

# How far origins are lifted where the face is not at hand: coordinates of scene space are at most 1, faces 2 wide.
OFFSET = 2 * LIFT


class _Twins(NamedTuple):
    """For each face the one that lies in the same place and faces the other way.

    Attributes:
        reverse: its number; −1 where there is none.
        corners: which corner of the face each of its corners is.
        normals: of the faces.
    """

    reverse: Int[np.ndarray, " f"]
    corners: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "f 3"]


def _twins(surfaces: Surfaces) -> _Twins | None:
    """None where no face has a reverse."""
    _, place = unique_rows(surfaces.vertices.astype(np.float32))
    ends = place[surfaces.faces]
    order = np.argsort(ends, axis=1)
    ranked = np.take_along_axis(ends, order, axis=1)
    # Whether the corners, in the order of their places, run the way that the face does.
    forward = (np.roll(order, -1, axis=1) - order) % 3 == 1
    forward = forward[:, 0]
    _, group = unique_rows(ranked)
    shared = np.flatnonzero(np.bincount(group)[group] > 1)
    reverse, corners = np.full(len(ends), -1), np.tile(np.arange(3), (len(ends), 1))
    first = {}
    for face in shared:
        first.setdefault((group[face], bool(forward[face])), face)
    for face in shared:
        other = first.get((group[face], not forward[face]), -1)
        if other >= 0:
            reverse[face] = other
            corners[face, order[other]] = order[face]
    if not (reverse >= 0).any():
        return None
    return _Twins(reverse, corners, surfaces.face_normals(np.arange(len(ends))))


class Tracer:
    """Rays against a fixed set of triangles in scene space. Its methods may be called from several threads.

    Tracers of the same triangles are equal: what is compiled with one as a static argument serves the others.
    """

    def __init__(self, surfaces: Surfaces):
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        self._twins = _twins(surfaces)
        self._scene = EmbreeScene()
        self._triangles = np.ascontiguousarray(surfaces.vertices[surfaces.faces], np.float32)
        TriangleMesh(self._scene, self._triangles)
        # Embree builds its tree at the first query; that must not happen in two threads at once.
        self._query(np.zeros((1, 3)), np.ones((1, 3)), "OCCLUDED")

    @functools.cached_property
    def key(self) -> str:
        """A hash of the triangles."""
        return hashlib.blake2b(self._triangles.data, digest_size=16).hexdigest()

    def __eq__(self, other: object) -> bool:
        return isinstance(other, Tracer) and self.key == other.key

    def __hash__(self) -> int:
        return hash(self.key)

    def occluded(
        self, origins: Real[np.ndarray, "*r 3"], directions: Real[np.ndarray, "r 3"]
    ) -> Bool[np.ndarray, " r"]:
        """Whether anything is hit along each ray, at any distance. Lift origins first: see `ray_origins`.

        One origin may stand for all rays; it is not copied for each.
        """
        return self._query(origins, directions, "OCCLUDED") == 0

    def blocked(
        self, origins: Float[np.ndarray, "r 3"], directions: Float[np.ndarray, "r 3"], distance: Float[np.ndarray, " r"]
    ) -> Bool[np.ndarray, " r"]:
        """Whether anything is hit along each ray before a distance in scene space. Lift origins first."""
        near = np.ascontiguousarray(np.clip(distance, 0, 1e30), np.float32)
        return self._query(origins, directions, "OCCLUDED", dists=near) == 0

    def distances(
        self, origins: Float[np.ndarray, "r 3"], directions: Float[np.ndarray, "r 3"]
    ) -> Float[np.ndarray, " r"]:
        """How far along each ray the first hit is, in scene space; infinite for none. Lift origins first."""
        distances = self._query(origins, directions, "DISTANCE")
        return np.where(distances < 1e30, distances, np.inf)

    def first_hits(
        self, origins: Real[np.ndarray, "*r 3"], directions: Real[np.ndarray, "r 3"]
    ) -> tuple[Int[np.ndarray, " r"], Float[np.ndarray, "r 3"]]:
        """The nearest face along each ray, −1 for none, and the barycentric weights of its corners.

        Of a face and its reverse at the same place it is the one whose front the ray meets.
        """
        hit = self._query(origins, directions, "INTERSECT", output=1)
        face = np.where(hit["tfar"] < 1e30, hit["primID"].astype(np.int64), -1)
        u, v = hit["u"].astype(float), hit["v"].astype(float)
        weights = np.stack([1 - u - v, u, v], axis=-1)
        if self._twins is not None:
            normals = self._twins.normals[face]
            turned = np.flatnonzero((face >= 0) & (np.sum(normals * directions, axis=1) > 0))
            turned = turned[self._twins.reverse[face[turned]] >= 0]
            weights[turned] = np.take_along_axis(weights[turned], self._twins.corners[face[turned]], axis=1)
            face[turned] = self._twins.reverse[face[turned]]
        return face, weights

    def _query(self, origins, directions, query, **options):
        origins = np.ascontiguousarray(origins, np.float32)
        directions = np.ascontiguousarray(directions, np.float32)
        if origins.shape == (3,) and directions.ndim == 2:
            origins = np.lib.stride_tricks.as_strided(origins, directions.shape, (0, origins.strides[0]))
        # Embree reads past a shorter array and calls rays that are not finite "not hit".
        if origins.shape != directions.shape or origins.shape[1:] != (3,):
            raise ValueError(f"rays need equal shapes [r, 3], not {origins.shape} and {directions.shape}")
        return self._scene.run(origins, directions, query=query, **options)
