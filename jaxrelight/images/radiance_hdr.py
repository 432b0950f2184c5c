"""Radiance pictures (.hdr, .pic): a text header, then scanlines of shared-exponent pixels, run-length coded.

A pixel's four bytes (r, g, b, e) mean (r, g, b)·2^(e − 136). Scanlines come flat, in the old run-length coding (a pixel
1, 1, 1, n repeats the one before it n times) or in the new one (each of the four components coded by itself).
"""

import re

import numpy as np

from jaxrelight.errors import InputError
from jaxrelight.images.primaries import to_rec709

_MAX_HEADER = 1 << 16
_ROW_BATCH = 64
_RESOLUTION = re.compile(rb"\s*([+-])\s*([XY])\s+(\d{1,9})\s+([+-])\s*([XY])\s+(\d{1,9})\s*", re.IGNORECASE)
_CODED_WIDTHS = range(8, 0x8000)  # scanlines that the new coding can hold
_DEFAULT_PRIMARIES = (0.64, 0.33, 0.29, 0.60, 0.15, 0.06, 1 / 3, 1 / 3)  # written by default, and meant as Rec.709


class _FormatError(Exception):
    """The bytes break the format; the message ends the sentence "this file ..."."""


def decode_radiance(data: bytes, name: str, max_pixels: int) -> tuple[np.ndarray, tuple[str, ...]]:
    """Decode a Radiance picture to float32 `[h, w, 3]`, and say in a line each what its header left to assume.

    EXPOSURE and COLORCORR, of which there may be several lines each, are divided out; PRIMARIES other than Radiance's
    own or Rec.709's are converted. Primaries that are none, as where all are 0, are taken as Rec.709, and exposures of
    0 as 1. Keys may be in lower case, and the empty line before the size may be missing.

    Args:
        data: The file's content.
        name: What to call it in messages.
        max_pixels: Size limit, checked before pixels are decoded.

    Raises:
        InputError: Not such a picture, cut short, longer than it claims, too large, in the XYZ variant or not linear.
    """
    try:
        scale, primaries, at, notes = _read_header(data)
        line_end = data.find(b"\n", at, at + 80)
        resolution = _RESOLUTION.fullmatch(data[at:line_end]) if line_end >= 0 else None
        axes = b"" if resolution is None else (resolution[2] + resolution[5]).upper()
        if resolution is None or axes not in (b"XY", b"YX"):
            raise _FormatError("has no resolution line such as '-Y 512 +X 1024'")
        count, length = int(resolution[3]), int(resolution[6])
        if not 0 < count * length <= max_pixels:
            raise _FormatError(f"claims {length}x{count} pixels, while 1 to {max_pixels} are allowed")
        rgbe = _read_scanlines(data, line_end + 1, count, length)
    except _FormatError as fault:
        raise InputError(f"{name}: this Radiance file {fault}; export or copy it again") from None

    # the first axis runs along resolution[2], in the direction of its sign; ours run down and right, which is -Y and +X
    if resolution[1] + axes[:1] in (b"+Y", b"-X"):
        rgbe = rgbe[::-1]
    if resolution[4] + axes[1:] in (b"+Y", b"-X"):
        rgbe = rgbe[:, ::-1]
    if axes == b"XY":
        rgbe = rgbe.swapaxes(0, 1)
    pixels = np.empty((*rgbe.shape[:2], 3), np.float32)
    # Some rows at a time: what lies between is several times the picture.
    for start in range(0, len(rgbe), _ROW_BATCH):
        rows = slice(start, start + _ROW_BATCH)
        exponents = np.where(rgbe[rows, :, 3] > 0, rgbe[rows, :, 3].astype(np.int32) - 136, -1000)  # e = 0 is black
        colours = np.ldexp(rgbe[rows, :, :3].astype(np.float32), exponents[..., None])
        with np.errstate(over="ignore", invalid="ignore"):
            colours = colours if (scale == 1).all() else (colours / scale).astype(np.float32)
            pixels[rows] = colours if primaries is None else colours @ primaries.T.astype(np.float32)
    return pixels, tuple(f"{name}: {note}" for note in notes)


