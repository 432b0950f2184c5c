"""Photographs of one surface under many lights: what a spatial BRDF is fitted to.

Directions are in the camera's frame: x to the right, y up, z from the surface to the camera, which is far away unless
directions to it are given. Lights are far away.
"""

import dataclasses
import pathlib
import tomllib
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float

from jaxrelight.errors import InputError
from jaxrelight.files.npz import read_npz
from jaxrelight.images import read_image
from jaxrelight.images.tone import srgb_encode

_AXIS = np.array([0.0, 0.0, 1.0])
# What normals are called.
_NORMALS = "normals", "normal_gt"
# Bytes of an array of an archive.
_MAX_ARRAY_BYTES = 2**31


@dataclasses.dataclass(frozen=True, eq=False)
class Stack:
    """Images of one surface, a light each.

    Attributes:
        images: linear radiance, as of a light of irradiance 1 on a surface that faces it.
        usable: whether a sample is finite and below saturation.
        lights: unit directions to the lights.
        views: unit directions to the camera.
        mask: pixels that show the surface.
        normals: unit normals of those; None where they are not known.
        name: what messages call it.
    """

    images: Float[np.ndarray, "n h w 3"]
    usable: Bool[np.ndarray, "n h w"]
    lights: Float[np.ndarray, "n 3"]
    views: Float[np.ndarray, "n 3"]
    mask: Bool[np.ndarray, "h w"]
    normals: Float[np.ndarray, "h w 3"] | None = None
    name: str = "the stack"

    def of(self, chosen: slice | Sequence[int] | np.ndarray) -> "Stack":
        """Some of the images."""
        return dataclasses.replace(
            self,
            images=self.images[chosen],
            usable=self.usable[chosen],
            lights=self.lights[chosen],
            views=self.views[chosen],
        )


def load_stack(path: str | pathlib.Path) -> Stack:
    """Reads a stack of images.

    `.npz`: `images` [n, h, w, 3] of integers (whose largest value is saturated) or radiance; `light_directions`
    [n, 3]; and, where they are known, `light_intensities` [n, 3], `mask` [h, w], `normals` or `normal_gt` [h, w, 3],
    `view_directions` [n, 3].

    `.toml`, whose paths are relative to it:

        mask = "mask.png"          # optional: white where the surface is
        normals = "normals.png"    # optional: (n + 1)/2 in the camera's frame
        encoding = "srgb"          # optional, of .png and .jpg: "srgb" or "linear"
        [[image]]
        file = "01.png"
        light = [0.2, 0.4, 0.9]
        intensity = [1, 1, 1]      # optional
        view = [0, 0, 1]           # optional

    Raises:
        InputError: for what is missing, of the wrong shape or not finite, by name.
    """
    path = pathlib.Path(path)
    if path.suffix.lower() == ".npz":
        return _from_npz(path)
    if path.suffix.lower() == ".toml":
        return _from_toml(path)
    raise InputError(f"{path}: a stack of images is a .npz file, or a .toml file that lists images")


def stack_of(
    images: Float[np.ndarray, "n h w 3"],
    lights: Float[np.ndarray, "n 3"],
    *,
    saturation: float = np.inf,
    intensities: Float[np.ndarray, "n 3"] | None = None,
    views: Float[np.ndarray, "n 3"] | None = None,
    mask: Bool[np.ndarray, "h w"] | None = None,
    normals: Float[np.ndarray, "h w 3"] | None = None,
    name: str = "the stack",
) -> Stack:
    """A stack from arrays; directions are normalized, and samples at or above `saturation` in a channel are unusable.

    Raises:
        InputError: for shapes that do not belong together, and numbers that are not finite.
    """
    images = np.asarray(images, np.float32)
    if images.ndim != 4 or images.shape[-1] != 3 or not images.size:
        raise InputError(f"{name}: 'images' have shape {images.shape}; they must be n × h × w pixels of three channels")
    n, height, width, _ = images.shape
    lights = _directions(name, "light directions", lights, (n, 3))
    views = np.broadcast_to(_AXIS, (n, 3)) if views is None else _directions(name, "view directions", views, (n, 3))
    intensities = np.ones((n, 3)) if intensities is None else _array(name, "light intensities", intensities, (n, 3))
    if not (intensities > 0).all():
        raise InputError(f"{name}: light intensities must be positive")
    shown = (
        np.ones((height, width), bool) if mask is None else np.greater(_array(name, "mask", mask, images.shape[1:3]), 0)
    )
    if normals is not None:
        normals = np.asarray(normals, float)
        if normals.shape != (height, width, 3):
            raise InputError(f"{name}: normals have shape {normals.shape}, not {(height, width, 3)}")
        length = np.linalg.norm(normals, axis=-1)
        shown = shown & np.isfinite(length) & (length > 0.5)
        normals = np.where(shown[..., None], normals / np.where(shown, length, 1)[..., None], _AXIS)
    if not shown.any():
        raise InputError(f"{name}: no pixel shows the surface; check the mask and the normals")
    usable = np.all(np.isfinite(images) & (images < saturation), axis=-1)
    scaled = np.where(usable[..., None], images, 0) / intensities[:, None, None].astype(np.float32)
    return Stack(scaled, usable, lights, views, shown, normals, name)


