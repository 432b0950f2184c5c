"""The readers of mesh files: content checked against what the file promises, and unrepaired otherwise.

PLY and STL are read here. trimesh parses them; what is here refuses files that are cut short, and hands trimesh only
the dialects it reads rightly.
"""

import dataclasses
import io
import pathlib
import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Int

from jaxrelight.errors import InputError
from jaxrelight.geometry.gltf import read_glb, read_gltf
from jaxrelight.geometry.obj import read_obj
from jaxrelight.geometry.raw_mesh import FilePart, RawMesh


def _joined(loaded: dict[str, Any]) -> RawMesh:
    """One mesh of all parts that a trimesh loader returns; vertices of different parts stay apart."""
    parts = list(loaded["geometry"].items()) if "geometry" in loaded else [("default", loaded)]
    nothing = np.zeros((0, 3))
    empty = np.zeros(0, np.int64)
    joined = [RawMesh(nothing, nothing.astype(np.int64), nothing, empty.astype(bool), nothing[:, :2], empty, [])]
    start = 0
    for number, (name, part) in enumerate(parts):
        points = np.asarray(part["vertices"], float).reshape(-1, 3)
        corners = _triangles(part.get("faces"))
        corners = np.where((corners >= 0) & (corners < len(points)), corners + start, -1)
        normals = np.asarray(part.get("vertex_normals", nothing), float)
        stated = np.full(len(points), normals.shape == points.shape)
        normals = normals if stated.any() else np.zeros_like(points)
        uv = part.get("uv", np.full((len(points), 2), np.nan))
        joined.append(
            RawMesh(points, corners, normals, stated, uv, np.full(len(points), number), [FilePart(str(name))])
        )
        start += len(points)
    names = ("vertices", "faces", "normals", "stated", "uv", "part")
    arrays: dict[str, Any] = {name: np.concatenate([getattr(part, name) for part in joined]) for name in names}
    return RawMesh(**arrays, parts=[part for mesh in joined for part in mesh.parts])


def _triangles(polygons: Any) -> Int[np.ndarray, "f 3"]:
    """Fans of equally long polygons [f, corners]."""
    if polygons is None or len(polygons) == 0 or np.shape(polygons)[1] < 3:
        return np.zeros((0, 3), np.int64)
    polygons = np.asarray(polygons).astype(np.int64)
    return np.concatenate([polygons[:, [0, i, i + 1]] for i in range(1, polygons.shape[1] - 1)])


# ---- STL -------------------------------------------------------------------------------------------------------------


def read_stl(data: bytes, folder: pathlib.Path) -> RawMesh:
    """Triangles of a binary or ASCII STL file, three vertices each; each `solid` is a part."""
    from trimesh.exchange.stl import load_stl

    promised = int.from_bytes(data[80:84], "little") if len(data) >= 84 else -1
    size, notes = 84 + 50 * promised, []
    if promised < 0 or size != len(data):
        if data.lstrip()[:5].lower() == b"solid" and b"\0" not in data:
            begun, ended = (
                len(re.findall(word, data.lower(), re.MULTILINE)) for word in (rb"^\s*solid\b", rb"^\s*endsolid\b")
            )
            if ended < begun:
                raise InputError(f"cut short: {begun} 'solid' but {ended} 'endsolid'; export or copy it again")
            data = data.decode("utf-8", "replace").encode()  # trimesh would look for a package that guesses encodings
        elif promised < 0:
            raise InputError(
                f"cut short or not an STL file: {len(data)} bytes, the header alone takes 84; export it again"
            )
        elif size > len(data):
            raise InputError(
                f"cut short or not an STL file: {promised:,} triangles promised, {size:,} bytes, "
                f"but it has {len(data):,}; export or copy it again"
            )
        else:
            notes.append(f"ignored {len(data) - size:,} bytes after the last triangle")
            data = data[:size]
    raw = _joined(load_stl(io.BytesIO(data)))
    raw.notes += notes
    return raw


# ---- PLY -------------------------------------------------------------------------------------------------------------

_PLY_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"double": "f8", "float16": "f2", "float32": "f4", "float64": "f8", "int64": "i8", "uint64": "u8"},
}
_PLY_UV = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
# Names under which trimesh is told of properties. It would spread texture coordinates over faces before it has looked
# at the vertex numbers.
_PLY_KEPT = {
    "vertex": {
        **{name: name for name in ("x", "y", "z", "nx", "ny", "nz")},
        **{name: f"kept_{name}" for pair in _PLY_UV for name in pair},
    },
    "face": {name: name for name in ("vertex_indices", "vertex_index")},
}


