"""OpenEXR files, through the OpenEXR library.

The library reports damage by printing, and then returns a file without parts; this module turns that, and whatever it
raises, into one `InputError`.
"""

import contextlib
import dataclasses
import io
import os
import struct
import threading
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np

from jaxrelight.errors import InputError
from jaxrelight.images.exr_layers import Wanted, choose_layer
from jaxrelight.images.primaries import to_rec709

_MAGIC = b"\x76\x2f\x31\x01"
_REQUIRED = {  # attributes that say what the pixels are, as name and type
    "channels\0chlist",
    "compression\0compression",
    "dataWindow\0box2i",
    "displayWindow\0box2i",
    "lineOrder\0lineOrder",
}
_LINES = {0: 1, 1: 1, 2: 1, 3: 16, 4: 32, 5: 16, 6: 32, 7: 32, 8: 32, 9: 256}  # in a chunk, by compression
_MAX_HEADER = 2**24
_QUIET = threading.Lock()


@dataclasses.dataclass(frozen=True, eq=False)
class ExrPicture:
    """The picture of an EXR file.

    Attributes:
        pixels: linear Rec.709, float32 `[h, w, 3]`, or `[h, w, 4]` if there is alpha. NaN and infinity are passed on.
        envmap: how the picture shows the whole sphere, "latlong" or "cube", if the file says that it does.
        notes: one line for everything that was assumed.
    """

    pixels: np.ndarray
    envmap: str | None = None
    notes: tuple[str, ...] = ()


def read_exr(path: Path, max_pixels: int) -> np.ndarray:
    """The pixels of `open_exr`."""
    return open_exr(path, max_pixels).pixels


def open_exr(path: Path, max_pixels: int, wanted: Wanted | None = None, name: str = "") -> ExrPicture:
    """Read the picture of an EXR file: its beauty pass, or the part and the layer that are named.

    Channels may be half or float, and be called R, G, B (and A) or Y alone for a grey image, in any case or spelled
    out (`red`), behind a layer's name or not (`ViewLayer.Combined.R`). `choose_layer` says which layer of which part
    is taken. Of several resolutions the full one is taken. Primaries other than Rec.709's are converted; ones that
    cannot be, such as zeros, are taken as Rec.709. The result covers the display window: pixels outside the data
    window are 0, data outside the display window is cropped.

    Args:
        path: A regular file.
        max_pixels: Size limit, checked against the header before any pixel is read.
        wanted: The part and the layer, if they are named.
        name: What messages call the file, if not its path.

    Raises:
        InputError: The file is not EXR, is damaged or incomplete, too large or deep, has no colours or several layers
            of them, or has colours that are integers, subsampled, or luminance and chroma.
    """
    name = name or str(path)
    with path.open("rb") as file:
        if file.read(4) != _MAGIC:
            raise InputError(f"{name}: not an OpenEXR file although it is named so; export it again as EXR")
        file.seek(0)
        _check_table(name, file.read(_MAX_HEADER), os.fstat(file.fileno()).st_size)
    headers = [header for header, _ in _load(path, name, header_only=True)]
    for header in headers:
        _check_header(name, header, max_pixels)
    number, names, note = choose_layer(
        name, [(str(header.get("name", "")), header["channels"]) for header in headers], wanted
    )

    parts = _load(path, name, header_only=False)
    if len(parts) != len(headers):
        raise InputError(f"{name}: pixels are missing or damaged; the file may be cut short, export or copy it again")
    header, channels = parts[number]
    height, width = _size(header["dataWindow"])
    for channel in names:
        if channels[channel].dtype.kind != "f" or channels[channel].shape != (height, width):
            raise InputError(
                f"{name}: channel {channel} holds integers or is subsampled; export full half or float RGB"
            )
    pixels = np.empty((height, width, len(names)), np.float32)
    for number, channel in enumerate(names):
        pixels[..., number] = channels[channel]
    # Whatever follows takes memory of its own.
    del parts, channels
    pixels, primaries_note = _in_rec709(name, pixels, header)
    pixels = _place(pixels, header["dataWindow"], header["displayWindow"])
    notes = tuple(line for line in (note, primaries_note) if line)
    return ExrPicture(pixels, _envmap(header), notes)


def write_exr(path: Path, pixels: np.ndarray) -> None:
    """Write `[h, w, 3 or 4]` as float32 channels R, G, B (and A), ZIP compressed, without loss.

    Raises:
        OSError: The file could not be written.
    """
    import OpenEXR

    image = np.ascontiguousarray(pixels, dtype=np.float32)  # a strided or float64 array is more than the library bears
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    try:
        with _quiet():
            OpenEXR.File(header, {"RGB" if image.shape[2] == 3 else "RGBA": image}).write(str(path))
    except Exception as fault:  # the library has no exception type of its own
        raise OSError(str(fault).strip().split('". ')[-1]) from fault
    # The library says nothing of a disk that fills up meanwhile.
    try:
        is_complete = np.array_equal(read_exr(path, image.shape[0] * image.shape[1]), image, equal_nan=True)
    except InputError:
        is_complete = False
    if not is_complete:
        raise OSError("what is on the disk is not what was written")


