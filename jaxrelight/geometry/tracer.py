"""Ray queries: the only file that knows embree."""

import functools
import hashlib

import numpy as np
from jaxtyping import Bool, Float, Int, Real

from jaxrelight.geometry.surfaces import Surfaces

# How far origins are lifted off a surface in scene space, whose coordinates are at most 1: rays have no near limit.
# About 170 ulps of 1: measured to leave no self-hit on planes and spheres and to cost nothing elsewhere.
OFFSET = 2e-5


class Tracer:
    """Rays against a fixed set of triangles in scene space. Its methods may be called from several threads.

    Tracers of the same triangles are equal: what is compiled with one as a static argument serves the others.
    """

    def __init__(self, surfaces: Surfaces):
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

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
        """Whether anything is hit along each ray, at any distance. Lift origins by `OFFSET` first.

        One origin may stand for all rays; it is not copied for each.
        """
        return self._query(origins, directions, "OCCLUDED") == 0

    def blocked(
        self, origins: Float[np.ndarray, "r 3"], directions: Float[np.ndarray, "r 3"], distance: Float[np.ndarray, " r"]
    ) -> Bool[np.ndarray, " r"]:
        """Whether anything is hit along each ray before a distance in scene space. Lift origins by `OFFSET` first."""
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
        """The nearest face along each ray, −1 for none, and the barycentric weights of its corners."""
        hit = self._query(origins, directions, "INTERSECT", output=1)
        face = np.where(hit["tfar"] < 1e30, hit["primID"].astype(np.int64), -1)
        u, v = hit["u"].astype(float), hit["v"].astype(float)
        return face, np.stack([1 - u - v, u, v], axis=-1)

    def _query(self, origins, directions, query, **options):
        origins = np.ascontiguousarray(origins, np.float32)
        directions = np.ascontiguousarray(directions, np.float32)
        if origins.shape == (3,) and directions.ndim == 2:
            origins = np.lib.stride_tricks.as_strided(origins, directions.shape, (0, origins.strides[0]))
        # Embree reads past a shorter array and calls rays that are not finite "not hit".
        if origins.shape != directions.shape or origins.shape[1:] != (3,):
            raise ValueError(f"rays need equal shapes [r, 3], not {origins.shape} and {directions.shape}")
        return self._scene.run(origins, directions, query=query, **options)
