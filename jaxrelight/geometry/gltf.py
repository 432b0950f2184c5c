"""glTF 2.0 files: triangles of all nodes, moved into place and posed, a part for each material."""

import pathlib
import struct
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxrelight.errors import InputError
from jaxrelight.geometry.creases import FLAT_FACE
from jaxrelight.geometry.gltf_content import MAX_CORNERS, Content
from jaxrelight.geometry.gltf_materials import read_material, uv_sets_of
from jaxrelight.geometry.gltf_nodes import instances, joint_matrices, scene_nodes, surroundings
from jaxrelight.geometry.raw_mesh import FilePart, RawMesh


def read_glb(data: bytes, folder: pathlib.Path) -> RawMesh:
    """A binary glTF file."""
    if data[:4] != b"glTF":
        raise InputError("not a GLB file: it does not begin with 'glTF'; check what it is")
    if len(data) < 20:
        raise InputError("cut short: its header has 20 bytes; export or copy it again")
    version, length = struct.unpack("<II", data[4:12])
    if version != 2:
        raise InputError(f"glTF version {version} is not read; export it as glTF 2.0")
    if length > len(data):
        raise InputError(f"cut short: {length:,} bytes promised, but it has {len(data):,}; export or copy it again")
    text, binary, at = b"", None, 12
    while at + 8 <= length:
        size, kind = struct.unpack("<I4s", data[at : at + 8])
        if at + 8 + size > length:
            raise InputError("cut short: a chunk is longer than the file; export or copy it again")
        if kind == b"JSON":
            text = data[at + 8 : at + 8 + size]
        elif kind == b"BIN\0" and binary is None:
            binary = data[at + 8 : at + 8 + size]
        at += 8 + size
    return _read(Content(text, binary, folder))


def read_gltf(data: bytes, folder: pathlib.Path) -> RawMesh:
    """A glTF file in text, with its buffers within or beside it."""
    return _read(Content(data, None, folder))


class _Primitive(NamedTuple):
    """Triangles of one material, as a mesh has them.

    Attributes:
        points: positions.
        faces: vertex numbers.
        normals: None where the file has none.
        uv: sets of texture coordinates up to the highest that the material follows, v upwards; NaN where absent.
        colours: linear; None where the file has none.
        bones: numbers of the joints that each vertex follows, and how much; None without a skin.
    """

    points: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "v 3"] | None
    uv: Float[np.ndarray, "v u"]
    colours: Float[np.ndarray, "v 3"] | None
    bones: tuple[Int[np.ndarray, "v b"], Float[np.ndarray, "v b"]] | None


def _read(content: Content) -> RawMesh:
    """Everything that the default scene shows."""
    count, nodes = len(content.entries("materials")), list(scene_nodes(content))
    placed: list[tuple[int, _Primitive, np.ndarray | None, np.ndarray]] = []
    corners = 0
    for node in nodes:
        if "mesh" not in node.entry:
            continue
        mesh = content.entries("meshes")[node.entry["mesh"]]
        weights = [float(weight) for weight in node.entry.get("weights", mesh.get("weights", []))]
        skin = joint_matrices(content, node.entry["skin"]) if "skin" in node.entry else None
        places = node.matrix[None] if skin is not None else instances(content, node)
        for entry in mesh["primitives"]:
            primitive = _primitive(content, entry, weights)
            if primitive is None:
                continue
            corners += (len(primitive.points) + 3 * len(primitive.faces)) * len(places)
            if corners > MAX_CORNERS:
                raise InputError("has more than 268 million vertices and corners; export less of it")
            material = entry.get("material", -1)
            placed.append((material if 0 <= material < count else -1, primitive, skin, places))
    parts: dict[int, list[_Primitive]] = {}
    for material, primitive, skin, places in placed:
        if skin is not None and primitive.bones is not None:
            content.note("meshes with skins stand as their joints do")
            primitive = _posed(skin, primitive)
        else:
            primitive = _moved(places, primitive)
        parts.setdefault(material, []).append(primitive)
    raw = _joined(content, parts)
    raw.surroundings = surroundings(content, sorted(nodes, key=lambda node: node.number))
    return raw


