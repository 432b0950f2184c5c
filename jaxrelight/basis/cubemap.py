"""A 6×n×n cube map of directions, with exact solid angles.

Faces are +x −x +y −y +z −z, each oriented as OpenGL orients cube-map faces. All tables are made once, in float64.
"""

import functools
from typing import Any

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.operators.contract import Basis


def face_plane(s: np.ndarray, t: np.ndarray) -> np.ndarray:
    """Points of the cube [−1, 1]³ at face coordinates s (rightwards) and t (downwards): [6, ..., 3]."""
    ones = np.ones_like(s)
    faces = [(ones, -t, -s), (-ones, -t, s), (s, ones, t), (s, -ones, -t), (s, -t, ones), (-s, -t, -ones)]
    return np.stack([np.stack(face, axis=-1) for face in faces])


def _corner_area(x: np.ndarray, y: np.ndarray) -> np.ndarray:
    """Solid angle of the face rectangle from the centre (0, 0) to the corner (x, y), signed."""
    return np.arctan2(x * y, np.sqrt(x * x + y * y + 1))


@functools.lru_cache(maxsize=8)
def directions(resolution: int) -> Float[np.ndarray, "d 3"]:
    """Unit vectors through the texel centres, d = 6·n² in the order face, row, column; float64, read-only."""
    centre = (np.arange(resolution) + 0.5) * (2 / resolution) - 1
    points = face_plane(*np.meshgrid(centre, centre, indexing="xy")).reshape(-1, 3)
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    points.flags.writeable = False
    return points


@functools.lru_cache(maxsize=8)
def solid_angles(resolution: int) -> Float[np.ndarray, " d"]:
    """Exact solid angles of the texels in steradians, in the order of `directions`; they sum to 4π. Read-only."""
    edge = np.linspace(-1, 1, resolution + 1)
    area = _corner_area(*np.meshgrid(edge, edge, indexing="xy"))
    face = area[1:, 1:] - area[1:, :-1] - area[:-1, 1:] + area[:-1, :-1]
    angles = np.tile(face.ravel(), 6)
    angles.flags.writeable = False
    return angles


def texel_of(direction: Float[np.ndarray, "... 3"], resolution: int) -> Any:
    """Index, in the order of `directions`, of the texel that each direction (of any length but 0) falls in."""
    axis = np.argmax(np.abs(direction), axis=-1)
    major = np.take_along_axis(direction, axis[..., None], axis=-1)[..., 0]
    x, y, z = np.moveaxis(direction / np.abs(major)[..., None], -1, 0)
    positive = major > 0
    # s, t per face, read off face_plane.
    s = np.choose(axis, [np.where(positive, -z, z), x, np.where(positive, x, -x)])
    t = np.choose(axis, [-y, np.where(positive, z, -z), -y])
    column, row = (np.clip(((c + 1) * (resolution / 2)).astype(np.int64), 0, resolution - 1) for c in (s, t))
    return ((2 * axis + ~positive) * resolution + row) * resolution + column


class Texels(Basis):
    """The basis of the texels themselves: what a transport operator without wavelets acts on."""

    resolution: int = eqx.field(static=True)

    @property
    def size(self) -> int:
        """Six faces of n² texels."""
        return 6 * self.resolution**2

    def _encode(self, texels: Float[Array, "... d"]) -> Float[Array, "... d"]:
        return texels

    def _decode(self, coefficients: Float[Array, "... d"]) -> Float[Array, "... d"]:
        return coefficients
