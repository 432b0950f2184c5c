"""PLY files: triangles, and what scanners and their programs write beside them."""

import dataclasses
import pathlib
import re
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxrelight.errors import InputError
from jaxrelight.geometry.file_materials import FileMaterial, FilePicture
from jaxrelight.geometry.file_references import find_file
from jaxrelight.geometry.polygons import triangulated
from jaxrelight.geometry.raw_mesh import FilePart, RawMesh

_TYPES = {
    **{"char": "i1", "uchar": "u1", "short": "i2", "ushort": "u2", "int": "i4", "uint": "u4", "float": "f4"},
    **{"int8": "i1", "uint8": "u1", "int16": "i2", "uint16": "u2", "int32": "i4", "uint32": "u4"},
    **{"double": "f8", "float16": "f2", "float32": "f4", "float64": "f8", "int64": "i8", "uint64": "u8"},
}
_UV = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
_COLOURS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
_CORNERS = "vertex_indices", "vertex_index"
_TEXTURE = re.compile(rb"^comment\s+texturefile\s+(.+?)\s*$", re.IGNORECASE | re.MULTILINE)


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

    def find(self, *names: str) -> _Property | None:
        """The first property with one of these names."""
        return next((item for name in names for item in self.properties if item.name == name), None)


class _Lists(NamedTuple):
    """Lists one after the other, and how long each is."""

    values: Float[np.ndarray, " n"]
    lengths: Int[np.ndarray, " rows"]


# The content of an element by property: a number or a list of each row.
_Content = dict[str, np.ndarray | _Lists]


def read_ply(data: bytes, folder: pathlib.Path) -> RawMesh:
    """Triangles of an ASCII or binary PLY file.

    Polygons that are not convex are cut into ears, others become fans; triangle strips are read, too. Texture
    coordinates and colours may belong to vertices, or to the corners of faces and to faces. Colours of whole numbers
    are taken as sRGB, others as linear. `comment TextureFile` names images.
    """
    encoding, elements, header, body = _header(data)
    content, notes = _ascii(elements, body) if encoding == "ascii" else _binary(elements, body, encoding)
    vertex = content.get("vertex", {})
    points = np.stack([_column(vertex, axis) for axis in "xyz"], axis=1)
    normals, stated = np.zeros_like(points), np.zeros(len(points), bool)
    if {"nx", "ny", "nz"} <= set(vertex):
        normals, stated = np.stack([_column(vertex, f"n{axis}") for axis in "xyz"], axis=1), ~stated
    uv = np.full((len(points), 2), np.nan)
    for pair in _UV:
        if set(pair) <= set(vertex):
            uv = np.stack([_column(vertex, name) for name in pair], axis=1)
            break
    colours, colour_notes = _colours(elements, content, "vertex")
    faces, owner, nth, short = _faces(points, content)
    part = np.zeros(len(points), np.int64)
    textures = [name.decode("utf-8", "replace") for name in _TEXTURE.findall(header)]
    of_face, face_notes = _colours(elements, content, "face")
    corner_uv = _corner_uv(content, owner, nth, faces)
    texture_of_face = _texture_numbers(content, owner, len(textures))
    if colours is not None or of_face is None:
        of_face, face_notes = None, []
    if corner_uv is not None or of_face is not None or (len(textures) > 1 and texture_of_face.any()):
        # Every corner becomes a vertex, as far as it is one; the repair merges those that are alike.
        inside = (faces >= 0) & (faces < len(points))
        source = np.where(inside, faces, 0).reshape(-1)
        points, normals, stated, part = points[source], normals[source], stated[source], np.repeat(texture_of_face, 3)
        uv = uv[source] if corner_uv is None else corner_uv.reshape(-1, 2)
        colours = (
            np.repeat(of_face[owner], 3, axis=0)
            if of_face is not None
            else None
            if colours is None
            else colours[source]
        )
        faces = np.where(inside, np.arange(faces.size).reshape(-1, 3), -1)
    parts, material_notes = _parts(textures, folder)
    return RawMesh(
        points,
        faces,
        normals,
        stated,
        uv,
        part,
        parts,
        {"fewer than three vertex numbers": short}
        if short and len(faces)
        else {},  # else there are points and lines only
        notes,
        [*material_notes, *colour_notes, *face_notes],
        colours,
    )


