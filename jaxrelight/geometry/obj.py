"""OBJ files: triangles, a part for each material, and what its library says of them."""

import pathlib
import re
from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool, Float

from jaxrelight.errors import InputError
from jaxrelight.geometry.creases import BY_ANGLE, FLAT_FACE
from jaxrelight.geometry.file_materials import FileMaterial
from jaxrelight.geometry.file_references import find_file, find_files
from jaxrelight.geometry.mtl import read_mtl
from jaxrelight.geometry.polygons import triangulated
from jaxrelight.geometry.raw_mesh import FilePart, RawMesh
from jaxrelight.geometry.text_encoding import decoded
from jaxrelight.numerics.unique_rows import unique_rows

_Corner = tuple[int, int, int]  # position, texture coordinate and normal: numbers from one, 0 where absent, −1 if bad
_WIDTHS = {"v": 3, "vt": 2, "vn": 3}
# The number of words after `v` where a colour follows the position; with a weight, or alpha after it, there are seven.
_COLOUR_WORDS = 6, 7


def read_obj(data: bytes, folder: pathlib.Path) -> RawMesh:
    """Triangles of an OBJ file.

    Negative numbers count back from the last vertex before their line. Polygons that are not convex are cut into ears,
    others become fans. Smoothing groups (`s`) tell which faces share normals where the file has none. Positions may be
    followed by a linear colour. `#` begins a comment, but not within the name of a material or of a library. Lines and
    points are passed over.
    """
    text = decoded(data).replace("\r\n", "\n").replace("\r", "\n").replace("\\\n", " ")
    rows: dict[str, list[list[str]]] = {name: [] for name in _WIDTHS}
    colours: dict[int, list[str]] = {}
    parts, part, libraries = {"": 0}, 0, []
    corners: list[_Corner] = []  # of one polygon after the other
    corner_counts: list[int] = []
    part_of_polygon: list[int] = []
    smoothing, smoothings = BY_ANGLE, []
    lost = {"fewer than three vertex numbers": 0, "index out of range": 0}
    for line in text.split("\n"):
        key, rest = [*line.split(None, 1), "", ""][:2]
        if key == "f":
            words = rest.split("#", 1)[0].split()
            counts = [len(rows[name]) for name in _WIDTHS]
            try:
                named = [_corner(word, counts) for word in words]
            except ValueError:
                named = []
            if len(named) < 3:
                lost["fewer than three vertex numbers"] += 1
                continue
            corners += named
            corner_counts.append(len(named))
            part_of_polygon.append(part)
            smoothings.append(smoothing)
            continue
        if key in rows:
            words, width = rest.split("#", 1)[0].split(), _WIDTHS[key]
            if key == "v" and len(words) in _COLOUR_WORDS:
                colours[len(rows["v"])] = words[-3:] if len(words) == 6 else words[3:6]
            rows[key].append(words[:width] if len(words) >= width else ["nan"] * width)
        elif key == "usemtl":
            part = parts.setdefault(rest.strip(), len(parts))
        elif key == "mtllib":
            libraries += find_files(rest, folder, ".mtl")
        elif key == "s":
            smoothing = _smoothing(rest)

    try:
        points, uvs, normals = (np.array(rows[name], float).reshape(-1, width) for name, width in _WIDTHS.items())
        painted = _colours(colours, len(points))
    except ValueError:
        raise InputError("damaged or no OBJ file (something else where a number belongs); export it again") from None
    flat = np.array(corners, np.int64).reshape(-1, 3)
    lengths = np.array(corner_counts, np.int64)
    triangles, owner = triangulated(points, flat[:, 0] - 1, lengths)
    starts = np.cumsum(lengths) - lengths
    of_triangles = flat[(starts[owner][:, None] + triangles).reshape(-1)]
    part_of_face, smoothing_of_face = (np.array(values, np.int64)[owner] for values in (part_of_polygon, smoothings))
    raw, kept = _assembled(points, uvs, normals, painted, of_triangles, part_of_face)
    raw.smoothing = smoothing_of_face[kept]
    lost["index out of range"] += int((~kept).sum())
    raw.lost = {reason: n for reason, n in lost.items() if n}
    last = text[text.rfind("\n") + 1 :].split()
    if last and not last[0].startswith("#"):
        raw.notes.append("the last line has no end: the file may be cut short")
    looks, notes = _libraries(libraries, folder)
    raw.material_notes += notes
    raw.parts = [FilePart(name or "default", _look(name, looks)) for name in parts]
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


def _smoothing(word: str) -> int:
    """The number of a smoothing group, or that there is none."""
    word = word.split("#", 1)[0].strip().lower()
    if word in ("off", "0", ""):
        return FLAT_FACE
    return int(word) if word.isdecimal() else BY_ANGLE


def _colours(words: dict[int, list[str]], count: int) -> Float[np.ndarray, "v 3"] | None:
    """Linear colours of positions, NaN where one has none; None where none has. Whole numbers above 1 are of 255."""
    if not words:
        return None
    colours = np.full((count, 3), np.nan)
    colours[list(words)] = np.array(list(words.values()), float)
    return colours / 255 if np.nanmax(colours) > 1 else colours


def _assembled(points, uvs, normals, painted, corners, part_of_face) -> tuple[RawMesh, Bool[np.ndarray, " f"]]:
    """A vertex for each different corner of a part, in the order of the positions, and which faces have all of them."""
    counts = [len(points), len(uvs), len(normals)]
    corners = np.where((corners > 0) & (corners <= counts), corners, 0)
    kept = corners[:, 0].reshape(-1, 3).min(axis=1) > 0
    named = np.column_stack([corners[:, 0], np.repeat(part_of_face, 3), corners[:, 1:]])[np.repeat(kept, 3)]
    first, faces = unique_rows(named)
    place, part, at_uv, at_normal = named[first].T

    def looked_up(values, numbers):
        return np.concatenate([np.full((1, values.shape[1]), np.nan), values])[numbers]

    mesh = RawMesh(
        # Where there are points but no faces, they are told from an empty file.
        vertices=points[place - 1] if len(place) else points,
        faces=faces.reshape(-1, 3),
        normals=looked_up(normals, at_normal) if len(place) else np.zeros_like(points),
        stated=at_normal > 0 if len(place) else np.zeros(len(points), bool),
        uv=looked_up(uvs, at_uv) if len(place) else np.full((len(points), 2), np.nan),
        part=part if len(place) else np.zeros(len(points), np.int64),
        parts=[],
        colours=None if painted is None else painted[place - 1] if len(place) else painted,
    )
    return mesh, kept


def _libraries(names: Sequence[str], folder: pathlib.Path) -> tuple[dict[str, FileMaterial], list[str]]:
    """Materials by name, of the libraries that are there, and a note for each that is not, or lies elsewhere."""
    materials: dict[str, FileMaterial] = {}
    notes = []
    for name in dict.fromkeys(names):
        path, note = find_file(name, folder)
        notes += [note] if note else []
        try:
            read = read_mtl(decoded(path.read_bytes()), path.parent)
        except (OSError, ValueError):
            notes.append(f"its material library '{name}' is missing or cannot be read; put it beside the file")
            continue
        materials = read | materials  # the first library that has a name holds
    return materials, notes


def _look(name: str, looks: Mapping[str, FileMaterial]) -> FileMaterial | None:
    """The material of that name, or, where there is none, of what stands before a comment."""
    return looks.get(name) or looks.get(re.split(r"\s#", name, maxsplit=1)[0].strip())
