"""Distant light: a picture of the whole sphere becomes a lat-long map, and that a light vector."""

import pathlib

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Float

from jaxrelight.basis import latlong
from jaxrelight.errors import InputError
from jaxrelight.lights.layouts import faces_of
from jaxrelight.numerics.arrays import as_array, on_host
from jaxrelight.operators.contract import Basis


class _Unseen:
    """Lines that no compiled program depends on: any are equal to any others."""

    def __init__(self, lines: tuple[str, ...]):
        self.lines = tuple(lines)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, _Unseen)

    def __hash__(self) -> int:
        return 0


class Environment(eqx.Module):
    """A lat-long map of radiance and how it is placed. A pytree: light is differentiable in its arrays.

    Attributes:
        pixels: linear Rec.709 radiance of any height and width; see `latlong` for the orientation.
        rotate_y: degrees by which it is turned about +y, counter-clockwise seen from +y.
        scale: factor on the radiance.
        notes: one line for everything that was mended. They are no part of the pytree: no program depends on them.
    """

    pixels: Float[Array, "h w 3"]
    rotate_y: float | Float[Array, ""]
    scale: float | Float[Array, ""]
    _notes: _Unseen = eqx.field(static=True)

    def __init__(
        self,
        pixels: Float[Array | np.ndarray, "h w 3"],
        rotate_y: float | Float[Array, ""] = 0.0,
        scale: float | Float[Array, ""] = 1.0,
        notes: tuple[str, ...] = (),
    ):
        """Makes an environment of pixels, which are checked unless they are traced.

        Negative pixels are clamped and counted in the notes.

        Raises:
            InputError: for another shape than [h, w, 3], pixels that are NaN or infinite, a rotation that is not
                finite, or a negative scale.
        """
        if isinstance(pixels, Tracer):
            self.pixels = pixels
        else:
            checked, more = _checked(pixels, "the environment", zero_nonfinite=False)
            self.pixels, notes = as_array(checked), (*notes, *more)
        self.rotate_y, self.scale = _placement(rotate_y, scale)
        self._notes = _Unseen(notes)

    @property
    def notes(self) -> tuple[str, ...]:
        """One line for everything that was mended."""
        return self._notes.lines

    def with_(
        self, rotate_y: float | Float[Array, ""] | None = None, scale: float | Float[Array, ""] | None = None
    ) -> "Environment":
        """The same map, turned or scaled otherwise."""
        rotate_y, scale = (own if new is None else new for own, new in ((self.rotate_y, rotate_y), (self.scale, scale)))
        # The pixels are checked already; a light that turns would wait for that in every picture.
        return eqx.tree_at(lambda of: (of.rotate_y, of.scale), self, _placement(rotate_y, scale))


