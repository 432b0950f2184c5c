"""A few named arrays in one file that tells when it is not what was written.

4 bytes      CRC-32 of all that follows, lowest byte first
one line     JSON: label; name, shape, type and compressed bytes of each array
the arrays   in that order, little-endian, each a Zstandard frame
"""

import json
import math
import zlib
from collections.abc import Collection, Iterable, Mapping

import numpy as np
import zstandard


def encode_arrays(label: str, arrays: Mapping[str, np.ndarray]) -> bytes:
    """The content of a file: always the same for the same label and arrays."""
    compressor = zstandard.ZstdCompressor(level=1)
    entries, frames = [], []
    for name, array in arrays.items():
        array = np.asarray(array)
        little = np.ascontiguousarray(array, array.dtype.newbyteorder("<"))
        frames.append(compressor.compress(little.data if little.size else b""))
        entries.append([name, list(array.shape), str(array.dtype), len(frames[-1])])
    body = b"".join([json.dumps({"label": label, "arrays": entries}).encode(), b"\n", *frames])
    return zlib.crc32(body).to_bytes(4, "little") + body


def check_arrays(label: str, content: bytes) -> None:
    """Finds out whether a file is whole and the one that was asked for.

    Raises:
        ValueError: if it is not.
    """
    if len(content) < 5 or zlib.crc32(memoryview(content)[4:]) != int.from_bytes(content[:4], "little"):
        raise ValueError("its checksum is wrong")
    stored_label = json.loads(content[4 : content.index(b"\n", 4)])["label"]
    if stored_label != label:
        raise ValueError(f"it holds '{stored_label}'")


def decode_arrays(
    label: str, content: bytes, names: Iterable[str] | None = None, written: Collection[str] | None = None
) -> dict[str, np.ndarray]:
    """The arrays of a file, or some of them, read-only.

    Args:
        label: that they were written under.
        content: of the file.
        names: of those to be read; all by default.
        written: all that the file must hold, and nothing else.

    Raises:
        ValueError: if they are not those that were written under this label.
    """
    check_arrays(label, content)
    start = content.index(b"\n", 4) + 1
    entries = json.loads(content[4:start])["arrays"]
    if written is not None and {name for name, *_ in entries} != set(written):
        raise ValueError("it holds other arrays than the layer")
    decompressor, arrays = zstandard.ZstdDecompressor(), {}
    for name, shape, dtype, length in entries:
        if names is None or name in names:
            little = np.dtype(dtype).newbyteorder("<")
            frame = memoryview(content)[start : start + length]
            raw = decompressor.decompress(frame, max_output_size=math.prod(shape) * little.itemsize)
            arrays[name] = np.frombuffer(raw, little).astype(dtype, copy=False).reshape(shape)
        start += length
    return arrays
