"""Image files by extension: OpenEXR and Radiance hold radiance as it is, PNG and JPEG hold sRGB."""

import io
import os
import struct
import warnings
import zlib
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from jaxrelight.errors import InputError
from jaxrelight.files.whole_file import check_place, write_whole
from jaxrelight.images.exr import read_exr, write_channels, write_exr
from jaxrelight.images.radiance_hdr import decode_radiance, encode_radiance
from jaxrelight.images.tone import srgb_decode, to_bytes, to_unit, tone_map

_PILLOW_FORMATS = {".png": "PNG", ".jpg": "JPEG", ".jpeg": "JPEG"}
_READABLE = ".exr, .hdr, .pic, .png, .jpg"
_WRITABLE = ".exr", ".hdr", ".pic", ".png"


def read_image(path: str | os.PathLike, max_pixels: int = 2**27) -> np.ndarray:
    """Read an image file as linear Rec.709.

    EXR and Radiance values come as they are stored, NaN included, with Radiance's EXPOSURE divided out. PNG and JPEG
    are decoded from sRGB to [0, 1], 16-bit colour at 8-bit precision; their colour profiles are not applied and alpha
    is not multiplied in.

    Args:
        path: A file ending in .exr, .hdr, .pic, .png, .jpg or .jpeg.
        max_pixels: A file whose header claims more is refused before memory is taken for it.

    Returns:
        float32 `[h, w, 3]`, or `[h, w, 4]` if the file has alpha; row 0 is the top.

    Raises:
        InputError: The file is missing, of another kind, damaged, cut short or too large.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    try:
        _check_regular(path)
        if suffix == ".exr":
            return read_exr(path, max_pixels)
        if suffix in (".hdr", ".pic"):
            with path.open("rb") as file:  # five bytes a pixel, besides the header, is the most that a picture can fill
                data = file.read(min(path.stat().st_size, 5 * max_pixels + 2**20))
            return decode_radiance(data, str(path), max_pixels)
        if suffix in _PILLOW_FORMATS:
            return _read_pillow(path, max_pixels)
    except MemoryError as fault:
        raise InputError(f"{path}: is larger than the free memory; shrink the image") from fault
    except OSError as fault:
        raise InputError(f"{path}: cannot be read, {fault.strerror or fault}; check the path and its rights") from fault
    raise InputError(f"{path}: unknown kind of image {suffix!r}; use one of {_READABLE}")


def write_image(path: str | os.PathLike, pixels: ArrayLike, exposure: float = 0.0, *, alpha: bool = False) -> None:
    """Write linear Rec.709 pixels in the format that the extension names.

    The file appears whole or not at all: it is written beside its place and then moved there.

    Args:
        path: .exr keeps float32 and a fourth channel exactly; .hdr and .pic keep RGB at about 1 %; .png is tone mapped.
        pixels: Floating point `[h, w, 3 or 4]`.
        exposure: Stops, for .png; the other formats hold radiance, which has no exposure.
        alpha: Whether a .png keeps the fourth channel. Without it RGB is written as it is, already blended.

    Raises:
        InputError: The pixels are not an image, the extension is unknown or the file cannot be written.
    """
    path = Path(path)
    image = _as_image(path, pixels)
    suffix = path.suffix.lower()
    if suffix == ".exr":
        write_whole(path, lambda partial: write_exr(partial, image))
    elif suffix in (".hdr", ".pic"):
        write_whole(path, lambda partial: partial.write_bytes(encode_radiance(image)))
    elif suffix == ".png":
        shown = tone_map(image, exposure)
        if alpha and image.shape[2] == 4:
            shown = np.concatenate([shown, to_bytes(to_unit(image[..., 3:]))], axis=-1)
        write_whole(path, lambda partial: _write_png(partial, shown))
    else:
        raise InputError(f"{path}: cannot write an image of kind {suffix!r}; use one of {', '.join(_WRITABLE)}")


def write_layers(path: str | os.PathLike, pixels: ArrayLike, layers: Mapping[str, np.ndarray]) -> None:
    """Write an EXR of a picture and of layers `[h, w, 3]` beside it, whose channels are called `name.R` and so on.

    Raises:
        InputError: As `write_image` does.
    """
    image = _as_image(Path(path), pixels)
    channels = {name: image[..., i] for i, name in enumerate("RGBA"[: image.shape[2]])}
    for layer, values in layers.items():
        channels |= {f"{layer}.{name}": values[..., i] for i, name in enumerate("RGB")}
    planes = {name: np.ascontiguousarray(plane, np.float32) for name, plane in channels.items()}
    write_whole(Path(path), lambda partial: write_channels(partial, [("picture", planes)]))


def check_writable(path: str | os.PathLike) -> None:
    """Find out before long work whether its picture could be written.

    Raises:
        InputError: The extension is unknown, or the folder does not exist or must not be written to.
    """
    check_place(Path(path), _WRITABLE, "an image")


def _check_regular(path: Path) -> None:
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the path of an image file")
    if not path.exists():
        raise InputError(f"{path}: no such file; check the path")
    if not path.is_file():  # reading a pipe or a device could wait or go on for ever
        raise InputError(f"{path}: is not a regular file; save the image to one first")
    if path.stat().st_size == 0:
        raise InputError(f"{path}: the file is empty; export or copy it again")


def _read_pillow(path: Path, max_pixels: int) -> np.ndarray:
    from PIL import Image

    kind = _PILLOW_FORMATS[path.suffix.lower()]
    try:
        data = path.read_bytes()  # a stream from a file would take the memory that a chunk claims
        with warnings.catch_warnings(), io.BytesIO(data) as file:
            warnings.simplefilter("ignore")  # its own size warning, and complaints about metadata
            image = Image.open(file, formats=[kind])
            _check_claimed_size(path, image.size, max_pixels)
            image.load()
            if kind == "PNG":
                _check_png_chunks(data)
            if image.mode.startswith("I"):  # 16-bit grey
                grey = np.asarray(image, dtype=np.float32) / 65535
                return np.repeat(srgb_decode(grey)[..., None], 3, axis=-1).astype(np.float32)
            stored = np.asarray(image.convert("RGBA" if image.has_transparency_data else "RGB"))
    except (InputError, MemoryError):
        raise
    except Exception as fault:  # a broken file can raise nearly anything in Pillow's many decoders
        raise InputError(f"{path}: not a {kind} file, or damaged or cut short; export or copy it again") from fault
    levels = np.arange(256) / 255
    linear = srgb_decode(levels).astype(np.float32)[stored]
    if stored.shape[2] == 4:
        linear[..., 3] = levels[stored[..., 3]]
    return linear


def _check_png_chunks(data: bytes) -> None:
    """Raise ValueError unless every chunk up to the end marker has its checksum; Pillow leaves that of pixels out."""
    at, name = 8, b""
    while name != b"IEND":
        length, name = struct.unpack_from(">I4s", data, at)
        (checksum,) = struct.unpack_from(">I", data, at + 8 + length)
        if zlib.crc32(data[at + 4 : at + 8 + length]) != checksum:
            raise ValueError("a chunk is damaged")
        at += 12 + length


def _check_claimed_size(path: Path, size: tuple[int, int], max_pixels: int) -> None:
    width, height = size
    if width * height > max_pixels:
        raise InputError(
            f"{path}: the header claims {width}x{height} pixels, more than the limit of {max_pixels}; shrink the image"
        )
    # deflate shrinks at most 1032-fold, and a pixel has at least one bit; JPEG stays below that, too
    if width * height > path.stat().st_size * 1032 * 8:
        raise InputError(f"{path}: too short for the {width}x{height} pixels it claims; export or copy it again")


def _as_image(path: Path, pixels) -> np.ndarray:
    pixels = np.asarray(pixels)
    if pixels.ndim != 3 or pixels.shape[2] not in (3, 4) or pixels.size == 0:
        raise InputError(f"{path}: an image to write has shape [h, w, 3 or 4], not {list(pixels.shape)}")
    if pixels.dtype.kind not in "fV":  # V: bfloat16 as numpy sees it
        raise InputError(f"{path}: pixels to write are linear floating point values, not {pixels.dtype}")
    with np.errstate(over="ignore"):
        return pixels.astype(np.float32)


def _write_png(path: Path, shown: np.ndarray) -> None:
    from PIL import Image

    Image.fromarray(shown).save(path, format="PNG")