def _primitive(content: Content, entry: dict, weights: list[float]) -> _Primitive | None:
    """A primitive in the shape that the weights of its morph targets give it; None for points and lines."""
    names = entry.get("attributes", {})
    if "POSITION" not in names:
        if "KHR_draco_mesh_compression" in entry.get("extensions", {}):
            raise InputError("is compressed (KHR_draco_mesh_compression), which is not read; export it without")
        return None
    if entry.get("mode", 4) < 4:
        content.note("points and lines are left out")
        return None
    _check_primitive(content, entry)
    points = content.accessor(names["POSITION"], 3).astype(float)
    count = len(points)
    indices = entry.get("indices")
    order = np.arange(count) if indices is None else content.accessor(indices, 1)[:, 0].astype(np.int64)
    materials, number = content.entries("materials"), entry.get("material", -1)
    wanted = uv_sets_of(materials[number]) if 0 <= number < len(materials) else set()
    sets, there = [np.full((count, 2), np.nan) for _ in range(max(wanted, default=0) + 1)], []
    for uv_set in {0, *wanted}:
        if f"TEXCOORD_{uv_set}" in names:
            sets[uv_set] = content.accessor(names[f"TEXCOORD_{uv_set}"], 2).astype(float)
            there.append(uv_set)
    normals = content.accessor(names["NORMAL"], 3).astype(float) if "NORMAL" in names else None
    colours = content.accessor(names["COLOR_0"], (3, 4), fractions=True) if "COLOR_0" in names else None
    colours = None if colours is None else colours[:, :3].astype(float)
    columns = {"POSITION": points, "NORMAL": normals, "COLOR_0": colours}
    columns |= {f"TEXCOORD_{uv_set}": sets[uv_set] for uv_set in there}
    if any(values is not None and len(values) != count for values in columns.values()):
        raise InputError("a primitive's attributes differ in length; export it again")
    _morph(content, entry.get("targets", []), weights, columns)
    for uv_set in there:
        sets[uv_set][:, 1] = 1 - sets[uv_set][:, 1]  # v counts downwards there
    faces = _triangles(order, entry.get("mode", 4))
    return _Primitive(points, faces, normals, np.concatenate(sets, axis=1), colours, _bones(content, names, count))


def _check_primitive(content: Content, entry: dict) -> None:
    """Notes what a primitive has that is not read, and refuses one that is there in compressed form alone."""
    extensions, names = entry.get("extensions", {}), entry["attributes"]
    if "KHR_draco_mesh_compression" in extensions:
        position = content.entries("accessors")[names["POSITION"]]
        if "bufferView" not in position and "sparse" not in position:
            raise InputError("is compressed (KHR_draco_mesh_compression), which is not read; export it without")
    left_out = sorted(name for name in extensions if name != "KHR_draco_mesh_compression")
    if left_out:
        content.note(f"extensions are left out: {', '.join(str(name)[:40] for name in left_out)}")
    if any(name.startswith("COLOR_") and name != "COLOR_0" for name in names):
        content.note("colours of vertices beyond the first set are left out")
    materials, number = content.entries("materials"), entry.get("material", -1)
    if "TANGENT" in names and 0 <= number < len(materials) and "normalTexture" in materials[number]:
        content.note("tangents are left out: normal maps follow the directions of texture coordinates")


