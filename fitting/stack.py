"""Photographs of one surface under many lights: what a spatial BRDF is fitted to.

Directions are in the camera's frame: x to the right, y up, z from the surface to the camera, which is far away unless
directions to it are given. Lights are far away, or lamps near a surface that is about a plane: then their positions
are in the units of the photographed rectangle's size, from its centre, and z is the distance from the plane.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float
from numpy.typing import ArrayLike

from jaxrelight.errors import InputError

_AXIS = np.array([0.0, 0.0, 1.0])


@dataclasses.dataclass(frozen=True, eq=False)
class Stack:
    """Images of one surface, a light each.

    Attributes:
        images: linear radiance, as of lights of irradiance 1 on a surface that faces them.
        usable: whether a sample is finite and below saturation.
        lights: unit directions to the lights; to near lamps, those from the centre of the picture.
        views: unit directions to the camera.
        mask: pixels that show the surface.
        normals: unit normals of those; None where they are not known.
        name: what messages call it.
        positions: of near lamps; None for lights that are far away.
        size: width and height of the rectangle that the images show, where lamps are near.
        notes: one line for everything that was assumed of files.
    """

    images: Float[np.ndarray, "n h w 3"]
    usable: Bool[np.ndarray, "n h w"]
    lights: Float[np.ndarray, "n 3"]
    views: Float[np.ndarray, "n 3"]
    mask: Bool[np.ndarray, "h w"]
    normals: Float[np.ndarray, "h w 3"] | None = None
    name: str = "the stack"
    positions: Float[np.ndarray, "n 3"] | None = None
    size: tuple[float, float] | None = None
    notes: tuple[str, ...] = ()

    def towards_lights(self, chosen: Bool[np.ndarray, "h w"] | np.ndarray) -> np.ndarray:
        """Unit directions from texels to the lights: [n, 3] where they are far away, else [p, n, 3].

        Args:
            chosen: a mask, or numbers of texels, row by row.
        """
        if self.positions is None or self.size is None:
            return self.lights
        apart = _from_texels(self.positions, self.size, self.mask.shape, chosen)
        return apart / np.linalg.norm(apart, axis=-1, keepdims=True)

    def of(self, chosen: slice | Sequence[int] | np.ndarray) -> "Stack":
        """Some of the images."""
        return dataclasses.replace(
            self,
            images=self.images[chosen],
            usable=self.usable[chosen],
            lights=self.lights[chosen],
            views=self.views[chosen],
            positions=None if self.positions is None else self.positions[chosen],
        )


def stack_of(
    images: Float[np.ndarray, "n h w 3"],
    lights: Float[np.ndarray, "n 3"] | None = None,
    *,
    positions: Float[np.ndarray, "n 3"] | None = None,
    size: float | Sequence[float] | np.ndarray | None = None,
    saturation: float = np.inf,
    usable: Bool[np.ndarray, "n h w"] | None = None,
    ambient: Float[np.ndarray, "h w 3"] | None = None,
    intensities: Float[np.ndarray, "n 3"] | None = None,
    views: Float[np.ndarray, "n 3"] | None = None,
    mask: Bool[np.ndarray, "h w"] | None = None,
    normals: Float[np.ndarray, "h w 3"] | None = None,
    name: str = "the stack",
) -> Stack:
    """A stack from arrays.

    Args:
        images: linear radiance.
        lights: directions to lights that are far away, of any length.
        positions: of lamps that are near, instead; in front of the plane, so z > 0.
        size: of the rectangle that the images show, in the units of the positions: its width, or width and height.
            Texels lie in the plane z = 0, around its centre.
        saturation: samples at or above it in a channel are unusable.
        usable: which samples may be used besides.
        ambient: an image without any of the lights, subtracted from all others.
        intensities: irradiance by channel of a surface that faces the light; that of near lamps in the picture's
            centre, from where it goes with the distance to the power -2. 1 by default.
        views: directions to the camera, of any length; (0, 0, 1) by default.
        mask: above 0 where the surface is.
        normals: of any length above 0.5; shorter ones, and ones that are not finite, are of no surface.
        name: what messages call it.

    Raises:
        InputError: for shapes that do not belong together, and numbers that are not finite.
    """
    images = np.asarray(images, np.float32)
    if images.ndim != 4 or images.shape[-1] != 3 or not images.size:
        raise InputError(f"{name}: 'images' have shape {images.shape}; they must be n × h × w pixels of three channels")
    n, height, width, _ = images.shape
    lights, positions, size = _lights(name, lights, positions, size, images.shape)
    views = np.broadcast_to(_AXIS, (n, 3)) if views is None else directions(name, "view directions", views, (n, 3))
    intensities = np.ones((n, 3)) if intensities is None else array_of(name, "light intensities", intensities, (n, 3))
    if not (intensities > 0).all():
        raise InputError(f"{name}: light intensities must be positive")
    shown = np.ones((height, width), bool)
    if mask is not None:
        shown = array_of(name, "mask", mask, (height, width)) > 0
    if normals is not None:
        normals = np.asarray(normals, float)
        if normals.shape != (height, width, 3):
            raise InputError(f"{name}: normals have shape {normals.shape}, not {(height, width, 3)}")
        length = np.linalg.norm(normals, axis=-1)
        shown = shown & np.isfinite(length) & (length > 0.5)
        normals = np.where(shown[..., None], normals / np.where(shown, length, 1)[..., None], _AXIS)
    if not shown.any():
        raise InputError(f"{name}: no pixel shows the surface; check the mask and the normals")
    below = np.all(np.isfinite(images) & (images < saturation), axis=-1)
    usable = np.asarray(below if usable is None else below & usable)
    if ambient is not None:
        dark = np.asarray(ambient, np.float32)
        if dark.shape != images.shape[1:]:
            raise InputError(f"{name}: 'ambient' has shape {dark.shape}, not {images.shape[1:]}, that of an image")
        usable = usable & np.isfinite(dark).all(axis=-1)
        images = np.maximum(images - np.where(np.isfinite(dark), dark, 0), 0)
    scaled = np.where(usable[..., None], images, 0) / intensities[:, None, None].astype(np.float32)
    if positions is not None and size is not None:
        for image, lamp in zip(scaled, positions[:, None], strict=True):
            square = np.sum(_from_texels(lamp, size, (height, width)) ** 2, axis=-1) / np.sum(lamp**2)
            image *= square.reshape(height, width, 1).astype(np.float32)
    return Stack(scaled, usable, lights, views, shown, normals, name, positions, size)


def _lights(
    name: str, lights, positions, size, shape: tuple[int, ...]
) -> tuple[np.ndarray, np.ndarray | None, tuple[float, float] | None]:
    """Directions, positions and the size of the picture, checked."""
    n, height, width, _ = shape
    if (lights is None) == (positions is None):
        raise InputError(f"{name}: give either directions to lights that are far away or positions of near lamps")
    if positions is None:
        if size is not None:
            raise InputError(f"{name}: 'size' belongs to positions of near lamps; leave it out, or give these")
        return directions(name, "light directions", lights, (n, 3)), None, None
    positions = array_of(name, "light positions", positions, (n, 3))
    if not (positions[:, 2] > 0).all():
        raise InputError(
            f"{name}: light positions must lie before the surface, z > 0; z is the distance from its plane"
        )
    if size is None:
        raise InputError(f"{name}: light positions need 'size', the width of what the images show, in the same units")
    size = np.atleast_1d(np.asarray(size, float))
    if size.shape not in ((1,), (2,)) or not (np.isfinite(size) & (size > 0)).all():
        raise InputError(f"{name}: 'size' is a positive width, or width and height, not {size.tolist()}")
    both = float(size[0]), float(size[1] if len(size) == 2 else size[0] * height / width)
    return positions / np.linalg.norm(positions, axis=-1, keepdims=True), positions, both


def _from_texels(
    positions: Float[np.ndarray, "n 3"],
    size: tuple[float, float],
    shape: tuple[int, int],
    chosen: Bool[np.ndarray, "h w"] | np.ndarray | slice = slice(None),
) -> Float[np.ndarray, "p n 3"]:
    """From texels to lamps."""
    height, width = shape
    x = ((np.arange(width) + 0.5) / width - 0.5) * size[0]
    y = (0.5 - (np.arange(height) + 0.5) / height) * size[1]
    texels = np.stack([*np.meshgrid(x, y), np.zeros(shape)], axis=-1)
    is_mask = isinstance(chosen, np.ndarray) and chosen.dtype == bool
    return positions - (texels[chosen] if is_mask else texels.reshape(-1, 3)[chosen])[:, None]


def array_of(name: str, what: str, values: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    """Finite numbers of a shape; InputError for others, which says what they are."""
    try:
        array = np.asarray(values, float)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.shape != shape:
        raise InputError(f"{name}: {what} have shape {array.shape}, not {shape}")
    if not np.isfinite(array).all():
        raise InputError(f"{name}: {what} must be finite")
    return array


def directions(name: str, what: str, values: ArrayLike, shape: tuple[int, ...]) -> np.ndarray:
    """Unit vectors in the direction of others."""
    array = array_of(name, what, values, shape)
    length = np.linalg.norm(array, axis=-1, keepdims=True)
    if not (length > 0).all():
        raise InputError(f"{name}: {what} must not be zero")
    return array / length
