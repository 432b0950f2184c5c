"""Stacks of photographs from files: an archive of arrays, or a list of images."""

import dataclasses
import pathlib
import tomllib
from collections.abc import Collection
from typing import Any

import numpy as np
from jaxtyping import Float

from fitting.stack import Stack, array_of, stack_of
from jaxrelight.errors import InputError
from jaxrelight.files.npz import read_npz
from jaxrelight.images import ImageFile, open_image, srgb_decode

_ENCODINGS = "linear", "srgb"
_LIGHTS = "light_directions", "light_positions"
_INTENSITIES = "light_intensities", "intensities"
_NORMALS = "normals", "normal_gt"
# Where a cut-out lies in a larger image: nothing depends on it.
_PASSED_OVER = "crop_y0x0", "full_hw"
_OTHERS = "images", "view_directions", "mask", "encoding", "saturation", "ambient", "size"
_KEYS = {*_LIGHTS, *_INTENSITIES, *_NORMALS, *_PASSED_OVER, *_OTHERS}
# Bytes of an array of an archive.
_MAX_ARRAY_BYTES = 2**31


def load_stack(path: str | pathlib.Path) -> Stack:
    """Reads a stack of images.

    `.npz`: `images` [n, h, w, 3] of integers (whose largest value is saturated) or of radiance; `light_directions`
    [n, 3], or `light_positions` [n, 3] and `size`; and, where they are known, `light_intensities` [n, 3], `mask`
    [h, w], `normals` or `normal_gt` [h, w, 3], `view_directions` [n, 3], `ambient` [h, w, 3] and `saturation` in the
    units of the images, and `encoding`, "linear" (as by default) or "srgb".

    `.toml`, whose paths are relative to it:

        mask = "mask.png"          # optional: white where the surface is
        normals = "normals.png"    # optional: (n + 1)/2 in the camera's frame
        encoding = "srgb"          # optional, of images with 8 or 16 bits: "srgb" or "linear"
        saturation = 0.98          # optional: of such images a share of full scale, which is saturated in any case; of
                                   # EXR files radiance
        ambient = "dark.png"       # optional: without any of the lights; subtracted
        size = 0.3                 # with positions: width of what the images show, or [width, height]
        [[image]]
        file = "01.png"
        light = [0.2, 0.4, 0.9]    # or position = [0.1, 0.2, 0.5] of a near lamp, from the centre of what is shown
        intensity = [1, 1, 1]      # optional: of a near lamp, what comes in that centre
        view = [0, 0, 1]           # optional

    Raises:
        InputError: for what is missing, unknown, of the wrong shape or not finite, by name.
    """
    path = pathlib.Path(path)
    if path.suffix.lower() == ".npz":
        return _from_npz(path)
    if path.suffix.lower() == ".toml":
        return _from_toml(path)
    raise InputError(f"{path}: a stack of images is a .npz file, or a .toml file that lists images")


def _from_npz(path: pathlib.Path) -> Stack:
    arrays = read_npz(path, "a stack of images", _KEYS, _MAX_ARRAY_BYTES, texts=["encoding"], refuse_others=True)
    if "images" not in arrays:
        raise InputError(f"{path}: 'images' is missing; a stack has images and light_directions")
    if not any(key in arrays for key in _LIGHTS):
        raise InputError(f"{path}: 'light_directions' is missing; a stack has it, or light_positions and size")
    images = arrays["images"]
    integers = images.dtype.kind in "ui"
    top = np.float32(np.iinfo(images.dtype).max if integers else 1)
    encoding = _encoding(path, str(arrays.get("encoding", "linear")))
    stored = images / top
    # Full scale is 1 in integers, and in whatever the curve of a screen was applied to.
    limit = _saturation(path, arrays.get("saturation"), top, 1 if integers or encoding == "srgb" else np.inf)
    ambient = arrays.get("ambient")
    if ambient is not None:
        ambient = ambient / np.float32(np.iinfo(ambient.dtype).max if ambient.dtype.kind in "ui" else top)
    return stack_of(
        _decoded(stored, encoding),
        _first(arrays, ["light_directions"]),
        positions=_first(arrays, ["light_positions"]),
        size=arrays.get("size"),
        usable=_below(stored, limit),
        ambient=None if ambient is None else _decoded(ambient, encoding),
        intensities=_first(arrays, _INTENSITIES),
        views=_first(arrays, ["view_directions"]),
        mask=arrays["mask"] > 0 if "mask" in arrays else None,
        normals=_first(arrays, _NORMALS),
        name=path.name,
    )