def read_channels(path: Path, max_pixels: int) -> list[dict[str, np.ndarray]]:
    """Read the channels of every part of an EXR file that holds other things than colours: `[h, w]` by name.

    Raises:
        InputError: As `read_exr` does, but for what colours a file has.
    """
    with path.open("rb") as file:
        if file.read(4) != _MAGIC:
            raise InputError(f"{path}: not an OpenEXR file although it is named so; write it again")
        file.seek(0)
        _check_table(str(path), file.read(_MAX_HEADER), os.fstat(file.fileno()).st_size)
    headers = [header for header, _ in _load(path, str(path), header_only=True)]
    for header in headers:
        _check_header(str(path), header, max_pixels)
    parts = _load(path, str(path), header_only=False)
    sizes = [_size(header["dataWindow"]) for header in headers]
    if len(parts) != len(headers) or any(
        plane.shape != size for size, (_, planes) in zip(sizes, parts, strict=True) for plane in planes.values()
    ):
        raise InputError(f"{path}: pixels are missing or damaged; the file may be cut short, write or copy it again")
    return [{name: plane.astype(np.float32) for name, plane in planes.items()} for _, planes in parts]


def write_channels(path: Path, parts: Sequence[tuple[str, dict[str, np.ndarray]]]) -> None:
    """Write named parts of named channels `[h, w]`, float32 or float16, ZIP compressed, without loss.

    The format wants one display window for all parts: it is as large as the largest.

    Raises:
        OSError: The file could not be written.
    """
    import OpenEXR

    file_parts = []
    heights, widths = zip(*(plane.shape for _, channels in parts for plane in channels.values()), strict=True)
    window = np.zeros(2, np.int32), np.array([max(widths) - 1, max(heights) - 1], np.int32)
    for name, channels in parts:
        planes = {channel: np.ascontiguousarray(plane) for channel, plane in channels.items()}
        header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage, "name": name}
        header["displayWindow"] = window
        file_parts.append(OpenEXR.Part(header, planes, name))
    try:
        with _quiet():
            OpenEXR.File(file_parts).write(str(path))
    except Exception as fault:  # the library has no exception type of its own
        raise OSError(str(fault).strip().split('". ')[-1]) from fault


