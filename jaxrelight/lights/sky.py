"""Light of a whole sky, by directions to it, each with shadows (Hašan 2006 §6)."""

import functools
import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int
from scipy.spatial import KDTree

from jaxrelight.basis import latlong
from jaxrelight.errors import InputError
from jaxrelight.geometry.morton import morton
from jaxrelight.lights.environment import Environment, coarsened
from jaxrelight.lights.local import Directional, Light, power
from jaxrelight.numerics.arrays import as_array, is_traced
from jaxrelight.numerics.numbers import Numbers

_GOLDEN = (np.sqrt(5) - 1) / 2


class Sky(Light):
    """Distant light from n directions.

    Attributes:
        directions: to the light, of unit length.
        irradiance: of each, on a surface that faces it.
    """

    directions: Float[Array, "n 3"]
    irradiance: Float[Array, "n 3"]

    def parts(self) -> Sequence[Directional]:
        """A directional light each."""
        if any(isinstance(of, Tracer) for of in (self.directions, self.irradiance)):
            each = zip(-self.directions, self.irradiance, strict=True)
        else:
            # Cut up on the host, where nothing is compiled for their number.
            each = zip(-np.asarray(self.directions), np.asarray(self.irradiance), strict=True)
        return [Directional(as_array(direction), as_array(light)) for direction, light in each]


def even_sky(radiance: Numbers, samples: int = 64) -> Sky:
    """The same radiance from everywhere above the horizon: what it lights is ambient occlusion.

    Raises:
        InputError: for samples below 1, or numbers as `point` refuses.
    """
    _check(samples)
    # A spiral of equal steps in height, which is equal areas.
    y = (np.arange(samples) + 0.5) / samples
    turn = 2 * np.pi * _GOLDEN * np.arange(samples)
    ring = np.sqrt(1 - y * y)
    directions = np.stack([ring * np.cos(turn), y, ring * np.sin(turn)], axis=1)
    irradiance = jnp.broadcast_to(power("radiance", radiance) * (2 * np.pi / samples), (samples, 3))
    return Sky(as_array(directions, jnp.float32), irradiance)


def sky_of(environment: Environment, samples: int = 256) -> Sky:
    """An environment as directions that carry equal shares of its light, the colour of each as it is there.

    The map's pixels are put in an order in which neighbours follow each other, and a direction is taken wherever
    another share of the sum is reached: bright parts get many. Linear in the map and differentiable, the shares held
    fixed.

    Raises:
        InputError: for samples below 1.
    """
    _check(samples)
    pixels = coarsened(environment.pixels, 64)
    # Pixels are cut where there are enough directions: one for a large pixel would light what it does not face.
    cut = math.isqrt(max(1, samples // math.prod(pixels.shape[:2])))
    pixels = pixels.repeat(cut, axis=0).repeat(cut, axis=1) if cut > 1 else pixels
    shares = _shares(jax.lax.stop_gradient(pixels), samples)
    # Shares that no pixel reaches are kept, dark: every sky is of as many lights, and compiles nothing anew.
    return _sky(pixels, environment.rotate_y, environment.scale, shares, samples)


def _shares(pixels, samples: int) -> Int[Array | np.ndarray, " p"]:
    """Which of equal shares of the light every pixel of a map is in."""

    def of_known(pixels) -> Int[np.ndarray, " p"]:
        h, w = pixels.shape[:2]
        v, u = (np.indices((h, w)).reshape(2, -1).T + 0.5).T / np.array([[h], [w]])
        order = np.argsort(morton(np.stack([u, v], axis=1)), kind="stable")
        light = (np.asarray(pixels, float) * latlong.solid_angles(h, w)[:, None, None]).reshape(-1, pixels.shape[2])
        sums = np.cumsum(np.maximum(light.sum(axis=1), 0)[order])
        share = np.zeros(len(order), np.int32)
        if sums[-1] > 0:
            share[order] = np.minimum((sums / sums[-1] * samples).astype(np.int32), samples - 1)
        return share

    if not is_traced(pixels):
        return of_known(np.asarray(pixels))
    shape = jax.ShapeDtypeStruct((pixels.shape[0] * pixels.shape[1],), np.int32)
    return jax.pure_callback(of_known, shape, pixels, vmap_method="sequential")


@functools.partial(jax.jit, static_argnames="samples")
def _sky(pixels, rotate_y, scale, share, samples: int) -> Sky:
    h, w, channels = pixels.shape
    v, u = (np.indices((h, w)).reshape(2, -1).T + 0.5).T / np.array([[h], [w]])
    # The map turned one way is directions turned the same way.
    towards = jnp.asarray(latlong.directions(u, v), pixels.dtype)
    light = (pixels * jnp.asarray(latlong.solid_angles(h, w), pixels.dtype)[:, None, None]).reshape(-1, channels)
    weighed = jax.lax.stop_gradient(towards * jnp.sum(light, axis=1, keepdims=True))
    mean = jax.ops.segment_sum(weighed, share, samples)
    length = jnp.linalg.norm(mean, axis=1, keepdims=True)
    directions = jnp.where(length > 0, mean / jnp.where(length > 0, length, 1), jnp.asarray([0, 1, 0], pixels.dtype))
    irradiance = jax.ops.segment_sum(light, share, samples) * scale
    return Sky(turned(directions, rotate_y), irradiance)


def turned(directions: Float[Array, "n 3"], degrees: Float[Array, ""] | float) -> Float[Array, "n 3"]:
    """Directions turned about +y as an environment's `rotate_y` turns its map."""
    angle = jnp.radians(degrees)
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    x, y, z = directions.T
    return jnp.stack([cosine * x + sine * z, y, cosine * z - sine * x], axis=1)


def nearest_directions(towards: Float[np.ndarray, "n 3"], height: int, width: int) -> Int[np.ndarray, "fh fw"]:
    """The nearest direction to each pixel of a lat-long map, cut into f×f parts so that each direction has several."""
    factor = int(np.ceil(np.sqrt(8 * len(towards) / (height * width))))
    h, w = factor * height, factor * width
    v, u = (np.indices((h, w)) + 0.5) / np.array([[[h]], [[w]]])
    return np.asarray(KDTree(towards).query(latlong.directions(u, v))[1])


@functools.partial(jax.jit, static_argnames="count")
def mean_radiance(
    pixels: Float[Array, "h w c"], rotate_y: ArrayLike, scale: ArrayLike, nearest: Int[Array, "fh fw"], count: int
) -> Float[Array, "n c"]:
    """The light of a map that each of n directions of equal solid angle stands for; together they have all of it.

    Args:
        pixels: radiance.
        rotate_y: degrees that the map is turned, as `Environment`.
        scale: factor on it.
        nearest: from `nearest_directions`.
        count: n.
    """
    factor = nearest.shape[0] // pixels.shape[0]
    turned = latlong.rotate(as_array(pixels), rotate_y)
    fine = jnp.repeat(jnp.repeat(turned, factor, axis=0), factor, axis=1)
    light = fine * jnp.asarray(latlong.solid_angles(*nearest.shape), fine.dtype)[:, None, None]
    sums = jax.ops.segment_sum(light.reshape(-1, light.shape[-1]), nearest.reshape(-1), count)
    return sums * (count / (4 * np.pi)) * scale


def _check(samples: int):
    if not (isinstance(samples, int) and samples >= 1):
        raise InputError(f"a sky's samples must be 1 or more, not {samples!r}")
