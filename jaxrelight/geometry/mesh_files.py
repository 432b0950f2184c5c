"""The readers of mesh files: content checked against what the file promises, and unrepaired otherwise.

STL is read here. trimesh parses it; what is here refuses files that are cut short.
"""

import io
import pathlib
import re
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Int

from jaxrelight.errors import InputError
from jaxrelight.geometry.gltf import read_glb, read_gltf
from jaxrelight.geometry.obj import read_obj
from jaxrelight.geometry.ply import read_ply
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


# ---- all -------------------------------------------------------------------------------------------------------------

READERS: dict[str, Callable[[bytes, pathlib.Path], RawMesh]] = {
    ".ply": read_ply,
    ".obj": read_obj,
    ".stl": read_stl,
    ".glb": read_glb,
    ".gltf": read_gltf,
}
