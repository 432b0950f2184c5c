"""What PLY, OBJ and STL files say, checked against what they promise and unrepaired otherwise.

trimesh parses; the functions here refuse files that are cut short, and hand trimesh only the dialects it reads rightly.
"""

import dataclasses
import io
import re
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxrelight.errors import InputError


@dataclasses.dataclass
class RawMesh:
    """The content of a mesh file.

    Attributes:
        vertices: positions, as written.
        faces: triangles, possibly with vertex numbers out of range.
        normals: the file's normals, as written.
        stated: which vertices have a normal in the file.
        seams: numbers besides position and normal that two vertices must share to be the same one.
        lost: faces already given up, counted by reason.
        notes: what the reader had to guess.
    """

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "v 3"]
    stated: Bool[np.ndarray, " v"]
    seams: Float[np.ndarray, "v s"]
    lost: dict[str, int] = dataclasses.field(default_factory=dict)
    notes: list[str] = dataclasses.field(default_factory=list)


def _joined(loaded: dict[str, Any]) -> RawMesh:
    """One mesh of all parts that a trimesh loader returns; vertices of different parts stay apart."""
    parts = list(loaded["geometry"].values()) if "geometry" in loaded else [loaded]
    nothing = np.zeros((0, 3))
    joined = [RawMesh(nothing, nothing.astype(np.int64), nothing, np.zeros(0, bool), nothing)]
    start = 0
    for number, part in enumerate(parts):
        points = np.asarray(part["vertices"], float).reshape(-1, 3)
        corners = _triangles(part.get("faces"))
        corners = np.where((corners >= 0) & (corners < len(points)), corners + start, -1)
        normals = np.asarray(part.get("vertex_normals", nothing), float)
        uv = getattr(part.get("visual"), "uv", None)
        seams = np.zeros((len(points), 3))
        seams[:, 0] = number
        if uv is not None and np.shape(uv) == (len(points), 2):
            seams[:, 1:] = np.round(np.nan_to_num(np.asarray(uv, float)) * 1e4)
        stated = np.full(len(points), normals.shape == points.shape)
        joined.append(RawMesh(points, corners, normals if stated.any() else np.zeros_like(points), stated, seams))
        start += len(points)
    return RawMesh(
        vertices=np.concatenate([part.vertices for part in joined]),
        faces=np.concatenate([part.faces for part in joined]),
        normals=np.concatenate([part.normals for part in joined]),
        stated=np.concatenate([part.stated for part in joined]),
        seams=np.concatenate([part.seams for part in joined]),
    )


def _triangles(polygons: Any) -> Int[np.ndarray, "f 3"]:
    """Fans of equally long polygons [f, corners]."""
    if polygons is None or len(polygons) == 0 or np.shape(polygons)[1] < 3:
        return np.zeros((0, 3), np.int64)
    polygons = np.asarray(polygons).astype(np.int64)
    return np.concatenate([polygons[:, [0, i, i + 1]] for i in range(1, polygons.shape[1] - 1)])


# ---- STL -------------------------------------------------------------------------------------------------------------


def read_stl(data: bytes) -> RawMesh:
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
_PLY_KEPT = {"vertex": ("x", "y", "z", "nx", "ny", "nz"), "face": ("vertex_indices", "vertex_index")}


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


def read_ply(data: bytes) -> RawMesh:
    """Vertices, normals and faces of an ASCII or binary PLY file; polygons become fans."""
    from trimesh.exchange.ply import load_ply

    encoding, elements, body = _ply_header(data)
    notes = []
    if encoding == "ascii":
        body = _promised_rows(elements, body)
    else:
        order = ">" if "big" in encoding else "<"
        least = sum(e.count * sum(_size(p.counter or p.kind) for p in e.properties) for e in elements)
        if least > len(body):
            raise InputError(
                f"cut short: at least {least:,} bytes promised after its header but {len(body):,} found; "
                "export or copy it again"
            )
        if not _even(elements, body, order):
            elements, body, spare = _fanned(elements, body, order)
            notes += [f"ignored {spare:,} bytes after the promised ones"] if spare else []
    # only what a mesh needs keeps its name, which hides colours, textures and edges from trimesh
    lines = ["ply", f"format {encoding} 1.0"]
    for number, element in enumerate(elements):
        kept = _PLY_KEPT.get(element.name, ())
        lines.append(f"element {element.name if kept else f'unused{number}'} {element.count}")
        for column, item in enumerate(element.properties):
            words = ["property", *(["list", item.counter] if item.counter else []), item.kind]
            lines.append(" ".join([*words, item.name if item.name in kept else f"unused{column}"]))
    header = "\n".join([*lines, "end_header\n"]).encode()
    raw = _joined(load_ply(io.BytesIO(header + body), skip_materials=True, fix_texture=False))
    raw.notes += notes
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


def _promised_rows(elements: Sequence[_Element], body: bytes) -> bytes:
    """An ASCII body without empty and surplus rows; refuses missing rows, or an incomplete last one."""
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
    return "\n".join(rows[:promised]).encode("ascii", "replace")


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