def encode_radiance(pixels: np.ndarray) -> bytes:
    """Encode `[h, w, 3 or 4]` as a Radiance picture in the new run-length coding.

    The format holds colours ≥ 0, with about 1 % precision relative to a pixel's largest channel, and no alpha: negative
    values and NaN become 0, values above 1.7e38 that number.
    """
    height, width = pixels.shape[:2]
    rgbe = _to_rgbe(pixels[..., :3])
    header = f"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n-Y {height} +X {width}\n".encode()
    if width not in _CODED_WIDTHS:
        return header + rgbe.tobytes()
    start = bytes((2, 2, width >> 8, width & 255))
    return header + b"".join(
        piece for row in rgbe for piece in (start, *(_encode_component(row[:, i].tobytes()) for i in range(4)))
    )


def _read_header(data: bytes) -> tuple[np.ndarray, np.ndarray | None, int, list[str]]:
    """The factor by which the stored pixels were multiplied, `[3]`, their primaries' matrix, the end, and notes."""
    scale, primaries, known, at, notes = np.ones(3), None, data.startswith(b"#?"), 0, []
    while True:
        end = data.find(b"\n", at, _MAX_HEADER)
        if end < 0:
            raise _FormatError("has a header without an end" if known else "does not start like one")
        line = data[at:end].strip()
        if known and _RESOLUTION.fullmatch(line):
            break
        at = end + 1
        if not line:
            break
        key, _, value = (word.strip() for word in line.partition(b"="))
        key = key.upper()
        if key == b"FORMAT":
            if value.lower() != b"32-bit_rle_rgbe":
                kind = value.decode("ascii", "replace")[:40]
                raise _FormatError(f"has FORMAT={kind}, and only 32-bit_rle_rgbe is read (ra_xyze -r converts XYZ)")
            known = True
        elif key == b"PRIMARIES":
            primaries, note = _primaries(value)
            notes += [note] if note else []
        elif key == b"GAMMA":
            if _numbers(key, value).tolist() not in ([1.0], [0.0]):  # 0 where a writer left it open
                raise _FormatError("has a GAMMA other than 1, so it holds no linear radiance")
        elif key in (b"EXPOSURE", b"COLORCORR"):
            numbers = _numbers(key, value)
            if numbers.size != (1 if key == b"EXPOSURE" else 3):
                raise _FormatError(f"has an unreadable {key.decode()} line")
            if (numbers == 0).all():
                notes.append(f"its {key.decode()} is 0, taken as 1")
            else:
                scale = scale * numbers
    if not known:
        raise _FormatError("has neither a '#?' line nor a FORMAT line, so it is something else")
    with np.errstate(over="ignore", under="ignore"):
        scale = scale.astype(np.float32)
    if not (np.isfinite(scale) & (scale > 0)).all():
        raise _FormatError("has an EXPOSURE or COLORCORR that is not a positive number")
    return scale, primaries, at, notes


def _numbers(key: bytes, value: bytes) -> np.ndarray:
    try:
        return np.array([float(word) for word in value.replace(b",", b" ").split()])
    except ValueError:
        raise _FormatError(f"has an unreadable {key.decode()} line") from None


def _primaries(value: bytes) -> tuple[np.ndarray | None, str]:
    """The matrix to Rec.709, and a note where the numbers are no primaries."""
    try:
        numbers = _numbers(b"PRIMARIES", value)
        usual = numbers.shape == (8,) and np.allclose(numbers, _DEFAULT_PRIMARIES, rtol=0, atol=0.011)
        return None if usual else to_rec709(numbers), ""
    except (ValueError, _FormatError):
        shown = value.decode("ascii", "replace")[:60]
        return None, f"its PRIMARIES={shown} are none; its colours are taken as Rec.709"