# ---- what elements hold ----------------------------------------------------------------------------------------------


def _column(content: _Content, name: str) -> Float[np.ndarray, " n"]:
    """The numbers of a property; none where the element is empty or absent."""
    values = content.get(name, np.zeros(0))
    assert isinstance(values, np.ndarray)
    return values.astype(float)


def _colours(
    elements: Sequence[_Element], content: dict[str, _Content], owner: str
) -> tuple[Float[np.ndarray, "n 3"] | None, list[str]]:
    """Linear colours of the rows of an element, and what was taken them for."""
    from jaxrelight.images.tone import srgb_decode

    element = next((one for one in elements if one.name == owner and one.count), None)
    if element is None:
        return None, []
    for names in _COLOURS:
        items = [element.find(name) for name in names]
        if all(item is not None and not item.counter for item in items):
            kind = np.dtype(_TYPES[items[0].kind])  # pyright: ignore[reportOptionalMemberAccess]
            values = np.stack([_column(content[owner], name) for name in names], axis=1)
            if kind.kind == "f":
                return values, []
            return srgb_decode(values / np.iinfo(kind).max), [f"colours of each {owner} are taken as sRGB"]
    return None, []


def _faces(points, content: dict[str, _Content]):
    """Triangles of polygons and strips.

    Returns:
        Their vertex numbers; which polygon each is of, 0 for those of strips; which corners of it they are; and how
        many polygons had fewer than three corners.
    """
    lists = next((content["face"][name] for name in _CORNERS if name in content.get("face", {})), None)
    faces, owner, nth, short = np.zeros((0, 3), np.int64), np.zeros(0, np.int64), np.zeros((0, 3), np.int64), 0
    if isinstance(lists, _Lists):
        starts = np.cumsum(lists.lengths) - lists.lengths
        long = np.flatnonzero(lists.lengths >= 3)
        short = len(lists.lengths) - len(long)
        corners = lists.values.astype(np.int64)
        in_polygons = np.repeat(lists.lengths >= 3, lists.lengths)
        nth, of_long = triangulated(points, corners[in_polygons], lists.lengths[long])
        owner = long[of_long]
        faces = corners[starts[owner][:, None] + nth]
    strips = next((content["tristrips"][name] for name in _CORNERS if name in content.get("tristrips", {})), None)
    if isinstance(strips, _Lists):
        of_strips = _strips(strips)
        faces = np.concatenate([faces, of_strips])
        owner = np.concatenate([owner, np.zeros(len(of_strips), np.int64)])
        nth = np.concatenate([nth, np.zeros_like(of_strips)])
    return faces, owner, nth, short


def _strips(strips: _Lists) -> Int[np.ndarray, "f 3"]:
    """Triangles of strips, of which −1 begins another one; every other triangle is turned."""
    values, row = strips.values.astype(np.int64), np.repeat(np.arange(len(strips.lengths)), strips.lengths)
    begins = np.ones(len(values), bool)
    begins[1:] = (row[1:] != row[:-1]) | (values[:-1] < 0)
    start = np.maximum.accumulate(np.where(begins, np.arange(len(values)), 0))
    first = np.arange(max(len(values) - 2, 0))
    whole = (
        (start[first] == start[first + 2]) & (values[first + 2] >= 0) & (values[first] >= 0) & (values[first + 1] >= 0)
    )
    first = first[whole]
    triangles = np.stack([values[first], values[first + 1], values[first + 2]], axis=1)
    odd = (first - start[first]) % 2 == 1
    return np.where(odd[:, None], triangles[:, [1, 0, 2]], triangles)


def _corner_uv(content: dict[str, _Content], owner, nth, faces) -> Float[np.ndarray, "f 3 2"] | None:
    """Texture coordinates that faces give their corners, NaN where a face has too few; None where none has any."""
    lists = content.get("face", {}).get("texcoord")
    if not isinstance(lists, _Lists) or not len(lists.values):
        return None
    starts = (np.cumsum(lists.lengths) - lists.lengths)[owner][:, None] + 2 * nth
    enough = 2 * nth + 1 < lists.lengths[owner][:, None]
    places = np.where(enough, starts, 0)
    uv = np.stack([lists.values[places], lists.values[np.minimum(places + 1, len(lists.values) - 1)]], axis=2)
    return np.where(enough[..., None], uv, np.nan)