def _load(path: Path, name: str, *, header_only: bool) -> list[tuple[dict, dict]]:
    """Header, with the channels' names, and pixels by channel of each part that the library could read."""
    import OpenEXR

    try:
        with _quiet():
            file = OpenEXR.File(str(path), separate_channels=True, header_only=header_only)
            parts = [
                (
                    {**file.header(i), "channels": [channel.name for channel in file.header(i)["channels"]]},
                    {} if header_only else {key: channel.pixels for key, channel in file.channels(i).items()},
                )
                for i in range(len(file.parts))
            ]
    except Exception as fault:  # RuntimeError, ValueError, UnicodeDecodeError, ...: whatever the damage led to
        raise InputError(f"{name}: damaged or cut-short OpenEXR file; export or copy it again") from fault
    if header_only and not parts:
        raise InputError(f"{name}: OpenEXR file without an image; export or copy it again")
    return parts


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Drop what the library prints: C++ writes to descriptor 2, its Python layer to `sys.stdout`."""
    with _QUIET, contextlib.ExitStack() as stack:
        stack.enter_context(contextlib.redirect_stdout(io.StringIO()))
        with contextlib.suppress(OSError):  # no descriptor 2: nothing to silence
            saved = os.dup(2)
            stack.callback(os.close, saved)
            nowhere = stack.enter_context(open(os.devnull, "wb"))
            stack.callback(os.dup2, saved, 2)
            os.dup2(nowhere.fileno(), 2)
        yield


def _size(window) -> tuple[int, int]:
    (left, top), (right, bottom) = np.asarray(window, dtype=np.int64)
    return int(bottom - top + 1), int(right - left + 1)


def _check_header(name: str, header: dict, max_pixels: int) -> None:
    import OpenEXR

    if header["type"] not in (OpenEXR.scanlineimage, OpenEXR.tiledimage):
        raise InputError(f"{name}: deep EXR images are not supported; flatten it and export again")
    for window in (header["dataWindow"], header["displayWindow"]):
        height, width = _size(window)
        if height < 1 or width < 1:
            raise InputError(f"{name}: the header claims an empty image of {width}x{height} pixels; export it again")
        if height * width > max_pixels:
            raise InputError(
                f"{name}: the header claims {width}x{height} pixels, more than the limit of {max_pixels}; "
                "shrink the image"
            )
    height, width = _size(header["dataWindow"])
    shown = int(np.prod(_size(header["displayWindow"])))
    if shown > max(64 * height * width, 2**22):
        raise InputError(
            f"{name}: its display window has {shown:,} pixels, but only {height * width:,} are stored; "
            "export it without the empty border"
        )
    if height * width * len(header["channels"]) > 4 * max_pixels:
        raise InputError(
            f"{name}: {len(header['channels'])} channels of {width}x{height} pixels are more than the limit of "
            f"{4 * max_pixels} values; export only the colour channels"
        )


def _check_table(name: str, head: bytes, file_size: int) -> None:
    """Refuse headers that lack what the library would make up, and sizes that leave chunks of the file over.

    The library believes a window with too few rows, and then reads the picture's upper part as the whole.
    """
    (version,), at, headers = struct.unpack_from("<I", head.ljust(8, b"\0"), 4), 8, []
    several = bool(version & 0x1000)
    try:
        while not headers or (several and head[at : at + 1] != b"\0"):
            attributes, at = _attributes(head, at)
            if missing := _REQUIRED - set(attributes):
                lacks = sorted(missing)[0].split("\0")[0]
                raise InputError(f"{name}: its header lacks {lacks!r}; export or copy it again")
            headers.append(attributes)
        count = None if several or version & 0x800 else _chunk_count(headers[0])
        if count is None or at + 8 * count + 8 > len(head):
            return
        first = min(struct.unpack_from(f"<{count}Q", head, at))
        (beyond,) = struct.unpack_from("<Q", head, at + 8 * count)
    except (ValueError, IndexError, KeyError, struct.error):
        if len(head) == _MAX_HEADER:
            return  # too long to look through; the library reads it
        raise InputError(f"{name}: damaged or cut-short OpenEXR header; export or copy it again") from None
    if first >= at + 8 * count + 8 and first < beyond < file_size:
        raise InputError(f"{name}: its header claims fewer pixels than the file holds; export or copy it again")


def _attributes(head: bytes, at: int) -> tuple[dict[str, bytes], int]:
    """Content of the attributes of a header, by name and type, and where it ends: at an attribute without a name."""
    attributes = {}
    while head[at] != 0:
        name_end = head.index(b"\0", at)
        kind_end = head.index(b"\0", name_end + 1)
        (size,) = struct.unpack_from("<i", head, kind_end + 1)
        start = kind_end + 5
        if not 0 <= size <= len(head) - start:
            raise ValueError("an attribute is longer than the file")
        attributes[head[at:kind_end].decode("latin-1")] = head[start : start + size]
        at = start + size
    return attributes, at + 1


def _chunk_count(header: dict[str, bytes]) -> int | None:
    """How many chunks a single part has; None where that is not known, or could not be."""
    left, top, right, bottom = struct.unpack("<4i", header["dataWindow\0box2i"])
    width, height = right - left + 1, bottom - top + 1
    if min(width, height) < 1:
        return None
    if "tiles\0tiledesc" not in header:
        lines = _LINES.get(header["compression\0compression"][0])
        return None if lines is None else -(-height // lines)
    across, down, mode = struct.unpack("<2IB", header["tiles\0tiledesc"])
    if mode != 0 or not across or not down:  # with levels, the table is longer than that of the first
        return None
    return -(-width // across) * -(-height // down)


def _envmap(header: dict) -> str | None:
    """The layout that the header names."""
    import OpenEXR

    names = {OpenEXR.ENVMAP_LATLONG: "latlong", OpenEXR.ENVMAP_CUBE: "cube"}
    return names.get(header.get("envmap"))  # pyright: ignore[reportArgumentType]


def _in_rec709(name: str, pixels: np.ndarray, header: dict) -> tuple[np.ndarray, str]:
    """Colours converted from the file's primaries, in place, and a note where these are none."""
    if "chromaticities" not in header:
        return pixels, ""
    try:
        matrix = to_rec709(header["chromaticities"])
    except ValueError as fault:
        return pixels, f"{name}: its chromaticities are not usable, {fault}; its colours are taken as Rec.709"
    if matrix is not None:
        with np.errstate(over="ignore", invalid="ignore"):
            pixels[..., :3] = pixels[..., :3] @ matrix.T.astype(np.float32)
    return pixels, ""


def _place(pixels: np.ndarray, data_window, display_window) -> np.ndarray:
    """Move pixels of the data window to where they belong in the display window."""
    offset = np.asarray(data_window, np.int64)[0] - np.asarray(display_window, np.int64)[0]
    height, width = _size(display_window)
    if pixels.shape[:2] == (height, width) and not offset.any():
        return pixels
    image = np.zeros((height, width, pixels.shape[2]), np.float32)
    (x_to, x_from), (y_to, y_from) = (
        (slice(max(at, 0), max(min(at + length, room), 0)), slice(max(-at, 0), max(min(length, room - at), 0)))
        for at, length, room in zip(offset.tolist(), pixels.shape[1::-1], (width, height), strict=True)
    )
    image[y_to, x_to] = pixels[y_from, x_from]
    return image
