"""Image files: OpenEXR and Radiance hold radiance as it is, the other kinds hold sRGB.

What a file holds is told by its content when it is read, and by its extension when it is written.
"""

import dataclasses
import os
import tempfile
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from jaxrelight.errors import InputError
from jaxrelight.files.whole_file import check_place, write_whole
from jaxrelight.images.encoded import FORMATS, decode_encoded
from jaxrelight.images.exr import open_exr, write_channels, write_exr
from jaxrelight.images.exr_layers import Wanted, split_choice
from jaxrelight.images.kinds import READABLE, SUFFIXES, kind_of, kind_of_suffix, other_kind_of
from jaxrelight.images.radiance_hdr import decode_radiance, encode_radiance
from jaxrelight.images.tone import Exposure, Tone, to_bytes, to_unit, tone_map

_WRITABLE = ".exr", ".hdr", ".pic", ".png"
_MAX_HEADER = 2**20
_MAX_BYTES_PER_PIXEL = 9  # of files that are not OpenEXR: four channels of 16 bits, and what does not shrink


@dataclasses.dataclass(frozen=True, eq=False)
class ImageFile:
    """What an image file holds.

    Attributes:
        pixels: float32 `[h, w, 3]`, or `[h, w, 4]` if there is alpha; row 0 is the top.
        kind: "OpenEXR", "Radiance", "PNG", "JPEG", "WebP", "TGA" or "BMP".
        envmap: how the picture shows the whole sphere, "latlong" or "cube", where an OpenEXR file says that it does.
        notes: one line for everything that was assumed.
    """

    pixels: np.ndarray
    kind: str
    envmap: str | None = None
    notes: tuple[str, ...] = ()

    @property
    def is_encoded(self) -> bool:
        """Whether the file's numbers run from 0 to a full scale, encoded by the sRGB curve."""
        return self.kind in FORMATS


def read_image(path: str | os.PathLike, max_pixels: int = 2**27) -> np.ndarray:
    """Read an image file as linear Rec.709.

    The format is found by content, not by the path's ending: OpenEXR, Radiance, PNG, JPEG, WebP, TGA or BMP. OpenEXR
    and Radiance values come as they are stored, NaN included, with Radiance's EXPOSURE divided out. The other kinds are
    decoded from sRGB to [0, 1], of 8 bits or, in PNG, 16; their colour profiles are not applied and alpha is not
    multiplied in.

    Of an OpenEXR file with several parts or layers the beauty pass is read. Another one is named behind the path:
    `sky.exr#layer:ViewLayer.Albedo`, `sky.exr#part:left` or `sky.exr#part:left,layer:albedo`.

    Args:
        path: A file.
        max_pixels: A file whose header claims more is refused before memory is taken for it.

    Returns:
        float32 `[h, w, 3]`, or `[h, w, 4]` if the file has alpha; row 0 is the top.

    Raises:
        InputError: The file is missing, of another kind, damaged, cut short or too large, or has no such layer.
    """
    return open_image(path, max_pixels).pixels


def open_image(path: str | os.PathLike, max_pixels: int = 2**27, *, stored: bool = False) -> ImageFile:
    """`read_image`, with what is known of the file beside its pixels.

    Args:
        path: A file.
        max_pixels: See `read_image`.
        stored: Whether numbers that are encoded by sRGB come as they stand in the file, from 0 to 1.

    Raises:
        InputError: As `read_image` does.
    """
    path, wanted = Path(path), None
    try:
        if not path.exists():
            plain, wanted = split_choice(os.fspath(path))
            path = Path(plain)
        _check_regular(path)
        with path.open("rb") as file:
            head = file.read(64)
            if kind_of(head) == "OpenEXR" or (kind_of(head) is None and kind_of_suffix(path.suffix) == "OpenEXR"):
                return _from_exr(path, str(path), path.suffix, max_pixels, wanted)
            # As much as asked for is set aside before it is read.
            data = head + file.read(min(path.stat().st_size, _MAX_BYTES_PER_PIXEL * max_pixels + _MAX_HEADER))
    except OSError as fault:
        raise InputError(f"{path}: cannot be read, {fault.strerror or fault}; check the path and its rights") from fault
    except MemoryError as fault:
        raise InputError(f"{path}: is larger than the free memory; shrink the image") from fault
    if wanted is not None:
        raise InputError(f"{path}: only OpenEXR files have parts and layers; leave out what follows '#'")
    return decode_image(data, str(path), max_pixels, stored=stored, suffix=path.suffix)


def decode_image(
    data: bytes, name: str, max_pixels: int = 2**27, *, stored: bool = False, suffix: str = ""
) -> ImageFile:
    """`open_image` of bytes, such as those of an image that another file holds.

    Args:
        data: The content of an image file.
        name: What messages call it.
        max_pixels: See `read_image`.
        stored: See `open_image`.
        suffix: The ending of its file's name, if it has one; it decides where the content says nothing.

    Raises:
        InputError: As `read_image` does.
    """
    kind = kind_of(data)
    try:
        if kind is None:
            other, kind = other_kind_of(data), kind_of_suffix(suffix)
            if other is not None:
                raise InputError(f"{name}: holds {other}, which is not read; convert it to one of {READABLE}")
            if kind is None:
                raise InputError(f"{name}: unknown kind of image {suffix!r}; use one of {READABLE}")
        if kind == "OpenEXR":
            with tempfile.TemporaryDirectory() as folder:
                path = Path(folder) / "embedded.exr"
                path.write_bytes(data)
                return _from_exr(path, name, suffix, max_pixels, None)
        if kind == "Radiance":
            pixels, notes = decode_radiance(data, name, max_pixels)
        else:
            pixels, notes = decode_encoded(data, kind, name, max_pixels, stored=stored), ()
    except MemoryError as fault:
        raise InputError(f"{name}: is larger than the free memory; shrink the image") from fault
    return ImageFile(pixels, kind, None, (*_misnamed(name, kind, suffix), *notes))


def _from_exr(path: Path, name: str, suffix: str, max_pixels: int, wanted: Wanted | None) -> ImageFile:
    picture = open_exr(path, max_pixels, wanted, name)
    return ImageFile(picture.pixels, "OpenEXR", picture.envmap, (*_misnamed(name, "OpenEXR", suffix), *picture.notes))


def _misnamed(name: str, kind: str, suffix: str) -> tuple[str, ...]:
    """A note where a file is called as one of another kind is."""
    return () if suffix.lower() in ("", *SUFFIXES[kind]) else (f"{name}: read as {kind}, which is what it holds",)


def write_image(
    path: str | os.PathLike,
    pixels: ArrayLike,
    exposure: Exposure = 0.0,
    *,
    tone: Tone = "linear",
    alpha: bool = False,
) -> None:
    """Write linear Rec.709 pixels in the format that the extension names.

    The file appears whole or not at all: it is written beside its place and then moved there.

    Args:
        path: .exr keeps float32 and a fourth channel exactly; .hdr and .pic keep RGB at about 1 %; .png is tone mapped.
        pixels: Floating point `[h, w, 3 or 4]`.
        exposure: Stops, or "auto", for .png; the other formats hold radiance, which has no exposure. See
            `auto_exposure`.
        tone: The curve between radiance and what a .png shows: "linear", "filmic" or "agx"; see `displayed`.
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
        shown = tone_map(image, exposure, tone)
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
