"""Several samples of surfaces in a pixel: their mean, and samples that take radiance from pixels.

Where a pixel is dear, its radiance is known once, and each sample takes that of the pixel that it is most like, so that
nothing leaks across edges (Hašan 2006 §3.6).
"""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.gbuffer import GBuffer
from jaxrelight.methods import check_choice

# Samples in a pixel.
ANTIALIASING = 1, 4, 16


def samples_along(antialiasing: int) -> int:
    """Samples along each side of a pixel that has so many.

    Raises:
        InputError: unless they are 1, 4 or 16.
    """
    check_choice("antialiasing", antialiasing, ANTIALIASING)
    return math.isqrt(antialiasing)


def pixel_angle(camera: Camera) -> float:
    """The angle that a pixel in the middle of a picture covers along a side, in radians."""
    return float(2 * np.tan(np.radians(camera.fov_y) / 2) / camera.height)


def nearest_pixels(
    fine: GBuffer, coarse: GBuffer, eye: Float[np.ndarray, "3"], pixel_angle: float
) -> Int[np.ndarray, "fh fw"]:
    """For each fine sample, the pixel of the 3×3 around it that is most like it; −1 where none shows a surface.

    Samples are alike that are near, measured in three pixels' width at that distance, and have similar normals.

    Args:
        fine: samples, a whole number of times as many as pixels along both sides.
        coarse: the pixels.
        eye: in scene space.
        pixel_angle: that a pixel covers along a side, in radians.
    """
    (h, w), (fh, fw) = coarse.covered.shape, fine.covered.shape
    factor = fh // h
    assert (fh, fw) == (factor * h, factor * w)
    number = np.full((h + 2, w + 2), -1)
    number[1:-1, 1:-1][coarse.covered] = np.arange(len(coarse.positions))
    pixel = np.full((h + 2, w + 2), -1)
    pixel[1:-1, 1:-1] = np.arange(h * w).reshape(h, w)
    y, x = (index // factor for index in np.nonzero(fine.covered))
    wide = (3 * pixel_angle * np.linalg.norm(fine.positions - eye, axis=1)) ** 2
    best, chosen = np.full(len(fine.positions), np.inf), np.full(len(fine.positions), -1)
    for dy in range(3):
        for dx in range(3):
            other = number[y + dy, x + dx]
            apart = np.sum((fine.positions - coarse.positions[other]) ** 2, axis=1) / np.maximum(wide, 1e-300)
            unlike = apart + np.sum((fine.normals - coarse.normals[other]) ** 2, axis=1)
            better = (other >= 0) & (unlike < best)
            best, chosen = np.where(better, unlike, best), np.where(better, pixel[y + dy, x + dx], chosen)
    nearest = np.full((fh, fw), -1)
    nearest[fine.covered] = chosen
    return nearest


@functools.partial(jax.jit, static_argnames="factor")
def averaged(samples: Float[Array, "fh fw c"], factor: int) -> Float[Array, "h w c"]:
    """The mean over each pixel's samples, so many along each side."""
    h, w, c = samples.shape
    return samples.reshape(h // factor, factor, w // factor, factor, c).mean(axis=(1, 3))


@jax.jit
def joined(
    direct: Float[Array, "fh fw c"], indirect: Float[Array, "h w c"], nearest: Int[Array, "fh fw"]
) -> Float[Array, "h w c"]:
    """The mean over each pixel's samples of direct light and the indirect light of the pixel that each is most like."""
    h, w, c = indirect.shape
    own = indirect.reshape(h * w, c).at[jnp.maximum(nearest, 0)].get(mode="promise_in_bounds")
    samples = direct + jnp.where((nearest >= 0)[..., None], own, 0)
    return averaged(samples, direct.shape[0] // h)