def _placement(rotate_y: float | Float[Array, ""], scale: float | Float[Array, ""]):
    """Both numbers, checked; whole ones are no others than real ones, and nothing is compiled anew for them."""
    numbers = [np.asarray(number) for number in (rotate_y, scale) if not isinstance(number, Tracer)]
    if not np.all(np.isfinite(numbers)) or not (isinstance(scale, Tracer) or scale >= 0):
        raise InputError("the environment: rotate_y must be finite and scale finite and not negative")
    return tuple(number if isinstance(number, jax.Array) else float(number) for number in (rotate_y, scale))


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
        layout: "latlong"; how the faces of a cube lie in the picture, "strip", "cross" or "openexr_cube"; or "probe" or
            "mirror_ball" for a disc; see `lights.layouts`. "auto" goes by the picture's sides and its corners, and
            notes what it guessed.
        zero_nonfinite: set NaN and infinite pixels to 0 and count them, instead.
        name: what messages call it.

    Raises:
        InputError: for another shape than [h, w, 3 or 4], a layout that does not fit, or pixels that are not finite.
    """
    pixels, notes = _checked(pixels, name, zero_nonfinite)
    faces, guess = faces_of(pixels, layout, name)
    if faces is not None:
        pixels = latlong.from_cube(faces)
    notes += [guess] if guess else []
    return Environment(np.ascontiguousarray(pixels), rotate_y, scale, tuple(notes))


def check_pixels(pixels: Float[Array | np.ndarray, "h w c"], name: str) -> None:
    """Refuses a map of which a pixel is not finite, as far as they are known: one would spoil all that is made of it.

    Raises:
        InputError: naming the first.
    """
    if isinstance(pixels, Tracer):
        return
    bad = np.logical_not(np.isfinite(np.asarray(pixels)).all(axis=-1))
    if bad.any():
        row, column = np.argwhere(bad)[0]
        raise InputError(
            f"{name} has {bad.sum():,} NaN or infinite pixels, the first in row {row}, column {column}; "
            "repair the file, or ask for them to be zeroed"
        )


def _checked(pixels, name: str, zero_nonfinite: bool) -> tuple[np.ndarray, list[str]]:
    """Pixels of three channels, finite and not negative, and what was mended."""
    pixels = np.asarray(pixels)
    if pixels.dtype != np.float64 or jax.dtypes.canonicalize_dtype(np.float64) != np.float64:
        with np.errstate(over="ignore"):
            pixels = pixels.astype(np.float32, copy=False)
    if pixels.ndim != 3 or not pixels.size or pixels.shape[2] not in (3, 4):
        raise InputError(f"{name} has shape {pixels.shape}; an environment is h × w pixels of three channels")
    pixels, notes = pixels[..., :3], []
    if zero_nonfinite:
        bad = np.logical_not(np.isfinite(pixels).all(axis=-1))
        if bad.any():
            pixels = np.where(bad[..., None], 0, pixels)
            notes.append(f"{name}: {bad.sum():,} NaN or infinite pixels were set to 0")
    else:
        check_pixels(pixels, name)
    negative = (pixels < 0).any(axis=-1)
    if negative.any():
        notes.append(f"{name}: {negative.sum():,} pixels had negative channels, clamped to 0")
        pixels = np.maximum(pixels, 0)
    return pixels, notes


def load_environment(
    path: str | pathlib.Path,
    rotate_y: float = 0.0,
    scale: float = 1.0,
    *,
    layout: str = "auto",
    zero_nonfinite: bool = False,
) -> Environment:
    """An environment from an image file; see `environment`. PNG and JPEG are decoded from sRGB to radiance 0 … 1.

    Where `layout` is "auto", the attribute `envmap` of OpenEXR files says what it is.
    """
    from jaxrelight.images import open_image

    image, name = open_image(path), pathlib.Path(path).name
    if layout == "auto" and image.envmap is not None:
        layout = {"latlong": "latlong", "cube": "openexr_cube"}[image.envmap]
    made = environment(image.pixels, rotate_y, scale, layout=layout, zero_nonfinite=zero_nonfinite, name=name)
    notes = tuple(note.replace(str(path), name, 1) for note in image.notes)
    return Environment(made.pixels, made.rotate_y, made.scale, (*notes, *made.notes))


def coarsened(pixels: Float[Array | np.ndarray, "h w c"], resolution: int) -> Float[Array | np.ndarray, "g u c"]:
    """The map with rows and columns halved, by area, until its pixels are a quarter of the texels of a cube map.

    Finer pixels change nothing that a texel's mean could show. The cube map has 6×resolution² texels.
    """
    pixels = on_host(pixels)
    height, width = pixels.shape[:2]
    while height >= 16 * resolution:
        height = -(-height // 2)
    while width >= 32 * resolution:
        width = -(-width // 2)
    return pixels if (height, width) == pixels.shape[:2] else latlong.resized(pixels, height, width)


def with_coarse_pixels(environment: Environment, resolution: int) -> Environment:
    """The environment with its pixels `coarsened`."""
    return eqx.tree_at(lambda of: of.pixels, environment, coarsened(environment.pixels, resolution))


@jax.jit
def encode(
    pixels: Float[Array, "h w c"],
    rotate_y: Float[Array, ""],
    scale: Float[Array, ""],
    resampling: latlong.AreaResampling,
    basis: Basis,
) -> Float[Array, "d c"]:
    """The light vector of a map: rotation → cube map → basis (Wang 2006 §4.3). Pure, differentiable in all numbers."""
    texels = resampling.apply(latlong.rotate(pixels, rotate_y))
    return basis.encode(texels.T).T * jnp.asarray(scale, texels.dtype)


def texels_of(environment: Environment, resolution: int) -> Float[Array, "d c"]:
    """Mean radiance of the texels of a cube map under an environment; differentiable in all that it holds.

    Rotation and resampling are programs of their own: as one they take half as long again.
    """
    pixels = coarsened(environment.pixels, resolution)
    resampling = latlong.area_resampling(*pixels.shape[:2], resolution, pixels.dtype)
    return _scaled(resampling.apply(latlong.rotate(pixels, environment.rotate_y)), environment.scale)


@jax.jit
def _scaled(texels: Float[Array, "d c"], scale) -> Float[Array, "d c"]:
    return texels * jnp.asarray(scale, texels.dtype)