def _read_scanlines(data: bytes, at: int, count: int, length: int) -> np.ndarray:
    """uint8 `[count, length, 4]`; memory for the whole is taken when every scanline has been found."""
    scanlines = []
    for number in range(count):
        try:
            if length in _CODED_WIDTHS and data[at : at + 2] == b"\2\2" and data[at + 2] < 128:
                if data[at + 2] << 8 | data[at + 3] != length:
                    raise IndexError
                scanline, at = _decode_components(data, at + 4, length)
            else:
                scanline, at = _decode_pixels(data, at, length)
        except IndexError:
            raise _FormatError(f"is cut short or damaged in scanline {number + 1} of {count}") from None
        scanlines.append(scanline)
    if len(spare := data[at:].strip(b"\0\r\n\x1a ")) > 0:
        raise _FormatError(f"has {len(spare)} bytes after the last of its {count} scanlines, so its header is damaged")
    return np.frombuffer(b"".join(scanlines), np.uint8).reshape(count, length, 4)


def _decode_components(data: bytes, at: int, length: int) -> tuple[bytes, int]:
    """One scanline in the new coding: a byte n > 128 repeats the next byte n − 128 times, else n bytes follow."""
    planes = bytearray()
    for component in range(1, 5):
        while (missing := component * length - len(planes)) > 0:
            code = data[at]
            run = code - 128 if code > 128 else code
            if not 0 < run <= missing:
                raise IndexError
            if code > 128:
                planes += data[at + 1 : at + 2] * run
                at += 2
            else:
                planes += data[at + 1 : at + 1 + run]
                at += 1 + run
            if at > len(data):
                raise IndexError
    return np.frombuffer(planes, np.uint8).reshape(4, length).T.tobytes(), at


def _decode_pixels(data: bytes, at: int, length: int) -> tuple[bytes, int]:
    """One scanline of plain pixels; 1, 1, 1, n among them repeats, and repeats in a row are digits to base 256."""
    flat = np.frombuffer(data[at : at + 4 * length], np.uint8)
    if flat.size == 4 * length and not (flat.reshape(-1, 4)[:, :3] == 1).all(axis=1).any():
        return flat.tobytes(), at + 4 * length
    pixels, shift = bytearray(), 0
    while (missing := length - len(pixels) // 4) > 0:
        pixel = data[at : at + 4]
        at += 4
        if len(pixel) < 4:
            raise IndexError
        if pixel[:3] != b"\1\1\1":
            pixels += pixel
            shift = 0
            continue
        run = pixel[3] << shift
        if run > missing or not pixels or shift > 24:
            raise IndexError
        pixels += pixels[-4:] * run
        shift += 8
    return bytes(pixels), at


def _to_rgbe(rgb: np.ndarray) -> np.ndarray:
    """uint8 `[h, w, 4]`, mantissas rounded to nearest."""
    largest = np.ldexp(255.0, 255 - 136)
    rgb = np.clip(np.nan_to_num(rgb.astype(np.float32), nan=0.0, posinf=largest, neginf=0.0), 0.0, largest)
    peak = rgb.max(axis=-1)
    exponent = np.frexp(peak)[1]  # peak = m·2^exponent with m in [0.5, 1), hence a mantissa in [128, 256)
    exponent += np.rint(np.ldexp(peak, 8 - exponent)) > 255
    mantissa = np.rint(np.ldexp(rgb, 8 - exponent[..., None]))
    stored = exponent + 128
    rgbe = np.concatenate([mantissa, stored[..., None]], axis=-1)
    return np.where((stored > 0)[..., None] & (peak > 0)[..., None], rgbe, 0).astype(np.uint8)


def _encode_component(values: bytes) -> bytes:
    """Runs of four bytes or more become (128 + n, byte), the rest (n, bytes)."""
    coded, at = bytearray(), 0
    for run in re.finditer(rb"(.)\1{3,126}", values, re.DOTALL):
        coded += _literals(values[at : run.start()])
        coded += bytes((128 + len(run[0]), run[0][0]))
        at = run.end()
    return bytes(coded + _literals(values[at:]))


def _literals(values: bytes) -> bytes:
    return b"".join(bytes((len(part),)) + part for i in range(0, len(values), 128) if (part := values[i : i + 128]))
