"""A small writer of glTF files, for the tests of the reader."""

import json
import struct
from typing import Any

import numpy as np

_KINDS = {"<f4": 5126, "<i2": 5122, "<u2": 5123, "<u4": 5125, "|i1": 5120, "|u1": 5121}
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4", 16: "MAT4"}


class Gltf:
    """A file in the making: its description and its one buffer."""

    def __init__(self):
        self.json: dict[str, Any] = {"asset": {"version": "2.0"}, "accessors": [], "bufferViews": [], "meshes": []}
        self.json |= {"nodes": [], "materials": []}
        self.binary = b""

    def view(self, data: bytes) -> int:
        """Number of a buffer view of bytes."""
        self.binary += bytes(-len(self.binary) % 4)
        self.json["bufferViews"].append({"buffer": 0, "byteOffset": len(self.binary), "byteLength": len(data)})
        self.binary += data
        return len(self.json["bufferViews"]) - 1

    def accessor(self, rows, kind: str = "<f4", **more) -> int:
        """Number of an accessor of rows."""
        rows = np.asarray(rows, kind)
        width = rows.shape[1] if rows.ndim == 2 else 1
        entry = {"bufferView": self.view(rows.tobytes()), "componentType": _KINDS[rows.dtype.str], "count": len(rows)}
        self.json["accessors"].append({**entry, "type": _TYPES[width], **more})
        return len(self.json["accessors"]) - 1

    def sparse(self, count: int, at, rows, base=None) -> int:
        """Number of an accessor of rows of three numbers, some of which are replaced; the others zeros without base."""
        indices = {"bufferView": self.view(np.asarray(at, "<u2").tobytes()), "componentType": 5123}
        values = {"bufferView": self.view(np.asarray(rows, "<f4").tobytes())}
        entry = {"componentType": 5126, "count": count, "type": "VEC3"}
        entry |= {} if base is None else {"bufferView": self.view(np.asarray(base, "<f4").tobytes())}
        self.json["accessors"].append({**entry, "sparse": {"count": len(at), "indices": indices, "values": values}})
        return len(self.json["accessors"]) - 1

    def mesh(self, positions, indices=None, normals=None, uv=None, attributes=None, **more) -> int:
        """Number of a mesh of one primitive; uv as the file counts it, v downwards."""
        attributes = {"POSITION": self.accessor(positions), **(attributes or {})}
        attributes |= {} if normals is None else {"NORMAL": self.accessor(normals)}
        attributes |= {} if uv is None else {"TEXCOORD_0": self.accessor(uv)}
        primitive = {"attributes": attributes, **more}
        primitive |= {} if indices is None else {"indices": self.accessor(np.ravel(indices), "<u2")}
        self.json["meshes"].append({"primitives": [primitive]})
        return len(self.json["meshes"]) - 1

    def glb(self) -> bytes:
        """The binary form."""
        self.json["buffers"] = [{"byteLength": len(self.binary)}]
        text = json.dumps(self.json).encode()
        text += b" " * (-len(text) % 4)
        binary = self.binary + bytes(-len(self.binary) % 4)
        body = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(binary), b"BIN\0") + binary
        return b"glTF" + struct.pack("<II", 2, 12 + len(body)) + body
