"""What mesh files say about lights and cameras, before anything is made of them."""

import dataclasses
from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float


@dataclasses.dataclass(frozen=True, eq=False)
class FileLight:
    """A light as a file describes it.

    Attributes:
        kind: "directional", "point" or "spot".
        intensity: by channel: irradiance of a directional light, else radiant intensity.
        position: in the file's coordinates.
        direction: unit, in which a directional light or a spot shines.
        inner: angle from a spot's axis up to which it is as bright as can be, in degrees.
        outer: angle beyond which it is dark.
        name: what messages call it.
    """

    kind: Literal["directional", "point", "spot"]
    intensity: Float[np.ndarray, "3"]
    position: Float[np.ndarray, "3"]
    direction: Float[np.ndarray, "3"]
    inner: float = 0.0
    outer: float = 45.0
    name: str = "light"

    def moved(self, matrix: Float[np.ndarray, "4 4"]) -> "FileLight":
        """The light where an affine matrix moves it; its intensity grows with the area of what it lights."""
        direction = _unit(matrix[:3, :3] @ self.direction)
        size = 1.0 if self.kind == "directional" else abs(np.linalg.det(matrix[:3, :3])) ** (2 / 3)
        position = matrix[:3, :3] @ self.position + matrix[:3, 3]
        return dataclasses.replace(self, intensity=size * self.intensity, position=position, direction=direction)


@dataclasses.dataclass(frozen=True, eq=False)
class FileCamera:
    """A perspective camera as a file describes it.

    Attributes:
        origin: the eye, in the file's coordinates.
        direction: unit, along which it looks.
        up: unit.
        fov_y: vertical field of view in degrees.
        aspect: width over height; None where the file leaves it open.
        name: what messages call it.
    """

    origin: Float[np.ndarray, "3"]
    direction: Float[np.ndarray, "3"]
    up: Float[np.ndarray, "3"]
    fov_y: float
    aspect: float | None = None
    name: str = "camera"

    def moved(self, matrix: Float[np.ndarray, "4 4"]) -> "FileCamera":
        """The camera where an affine matrix moves it."""
        linear = matrix[:3, :3]
        return dataclasses.replace(
            self,
            origin=linear @ self.origin + matrix[:3, 3],
            direction=_unit(linear @ self.direction),
            up=_unit(linear @ self.up),
        )


@dataclasses.dataclass(frozen=True)
class Surroundings:
    """The lights and cameras of a mesh file."""

    lights: Sequence[FileLight] = ()
    cameras: Sequence[FileCamera] = ()

    def moved(self, matrix: Float[np.ndarray, "4 4"]) -> "Surroundings":
        """All of them where an affine matrix moves them."""
        return Surroundings(
            [light.moved(matrix) for light in self.lights], [camera.moved(matrix) for camera in self.cameras]
        )


def _unit(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    length = np.linalg.norm(vector)
    return vector / (length if length > 0 else 1.0)