def _from_toml(path: pathlib.Path) -> Stack:
    try:
        content = tomllib.loads(path.read_text(encoding="utf-8"))
    except (OSError, UnicodeDecodeError, tomllib.TOMLDecodeError) as fault:
        raise InputError(f"{path}: cannot be read as a list of images: {fault}") from None
    _check_known(path, content, {"image", "mask", "normals", "encoding", "saturation", "ambient", "size"})
    encoding = _encoding(path, content.get("encoding", "srgb"))
    entries = content.get("image")
    if not isinstance(entries, list) or not entries:
        raise InputError(f"{path}: lists no [[image]]")
    images, usable, lights, intensities, views, notes = [], [], [], [], [], []
    kind = "position" if isinstance(entries[0], dict) and "position" in entries[0] else "light"
    for number, entry in enumerate(entries, 1):
        where = f"{path}: [[image]] number {number}"
        _check_known(where, entry, {"file", "light", "position", "intensity", "view"})
        if not isinstance(entry.get("file"), str) or ("light" in entry) == ("position" in entry):
            raise InputError(
                f"{where}: needs 'file', the path of an image, and 'light', the direction to its light, or 'position'"
            )
        if kind not in entry:
            raise InputError(f"{where}: all images have a 'light', or all have a 'position'; the first has a {kind!r}")
        image = open_image(path.parent / entry["file"], stored=True)
        stored = image.pixels[..., :3]
        notes += image.notes
        if images and stored.shape != images[0].shape:
            raise InputError(f"{where}: is of {stored.shape[:2]} pixels, the ones before it of {images[0].shape[:2]}")
        limit = _saturation(path, content.get("saturation"), 1, 1 if image.is_encoded else np.inf)
        usable.append(_below(stored, limit))
        images.append(_linear(image, encoding))
        lights.append(array_of(where, f"'{kind}'", entry[kind], (3,)))
        intensities.append(array_of(where, "'intensity'", entry.get("intensity", [1.0] * 3), (3,)))
        views.append(array_of(where, "'view'", entry.get("view", [0.0, 0.0, 1.0]), (3,)))

    def shown(key: str) -> ImageFile | None:
        if key not in content:
            return None
        if not isinstance(content[key], str):
            raise InputError(f"{path}: '{key}' is the path of an image")
        return open_image(path.parent / content[key], stored=True)

    normals, mask, ambient = shown("normals"), shown("mask"), shown("ambient")
    notes += [note for image in (normals, mask, ambient) if image is not None for note in image.notes]
    stack = stack_of(
        np.stack(images),
        np.stack(lights) if kind == "light" else None,
        positions=np.stack(lights) if kind == "position" else None,
        size=content.get("size"),
        usable=np.stack(usable),
        ambient=None if ambient is None else _linear(ambient, encoding),
        intensities=np.stack(intensities),
        views=np.stack(views),
        mask=None if mask is None else mask.pixels[..., :3].max(axis=-1) > 0.5,
        normals=None if normals is None else normals.pixels[..., :3] * 2 - 1,
        name=path.name,
    )
    return dataclasses.replace(stack, notes=tuple(notes))


def _first(arrays: dict[str, np.ndarray], names: Collection[str]) -> np.ndarray | None:
    """The first array that is there, as floating point numbers."""
    found = next((arrays[name] for name in names if name in arrays), None)
    return found if found is None or found.dtype.kind == "f" else found.astype(float)


def _linear(image: ImageFile, encoding: str) -> Float[np.ndarray, "h w 3"]:
    """The linear colours of an image that was read as it is stored."""
    return _decoded(image.pixels[..., :3], encoding if image.is_encoded else "linear")


def _decoded(stored: np.ndarray, encoding: str) -> np.ndarray:
    return srgb_decode(stored).astype(np.float32) if encoding == "srgb" else stored


def _below(stored: Float[np.ndarray, "*n h w c"], limit: float) -> np.ndarray:
    """Which samples are below saturation in all channels."""
    return np.asarray((stored < np.float32(limit)).all(axis=-1))


def _encoding(path: pathlib.Path, value: object) -> str:
    if value not in _ENCODINGS:
        raise InputError(f'{path}: \'encoding\' is "srgb" or "linear", not {value!r}')
    return str(value)


def _saturation(path: pathlib.Path, value: Any, top: float | np.floating, full_scale: float) -> float:
    """The value from which on samples are saturated: as given, but no more than full scale."""
    if value is None:
        return full_scale
    number = np.asarray(value)
    if number.shape != () or number.dtype.kind not in "uif" or not number > 0:
        raise InputError(f"{path}: 'saturation' is one positive number, not {np.array2string(number, threshold=6)}")
    return min(float(np.float32(number) / np.float32(top)), full_scale)


def _check_known(where, content, known: set[str]):
    if not isinstance(content, dict):
        raise InputError(f"{where}: must be a table")
    for key in content:
        if key not in known:
            raise InputError(f"{where}: '{key}' is not known; known are {', '.join(sorted(known))}")
