"""Distant light: a picture of the whole sphere becomes a lat-long map, and that a light vector."""

import dataclasses
import pathlib

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.basis import latlong
from jaxrelight.errors import InputError
from jaxrelight.lights.layouts import faces_of


@dataclasses.dataclass(frozen=True)
class Environment:
    """A lat-long map of radiance and how it is placed.

    Attributes:
        pixels: linear Rec.709 radiance, finite and not negative, of any height and width; see `latlong` for the
            orientation.
        rotate_y: degrees it is turned about +y, counter-clockwise seen from +y.
        scale: factor on the radiance.
        notes: one line for everything that was mended.
    """

    pixels: Float[np.ndarray, "h w 3"]
    rotate_y: float = 0.0
    scale: float = 1.0
    notes: tuple[str, ...] = ()

    def __post_init__(self):
        if not (np.isfinite(self.rotate_y) and np.isfinite(self.scale) and self.scale >= 0):
            raise InputError("the environment: rotate_y must be finite and scale finite and not negative")


def environment(
    pixels: Float[np.ndarray, "h w c"],
    rotate_y: float = 0.0,
    scale: float = 1.0,
    *,
    layout: str = "auto",
    zero_nonfinite: bool = False,
    name: str = "the environment",
) -> Environment:
    """An environment from pixels: negative ones are clamped and counted, NaN and infinite ones refused.

    Args:
        pixels: radiance of the whole sphere; a fourth channel is ignored.
        rotate_y: see `Environment`.
        scale: see `Environment`.
        layout: "latlong", or how the faces of a cube lie in the picture: "strip" or "cross"; see `lights.layouts`.
            "auto" goes by the picture's sides and notes what it guessed.
        zero_nonfinite: set NaN and infinite pixels to 0 and count them, instead.
        name: what messages call it.

    Raises:
        InputError: for another shape than [h, w, 3 or 4], a layout that does not fit, or pixels that are not finite.
    """
    with np.errstate(over="ignore"):
        pixels = np.asarray(pixels, np.float32)
    if pixels.ndim != 3 or not pixels.size or pixels.shape[2] not in (3, 4):
        raise InputError(f"{name} has shape {pixels.shape}; an environment is h × w pixels of three channels")
    pixels, notes = pixels[..., :3], []
    bad = np.logical_not(np.isfinite(pixels).all(axis=-1))
    if bad.any():
        if not zero_nonfinite:
            row, column = np.argwhere(bad)[0]
            raise InputError(
                f"{name} has {bad.sum():,} NaN or infinite pixels, the first in row {row}, column {column}; "
                "repair the file, or ask for them to be zeroed"
            )
        pixels = np.where(bad[..., None], 0, pixels)
        notes.append(f"{name}: {bad.sum():,} NaN or infinite pixels were set to 0")
    negative = (pixels < 0).any(axis=-1)
    if negative.any():
        notes.append(f"{name}: {negative.sum():,} pixels had negative channels, clamped to 0")
        pixels = np.maximum(pixels, 0)
    faces, guess = faces_of(pixels, layout, name)
    if faces is not None:
        pixels = latlong.from_cube(faces)
    notes += [guess] if guess else []
    return Environment(np.ascontiguousarray(pixels), float(rotate_y), float(scale), tuple(notes))


def load_environment(
    path: str | pathlib.Path,
    rotate_y: float = 0.0,
    scale: float = 1.0,
    *,
    layout: str = "auto",
    zero_nonfinite: bool = False,
) -> Environment:
    """An environment from an image file; see `environment`. PNG and JPEG are decoded from sRGB to radiance 0 … 1."""
    from jaxrelight.images import read_image

    name = pathlib.Path(path).name
    return environment(read_image(path), rotate_y, scale, layout=layout, zero_nonfinite=zero_nonfinite, name=name)


def coarsened(pixels: Float[np.ndarray, "h w 3"], resolution: int) -> Float[np.ndarray, "g u 3"]:
    """The map with rows and columns halved, by area, until its pixels are a quarter of the texels of a cube map.

    Finer pixels change nothing that a texel's mean could show. The cube map has 6×resolution² texels.
    """
    pixels = np.asarray(pixels, np.float32)
    height, width = pixels.shape[:2]
    while height >= 16 * resolution:
        height = -(-height // 2)
    while width >= 32 * resolution:
        width = -(-width // 2)
    return pixels if (height, width) == pixels.shape[:2] else latlong.resized(pixels, height, width)


@jax.jit
def encode(
    pixels: Float[Array, "h w c"],
    rotate_y: Float[Array, ""],
    scale: Float[Array, ""],
    resampling: latlong.AreaResampling,
    basis,
) -> Float[Array, "d c"]:
    """The light vector of a map: rotation → cube map → basis (Wang 2006 §4.3). Pure, differentiable in all numbers."""
    texels = resampling.apply(latlong.rotate(pixels, rotate_y))
    return basis.encode(texels.T).T * jnp.asarray(scale, texels.dtype)