def _texture_numbers(content: dict[str, _Content], owner, count: int) -> Int[np.ndarray, " f"]:
    """Which image each triangle has."""
    numbers = content.get("face", {}).get("texnumber")
    if not isinstance(numbers, np.ndarray) or not len(owner):
        return np.zeros(len(owner), np.int64)
    return np.clip(numbers[owner].astype(np.int64), 0, max(count - 1, 0))


def _parts(textures: Sequence[str], folder: pathlib.Path) -> tuple[list[FilePart], list[str]]:
    """A part for each image, and where images were taken from elsewhere."""
    if not textures:
        return [FilePart("default")], []
    parts, notes = [], []
    for name in textures:
        path, note = find_file(name, folder)
        notes += [note] if note else []
        parts.append(FilePart(path.stem or "default", FileMaterial((1.0, 1.0, 1.0), diffuse_picture=FilePicture(path))))
    return parts, notes


# ---- the format ------------------------------------------------------------------------------------------------------


def _header(data: bytes) -> tuple[str, list[_Element], bytes, bytes]:
    """Encoding, elements, the header and what follows it."""
    if data[:3] != b"ply":
        raise InputError("not a PLY file: it does not begin with 'ply'; check what it is")
    end = re.search(rb"^end_header[ \t]*(\r\n|\n|\r|$)", data, re.MULTILINE)
    if end is None:
        raise InputError("cut short or not a PLY file: its header has no end; export or copy it again")
    encoding, elements, header = "", [], data[: end.start()]
    for line in header.decode("ascii", "replace").splitlines()[1:]:
        match line.split():
            case [] | ["comment" | "obj_info", *_]:
                pass
            case ["format", kind, _]:
                encoding = kind.lower()
            case ["element", name, count] if count.isdecimal():
                elements.append(_Element(name, int(count), []))
            case ["property", kind, name] if elements and kind in _TYPES:
                elements[-1].properties.append(_Property(name, kind))
            case ["property", "list", counter, kind, name] if elements and {counter, kind} <= set(_TYPES):
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
        if element.count and element.name in ("face", "tristrips") and not set(_CORNERS) & set(lists):
            raise InputError(f"PLY {element.name} elements lack the list vertex_indices; export it again")
    return encoding, elements, header, data[end.end() :]


def _ascii(elements: Sequence[_Element], body: bytes) -> tuple[dict[str, _Content], list[str]]:
    """The content, and what is doubtful."""
    notes = [] if body.endswith((b"\n", b"\r")) else ["the last line has no end: the file may be cut short"]
    rows = [row for row in body.decode("ascii", "replace").splitlines() if row.strip()]
    promised = sum(element.count for element in elements)
    if len(rows) < promised:
        raise InputError(f"cut short: {promised:,} rows promised but {len(rows):,} found; export or copy it again")
    if len(rows) > promised:
        notes.append(f"ignored {len(rows) - promised:,} rows after the promised ones")
    content, start = {}, 0
    for element in elements:
        mine = rows[start : start + element.count]
        start += element.count
        is_last = start == promised and bool(element.count)
        content[element.name] = _ascii_element(element, mine, is_last)
    return content, notes


def _ascii_element(element: _Element, rows: Sequence[str], is_last: bool) -> _Content:
    """An element by its rows; a list with fewer words than it promises is empty."""
    scalars: dict[str, list[str]] = {item.name: [] for item in element.properties if not item.counter}
    values: dict[str, list[str]] = {item.name: [] for item in element.properties if item.counter}
    lengths: dict[str, list[int]] = {name: [] for name in values}
    for number, row in enumerate(rows):
        words, at = row.split(), 0
        for item in element.properties:
            if item.counter:
                count = int(words[at])
                mine = words[at + 1 : at + 1 + count]
                if len(mine) < count:
                    if is_last and number == len(rows) - 1:
                        raise InputError("cut short: its last row is incomplete; export or copy it again")
                    mine = []
                if _TYPES[item.kind][0] in "iu":
                    for word in mine:
                        int(word)
                values[item.name] += mine
                lengths[item.name].append(len(mine))
                at += 1 + count
            elif at < len(words):
                scalars[item.name].append(words[at])
                at += 1
            elif is_last and number == len(rows) - 1:
                raise InputError("cut short: its last row is incomplete; export or copy it again")
            else:
                raise ValueError(f"row {number + 1} of {element.name} is incomplete")
    content: _Content = {name: np.array(words, float) for name, words in scalars.items()}
    for name, words in values.items():
        content[name] = _Lists(np.array(words, float), np.array(lengths[name], np.int64))
    return content


