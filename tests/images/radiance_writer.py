"""Radiance pictures written independently of the package: every coding, orientation and header.

Follows the description of picture files in Radiance's own manual: a scanline is flat, in the old run-length coding
(1, 1, 1, n) or in the new one (2, 2, length, then four components of runs and dumps).
"""

import struct
from collections.abc import Sequence

import numpy as np

ORIENTATIONS = ("-Y +X", "+Y +X", "-Y -X", "+Y -X", "+X -Y", "+X +Y", "-X -Y", "-X +Y")


def values(rgbe: np.ndarray) -> np.ndarray:
    """Radiance of bytes [h, w, 4], in float64."""
    r, g, b, e = np.moveaxis(rgbe.astype(float), -1, 0)
    return np.stack([r, g, b], axis=-1) * np.where(e > 0, 2.0 ** (e - 136), 0)[..., None]


def picture(
    rgbe: np.ndarray,
    coding: str = "new",
    orientation: str = "-Y +X",
    first: str | None = "#?RADIANCE",
    lines: Sequence[str] = ("FORMAT=32-bit_rle_rgbe",),
    newline: str = "\n",
) -> bytes:
    """The file whose picture, seen upright, is `rgbe` [h, w, 4]."""
    slow, fast = orientation.split()
    stored = rgbe.swapaxes(0, 1) if slow[1] == "X" else rgbe
    stored = stored[::-1] if slow in ("+Y", "-X") else stored
    stored = stored[:, ::-1] if fast in ("+Y", "-X") else stored
    header = ([] if first is None else [first]) + [*lines, "", f"{slow} {stored.shape[0]} {fast} {stored.shape[1]}", ""]
    scanline = {"flat": np.ndarray.tobytes, "old": _old, "new": _new}[coding]
    return newline.join(header).encode() + b"".join(scanline(np.ascontiguousarray(row)) for row in stored)


def _runs(items: Sequence) -> list[tuple[int, int]]:
    """Start and length of the stretches of equal items."""
    starts = [i for i in range(len(items)) if i == 0 or items[i] != items[i - 1]]
    return [(start, end - start) for start, end in zip(starts, [*starts[1:], len(items)], strict=True)]


def _old(row: np.ndarray) -> bytes:
    pixels, out = [bytes(pixel) for pixel in row.tolist()], b""
    for start, length in _runs(pixels):
        out += pixels[start]
        repeats = length - 1
        while repeats:  # digits to base 256, the lowest first
            out += bytes((1, 1, 1, repeats & 255))
            repeats >>= 8
    return out


def _new(row: np.ndarray) -> bytes:
    out = struct.pack(">BBH", 2, 2, len(row))
    for component in row.T.tolist():
        for start, length in _runs(component):
            if length < 3:
                out += bytes((length, *component[start : start + length]))
            else:
                for at in range(0, length, 127):
                    out += bytes((128 + min(127, length - at), component[start]))
    return out
