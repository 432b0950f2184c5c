"""PLY files: triangles, and what scanners and their programs write beside them."""

import pathlib
import re
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from jaxrelight.geometry.file_materials import FileMaterial, FilePicture
from jaxrelight.geometry.file_references import find_file
from jaxrelight.geometry.ply_format import CORNERS, TYPES, Content, Element, Lists, read_ascii, read_binary, read_header
from jaxrelight.geometry.polygons import triangulated
from jaxrelight.geometry.raw_mesh import FilePart, RawMesh

_UV = (("s", "t"), ("u", "v"), ("texture_u", "texture_v"))
_COLOURS = (("red", "green", "blue"), ("diffuse_red", "diffuse_green", "diffuse_blue"), ("r", "g", "b"))
_TEXTURE = re.compile(rb"^comment\s+texturefile\s+(.+?)\s*$", re.IGNORECASE | re.MULTILINE)


def read_ply(data: bytes, folder: pathlib.Path) -> RawMesh:
    """Triangles of an ASCII or binary PLY file.

    Polygons that are not convex are cut into ears, others become fans; triangle strips are read, too. Texture
    coordinates and colours may belong to vertices, or to the corners of faces and to faces. Colours of whole numbers
    are taken as sRGB, others as linear. `comment TextureFile` names images.
    """
    encoding, elements, header, body = read_header(data)
    content, notes = read_ascii(elements, body) if encoding == "ascii" else read_binary(elements, body, encoding)
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


def _column(content: Content, name: str) -> Float[np.ndarray, " n"]:
    """The numbers of a property; none where the element is empty or absent."""
    values = content.get(name, np.zeros(0))
    assert isinstance(values, np.ndarray)
    return values.astype(float)


def _colours(
    elements: Sequence[Element], content: dict[str, Content], owner: str
) -> tuple[Float[np.ndarray, "n 3"] | None, list[str]]:
    """Linear colours of the rows of an element, and what was taken them for."""
    from jaxrelight.images.tone import srgb_decode

    element = next((one for one in elements if one.name == owner and one.count), None)
    if element is None:
        return None, []
    for names in _COLOURS:
        items = [element.find(name) for name in names]
        if all(item is not None and not item.counter for item in items):
            kind = np.dtype(TYPES[items[0].kind])  # pyright: ignore[reportOptionalMemberAccess]
            values = np.stack([_column(content[owner], name) for name in names], axis=1)
            if kind.kind == "f":
                return values, []
            return srgb_decode(values / np.iinfo(kind).max), [f"colours of each {owner} are taken as sRGB"]
    return None, []


def _faces(points, content: dict[str, Content]):
    """Triangles of polygons and strips.

    Returns:
        Their vertex numbers; which polygon each is of, 0 for those of strips; which corners of it they are; and how
        many polygons had fewer than three corners.
    """
    lists = next((content["face"][name] for name in CORNERS if name in content.get("face", {})), None)
    faces, owner, nth, short = np.zeros((0, 3), np.int64), np.zeros(0, np.int64), np.zeros((0, 3), np.int64), 0
    if isinstance(lists, Lists):
        starts = np.cumsum(lists.lengths) - lists.lengths
        long = np.flatnonzero(lists.lengths >= 3)
        short = len(lists.lengths) - len(long)
        corners = lists.values.astype(np.int64)
        in_polygons = np.repeat(lists.lengths >= 3, lists.lengths)
        nth, of_long = triangulated(points, corners[in_polygons], lists.lengths[long])
        owner = long[of_long]
        faces = corners[starts[owner][:, None] + nth]
    strips = next((content["tristrips"][name] for name in CORNERS if name in content.get("tristrips", {})), None)
    if isinstance(strips, Lists):
        of_strips = _strips(strips)
        faces = np.concatenate([faces, of_strips])
        owner = np.concatenate([owner, np.zeros(len(of_strips), np.int64)])
        nth = np.concatenate([nth, np.zeros_like(of_strips)])
    return faces, owner, nth, short


def _strips(strips: Lists) -> Int[np.ndarray, "f 3"]:
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


def _corner_uv(content: dict[str, Content], owner, nth, faces) -> Float[np.ndarray, "f 3 2"] | None:
    """Texture coordinates that faces give their corners, NaN where a face has too few; None where none has any."""
    lists = content.get("face", {}).get("texcoord")
    if not isinstance(lists, Lists) or not len(lists.values):
        return None
    starts = (np.cumsum(lists.lengths) - lists.lengths)[owner][:, None] + 2 * nth
    enough = 2 * nth + 1 < lists.lengths[owner][:, None]
    places = np.where(enough, starts, 0)
    uv = np.stack([lists.values[places], lists.values[np.minimum(places + 1, len(lists.values) - 1)]], axis=2)
    return np.where(enough[..., None], uv, np.nan)


def _texture_numbers(content: dict[str, Content], owner, count: int) -> Int[np.ndarray, " f"]:
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