@dataclasses.dataclass
class _Property:
    """A number, or where `counter` is set a list that begins with its length."""

    name: str
    kind: str
    counter: str = ""


@dataclasses.dataclass
class _Element:
    name: str
    count: int
    properties: list[_Property]


def read_ply(data: bytes, folder: pathlib.Path) -> RawMesh:
    """Vertices, normals and faces of an ASCII or binary PLY file; polygons become fans."""
    from trimesh.exchange.ply import load_ply

    encoding, elements, body = _ply_header(data)
    notes, short = [], 0
    if encoding == "ascii":
        if not body.endswith((b"\n", b"\r")):
            notes.append("the last line has no end: the file may be cut short")
        body, short, surplus = _promised_rows(elements, body)
        notes += [f"ignored {surplus:,} rows after the promised ones"] if surplus else []
    else:
        order = ">" if "big" in encoding else "<"
        least = sum(e.count * sum(_size(p.counter or p.kind) for p in e.properties) for e in elements)
        if least > len(body):
            raise InputError(
                f"cut short: at least {least:,} bytes promised after its header but {len(body):,} found; "
                "export or copy it again"
            )
        if not _even(elements, body, order):
            elements, body, short, spare = _fanned(elements, body, order)
            notes += [f"ignored {spare:,} bytes after the promised ones"] if spare else []
    # only what a mesh needs keeps its name, which hides colours, textures and edges from trimesh
    lines = ["ply", f"format {encoding} 1.0"]
    for number, element in enumerate(elements):
        kept = _PLY_KEPT.get(element.name, {})
        lines.append(f"element {element.name if kept else f'unused{number}'} {element.count}")
        for column, item in enumerate(element.properties):
            words = ["property", *(["list", item.counter] if item.counter else []), item.kind]
            lines.append(" ".join([*words, kept.get(item.name, f"unused{column}")]))
    header = "\n".join([*lines, "end_header\n"]).encode()
    loaded = load_ply(io.BytesIO(header + body), skip_materials=True, fix_texture=False)
    vertices = loaded.get("metadata", {}).get("_ply_raw", {}).get("vertex", {})
    for u, v in _PLY_UV:
        if {u, v} <= {item.name for element in elements if element.name == "vertex" for item in element.properties}:
            columns = [np.ravel(vertices["data"][f"kept_{name}"]) for name in (u, v) if vertices.get("length")]
            loaded |= {"uv": np.column_stack(columns).astype(float)} if columns else {}
            break
    raw = _joined(loaded)
    raw.notes += notes
    if short and len(raw.faces):  # else there are points and lines only
        raw.lost["fewer than three vertex numbers"] = short
    return raw


def _size(kind: str) -> int:
    return int(_PLY_TYPES[kind][1])


def _ply_header(data: bytes) -> tuple[str, list[_Element], bytes]:
    """Encoding, elements and what follows the header."""
    if data[:3] != b"ply":
        raise InputError("not a PLY file: it does not begin with 'ply'; check what it is")
    end = re.search(rb"^end_header[ \t]*(\r\n|\n|\r|$)", data, re.MULTILINE)
    if end is None:
        raise InputError("cut short or not a PLY file: its header has no end; export or copy it again")
    encoding, elements = "", []
    for line in data[: end.start()].decode("ascii", "replace").splitlines()[1:]:
        match line.split():
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", kind, _]:
                encoding = kind.lower()
            case ["element", name, count] if count.isdecimal():
                elements.append(_Element(name, int(count), []))
            case ["property", kind, name] if elements and kind in _PLY_TYPES:
                elements[-1].properties.append(_Property(name, kind))
            case ["property", "list", counter, kind, name] if elements and {counter, kind} <= set(_PLY_TYPES):
                elements[-1].properties.append(_Property(name, kind, counter))
            case _:
                raise InputError(f"PLY header line {line.strip()[:60]!r} is not understood; export it again")
    if encoding not in ("ascii", "binary_little_endian", "binary_big_endian"):
        raise InputError(f"PLY encoding {encoding[:30]!r} is unknown; export it as ascii or binary_little_endian")
    required = {"vertex": {"x", "y", "z"}, "face": set()}
    for element in elements:
        names = [item.name for item in element.properties]
        if len(set(names)) < len(names) or [other.name for other in elements].count(element.name) > 1:
            raise InputError("PLY header declares a name twice; export it again")
        if element.count and not required.get(element.name, set()) <= set(names):
            raise InputError("PLY vertices lack x, y or z; export it again")
        lists = [item.name for item in element.properties if item.counter]
        if element.count and element.name == "face" and not set(_PLY_KEPT["face"]) & set(lists):
            raise InputError("PLY faces lack the list vertex_indices; export it again")
    return encoding, elements, data[end.end() :]


