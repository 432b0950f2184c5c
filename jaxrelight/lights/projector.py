"""A light that throws an image, as a slide projector does (Hašan 2006 §6)."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.errors import InputError
from jaxrelight.lights.local import (
    PLACE,
    Incident,
    Place,
    Punctual,
    check_target,
    frame_towards,
    from_point,
    place,
    vector,
)
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.numbers import Number, Vector, as_numbers, float_dtype, holds, shown


class Projector(Punctual):
    """A point light whose intensity in W/sr is an image in front of it, and 0 beside that.

    The image is linear between its pixels' centres; differentiable in its pixels, and in where it is.

    Attributes:
        position: of the lens.
        target: a point that the image's centre falls on.
        up: the direction that is upwards in the image.
        fov_y: degrees from its lower to its upper edge.
        image: intensities, the top row first.
    """

    position: Place = eqx.field(metadata=PLACE)
    target: Place = eqx.field(metadata=PLACE)
    up: Float[Array, "3"]
    fov_y: Float[Array, ""]
    image: Float[Array, "h w 3"]

    @jax.jit
    def at(self, positions: Float[Array, "p 3"]) -> Incident:
        """Falls off with the square of the distance; the image as large as it is far."""
        incident = from_point(self.position, 1.0, positions)
        frame = frame_towards(self.position, self.target, self.up)
        right, upwards, depth = jnp.matmul(-incident.omega_i, frame.T, precision="highest").T
        in_front = depth > 1e-6
        scale = jnp.where(in_front, 1 / jnp.where(in_front, depth, 1), 0) / jnp.tan(jnp.radians(self.fov_y) / 2)
        h, w = self.image.shape[:2]
        x, y = right * scale * (h / w), upwards * scale
        inside = in_front & (jnp.abs(x) < 1) & (jnp.abs(y) < 1)
        places = [(1 - y) / 2 * h - 0.5, (x + 1) / 2 * w - 0.5]
        seen = [
            jax.scipy.ndimage.map_coordinates(self.image[..., c], places, order=1, mode="nearest") for c in range(3)
        ]
        irradiance = jnp.where(inside[:, None], incident.irradiance * jnp.stack(seen, axis=1), 0)
        return incident._replace(irradiance=irradiance, within=inside)


def projector(
    position: Vector,
    target: Vector,
    image: Float[Array | np.ndarray, "h w 3"] | Sequence,
    fov_y: Number,
    up: Vector = (0.0, 1.0, 0.0),
) -> Projector:
    """A projector of an image of intensities; numbers and their type as of `point`.

    Args:
        position: of the lens, in world units.
        target: a point that the image's centre falls on.
        image: intensities in W/sr, the top row first.
        fov_y: degrees from its lower to its upper edge.
        up: the direction that is upwards in the image.

    Raises:
        InputError: for an image that is none, is not finite or is negative, an angle outside 0 … 180, a target at the
            position, or `up` along the way to it.
    """
    dtype = float_dtype(position, target, image, fov_y, up)
    pixels, angle = as_numbers(image), as_numbers(fov_y)
    if pixels.ndim != 3 or pixels.shape[2] != 3 or not pixels.size:
        raise InputError(f"a projector's image must be [h, w, 3], not {list(pixels.shape)}")
    if not holds(lambda pixels: np.isfinite(pixels) & (pixels >= 0), pixels):
        raise InputError("a projector's image must be finite and not negative")
    if angle.ndim != 0 or not holds(lambda angle: (angle > 0) & (angle < 180), angle):
        raise InputError(f"a projector's fov_y must lie between 0 and 180 degrees, not {shown(fov_y)}")
    placed, upwards = (place("position", position, dtype), place("target", target, dtype)), vector("up", up, dtype)
    check_frame("a projector", *placed, upwards)
    return Projector(*placed, *(as_array(each, dtype) for each in (upwards, angle, pixels)))


def check_frame(
    what: str,
    position: Place,
    target: Place,
    up: Float[Array | np.ndarray, "3"],
) -> None:
    """Refuses a light that does not know where it looks, or which way is up, as far as that is known.

    Raises:
        InputError: naming it.
    """
    check_target(what, position, target)

    def is_aside(position: np.ndarray, target: np.ndarray, up: np.ndarray) -> np.bool_:
        forward = target - position
        return np.linalg.norm(np.cross(forward, up)) > 1e-6 * np.linalg.norm(forward) * np.linalg.norm(up)

    if not holds(is_aside, position, target, up):
        raise InputError(f"{what}'s up is along the way to its target; give it another")
