"""OBJ files: triangles, a part for each material, and what its library says of them."""

import contextlib
import pathlib
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxrelight.errors import InputError
from jaxrelight.geometry.file_materials import FileMaterial, read_mtl
from jaxrelight.geometry.raw_mesh import FilePart, RawMesh

_Corner = tuple[int, int, int]  # position, texture coordinate and normal: numbers from one, 0 where absent, −1 if bad
_WIDTHS = {"v": 3, "vt": 2, "vn": 3}


def read_obj(data: bytes, folder: pathlib.Path) -> RawMesh:
    """Triangles of an OBJ file.

    Negative numbers count back from the last vertex before their line. Polygons become fans. Names, lines and points
    are passed over.
    """
    text = data.decode("utf-8", "replace").replace("\r\n", "\n").replace("\r", "\n")
    rows: dict[str, list[list[str]]] = {name: [] for name in _WIDTHS}
    parts, part, libraries = {"": 0}, 0, []
    corners: list[_Corner] = []  # three for each triangle
    part_of_face: list[int] = []
    polygons: list[list[int]] = []
    lost = {"fewer than three vertex numbers": 0, "index out of range": 0}
    for line in text.replace("\\\n", " ").split("\n"):
        words = line.split("#", 1)[0].split()
        key = words[0] if words else ""
        if key in rows:
            width = _WIDTHS[key]
            rows[key].append(words[1 : 1 + width] if len(words) > width else ["nan"] * width)
        elif key == "usemtl":
            part = parts.setdefault(" ".join(words[1:]), len(parts))
        elif key == "mtllib":
            libraries.append(line.split("#", 1)[0].strip()[7:].strip())
        elif key == "f":
            counts = [len(rows[name]) for name in _WIDTHS]
            try:
                named = [_corner(word, counts) for word in words[1:]]
            except ValueError:
                named = []
            if len(named) < 3:
                lost["fewer than three vertex numbers"] += 1
            elif len(named) > 3:
                polygons.append([corner[0] - 1 for corner in named])
            for i in range(1, len(named) - 1):
                corners += [named[0], named[i], named[i + 1]]
                part_of_face.append(part)

    try:
        points, uvs, normals = (np.array(rows[name], float).reshape(-1, width) for name, width in _WIDTHS.items())
    except ValueError:
        raise InputError("damaged or no OBJ file (something else where a number belongs); export it again") from None
    raw = _assembled(points, uvs, normals, np.array(corners, np.int64).reshape(-1, 3), np.array(part_of_face, np.int64))
    lost["index out of range"] += len(part_of_face) - len(raw.faces)
    raw.lost = {reason: n for reason, n in lost.items() if n}
    dented = _dented(points, polygons)
    if dented:
        raw.notes.append(f"polygons that are not convex: {dented:,}; fans may cover their notches, triangulate them")
    last = text[text.rfind("\n") + 1 :].split()
    if last and last[0] in (*_WIDTHS, "f"):
        raw.notes.append("the last line has no end: the file may be cut short")
    looks = _libraries(libraries, folder)
    raw.parts = [FilePart(name or "default", looks.get(name)) for name in parts]
    return raw


def _corner(word: str, counts: Sequence[int]) -> _Corner:
    """Absolute numbers of a corner written as 7, 7/2, 7//3 or 7/2/3, or with negative numbers."""
    parts = [*word.split("/"), "", ""][:3]
    if not parts[0]:
        raise ValueError("a corner without position")
    numbers = [int(part) if part else 0 for part in parts]
    first, second, third = (
        n if n >= 0 else n + count + 1 if -n <= count else -1 for n, count in zip(numbers, counts, strict=True)
    )
    return first, second, third


def _assembled(points, uvs, normals, corners, part_of_face) -> RawMesh:
    """A vertex for each different corner of a part, in the order of the positions."""
    counts = [len(points), len(uvs), len(normals)]
    corners = np.where((corners > 0) & (corners <= counts), corners, 0)
    kept = (corners[:, 0] > 0).reshape(-1, 3).all(axis=1)
    named = np.column_stack([corners[:, 0], np.repeat(part_of_face, 3), corners[:, 1:]])[np.repeat(kept, 3)]
    vertices, faces = np.unique(named, axis=0, return_inverse=True)
    place, part, at_uv, at_normal = vertices.reshape(-1, 4).T

    def looked_up(values, numbers):
        return np.concatenate([np.full((1, values.shape[1]), np.nan), values])[numbers]

    return RawMesh(
        # Where there are points but no faces, they are told from an empty file.
        vertices=points[place - 1] if len(place) else points,
        faces=faces.reshape(-1, 3),
        normals=looked_up(normals, at_normal) if len(place) else np.zeros_like(points),
        stated=at_normal > 0 if len(place) else np.zeros(len(points), bool),
        uv=looked_up(uvs, at_uv) if len(place) else np.full((len(points), 2), np.nan),
        part=part if len(place) else np.zeros(len(points), np.int64),
        parts=[],
    )


def _dented(points: Float[np.ndarray, "v 3"], polygons: Sequence[Sequence[int]]) -> int:
    """How many polygons have a fan triangle that faces against the whole."""
    polygons = [polygon for polygon in polygons if all(0 <= i < len(points) for i in polygon)]
    if not polygons:
        return 0
    fans = points[np.array([(p[0], p[i], p[i + 1]) for p in polygons for i in range(1, len(p) - 1)])]
    owner = np.repeat(np.arange(len(polygons)), [len(p) - 2 for p in polygons])
    areas = np.cross(fans[:, 1] - fans[:, 0], fans[:, 2] - fans[:, 0])
    polygon_areas = np.stack([np.bincount(owner, areas[:, k]) for k in range(3)], axis=1)[owner]
    against = (areas * polygon_areas).sum(axis=1) < -1e-6 * (polygon_areas**2).sum(axis=1)
    return len(np.unique(owner[against]))


def _libraries(names: Sequence[str], folder: pathlib.Path) -> dict[str, FileMaterial]:
    """Materials by name, of the libraries that are there."""
    materials: dict[str, FileMaterial] = {}
    for name in dict.fromkeys(names):
        with contextlib.suppress(OSError, ValueError):
            materials |= read_mtl((folder / name).read_text(encoding="utf-8", errors="replace"), folder)
    return materials
