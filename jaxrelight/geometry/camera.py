"""The perspective camera."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxrelight.errors import InputError

MAX_PIXELS = 2**27  # as many as are read from a picture; more is a slip of the pen


@dataclasses.dataclass(frozen=True)
class Camera:
    """A pinhole camera in world space.

    Attributes:
        origin: position of the eye.
        target: a point that the image centre shows.
        up: the direction that is upwards in the image.
        fov_y: vertical field of view in degrees.
        width: pixels in a row.
        height: rows.
    """

    origin: Sequence[float] | np.ndarray
    target: Sequence[float] | np.ndarray
    up: Sequence[float] | np.ndarray = (0.0, 1.0, 0.0)
    fov_y: float = 38.0
    width: int = 512
    height: int = 512

    def __post_init__(self) -> None:
        vectors = [np.asarray(vector, float) for vector in (self.origin, self.target, self.up)]
        finite = np.isfinite(self.fov_y) and all(np.isfinite(vector).all() for vector in vectors)
        if not finite or any(vector.shape != (3,) for vector in vectors):
            raise InputError("the camera's origin, target and up need three finite numbers each, fov_y one")
        # Equal cameras are equal, whatever sequences they were made from.
        for name, vector in zip(("origin", "target", "up"), vectors, strict=True):
            object.__setattr__(self, name, tuple(vector.tolist()))
        if not 0 < self.fov_y < 180:
            raise InputError(f"the camera's fov_y is {self.fov_y}; it must lie between 0 and 180 degrees")
        if self.width < 1 or self.height < 1:
            raise InputError(f"the camera's image is {self.width} × {self.height} pixels; it needs at least one")
        if self.width * self.height > MAX_PIXELS:
            raise InputError(
                f"the camera's image is {self.width:,} × {self.height:,} pixels; it may have at most {MAX_PIXELS:,}"
            )
        forward = np.subtract(self.target, self.origin)
        if np.linalg.norm(np.cross(forward, self.up)) <= 1e-9 * np.linalg.norm(forward) * np.linalg.norm(self.up):
            raise InputError("the camera's view direction and up must not be parallel, nor origin equal target")

    def directions(self) -> Float[np.ndarray, "h w 3"]:
        """Unit world directions through the pixel centres, the top row first."""
        forward = np.subtract(self.target, self.origin)
        forward = forward / np.linalg.norm(forward)
        right = np.cross(forward, np.asarray(self.up, float))
        right /= np.linalg.norm(right)
        up = np.cross(right, forward)
        x, y, length = self._plane()
        return (forward + x[..., None] * right + y[..., None] * up) / length[..., None]

    def solid_angles(self) -> Float[np.ndarray, "h w"]:
        """Steradians of every pixel: its area at distance 1 along the axis, times cos³ of its angle from the axis."""
        _, _, length = self._plane()
        return (2 * np.tan(np.radians(self.fov_y) / 2) / self.height) ** 2 / (length * length * length)

    def _plane(self):
        """Columns' and rows' places at distance 1 along the axis, and how far away each pixel is there."""
        half = np.tan(np.radians(self.fov_y) / 2)
        x = ((np.arange(self.width) + 0.5) * 2 - self.width) / self.height * half
        y = (1 - (np.arange(self.height) + 0.5) * 2 / self.height) * half
        return x[None, :], y[:, None], np.sqrt(1 + x[None, :] ** 2 + y[:, None] ** 2)
