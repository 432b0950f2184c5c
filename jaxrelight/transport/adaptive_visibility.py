"""Visibility by rays where it changes: a grid of directions, finer and finer where neighbours differ.

What hides the sky has edges, and on both sides of them directions see the same. So the first rays of a receiver go to a
coarse grid, and cells whose neighbours differ are divided, down to single texels; from there edges are followed until
all texels beside them have rays of their own. What falls between the rays of one receiver is met by those of others:
each of them samples other texels of the cells, and a cell in which receivers nearby differ is divided for all of them.
Where geometry proves that nothing is, there are no rays.

The receivers of a group are bits: in arrays [n, w] of 64-bit words a row is a cell or texel, and each bit a receiver.
"""

import functools
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8, UInt64

from jaxrelight.basis import cubemap
from jaxrelight.geometry.occluders import Occluders
from jaxrelight.geometry.tracer import Tracer

# Cells of the first grid are so many texels wide, or less where there would be fewer of them along an edge than this.
_WIDEST, _MIN_CELLS = 4, 16
# Receivers of which each hints at what others of them miss, and the levels at which they do.
_NEARBY, _HINTED = np.uint32, 2
# Of heights over the horizon.
ROUNDING = np.float32(1e-6)
# What visibility depends on beside the scene and the receivers.
DIALS = _WIDEST, _MIN_CELLS, np.dtype(_NEARBY).itemsize, _HINTED


class Cells(NamedTuple):
    """The cells of one level, in the order face, row, column.

    Attributes:
        side: of a cell, in texels.
        corner: the first texel of each.
        neighbours: of each, across the edges of faces, too.
        parent: the cell of twice the side that each lies in.
        quarter: of its parent that each is: 0 to 3, row by row.
    """

    side: int
    corner: Int[np.ndarray, " n"]
    neighbours: Int[np.ndarray, "n 8"]
    parent: Int[np.ndarray, " n"]
    quarter: Int[np.ndarray, " n"]