def _binary(elements: Sequence[_Element], body: bytes, encoding: str) -> tuple[dict[str, _Content], list[str]]:
    """The content, and what is doubtful."""
    order = ">" if "big" in encoding else "<"
    least = sum(e.count * sum(_dtype(p.counter or p.kind, order).itemsize for p in e.properties) for e in elements)
    if least > len(body):
        raise InputError(
            f"cut short: at least {least:,} bytes promised after its header but {len(body):,} found; "
            "export or copy it again"
        )
    content, at = {}, 0
    for element in elements:
        even = _even_rows(element, body, at, order)
        content[element.name], at = _uneven_rows(element, body, at, order) if even is None else even
    notes = [f"ignored {len(body) - at:,} bytes after the promised ones"] if at < len(body) else []
    return content, notes


def _dtype(kind: str, order: str) -> np.dtype:
    return np.dtype(order + _TYPES[kind])


def _even_rows(element: _Element, body: bytes, at: int, order: str) -> tuple[_Content, int] | None:
    """An element whose lists are all as long as in its first row, read at once; None where they are not."""
    fields, row = [], at
    for number, item in enumerate(element.properties if element.count else ()):
        kind = _dtype(item.kind, order)
        if not item.counter:
            fields.append((f"{number}", kind))
            row += kind.itemsize
            continue
        counter = _dtype(item.counter, order)
        if row + counter.itemsize > len(body):
            return None
        length = int(np.frombuffer(body, counter, 1, row)[0])
        if length < 0 or row + counter.itemsize + length * kind.itemsize > len(body):
            return None
        fields += [(f"count {number}", counter), (f"{number}", kind, (length,))]
        row += counter.itemsize + length * kind.itemsize
    table = np.dtype(fields)
    if at + element.count * table.itemsize > len(body):
        return None
    rows = np.frombuffer(body, table, element.count, at) if fields else np.zeros(0, table)
    content: _Content = {}
    for number, item in enumerate(element.properties):
        if not element.count:
            content[item.name] = _Lists(np.zeros(0), np.zeros(0, np.int64)) if item.counter else np.zeros(0)
        elif item.counter:
            values, counts = rows[f"{number}"], rows[f"count {number}"]
            if (counts != values.shape[-1]).any():
                return None
            content[item.name] = _Lists(values.reshape(-1).astype(float), counts.astype(np.int64))
        else:
            content[item.name] = rows[f"{number}"]
    return content, at + element.count * table.itemsize


def _uneven_rows(element: _Element, body: bytes, at: int, order: str) -> tuple[_Content, int]:
    """An element row by row, and where it ends."""
    columns: dict[str, list] = {item.name: [] for item in element.properties}
    lengths: dict[str, list[int]] = {item.name: [] for item in element.properties if item.counter}
    kinds = [
        (item.name, _dtype(item.kind, order), _dtype(item.counter, order) if item.counter else None)
        for item in element.properties
    ]
    for _ in range(element.count):
        for name, kind, counter in kinds:
            length = 1
            if counter is not None:
                if at + counter.itemsize > len(body):
                    raise InputError(f"cut short: {element.count:,} rows of {element.name!r} promised; export it again")
                length = int(np.frombuffer(body, counter, 1, at)[0])
                at += counter.itemsize
                lengths[name].append(length)
            if length < 0 or at + length * kind.itemsize > len(body):
                raise InputError(f"cut short: {element.count:,} rows of {element.name!r} promised; export it again")
            columns[name].append(np.frombuffer(body, kind, length, at))
            at += length * kind.itemsize
    content: _Content = {}
    for name, _, counter in kinds:
        values = np.concatenate([np.zeros(0), *columns[name]]).astype(float)
        content[name] = values if counter is None else _Lists(values, np.array(lengths[name], np.int64))
    return content, at
