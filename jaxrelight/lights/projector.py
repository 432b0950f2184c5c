"""A light that throws an image, as a slide projector does (Hašan 2006 §6)."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.errors import InputError
from jaxrelight.lights.local import Incident, Punctual, frame_towards, from_point, vector
from jaxrelight.numerics.arrays import as_array


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

    position: Float[Array, "3"]
    target: Float[Array, "3"]
    up: Float[Array, "3"]
    fov_y: Float[Array, ""]
    image: Float[Array, "h w 3"]

    @jax.jit
    def at(self, positions: Float[Array, "p 3"]) -> Incident:
        """Falls off with the square of the distance; the image as large as it is far."""
        found = from_point(self.position, 1.0, positions)
        frame = frame_towards(self.position, self.target, self.up)
        right, upwards, depth = jnp.matmul(-found.omega_i, frame.T, precision="highest").T
        in_front = depth > 1e-6
        scale = jnp.where(in_front, 1 / jnp.where(in_front, depth, 1), 0) / jnp.tan(jnp.radians(self.fov_y) / 2)
        h, w = self.image.shape[:2]
        x, y = right * scale * (h / w), upwards * scale
        inside = in_front & (jnp.abs(x) < 1) & (jnp.abs(y) < 1)
        places = [(1 - y) / 2 * h - 0.5, (x + 1) / 2 * w - 0.5]
        seen = [
            jax.scipy.ndimage.map_coordinates(self.image[..., c], places, order=1, mode="nearest") for c in range(3)
        ]
        irradiance = jnp.where(inside[:, None], found.irradiance * jnp.stack(seen, axis=1), 0)
        return found._replace(irradiance=irradiance, within=inside)


def projector(position, target, image, fov_y: float, up=(0.0, 1.0, 0.0)) -> Projector:
    """A projector of an image of intensities [h, w, 3].

    Raises:
        InputError: for an image that is none, is not finite or is negative, an angle outside 0 … 180, a target at the
            position, or `up` along the way to it.
    """
    pixels = np.asarray(image, float)
    if pixels.ndim != 3 or pixels.shape[2] != 3 or not pixels.size:
        raise InputError(f"a projector's image must be [h, w, 3], not {list(pixels.shape)}")
    if not np.isfinite(pixels).all() or (pixels < 0).any():
        raise InputError("a projector's image must be finite and not negative")
    if not 0 < fov_y < 180:
        raise InputError(f"a projector's fov_y must lie between 0 and 180 degrees, not {fov_y:g}")
    placed = vector("position", position), vector("target", target), vector("up", up)
    check_frame("a projector", *placed)
    return Projector(*placed, as_array(fov_y, jnp.float32), as_array(pixels, jnp.float32))


def check_frame(what: str, position, target, up):
    """Refuses a light that does not know where it looks, or which way is up.

    Raises:
        InputError: naming it.
    """
    forward = np.subtract(target, position)
    if not forward.any():
        raise InputError(f"{what}'s target is where it stands; give it another")
    if np.linalg.norm(np.cross(forward, up)) <= 1e-6 * np.linalg.norm(forward) * np.linalg.norm(up):
        raise InputError(f"{what}'s up is along the way to its target; give it another")
