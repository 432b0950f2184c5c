"""Meshes made by formula: plane, sphere and box, all with exact normals and outward winding."""

import math
import operator
from collections.abc import Sequence

import numpy as np
from jaxtyping import Int

from jaxrelight.errors import InputError
from jaxrelight.geometry.mesh import Mesh
from jaxrelight.geometry.repair import MAX_COORDINATE
from jaxrelight.numerics.numbers import Number

MAX_QUADS = 2**24  # more is a slip of the pen: 800 MB a plane


def plane(
    size: Sequence[float] | np.ndarray = (1.0, 1.0), resolution: int | np.integer | Sequence[int] | np.ndarray = 64
) -> Mesh:
    """A rectangle in y = 0 that faces +y, centred at the origin; an image lies on it with its top towards −z.

    Args:
        size: lengths along x and z in metres.
        resolution: quads along x and z, or one number for both.

    Raises:
        InputError: a size that is not positive, a resolution that is not a whole number from one.
    """
    width, depth = _lengths("plane", size, 2)
    columns, rows = _resolution("plane", resolution, 2)
    u, v, faces = _grid(columns, rows)
    vertices = np.stack([width * (u / columns - 0.5), np.zeros(len(u)), depth * (v / rows - 0.5)], axis=1)
    uv = np.stack([u / columns, 1 - v / rows], axis=1)
    return Mesh(vertices, faces, np.tile([0.0, 1.0, 0.0], (len(vertices), 1)), uv=uv)


def sphere(radius: Number = 0.5, resolution: int | np.integer = 64) -> Mesh:
    """A sphere around the origin: a cube's sides, divided by equal angles and pushed out.

    All 6 n² + 2 vertices lie on the sphere with exact normals, and triangles' areas differ by a factor of √2 at most.

    Args:
        radius: in metres.
        resolution: n, quads along each edge of the cube, a quarter of the equator.

    Raises:
        InputError: a radius that is not positive, a resolution that is not a whole number from one.
    """
    (radius,) = _lengths("sphere", (radius,), 1)
    (n,) = _resolution("sphere", resolution, 1, sides=6)
    lattice, faces = _cube(n)
    _, first, same = np.unique(lattice, axis=0, return_index=True, return_inverse=True)
    directions = np.tan(math.pi / 4 * (2.0 * lattice[first] / n - 1))
    normals = directions / np.linalg.norm(directions, axis=1, keepdims=True)
    return Mesh(radius * normals, same.reshape(-1)[faces], normals)


def box(size: Sequence[float] | np.ndarray = (1.0, 1.0, 1.0), resolution: int | np.integer = 16) -> Mesh:
    """A box around the origin, flat shaded: each side has its own vertices and shows a whole image.

    Args:
        size: lengths along x, y and z in metres.
        resolution: quads along each edge.

    Raises:
        InputError: a size that is not positive, a resolution that is not a whole number from one.
    """
    lengths = np.array(_lengths("box", size, 3))
    (n,) = _resolution("box", resolution, 1, sides=6)
    lattice, faces = _cube(n)
    axes = np.eye(3)
    normals = np.repeat(np.concatenate([axes, -axes]), (n + 1) ** 2, axis=0)
    place = lattice / n
    # Seen from outside: u to the right, v upwards; +y and −y are seen with −z, and with +z, at the top.
    across = np.stack([1 - place[:, 2], place[:, 0], place[:, 0], place[:, 2], place[:, 0], 1 - place[:, 0]])
    along = np.stack([place[:, 1], 1 - place[:, 2], place[:, 1], place[:, 1], place[:, 2], place[:, 1]])
    side = np.repeat(np.arange(6), (n + 1) ** 2)
    row = np.arange(len(place))
    return Mesh(lengths * (place - 0.5), faces, normals, uv=np.stack([across[side, row], along[side, row]], axis=1))


def _grid(columns: int, rows: int) -> tuple[Int[np.ndarray, " v"], Int[np.ndarray, " v"], Int[np.ndarray, "f 3"]]:
    """Lattice coordinates u (slow) and v (fast) of a grid of quads, and triangles that face v × u."""
    u, v = (axis.reshape(-1) for axis in np.mgrid[: columns + 1, : rows + 1])
    i = (np.arange(columns)[:, None] * (rows + 1) + np.arange(rows)).reshape(-1)
    right, above, across = i + 1, i + rows + 1, i + rows + 2
    return u, v, np.concatenate([np.stack([i, right, across], axis=1), np.stack([i, across, above], axis=1)])


def _cube(n: int) -> tuple[Int[np.ndarray, "v 3"], Int[np.ndarray, "f 3"]]:
    """Sides +x, +y, +z, −x, −y, −z of the cube [0, n]³ as grids that share no vertex."""
    u, v, faces = _grid(n, n)
    sides = []
    for far in (n, 0):
        for axis in range(3):
            side = np.full((len(u), 3), far)
            first, second = (v, u) if far else (u, v)  # first × second points out
            side[:, (axis + 1) % 3], side[:, (axis + 2) % 3] = first, second
            sides.append(side)
    return np.concatenate(sides), np.concatenate([faces + k * len(u) for k in range(6)])


def _lengths(shape: str, size: Sequence[Number] | np.ndarray, count: int) -> list[float]:
    try:
        lengths = [float(length) for length in size]
    except (TypeError, ValueError):
        lengths = []
    if len(lengths) != count or not all(0 < length <= MAX_COORDINATE for length in lengths):
        wanted = "a positive number" if count == 1 else f"{count} positive numbers"
        raise InputError(f"{shape}: size {size!r} is not {wanted} of metres")
    return lengths


def _resolution(
    shape: str, resolution: int | np.integer | Sequence[int] | np.ndarray, count: int, sides: int = 1
) -> list[int]:
    try:
        counts = list(resolution) if isinstance(resolution, Sequence | np.ndarray) else [resolution] * count
        quads = [operator.index(number) for number in counts]
    except TypeError:
        counts, quads = [], []
    if len(quads) != count or min(quads) < 1 or any(isinstance(number, bool) for number in counts):
        wanted = "a whole number" if count == 1 else f"a whole number, or {count} of them,"
        raise InputError(f"{shape}: resolution {resolution!r} is not {wanted} from 1")
    if sides * math.prod(quads * (2 if count == 1 else 1)) > MAX_QUADS:
        raise InputError(f"{shape}: resolution {resolution!r} makes more than {MAX_QUADS:,} quads; give a lower one")
    return quads