def _promised_rows(elements: Sequence[_Element], body: bytes) -> tuple[bytes, int, int]:
    """An ASCII body without empty and surplus rows.

    Returns:
        The body; how many polygons had fewer than three corners; and how many rows were surplus.

    Raises:
        InputError: rows are missing, or the last one is incomplete.
    """
    rows = [row for row in body.decode("ascii", "replace").splitlines() if row.strip()]
    promised = sum(element.count for element in elements)
    if len(rows) < promised:
        raise InputError(f"cut short: {promised:,} rows promised but {len(rows):,} found; export or copy it again")
    filled = [element for element in elements if element.count]
    if filled:
        words, used = rows[promised - 1].split(), 0
        for item in filled[-1].properties:
            used += 1 + (int(words[used]) if item.counter and used < len(words) else 0)
        if used > len(words):
            raise InputError("cut short: its last row is incomplete; export or copy it again")
    start, short = 0, 0
    for element in elements:
        if element.name == "face":
            short = sum(_corner_count(row.split(), element) < 3 for row in rows[start : start + element.count])
        start += element.count
    return "\n".join(rows[:promised]).encode("ascii", "replace"), short, len(rows) - promised


def _corner_count(words: Sequence[str], face: _Element) -> int:
    """How many vertex numbers a row of an ASCII file has for its polygon; they must be whole."""
    at = 0
    for item in face.properties:
        if item.name in _PLY_KEPT["face"]:
            return len([int(word) for word in words[at + 1 : at + 1 + int(words[at])]])
        at += 1 + (int(words[at]) if item.counter else 0)
    return 0


def _even(elements: Sequence[_Element], body: bytes, order: str) -> bool:
    """Whether every list of a binary body is as long as the first of its kind, and nothing is left over."""
    start = 0
    for element in elements:
        row, counters = 0, []
        for item in element.properties if element.count else ():
            length = 1
            if item.counter:
                kind = np.dtype(order + _PLY_TYPES[item.counter])
                if start + row + kind.itemsize > len(body):
                    return False
                length = int(np.frombuffer(body, kind, 1, start + row)[0])
                counters.append((row, kind, length))
                row += kind.itemsize
            row += length * _size(item.kind)
        if start + element.count * row > len(body):
            return False
        for column, kind, length in counters:
            if (np.ndarray(element.count, kind, body, start + column, (row,)) != length).any():
                return False
        start += element.count * row
    return start == len(body)


def _fanned(elements: Sequence[_Element], body: bytes, order: str) -> tuple[list[_Element], bytes, int, int]:
    """Reads a binary body whose polygons differ in length row by row.

    Returns:
        Elements and body with the vertices as they are and triangles as faces; how many polygons had fewer than three
        corners; and how many bytes were left over.
    """
    at, kept, content, fans, short = 0, [], b"", [], 0
    for element in elements:
        begin = at
        if not any(item.counter for item in element.properties):
            at += element.count * sum(_size(item.kind) for item in element.properties)
            if element.name == "vertex":
                kept, content = [element], body[begin:at]
            continue
        for _ in range(element.count):
            for item in element.properties:
                length = 1
                if item.counter:
                    length = int.from_bytes(body[at : at + _size(item.counter)], "big" if order == ">" else "little")
                    at += _size(item.counter)
                if at + length * _size(item.kind) > len(body):
                    raise InputError(f"cut short: {element.count:,} rows of {element.name!r} promised; export it again")
                if element.name == "face" and item.name in _PLY_KEPT["face"]:
                    corners = np.frombuffer(body, order + _PLY_TYPES[item.kind], length, at).tolist()
                    short += length < 3
                    fans += [(3, corners[0], *corners[i : i + 2]) for i in range(1, length - 1)]
                at += length * _size(item.kind)
    rows = np.zeros(len(fans), [("length", "u1"), ("corners", order + "i8", 3)])
    table = np.array(fans, np.int64).reshape(-1, 4)
    rows["length"], rows["corners"] = table[:, 0], table[:, 1:]
    faces = _Element("face", len(fans), [_Property("vertex_indices", "int64", "uchar")])
    return [*kept, faces], content + rows.tobytes(), short, len(body) - at


# ---- all -------------------------------------------------------------------------------------------------------------

READERS: dict[str, Callable[[bytes, pathlib.Path], RawMesh]] = {
    ".ply": read_ply,
    ".obj": read_obj,
    ".stl": read_stl,
    ".glb": read_glb,
    ".gltf": read_gltf,
}
