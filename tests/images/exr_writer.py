"""OpenEXR files written byte by byte, uncompressed, independently of the OpenEXR library.

Follows "OpenEXR File Layout": magic and version, headers of attributes, tables of chunk offsets, chunks.
"""

import struct
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np

TYPES = {np.dtype(np.uint32): 0, np.dtype(np.float16): 1, np.dtype(np.float32): 2}


@dataclass
class Part:
    """One image: planes by channel name, and how they are stored.

    Attributes:
        planes: `[h, w]` of uint32, float16 or float32; a subsampled channel has a smaller one.
        sampling: of the channels that are subsampled, in x and y.
        tile: side of the tiles, or 0 for scan lines.
        mipmap: whether tiles come in all levels; those above 0 are filled with 7.
        corner: of the data window, x and y.
        display: the display window, if it is another than the data window.
        attributes: further ones: type name and content.
        missing: numbers of the chunks that are left out.
    """

    planes: Mapping[str, np.ndarray]
    sampling: Mapping[str, tuple[int, int]] = field(default_factory=dict)
    tile: int = 0
    mipmap: bool = False
    corner: tuple[int, int] = (0, 0)
    display: tuple[int, int, int, int] | None = None
    attributes: Mapping[str, tuple[str, bytes]] = field(default_factory=dict)
    missing: Collection[int] = ()

    @property
    def size(self) -> tuple[int, int]:
        return max(np.shape(plane) for plane in self.planes.values())

    def header(self, number: int | None) -> bytes:
        """Attributes; `number` is the part's in a file of several, where a part has a name and a count of chunks."""
        (height, width), (x, y) = self.size, self.corner
        window = (x, y, x + width - 1, y + height - 1)
        channels = b"".join(
            name.encode() + b"\0" + struct.pack("<iB3xii", TYPES[self.planes[name].dtype], 0, *self._sampling(name))
            for name in sorted(self.planes)
        )
        attributes = {
            "channels": ("chlist", channels + b"\0"),
            "compression": ("compression", b"\0"),
            "dataWindow": ("box2i", struct.pack("<4i", *window)),
            "displayWindow": ("box2i", struct.pack("<4i", *(self.display or window))),
            "lineOrder": ("lineOrder", b"\0"),
            "pixelAspectRatio": ("float", struct.pack("<f", 1)),
            "screenWindowCenter": ("v2f", struct.pack("<2f", 0, 0)),
            "screenWindowWidth": ("float", struct.pack("<f", 1)),
            **self.attributes,
        }
        if self.tile:
            attributes["tiles"] = ("tiledesc", struct.pack("<2IB", self.tile, self.tile, int(self.mipmap)))
        if number is not None:
            attributes["name"] = ("string", f"part{number}".encode())
            attributes["type"] = ("string", b"tiledimage" if self.tile else b"scanlineimage")
            attributes["chunkCount"] = ("int", struct.pack("<i", len(self.chunks())))
        return (
            b"".join(
                name.encode() + b"\0" + kind.encode() + b"\0" + struct.pack("<i", len(content)) + content
                for name, (kind, content) in attributes.items()
            )
            + b"\0"
        )

    def chunks(self) -> list[bytes]:
        """Every chunk without the part's number."""
        height, width = self.size
        if not self.tile:
            return [self._line(row) for row in range(height)]
        packed, level = [], 0
        while True:
            h, w = max(height >> level, 1), max(width >> level, 1)
            planes = [self.planes[name] for name in sorted(self.planes)]
            planes = [plane if level == 0 else np.full((h, w), 7, plane.dtype) for plane in planes]
            for j in range(-(-h // self.tile)):
                for i in range(-(-w // self.tile)):
                    rows = range(j * self.tile, min((j + 1) * self.tile, h))
                    columns = slice(i * self.tile, (i + 1) * self.tile)
                    pixels = b"".join(plane[row, columns].tobytes() for row in rows for plane in planes)
                    packed.append(struct.pack("<5i", i, j, level, level, len(pixels)) + pixels)
            if not self.mipmap or max(h, w) == 1:
                return packed
            level += 1

    def _sampling(self, name: str) -> tuple[int, int]:
        return self.sampling.get(name, (1, 1))

    def _line(self, row: int) -> bytes:
        y, pixels = self.corner[1] + row, b""
        for name in sorted(self.planes):
            step = self._sampling(name)[1]
            if y % step == 0:
                pixels += self.planes[name][row // step].tobytes()
        return struct.pack("<2i", y, len(pixels)) + pixels


def picture(first: Part, *more: Part) -> bytes:
    """The file: single-part unless several are given."""
    parts = (first, *more)
    version = 2 | (0x1000 if more else 0x200 if first.tile else 0)
    chunks = [part.chunks() for part in parts]
    head = b"\x76\x2f\x31\x01" + struct.pack("<i", version)
    head += b"".join(part.header(i if more else None) for i, part in enumerate(parts))
    head += b"\0" if more else b""
    at, table, body = len(head) + 8 * sum(map(len, chunks)), b"", b""
    for number, (part, own) in enumerate(zip(parts, chunks, strict=True)):
        for i, chunk in enumerate(own):
            if i in part.missing:
                table += struct.pack("<Q", 0)
                continue
            table += struct.pack("<Q", at + len(body))
            body += (struct.pack("<i", number) if more else b"") + chunk
    return head + table + body


def planes(pixels: np.ndarray, names: Sequence[str]) -> dict[str, np.ndarray]:
    """Channels of `[h, w, c]` by name."""
    return {name: np.ascontiguousarray(pixels[..., i]) for i, name in enumerate(names)}
