"""What points of a cloud get from each other over several bounces, by photons that they shoot (Hašan 2006 §4.3)."""

import threading
from collections.abc import Sequence

import numpy as np
import scipy.sparse
from jaxtyping import Float
from scipy.spatial import KDTree

from jaxrelight.basis.haar import HaarFaces
from jaxrelight.brdf.reflection import Reflection
from jaxrelight.gather.gather_cloud import GatherCloud
from jaxrelight.gather.gathered import Gathered
from jaxrelight.gather.photons import AlbedoAt, Photons, shoot
from jaxrelight.geometry.receivers import Receivers
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.numerics.arrays import as_array

# The number of nearest photons that tell what arrives.
_NEAREST = 2000
# Cosine between normals of what is the same surface.
_ALIKE = 0.5
# Parts of points that tell the area of a disc, about.
_PARTS = 32


class PhotonGather:
    """Rows over the Haar coefficients of a cloud's image, of light that was reflected any number of times up to one.

    Of a point x and those photons of the k nearest that landed on surfaces like its own, within a disc of area D,

        M(x, s) = Σ power A_s / (n D)

    of the photons that point s, of area A_s, shot n of. D is what parts of the cloud's points stand for in it, so
    that nothing is lost at the edges of surfaces.

    Attributes:
        emits: whether what surfaces emit is gathered beside rows: it is light of the cloud, and is not.
        rays: traced so far.
    """

    def __init__(
        self,
        cloud: GatherCloud,
        surfaces: Surfaces,
        tracer: Tracer,
        albedo: AlbedoAt,
        each: int,
        length: int,
        seed: int = 0,
    ):
        """Photons are shot when the first rows are asked for.

        Args:
            cloud: whose points shoot, each as many.
            surfaces: of the scene.
            tracer: of the scene.
            albedo: of surface points: of all that photons meet on their way, but for the last.
            each: photons of each point.
            length: how often each lands at most.
            seed: of their directions.
        """
        self.emits = False
        self.rays = 0
        self._cloud, self._share = cloud, cloud.areas / each
        self._parts = KDTree(cloud.parts.reshape(-1, 3))
        self._shooting = surfaces, tracer, cloud.positions, cloud.face_normals, albedo, each, length, seed
        self._once = threading.Lock()
        self._shot: tuple[Photons, KDTree] | None = None

    def _landed(self) -> tuple[Photons, KDTree]:
        with self._once:
            if self._shot is None:
                photons = shoot(*self._shooting)
                # Photons set out, and go on from every landing but those at the end of their way.
                self.rays = len(self._cloud.positions) * self._shooting[5] + len(photons.origins)
                self._shot = photons, KDTree(photons.positions)
            return self._shot

    def rows(
        self,
        receivers: Receivers,
        group: int,
        frames: Float[np.ndarray, "m 3 3"],
        reflections: Sequence[Reflection],
        channels: Sequence[int] | None = None,
    ) -> list[Gathered]:
        """What one group of the cloud's points gets of a white surface's share; reflections are of that."""
        positions, normals = receivers.positions[group], receivers.face_normals[group]
        cloud, (photons, tree) = self._cloud, self._landed()
        # Where there are many photons, more are taken, so that their disc has enough of the points' parts for its area.
        enough = max(_NEAREST, _PARTS * len(photons.positions) // cloud.parts[..., 0].size)
        m, k = len(positions), min(enough, len(photons.positions))
        rows = np.zeros((m, 3, len(cloud.positions)), np.float32)
        if k:
            distance, nearest = (np.asarray(array).reshape(m, k) for array in tree.query(positions, k))
            alike = np.einsum("mkx,mx->mk", photons.normals[nearest], normals) > _ALIKE
            receiver, nth = np.nonzero(alike)
            chosen = nearest[receiver, nth]
            origin = photons.origins[chosen]
            share = self._share[origin] / self._areas(positions, normals, distance[:, -1])[receiver]
            for c in range(3):
                sums = scipy.sparse.coo_matrix((photons.power[chosen, c] * share, (receiver, origin)), rows[:, c].shape)
                rows[:, c] = sums.toarray()
        encoded = np.asarray(HaarFaces(cloud.side, 1).encode(as_array(rows)))
        columns = np.arange(encoded.shape[-1])
        return [Gathered(columns, encoded[:, None], None) for _ in reflections]

    def channels_of(self, reflections: Sequence[Reflection]) -> list[int]:
        """Three: the colours that were met on the way."""
        return [3] * len(reflections)

    def _areas(self, positions, normals, radii) -> Float[np.ndarray, " m"]:
        """Areas of surfaces like a receiver's own within a radius: of the points' parts, or of a disc without any."""
        neighbours = self._parts.query_ball_point(positions, radii)
        areas, facing = self._cloud.part_areas.reshape(-1), self._cloud.part_normals.reshape(-1, 3)
        alike = [
            np.asarray(chosen)[facing[chosen] @ normal > _ALIKE]
            for chosen, normal in zip(neighbours, normals, strict=True)
        ]
        sums = np.array([areas[chosen].sum() for chosen in alike])
        return np.where(sums > 0, sums, np.pi * radii**2)