def _array(name: str, what: str, values, shape: tuple[int, ...]) -> np.ndarray:
    try:
        array = np.asarray(values, float)
    except (TypeError, ValueError):
        array = np.zeros(0)
    if array.shape != shape:
        raise InputError(f"{name}: {what} have shape {array.shape}, not {shape}")
    if not np.isfinite(array).all():
        raise InputError(f"{name}: {what} must be finite")
    return array


def _directions(name: str, what: str, values, shape: tuple[int, ...]) -> np.ndarray:
    array = _array(name, what, values, shape)
    length = np.linalg.norm(array, axis=-1, keepdims=True)
    if not (length > 0).all():
        raise InputError(f"{name}: {what} must not be zero")
    return array / length


def _from_npz(path: pathlib.Path) -> Stack:
    required, known = ("images", "light_directions"), ("light_intensities", "view_directions", "mask", *_NORMALS)
    arrays = read_npz(path, "a stack of images", (*required, *known), _MAX_ARRAY_BYTES)
    for key in required:
        if key not in arrays:
            raise InputError(f"{path}: '{key}' is missing; a stack has {' and '.join(required)}")
    images = arrays["images"]
    integers = images.dtype.kind in "ui"
    top = np.iinfo(images.dtype).max if integers else 1
    return stack_of(
        images / np.float32(top),
        arrays["light_directions"],
        saturation=1 if integers else np.inf,
        intensities=arrays.get("light_intensities"),
        views=arrays.get("view_directions"),
        mask=arrays.get("mask"),
        normals=next((arrays[name] for name in _NORMALS if name in arrays), None),
        name=path.name,
    )


def _from_toml(path: pathlib.Path) -> Stack:
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as fault:
        raise InputError(f"{path}: cannot be read as a list of images: {fault}") from None
    _known(path, content, {"image", "mask", "normals", "encoding"})
    encoding = content.get("encoding", "srgb")
    if encoding not in ("srgb", "linear"):
        raise InputError(f'{path}: \'encoding\' is "srgb" or "linear", not {encoding!r}')
    entries = content.get("image")
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{path}: lists no [[image]]")
    images, lights, intensities, views, shown = [], [], [], [], False
    for number, entry in enumerate(entries, 1):
        where = f"{path}: [[image]] number {number}"
        _known(where, entry, {"file", "light", "intensity", "view"})
        if not isinstance(entry.get("file"), str) or "light" not in entry:
            raise InputError(f"{where}: needs 'file', the path of an image, and 'light', the direction to its light")
        pixels = _pixels(path.parent / entry["file"], encoding)
        if images and pixels.shape != images[0].shape:
            raise InputError(f"{where}: is of {pixels.shape[:2]} pixels, the ones before it of {images[0].shape[:2]}")
        images.append(pixels)
        shown = shown or pathlib.Path(entry["file"]).suffix.lower() in (".png", ".jpg", ".jpeg")
        lights.append(_array(where, "'light'", entry["light"], (3,)))
        intensities.append(_array(where, "'intensity'", entry.get("intensity", [1.0] * 3), (3,)))
        views.append(_array(where, "'view'", entry.get("view", _AXIS), (3,)))
    normals = _pixels(path.parent / content["normals"], "linear") * 2 - 1 if "normals" in content else None
    mask = _pixels(path.parent / content["mask"], "linear").max(axis=-1) > 0.5 if "mask" in content else None
    return stack_of(
        np.stack(images),
        np.stack(lights),
        saturation=1 if shown else np.inf,
        intensities=np.stack(intensities),
        views=np.stack(views),
        mask=mask,
        normals=normals,
        name=path.name,
    )


def _known(where, content, known: set[str]):
    if not isinstance(content, dict):
        raise InputError(f"{where}: must be a table")
    for key in content:
        if key not in known:
            raise InputError(f"{where}: '{key}' is not known; known are {', '.join(sorted(known))}")


def _pixels(path: pathlib.Path, encoding: str) -> np.ndarray:
    pixels = read_image(path)[..., :3]
    if encoding == "linear" and path.suffix.lower() in (".png", ".jpg", ".jpeg"):
        pixels = srgb_encode(pixels)  # the numbers that stand in the file
    return pixels