def _fanned(elements: Sequence[_Element], body: bytes, order: str) -> tuple[list[_Element], bytes, int]:
    """Reads a binary body whose polygons differ in length row by row.

    Returns:
        Elements and body with the vertices as they are and triangles as faces, and how many bytes were left over.
    """
    at, kept, content, fans = 0, [], b"", []
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
                    fans += [(3, corners[0], *corners[i : i + 2]) for i in range(1, length - 1)]
                at += length * _size(item.kind)
    rows = np.zeros(len(fans), [("length", "u1"), ("corners", order + "i8", 3)])
    table = np.array(fans, np.int64).reshape(-1, 4)
    rows["length"], rows["corners"] = table[:, 0], table[:, 1:]
    faces = _Element("face", len(fans), [_Property("vertex_indices", "int64", "uchar")])
    return [*kept, faces], content + rows.tobytes(), len(body) - at


# ---- OBJ -------------------------------------------------------------------------------------------------------------

_Corner = tuple[int, int, int]  # position, texture coordinate and normal: numbers from one, 0 where absent, −1 if bad
_OBJ_WIDTHS = {"v": 3, "vt": 2, "vn": 3}


def read_obj(data: bytes) -> RawMesh:
    """Triangles of an OBJ file; each material is a part."""
    from trimesh.exchange.obj import load_obj

    text = data.decode("utf-8", "replace").replace("\r\n", "\n").replace("\r", "\n")
    plain, lost, notes = absolute_obj(text)
    raw = _joined(load_obj(io.BytesIO(plain.encode()), skip_materials=True) if plain else {"geometry": {}})
    raw.lost = lost
    raw.notes += notes
    last = text[text.rfind("\n") + 1 :].split()
    if last and last[0] in (*_OBJ_WIDTHS, "f"):
        raw.notes.append("the last line has no end: the file may be cut short")
    return raw


def absolute_obj(text: str) -> tuple[str, dict[str, int], list[str]]:
    """Rewrites OBJ text as triangles with absolute numbers, the dialect that trimesh reads without slips.

    Negative numbers count back from the last vertex before their line. Polygons become fans. Corners without texture
    coordinate or normal get a NaN one where others of their material have it. Names, lines and points are left out.

    Returns:
        The text, empty without vertices; how many faces were left out, by reason; and notes.
    """
    rows: dict[str, list[str]] = {name: [] for name in _OBJ_WIDTHS}
    materials: dict[str, list[tuple[_Corner, ...]]] = {}
    faces = materials.setdefault("", [])
    polygons: list[list[int]] = []
    lost = {"fewer than three vertex numbers": 0, "index out of range": 0}
    for line in text.replace("\\\n", " ").split("\n"):
        words = line.split("#", 1)[0].split()
        key = words[0] if words else ""
        if key in rows:
            width = _OBJ_WIDTHS[key]
            rows[key].append(" ".join([key, *(words[1 : 1 + width] if len(words) > width else ["nan"] * width)]))
        elif key == "usemtl":
            faces = materials.setdefault(" ".join(words[1:]), [])
        elif key == "f":
            counts = [len(rows[name]) for name in _OBJ_WIDTHS]
            try:
                corners = [_corner(word, counts) for word in words[1:]]
            except ValueError:
                corners = []
            if len(corners) < 3:
                lost["fewer than three vertex numbers"] += 1
            elif len(corners) > 3:
                polygons.append([corner[0] - 1 for corner in corners])
            faces += [(corners[0], *corners[i : i + 2]) for i in range(1, len(corners) - 1)]

    counts = [len(rows[name]) for name in _OBJ_WIDTHS]
    out = [*rows["v"], *rows["vt"], "vt nan nan", *rows["vn"], "vn nan nan nan"]
    for number, faces in enumerate(materials.values()):
        kept = [face for face in faces if all(0 < corner[0] <= counts[0] for corner in face)]
        lost["index out of range"] += len(faces) - len(kept)
        used = [0] + [k for k in (1, 2) if any(0 < corner[k] <= counts[k] for face in kept for corner in face)]
        form = {(0,): "{0}", (0, 1): "{0}/{1}", (0, 2): "{0}//{2}", (0, 1, 2): "{0}/{1}/{2}"}[tuple(used)]
        out += [f"usemtl {number}"] if kept else []
        for face in kept:
            named = [[n if 0 < n <= count else count + 1 for n, count in zip(c, counts, strict=True)] for c in face]
            out.append("f " + " ".join(form.format(*corner) for corner in named))
    dented = _dented(rows["v"], polygons)
    notes = [f"polygons that are not convex: {dented:,}; fans may cover their notches, triangulate when exporting"]
    plain = "\n".join(out) + "\n" if counts[0] else ""
    return plain, {reason: n for reason, n in lost.items() if n}, notes if dented else []


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


def _dented(rows: Sequence[str], polygons: Sequence[Sequence[int]]) -> int:
    """How many polygons have a fan triangle that faces against the whole."""
    polygons = [polygon for polygon in polygons if all(0 <= i < len(rows) for i in polygon)]
    if not polygons:
        return 0
    points = np.array([row.split()[1:] for row in rows], float)
    fans = points[np.array([(p[0], p[i], p[i + 1]) for p in polygons for i in range(1, len(p) - 1)])]
    owner = np.repeat(np.arange(len(polygons)), [len(p) - 2 for p in polygons])
    areas = np.cross(fans[:, 1] - fans[:, 0], fans[:, 2] - fans[:, 0])
    whole = np.stack([np.bincount(owner, areas[:, k]) for k in range(3)], axis=1)[owner]
    against = (areas * whole).sum(axis=1) < -1e-6 * (whole**2).sum(axis=1)
    return len(np.unique(owner[against]))


READERS: dict[str, Callable[[bytes], RawMesh]] = {".ply": read_ply, ".obj": read_obj, ".stl": read_stl}
