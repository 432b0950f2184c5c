"""How much of what each place reflects reaches the picture, by particles from it (Smits 1992; Hašan 2006 §4.1)."""

import numpy as np
from jaxtyping import Float
from scipy.spatial import KDTree

from jaxrelight.gather.photons import AlbedoAt, shoot
from jaxrelight.geometry.gbuffer import GBuffer
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import Tracer

# The number of nearest particles that tell their density.
_NEAREST = 64
# Places that no particle reaches are worth this share of the mean.
_MIN_RELATIVE_DENSITY = 0.05


class Importance:
    """The density of particles that were shot from what a camera sees."""

    def __init__(
        self,
        surfaces: Surfaces,
        tracer: Tracer,
        seen: GBuffer,
        albedo: AlbedoAt,
        particles: int = 2**19,
        length: int = 3,
        seed: int = 0,
    ):
        """Shoots them.

        Args:
            surfaces: of the scene.
            tracer: of the scene.
            seen: at least one pixel.
            albedo: of surface points.
            particles: in all, about; each pixel shoots at least one.
            length: how often each lands at most.
            seed: of their directions.
        """
        each = max(1, round(particles / len(seen.positions)))
        photons = shoot(surfaces, tracer, seen.positions, seen.face_normals, albedo, each, length, seed)
        self._normals, self._power = photons.normals, photons.power.mean(axis=1)
        self._tree = KDTree(photons.positions) if len(photons.positions) >= _NEAREST else None

    def __call__(
        self, positions: Float[np.ndarray, "p 3"], normals: Float[np.ndarray, "p 3"], areas: Float[np.ndarray, " p"]
    ) -> Float[np.ndarray, " p"]:
        """The importance of places that stand for some areas, relative to their mean; it is never 0."""
        if self._tree is None:
            return np.ones(len(positions))
        distance, nearest = self._tree.query(positions, _NEAREST, workers=-1)
        front = np.einsum("pkx,px->pk", self._normals[nearest], normals) > 0
        density = np.sum(self._power[nearest] * front, axis=1) / np.maximum(distance[:, -1], 1e-4) ** 2
        mean = np.sum(density * areas) / areas.sum()
        return np.maximum(density / mean, _MIN_RELATIVE_DENSITY) if mean > 0 else np.ones(len(positions))
