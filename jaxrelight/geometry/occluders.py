"""Where a group of receivers may be occluded, proved from bounds of what surrounds it: elsewhere there is open sky."""

import numpy as np
from jaxtyping import Bool, Float

from jaxrelight.geometry.morton import morton
from jaxrelight.geometry.surfaces import Surfaces

# Faces are bounded in parts of at most this radius, and parts in clusters, of which there are not many more than this.
_LARGEST_PART, _CLUSTERS, _MIN_PARTS = 1 / 16, 2048, 16
# Large faces stay whole where dividing them would make more parts than this.
_MAX_PARTS = 2**20
# Heights above a receiver that rounding of its ray's origin and direction may cause.
_ROUNDING = 1e-7


class Occluders:
    """Boxes and spheres around clusters of faces that are close to each other, in scene space."""

    def __init__(self, surfaces: Surfaces):
        """From all faces of a scene."""
        corners = _in_parts(surfaces.vertices[surfaces.faces])
        order = np.argsort(morton((corners.mean(axis=1) + 1) / 2))
        size = max(_MIN_PARTS, -(-len(order) // _CLUSTERS))
        # The last cluster is filled up with its last face.
        filled = np.concatenate([order, np.repeat(order[-1:], -len(order) % size)])
        self._corners = corners[filled].reshape(-1, 3 * size, 3)
        low, high = self._corners.min(axis=1), self._corners.max(axis=1)
        self._centres, self._halves = (low + high) / 2, (high - low) / 2
        self._radii = np.linalg.norm(self._corners - self._centres[:, None], axis=2).max(axis=1)

    def possible(
        self,
        origins: Float[np.ndarray, "m 3"],
        normals: Float[np.ndarray, "m 3"],
        directions: Float[np.ndarray, "n 3"],
        radius: float,
    ) -> Bool[np.ndarray, " n"]:
        """Directions near which a ray of some receiver may hit anything above the horizon.

        Args:
            origins: of the receivers' rays, lifted off the surface.
            normals: theirs; only rays above them count.
            directions: unit vectors.
            radius: how far off these rays are, at most, as an angle.
        """
        low, high = origins.min(axis=0), origins.max(axis=0)
        middle = (low + high) / 2
        towards = self._centres - middle
        extent = self._radii + np.linalg.norm(origins - middle, axis=1).max() + _ROUNDING
        distance = np.linalg.norm(towards, axis=1)
        around, others = distance <= extent, distance > extent
        if self._any_rises(origins, normals, np.flatnonzero(around)):
            return np.ones(len(directions), bool)
        seen = np.flatnonzero(others)[self._rise_above(origins, normals, np.flatnonzero(others))]
        angle = np.minimum(np.arcsin(extent[seen] / distance[seen]) + radius, np.pi)
        near = directions @ (towards[seen] / distance[seen, None]).T >= np.cos(angle) - _ROUNDING
        return near.any(axis=1)

    def _any_rises(self, origins, normals, clusters) -> bool:
        """Whether any cluster has a face in part above the horizon of a receiver: mostly, one corner of each tells."""
        heights = np.sum(normals * origins, axis=1)[:, None]
        first = normals @ self._corners[clusters, 0].T - heights
        return bool((first > _ROUNDING).any()) or bool(self._rise_above(origins, normals, clusters).any())

    def _rise_above(self, origins, normals, clusters) -> Bool[np.ndarray, " k"]:
        """Which clusters have a face in part above the horizon of a receiver."""
        heights = np.sum(normals * origins, axis=1)[:, None]
        rise = (normals @ self._corners[clusters, 0].T - heights > _ROUNDING).any(axis=0)
        tops = normals @ self._centres[clusters].T + np.abs(normals) @ self._halves[clusters].T - heights
        # Where one corner of a cluster is below all horizons, and its box is not, all of its corners tell.
        unclear = np.flatnonzero(~rise & (tops > _ROUNDING).any(axis=0))
        corners = self._corners[clusters[unclear]]
        highest = (normals @ corners.reshape(-1, 3).T - heights).max(axis=0, initial=-np.inf)
        rise[unclear] = (highest.reshape(corners.shape[:2]) > _ROUNDING).any(axis=1)
        return rise


def _in_parts(corners: Float[np.ndarray, "f 3 3"]) -> Float[np.ndarray, "p 3 3"]:
    """The faces, with large ones divided into parts that cover the same surface.

    Where there are so many large faces that the parts would be too many, the rest of them stay large: bounds are wider
    then, and still hold.
    """
    done, most = [], max(_MAX_PARTS, len(corners))
    while len(corners):
        middle = (corners.min(axis=1) + corners.max(axis=1)) / 2
        large = np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1) > _LARGEST_PART
        if sum(map(len, done)) + len(corners) + np.count_nonzero(large) > most:
            large[:] = False
        done.append(corners[~large])
        corners = _halved(corners[large])
    return np.concatenate(done)


def _halved(corners: Float[np.ndarray, "f 3 3"]) -> Float[np.ndarray, "p 3 3"]:
    """Each triangle as two, cut at the middle of its longest edge, so that long narrow ones become shorter."""
    edges = np.linalg.norm(np.roll(corners, -1, axis=1) - corners, axis=2)
    order = (edges.argmax(axis=1)[:, None] + np.arange(3)) % 3
    a, b, c = np.take_along_axis(corners, order[..., None], axis=1).transpose(1, 0, 2)
    middle = (a + b) / 2
    return np.concatenate([np.stack(of, axis=1) for of in ((a, middle, c), (middle, b, c))])