def _triangles(order: Int[np.ndarray, " n"], mode: int) -> Int[np.ndarray, "f 3"]:
    """Faces of a list, a strip or a fan."""
    if mode == 5:
        faces = np.stack([order[:-2], order[1:-1], order[2:]], axis=1)
        faces[1::2] = faces[1::2, ::-1]
        return faces
    if mode == 6:
        return np.stack([np.broadcast_to(order[:1], order[2:].shape), order[1:-1], order[2:]], axis=1)
    return order[: len(order) // 3 * 3].reshape(-1, 3)


def _morph(content: Content, targets: list[dict], weights: list[float], columns: dict[str, np.ndarray | None]) -> None:
    """Adds the displacements of morph targets, by their weights, to the columns of vertices."""
    widths = {"POSITION": 3, "NORMAL": 3, "COLOR_0": (3, 4)}
    for target, weight in zip(targets, weights, strict=False):
        for name, number in target.items() if weight else ():
            values = columns.get(name)
            if values is None:
                continue
            moved = content.accessor(number, widths.get(name, 2), fractions=name == "COLOR_0")
            if len(moved) != len(values):
                raise InputError("a morph target differs in length from its mesh; export it again")
            values += weight * moved[:, : values.shape[1]]


def _bones(content: Content, names: dict, count: int) -> tuple[Int[np.ndarray, "v b"], Float[np.ndarray, "v b"]] | None:
    """The joints that vertices follow, and by how much of 1."""
    joints, shares = [], []
    while f"JOINTS_{len(joints)}" in names and f"WEIGHTS_{len(joints)}" in names:
        number = len(joints)
        joints.append(content.accessor(names[f"JOINTS_{number}"], 4).astype(np.int64))
        shares.append(content.accessor(names[f"WEIGHTS_{number}"], 4, fractions=True).astype(float))
        if not len(joints[-1]) == len(shares[-1]) == count:
            raise InputError("a primitive's attributes differ in length; export it again")
    if not joints:
        return None
    share = np.concatenate(shares, axis=1)
    total = share.sum(axis=1, keepdims=True)
    return np.concatenate(joints, axis=1), share / np.where(total > 0, total, 1)


def _posed(joints: Float[np.ndarray, "j 4 4"], primitive: _Primitive) -> _Primitive:
    """A primitive whose vertices follow joints; where its node stands does not count."""
    assert primitive.bones is not None
    number, share = primitive.bones
    if (share[number >= len(joints)] > 0).any():
        raise InputError("a vertex follows a joint that its skin does not have; export it again")
    matrices = np.zeros((len(number), 4, 4))
    for column in range(number.shape[1]):  # one matrix a vertex, not one for each joint of a vertex
        matrices += share[:, column, None, None] * joints[np.minimum(number[:, column], len(joints) - 1)]
    points = np.einsum("vij,vj->vi", matrices[:, :3, :3], primitive.points) + matrices[:, :3, 3]
    mirrors = np.linalg.det(matrices[:, :3, :3]) < 0
    normals = primitive.normals
    if normals is not None:
        normals = np.einsum("vij,vj->vi", _cofactors(matrices[:, :3, :3]), normals)
        normals = np.where(mirrors[:, None], -normals, normals)
    # A face is mirrored where its vertices are.
    inside = primitive.faces[((primitive.faces >= 0) & (primitive.faces < len(points))).all(axis=1)]
    flipped = mirrors[inside].mean() > 0.5 if len(inside) else False
    faces = primitive.faces[:, ::-1] if flipped else primitive.faces
    return primitive._replace(points=points, normals=normals, faces=faces, bones=None)


def _moved(matrices: Float[np.ndarray, "n 4 4"], primitive: _Primitive) -> _Primitive:
    """A primitive in its places, as one."""
    linear, (times, count) = matrices[:, :3, :3], (len(matrices), len(primitive.points))
    mirrors = np.linalg.det(linear) < 0
    normals = primitive.normals
    if normals is not None:
        side = np.where(mirrors, -1.0, 1.0)[:, None, None]
        normals = (side * (normals @ _cofactors(linear).transpose(0, 2, 1))).reshape(-1, 3)
    points = primitive.points @ linear.transpose(0, 2, 1) + matrices[:, None, :3, 3]
    inside = (primitive.faces >= 0) & (primitive.faces < count)
    faces = np.where(inside, primitive.faces + count * np.arange(times)[:, None, None], -1)
    faces = np.where(mirrors[:, None, None], faces[..., ::-1], faces)
    colours = None if primitive.colours is None else np.tile(primitive.colours, (times, 1))
    uv = np.tile(primitive.uv, (times, 1))
    return _Primitive(points.reshape(-1, 3), faces.reshape(-1, 3), normals, uv, colours, None)


def _cofactors(linear: Float[np.ndarray, "*n 3 3"]) -> Float[np.ndarray, "*n 3 3"]:
    """What turns normals, also where a matrix flattens the mesh."""
    a, b, c = (linear[..., k] for k in range(3))
    return np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=-1)


def _joined(content: Content, parts: dict[int, list[_Primitive]]) -> RawMesh:
    """All primitives as one mesh, a part for each material."""
    every = [(number, one) for number in sorted(parts) for one in parts[number]]
    width = max([2, *(one.uv.shape[1] for _, one in every)])
    coloured = any(one.colours is not None for _, one in every)
    starts = np.cumsum([0, *(len(one.points) for _, one in every)])
    place, none = {number: i for i, number in enumerate(sorted(parts))}, np.zeros((0, 3))

    def rows(values: list[np.ndarray], nothing: np.ndarray = none) -> np.ndarray:
        return np.concatenate([nothing, *values])

    faces = []
    for start, (_, one) in zip(starts[:-1], every, strict=True):
        inside = (one.faces >= 0) & (one.faces < len(one.points))
        faces.append(np.where(inside, one.faces + start, -1))
    lengths = [len(one.points) for _, one in every]
    colours = [np.full((len(one.points), 3), np.nan) if one.colours is None else one.colours for _, one in every]
    uv = [np.pad(one.uv, ((0, 0), (0, width - one.uv.shape[1])), constant_values=np.nan) for _, one in every]
    return RawMesh(
        rows([one.points for _, one in every]),
        rows(faces, none.astype(np.int64)),
        rows([np.zeros_like(one.points) if one.normals is None else one.normals for _, one in every]),
        np.repeat([one.normals is not None for _, one in every], lengths).astype(bool),
        rows(uv, np.zeros((0, width))),
        np.repeat(np.array([place[number] for number, _ in every], np.int64), lengths),
        [_part(content, number) for number in sorted(parts)],
        notes=content.notes,
        # Meshes without normals are flat, by the specification.
        smoothing=np.full(sum(map(len, faces)), FLAT_FACE),
        colours=rows(colours) if coloured else None,
    )


def _part(content: Content, number: int) -> FilePart:
    if number < 0:
        return FilePart("default")
    entry = content.entries("materials")[number]
    return FilePart(str(entry.get("name") or f"material {number}"), read_material(content, entry))