@functools.lru_cache(maxsize=16)
def cells_of(resolution: int, side: int) -> Cells:
    """The cells of a cube map that are so many texels wide."""
    count = resolution // side
    centres = (np.arange(-1, count + 1) + 0.5) * (2 / count) - 1
    # Beyond the edges of a face lie cells of others.
    around = cubemap.texel_of(cubemap.face_plane(*np.meshgrid(centres, centres, indexing="xy")), count)
    steps = [(down, right) for down in range(3) for right in range(3) if (down, right) != (1, 1)]
    neighbours = np.stack([around[:, down : down + count, right : right + count] for down, right in steps], axis=-1)
    face, row, column = np.unravel_index(np.arange(6 * count**2), (6, count, count))
    corner = (face * resolution + row * side) * resolution + column * side
    parent = (face * (count // 2) + row // 2) * (count // 2) + column // 2
    return Cells(side, corner, neighbours.reshape(-1, 8), parent, 2 * (row % 2) + column % 2)


def first_cells(resolution: int) -> Cells:
    """The cells of the first grid; texels where a cube map is so small that all of them have rays."""
    side = _WIDEST
    while side > 1 and (resolution % side or resolution // side < _MIN_CELLS):
        side //= 2
    return cells_of(resolution, side)


def trace_adaptively(
    tracer: Tracer,
    occluders: Occluders,
    origins: Float[np.ndarray, "m 3"],
    normals: Float[np.ndarray, "m 3"],
    resolution: int,
    *,
    are_close: bool = True,
) -> tuple[UInt8[np.ndarray, "m bytes"], int]:
    """Visibility as `trace_visibility` gives it of the texels of a cube map, and the number of rays.

    Where nothing can hide the sky from any of the receivers, all bits are 1, also those below their horizons: no light
    that comes from there counts.

    Args:
        tracer: of the scene.
        occluders: of the same scene.
        origins: of receivers, lifted off the surface.
        normals: theirs.
        resolution: texels along an edge of the cube map.
        are_close: whether receivers are close to each other, so that what some of them meet, others may have missed.
    """
    rays, cells = _Rays(tracer, origins, normals, resolution), first_cells(resolution)
    directions, radius = _bounds(resolution)
    possible = occluders.possible(np.asarray(origins, float), np.asarray(normals, float), directions, radius)
    if not possible.any():
        # Of bits that are all the same, next to nothing is left on disk; horizons would be most of a store.
        return np.full((len(origins), 6 * resolution**2 // 8), 255, np.uint8), 0
    asked = np.where(possible, np.iinfo(np.uint64).max, 0).astype(np.uint64)[:, None]
    # Where a cell has been sampled above the horizon, and whether that ray hit nothing.
    known = rays.sampled(cells)
    is_open = rays.cast(known & asked, cells) | ~asked
    known, traced, level = known | ~asked, known, 0
    while cells.side > 1:
        divided = _differing(is_open, known & ~is_open, cells.neighbours) | rays.unsampled(cells, known)
        if are_close and level < _HINTED:
            divided |= _differing_nearby(is_open, known & ~is_open)
        divided &= asked
        level, cells = level + 1, cells_of(resolution, cells.side // 2)
        divided, asked, known, is_open = (of[cells.parent] for of in (divided, asked, known, is_open))
        sampled = rays.sampled(cells)
        traced = divided & sampled
        new = traced & ~(known & rays.in_quarter(cells))
        is_open = is_open & ~new | rays.cast(new, cells)
        known = known & ~divided | traced
    if level:
        is_open = _follow_edges(rays, cells, is_open, traced, asked)
    return _by_receiver(is_open & rays.above)[: len(origins)], rays.count


@functools.lru_cache(maxsize=8)
def _bounds(resolution: int) -> tuple[Float[np.ndarray, "n 3"], float]:
    """Directions of the first cells' middles, and the largest angle between one and a texel of its cell."""
    cells, texels = first_cells(resolution), cubemap.directions(resolution)
    middles = cubemap.directions(resolution // cells.side)
    last = (cells.side - 1) * np.array([0, 1, resolution, resolution + 1])
    cosines = [np.sum(middles * texels[cells.corner + one], axis=1).min() for one in last]
    return middles, float(np.arccos(np.clip(min(cosines), -1, 1)))


class _Rays:
    """Casts rays of a group's receivers, and counts them.

    Attributes:
        above: the texels above each receiver's horizon, [d, w].
        count: rays that were cast.
    """

    def __init__(
        self,
        tracer: Tracer,
        origins: Float[np.ndarray, "m 3"],
        normals: Float[np.ndarray, "m 3"],
        resolution: int,
    ):
        self._tracer, self._resolution = tracer, resolution
        self._origins = np.ascontiguousarray(origins, np.float32)
        self._directions = cubemap.directions(resolution).astype(np.float32)
        self.above = _above(np.asarray(normals, np.float32), resolution)
        # Rows and columns by which samples lie off the first texel of a cell.
        order = _spread_out(first_cells(resolution).side)
        self._down, self._right = order[np.arange(64 * self.above.shape[1]) % len(order)].T
        self.count = 0

    def sampled(self, cells: Cells) -> UInt64[np.ndarray, "n w"]:
        """Where the samples of cells are above the horizon."""
        side, above = cells.side, np.zeros((len(cells.corner), self.above.shape[1]), np.uint64)
        for down, right in np.ndindex(side, side):
            own = _packed(((self._down % side == down) & (self._right % side == right))[None])
            above |= self.above[cells.corner + down * self._resolution + right] & own
        return above

    def unsampled(self, cells: Cells, sampled: UInt64[np.ndarray, "n w"]) -> UInt64[np.ndarray, "n w"]:
        """Cells of which a part is above the horizon, though their sample is not.

        Without dividing them, two to five times as many texels are wrong.
        """
        # The height over a plane is linear in a face, so that one of the corners is the highest.
        last = (cells.side - 1) * np.array([0, 1, self._resolution, self._resolution + 1])
        return np.bitwise_or.reduce([self.above[cells.corner + one] for one in last]) & ~sampled

    def in_quarter(self, cells: Cells) -> UInt64[np.ndarray, "n w"]:
        """Cells that hold the sample of the cell of which they are a quarter."""
        down, right = (of // cells.side % 2 for of in (self._down, self._right))
        return _packed(np.arange(4)[:, None] == (2 * down + right)[None])[cells.quarter]

    def cast(self, asked: UInt64[np.ndarray, "n w"], cells: Cells) -> UInt64[np.ndarray, "n w"]:
        """Casts the rays that are asked for, and marks those that hit nothing."""
        bits = _unpacked(asked)
        place = np.flatnonzero(bits)
        cell, receiver = np.divmod(place, bits.shape[1])
        down, right = self._down % cells.side, self._right % cells.side
        texel = cells.corner[cell] + (down * self._resolution + right)[receiver]
        self.count += len(cell)
        bits.reshape(-1)[place] = ~self._tracer.occluded(self._origins[receiver], self._directions[texel])
        return _packed(bits)


def heights_on_faces(
    normals: Float[np.ndarray, "m 3"], resolution: int
) -> tuple[Float[np.ndarray, "6 n m"], Float[np.ndarray, "6 n m"]]:
    """Heights of texels over horizons: on a face linear in columns and rows, hence differences of one of each."""
    normals = np.asarray(normals, np.float32)
    centres = (np.arange(resolution) + 0.5) * (2 / resolution) - 1
    still = np.zeros_like(centres)
    heights = (cubemap.face_plane(*of) @ normals.T for of in ((centres, still), (still, centres), (still, still)))
    along, down, middle = (of.astype(np.float32) for of in heights)
    return along, middle - down


def _above(normals: Float[np.ndarray, "m 3"], resolution: int) -> UInt64[np.ndarray, "d w"]:
    """The texels above the horizons of normals, or on them."""
    # Where rounding takes a texel on the horizon for one above, it must not be taken for a hidden one.
    pairs = zip(*heights_on_faces(normals, resolution), strict=True)
    faces = [columns[None] > rows[:, None] - ROUNDING for columns, rows in pairs]
    return np.concatenate([_packed(face.reshape(resolution**2, -1)) for face in faces])


def _follow_edges(rays: _Rays, texels: Cells, is_open, traced, asked) -> UInt64[np.ndarray, "d w"]:
    """Casts rays to texels that had none and differ from a neighbour, until no such texel is left."""
    is_open, left, changed = is_open.copy(), rays.above & asked & ~traced, None
    while True:
        rows = np.arange(len(is_open)) if changed is None else np.unique(texels.neighbours[changed])
        blocked = rays.above & ~is_open
        edges = _differing(is_open & rays.above, blocked, texels.neighbours, rows) & left[rows]
        some = edges.any(axis=1)
        rows, edges = rows[some], edges[some]
        if not len(rows):
            return is_open
        of_rows = texels._replace(corner=texels.corner[rows])
        seen = rays.cast(edges, of_rows)
        differs = ((is_open[rows] & edges) != seen).any(axis=1)
        is_open[rows] = is_open[rows] & ~edges | seen
        left[rows] &= ~edges
        changed = rows[differs]


def _differing(is_open, is_blocked, neighbours, rows: slice | np.ndarray = slice(None)) -> UInt64[np.ndarray, "n w"]:
    """Cells that differ from a neighbour; one that is neither open nor blocked differs from none."""
    near_open, near_blocked = (np.zeros_like(is_open[rows]) for _ in range(2))
    for neighbour in neighbours[rows].T:
        near_open |= is_open[neighbour]
        near_blocked |= is_blocked[neighbour]
    return is_open[rows] & near_blocked | is_blocked[rows] & near_open


def _differing_nearby(is_open, is_blocked) -> UInt64[np.ndarray, "n w"]:
    """Cells in which receivers nearby differ from each other, marked for all of those receivers."""
    both = (is_open.view(_NEARBY) != 0) & (is_blocked.view(_NEARBY) != 0)
    return np.where(both, np.iinfo(_NEARBY).max, 0).astype(_NEARBY).view(np.uint64) & (is_open | is_blocked)


def _spread_out(side: int) -> Int[np.ndarray, "n 2"]:
    """Rows and columns of a square in an order in which those that follow each other are far apart."""
    rank = np.zeros((1, 1), int)
    while len(rank) < side:
        rank = np.block([[4 * rank, 4 * rank + 2], [4 * rank + 3, 4 * rank + 1]])
    return np.stack(np.unravel_index(np.argsort(rank, axis=None), rank.shape), axis=1)


def _packed(values: Bool[np.ndarray, "n m"]) -> UInt64[np.ndarray, "n w"]:
    """Bits of receivers, filled up with zeros."""
    packed = np.packbits(values, axis=1, bitorder="little")
    return np.pad(packed, ((0, 0), (0, -packed.shape[1] % 8))).view(np.uint64)


def _unpacked(bits: UInt64[np.ndarray, "n w"]) -> Bool[np.ndarray, "n m"]:
    return np.unpackbits(bits.view(np.uint8), axis=1, bitorder="little").view(bool)


def _by_receiver(bits: UInt64[np.ndarray, "d w"]) -> UInt8[np.ndarray, "m bytes"]:
    """From texels by receivers to receivers by texels: squares of 8 by 8 bits are transposed."""
    squares = np.ascontiguousarray(bits.view(np.uint8).reshape(-1, 8, 8 * bits.shape[1]).transpose(2, 0, 1))
    word = squares.view(np.uint64)[..., 0]
    for shift, mask in ((7, 0x00AA00AA00AA00AA), (14, 0x0000CCCC0000CCCC), (28, 0x00000000F0F0F0F0)):
        swapped = (word ^ (word >> np.uint64(shift))) & np.uint64(mask)
        word = word ^ swapped ^ (swapped << np.uint64(shift))
    return np.ascontiguousarray(word[..., None].view(np.uint8).transpose(0, 2, 1)).reshape(8 * len(word), -1)
