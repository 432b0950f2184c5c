"""glTF 2.0 files: triangles of all nodes, moved into place, a part for each material."""

import base64
import json
import pathlib
import struct
from typing import Any

import numpy as np
from jaxtyping import Float, Int

from jaxrelight.errors import InputError
from jaxrelight.geometry.creases import FLAT_FACE
from jaxrelight.geometry.file_materials import FileMaterial, FilePicture, metallic_roughness
from jaxrelight.geometry.raw_mesh import FilePart, RawMesh

_NUMBERS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
_MAX_CORNERS = 2**28  # instances of one mesh can ask for more than any memory
_KNOWN = ("KHR_materials_", "KHR_texture_transform", "KHR_mesh_quantization", "KHR_lights_punctual")


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
    return _Reader(text, binary, folder).mesh()


def read_gltf(data: bytes, folder: pathlib.Path) -> RawMesh:
    """A glTF file in text, with its buffers within or beside it."""
    return _Reader(data, None, folder).mesh()


class _Reader:
    """Looks things up in a file's JSON; whatever is missing or of the wrong kind raises."""

    def __init__(self, text: bytes, binary: bytes | None, folder: pathlib.Path):
        try:
            self.json: Any = json.loads(text)
        except (ValueError, RecursionError):
            raise InputError("its description is no JSON; export or copy it again") from None
        if not isinstance(self.json, dict) or not str(self.json.get("asset", {}).get("version", "")).startswith("2"):
            raise InputError("not a glTF 2.0 file; export it as glTF 2.0")
        asked = [name for name in self.json.get("extensionsRequired", []) if not str(name).startswith(_KNOWN)]
        if asked:
            raise InputError(f"needs the extension {str(asked[0])[:40]}, which is not read; export it without")
        self.folder, self.notes = folder, []
        self.buffers: list[bytes] = []
        for number, entry in enumerate(self.json.get("buffers", [])):
            content = self._bytes(entry["uri"]) if "uri" in entry else binary if number == 0 else None
            if content is None or len(content) < entry["byteLength"]:
                raise InputError(f"cut short: buffer {number} has {entry['byteLength']} bytes promised; copy it again")
            self.buffers.append(content)

    def _bytes(self, uri: str) -> bytes:
        if uri.startswith("data:"):
            return base64.b64decode(uri.split(",", 1)[1])
        try:
            if not (self.folder / uri).is_file():
                raise OSError("a pipe or a device could go on for ever")
            return (self.folder / uri).read_bytes()
        except (OSError, ValueError):
            raise InputError(f"its buffer '{uri[:80]}' cannot be read; put it beside the file") from None

    def mesh(self) -> RawMesh:
        """Everything that the default scene shows."""
        count = len(self.json.get("materials", []))
        parts: dict[int, list] = {}
        corners = 0
        for matrix, number in self._instances():
            for primitive in self.json["meshes"][number]["primitives"]:
                arrays = self._primitive(primitive)
                if arrays is None:
                    continue
                corners += len(arrays[0]) + 3 * len(arrays[1])
                if corners > _MAX_CORNERS:
                    raise InputError("has more than 268 million vertices and corners; export less of it")
                material = primitive.get("material", -1)
                parts.setdefault(material if 0 <= material < count else -1, []).append(_moved(matrix, *arrays))
        return self._joined(parts)

    def _instances(self):
        """(matrix, mesh number) of all nodes that are in the scene."""
        nodes = self.json.get("nodes", [])
        if self.json.get("scenes"):
            roots = self.json["scenes"][self.json.get("scene", 0)].get("nodes", [])
        else:
            roots = set(range(len(nodes))) - {child for node in nodes for child in node.get("children", [])}
        waiting = [(number, np.eye(4)) for number in sorted(roots)]
        visited = set()
        while waiting:
            number, above = waiting.pop()
            if number in visited or number < 0:
                raise InputError(f"node {number} is below several others; export it again")
            visited.add(number)
            node = nodes[number]
            matrix = above @ _matrix(node)
            waiting += [(child, matrix) for child in node.get("children", [])]
            if "skin" in node or any("targets" in p for p in self._primitives(node)):
                self._note("skins and morph targets are left out: it is in its rest pose")
            if "mesh" in node:
                yield matrix, node["mesh"]

    def _primitives(self, node) -> list:
        return self.json["meshes"][node["mesh"]]["primitives"] if "mesh" in node else []

    def _note(self, note: str):
        if note not in self.notes:
            self.notes.append(note)

    def _primitive(self, primitive):
        """(positions, triangles, normals or None, uv or None); None for points and lines."""
        names = primitive.get("attributes", {})
        if "POSITION" not in names:
            return None
        points = self._accessor(names["POSITION"], 3).astype(float)
        indices = primitive.get("indices")
        order = np.arange(len(points)) if indices is None else self._accessor(indices, 1)[:, 0].astype(np.int64)
        mode = primitive.get("mode", 4)
        if mode == 4:
            faces = order[: len(order) // 3 * 3].reshape(-1, 3)
        elif mode == 5:
            faces = np.stack([order[:-2], order[1:-1], order[2:]], axis=1)
            faces[1::2] = faces[1::2, ::-1]
        elif mode == 6:
            faces = np.stack([np.broadcast_to(order[:1], order[2:].shape), order[1:-1], order[2:]], axis=1)
        else:
            faces = np.zeros((0, 3), np.int64)
        normals = self._accessor(names["NORMAL"], 3).astype(float) if "NORMAL" in names else None
        channel = self._texture_set(primitive.get("material", -1))
        uv = self._accessor(names[channel], 2).astype(float) if channel in names else None
        if any(values is not None and len(values) != len(points) for values in (normals, uv)):
            raise InputError("a primitive's attributes differ in length; export it again")
        if uv is not None:
            uv[:, 1] = 1 - uv[:, 1]  # v counts downwards there
        return points, faces, normals, uv

    def _texture_set(self, material: int) -> str:
        materials = self.json.get("materials", [])
        look = materials[material] if 0 <= material < len(materials) else {}
        pbr = look.get("pbrMetallicRoughness", {})
        texture = pbr.get("baseColorTexture", look.get("normalTexture", {}))
        return f"TEXCOORD_{int(texture.get('texCoord', 0))}"

    def _accessor(self, number: int, width: int) -> np.ndarray:
        """The rows of an accessor; normalized whole numbers as fractions."""
        entry = self.json["accessors"][number]
        if "sparse" in entry or "bufferView" not in entry:
            raise InputError("sparse accessors are not read; export it without")
        view = self.json["bufferViews"][entry["bufferView"]]
        kind, count = np.dtype(_NUMBERS[entry["componentType"]]), entry["count"]
        if _WIDTHS[entry["type"]] != width:
            raise InputError(f"accessor {number} is of type {entry['type']}, not of {width} numbers; export it again")
        row = width * kind.itemsize
        step = view.get("byteStride", row)
        start = view.get("byteOffset", 0) + entry.get("byteOffset", 0)
        end = view.get("byteOffset", 0) + view["byteLength"]
        buffer = self.buffers[view["buffer"]]
        sound = all(type(n) is int and n >= 0 for n in (count, step, start, end)) and step >= row
        if not sound or end > len(buffer) or (count and start + step * (count - 1) + row > end):
            raise InputError(f"accessor {number} reaches beyond its buffer; export or copy it again")
        rows = np.ndarray((count, width), kind, buffer, start, (step, kind.itemsize)) if count else np.zeros((0, width))
        if entry.get("normalized") and kind.kind in "iu":
            return np.maximum(rows / float(np.iinfo(kind).max), -1)
        return rows

    def _joined(self, parts: dict[int, list]) -> RawMesh:
        nothing = np.zeros((0, 3))
        points, faces, normals, stated, uvs, part_of, named = (
            [nothing],
            [nothing.astype(int)],
            [nothing],
            [],
            [],
            [],
            [],
        )
        start = 0
        for material in sorted(parts):
            for positions, triangles, file_normals, uv in parts[material]:
                count = len(positions)
                inside = (triangles >= 0) & (triangles < count)
                points.append(positions)
                faces.append(np.where(inside, triangles + start, -1))
                normals.append(np.zeros_like(positions) if file_normals is None else file_normals)
                stated.append(np.full(count, file_normals is not None))
                uvs.append(np.full((count, 2), np.nan) if uv is None else uv)
                part_of.append(np.full(count, len(named)))
                start += count
            named.append(self._part(material))
        return RawMesh(
            np.concatenate(points),
            np.concatenate(faces),
            np.concatenate(normals),
            np.concatenate([np.zeros(0, bool), *stated]),
            np.concatenate([np.zeros((0, 2)), *uvs]),
            np.concatenate([np.zeros(0, np.int64), *part_of]),
            named,
            notes=self.notes,
            # Meshes without normals are flat, by the specification.
            smoothing=np.full(sum(map(len, faces)), FLAT_FACE),
        )

    def _part(self, number: int) -> FilePart:
        if number < 0:
            return FilePart("default")
        entry = self.json["materials"][number]
        return FilePart(str(entry.get("name") or f"material {number}"), self._material(entry))

    def _material(self, entry) -> FileMaterial:
        pbr, notes = entry.get("pbrMetallicRoughness", {}), []
        base = [min(max(float(c), 0.0), 1.0) for c in pbr.get("baseColorFactor", [1, 1, 1, 1])[:3]]
        metallic, roughness = (float(pbr.get(f"{name}Factor", 1)) for name in ("metallic", "roughness"))
        mixed = self._picture(pbr.get("metallicRoughnessTexture"), notes)
        if mixed is not None:
            notes.append("its texture of metalness and roughness is left out, their factors hold everywhere")
        red, green, blue = base
        picture = self._picture(pbr.get("baseColorTexture"), notes)
        material = metallic_roughness((red, green, blue), min(max(metallic, 0), 1), min(max(roughness, 0), 1), picture)
        material.normal_picture = self._picture(entry.get("normalTexture"), notes)
        if entry.get("normalTexture", {}).get("scale", 1) != 1:
            notes.append("the scale of its normal map is left out")
        material.two_sided = bool(entry.get("doubleSided", False))
        if entry.get("alphaMode", "OPAQUE") != "OPAQUE":
            notes.append("transparency is left out; it is opaque")
        if any(entry.get("emissiveFactor", [0])):
            notes.append("emission is left out")
        asked = [name for name in entry.get("extensions", {}) if name != "KHR_materials_unlit"]
        if asked:
            notes.append(f"extensions are left out: {', '.join(sorted(asked))}")
        material.notes += notes
        return material

    def _picture(self, texture, notes: list[str]) -> FilePicture | None:
        if texture is None:
            return None
        if "KHR_texture_transform" in texture.get("extensions", {}):
            notes.append("a texture's transform is left out")
        entry = self.json["textures"][texture["index"]]
        if "source" not in entry:
            notes.append("a texture of another kind than PNG or JPEG is left out")
            return None
        if "sampler" in entry:
            sampler = self.json["samplers"][entry["sampler"]]
            if {sampler.get("wrapS", 10497), sampler.get("wrapT", 10497)} != {10497}:
                notes.append("textures are repeated beyond their edges, though the file asks for another way")
        image = self.json["images"][entry["source"]]
        if "uri" in image:
            uri = str(image["uri"])
            return FilePicture(self._bytes(uri) if uri.startswith("data:") else self.folder / uri)
        view = self.json["bufferViews"][image["bufferView"]]
        start = view.get("byteOffset", 0)
        return FilePicture(self.buffers[view["buffer"]][start : start + view["byteLength"]])


def _matrix(node) -> Float[np.ndarray, "4 4"]:
    """A node's own transform: column by column, or translation · rotation · scale."""
    if "matrix" in node:
        return np.array(node["matrix"], float).reshape(4, 4).T
    x, y, z, w = np.array(node.get("rotation", [0, 0, 0, 1]), float)
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    matrix = np.eye(4)
    matrix[:3, :3] = turn * np.array(node.get("scale", [1, 1, 1]), float)
    matrix[:3, 3] = node.get("translation", [0, 0, 0])
    return matrix


def _moved(
    matrix: Float[np.ndarray, "4 4"],
    points: Float[np.ndarray, "v 3"],
    faces: Int[np.ndarray, "f 3"],
    normals: Float[np.ndarray, "v 3"] | None,
    uv: Float[np.ndarray, "v 2"] | None,
):
    """A primitive in its place. The cofactors turn normals, also where the matrix flattens the mesh."""
    linear = matrix[:3, :3]
    mirrors = np.linalg.det(linear) < 0
    if normals is not None:
        a, b, c = linear.T
        cofactors = np.stack([np.cross(b, c), np.cross(c, a), np.cross(a, b)], axis=1)
        normals = (normals @ cofactors.T) * (-1 if mirrors else 1)
    return points @ linear.T + matrix[:3, 3], faces[:, ::-1] if mirrors else faces, normals, uv
