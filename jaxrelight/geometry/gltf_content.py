"""What a glTF file holds, looked up by number: buffers, the rows of accessors, images. What it drops is noted."""

import base64
import json
import pathlib
import urllib.parse
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxrelight.errors import InputError

# Instances of one mesh, and accessors without data, can ask for more than any memory.
MAX_CORNERS = 2**28

_NUMBERS = {5120: "i1", 5121: "u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_WIDTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4, "MAT4": 16}
_READ = {
    "EXT_mesh_gpu_instancing",
    "EXT_texture_webp",
    "KHR_lights_punctual",
    "KHR_materials_emissive_strength",
    "KHR_materials_ior",
    "KHR_materials_pbrSpecularGlossiness",
    "KHR_materials_specular",
    "KHR_materials_unlit",
    "KHR_mesh_quantization",
    "KHR_node_visibility",
    "KHR_texture_transform",
}
_REMEDIES = {
    "KHR_draco_mesh_compression": "export it without compression of meshes",
    "EXT_meshopt_compression": "export it without compression (gltfpack without -c or -cc)",
    "KHR_meshopt_compression": "export it without compression (gltfpack without -c or -cc)",
    "KHR_texture_basisu": "export its textures as PNG, JPEG or WebP",
    "EXT_texture_avif": "export its textures as PNG, JPEG or WebP",
}


class Content:
    """Looks things up in a file's JSON; whatever is missing or of the wrong kind raises.

    Attributes:
        json: the file's description.
        folder: the file's.
        notes: what was left out or assumed, each once.
    """

    def __init__(self, text: bytes, binary: bytes | None, folder: pathlib.Path):
        try:
            self.json: Any = json.loads(text)
        except (ValueError, RecursionError):
            raise InputError("its description is no JSON; export or copy it again") from None
        if not isinstance(self.json, dict) or not str(self.json.get("asset", {}).get("version", "")).startswith("2"):
            raise InputError("not a glTF 2.0 file; export it as glTF 2.0")
        for name in map(str, self.json.get("extensionsRequired", [])):
            if name not in _READ:
                raise InputError(f"needs the extension {name[:40]}, which is not read; {remedy(name)}")
        self.folder, self.notes = folder, []
        self._check_used()
        self._buffers: list[bytes | None] = []
        for number, entry in enumerate(self.json.get("buffers", [])):
            content = (
                self.read_bytes(str(entry["uri"]), "buffer") if "uri" in entry else binary if number == 0 else None
            )
            if content is None and any("meshopt" in name for name in entry.get("extensions", {})):
                self._buffers.append(None)  # only compressed views need it
                continue
            if content is None or len(content) < entry["byteLength"]:
                raise InputError(f"cut short: buffer {number} has {entry['byteLength']} bytes promised; copy it again")
            self._buffers.append(content)

    def entries(self, kind: str) -> list:
        """All of a kind, such as the nodes."""
        return self.json.get(kind, [])

    def note(self, note: str) -> None:
        """Tells something once."""
        if note not in self.notes:
            self.notes.append(note)

    def _check_used(self) -> None:
        # Materials tell theirs, by the parts that have them.
        of_materials = {name for entry in self.entries("materials") for name in entry.get("extensions", {})}
        used = map(str, self.json.get("extensionsUsed", []))
        left_out = sorted({name for name in used if name not in _READ and name not in of_materials})
        if left_out:
            self.note(f"extensions are left out: {', '.join(name[:40] for name in left_out)}")
        if self.entries("animations"):
            self.note("animations are left out: it stands as its nodes do without them")

    def path(self, uri: str) -> pathlib.Path:
        """The file that a URI names; percent signs and backslashes count as they are where that is a file's name."""
        decoded = urllib.parse.unquote(uri)
        names = dict.fromkeys([decoded, uri, decoded.replace("\\", "/")])
        return next((path for path in map(self.folder.joinpath, names) if path.is_file()), self.folder / decoded)

    def read_bytes(self, uri: str, what: str) -> bytes:
        """The bytes of a data URI or of a file beside this one."""
        if uri[:5].lower() == "data:":
            head, _, content = uri.partition(",")
            data = urllib.parse.unquote_to_bytes(content)
            return base64.b64decode(data) if head.lower().endswith(";base64") else data
        try:
            path = self.path(uri)
            if not path.is_file():
                raise OSError("a pipe or a device could go on for ever")
            return path.read_bytes()
        except (OSError, ValueError):
            raise InputError(f"its {what} '{uri[:80]}' cannot be read; put it beside the file") from None

    def view(self, number: int) -> tuple[bytes, int, int, dict]:
        """A buffer, where in it a view begins and ends, and the view's description."""
        entry = self.entries("bufferViews")[number]
        buffer = self._buffers[entry["buffer"]]
        if buffer is None:
            name = next((name for name in entry.get("extensions", {})), "EXT_meshopt_compression")
            raise InputError(f"needs the extension {name[:40]}, which is not read; {remedy(name)}")
        start = entry.get("byteOffset", 0)
        return buffer, start, start + entry["byteLength"], entry

    def image_bytes(self, number: int) -> bytes:
        """The bytes of an image that lies in a buffer view."""
        buffer, start, end, _ = self.view(number)
        return buffer[start:end]

    def accessor(self, number: int, width: int | Sequence[int], *, fractions: bool = False) -> np.ndarray:
        """The rows of an accessor; normalized whole numbers as fractions.

        Args:
            number: the accessor's.
            width: of its rows, or those that are allowed.
            fractions: whether whole numbers are normalized, even if the file does not say so.
        """
        entry = self.entries("accessors")[number]
        kind, count = np.dtype(_NUMBERS[entry["componentType"]]), entry["count"]
        widths = [width] if isinstance(width, int) else width
        columns = _WIDTHS[entry["type"]]
        if columns not in widths:
            wanted = " or ".join(map(str, widths))
            raise InputError(f"accessor {number} is of type {entry['type']}, not of {wanted} numbers; export it again")
        if type(count) is not int or not 0 <= count <= MAX_CORNERS:
            raise InputError(f"accessor {number} reaches beyond its buffer; export or copy it again")
        if "bufferView" in entry:
            rows = self._rows(number, entry, kind, count, columns)
        else:
            rows = np.zeros((count, columns), kind)
        if "sparse" in entry:
            rows = self._replaced(number, entry["sparse"], rows)
        if kind.kind in "iu" and (fractions or entry.get("normalized")):
            return np.maximum(rows / float(np.iinfo(kind).max), -1)
        return rows

    def _rows(self, number: int, entry: dict, kind: np.dtype, count: int, columns: int) -> np.ndarray:
        """Rows that a buffer view holds at an entry's offset."""
        buffer, begin, end, view = self.view(entry["bufferView"])
        row = columns * kind.itemsize
        step, start = view.get("byteStride", row), begin + entry.get("byteOffset", 0)
        sound = all(type(n) is int and n >= 0 for n in (count, step, start, end)) and step >= row
        if not sound or end > len(buffer) or (count and start + step * (count - 1) + row > end):
            raise InputError(f"accessor {number} reaches beyond its buffer; export or copy it again")
        if not count:
            return np.zeros((0, columns), kind)
        return np.ndarray((count, columns), kind, buffer, start, (step, kind.itemsize))

    def _replaced(self, number: int, sparse: dict, rows: np.ndarray) -> np.ndarray:
        """Rows of which a sparse accessor replaces some."""
        count, indices = sparse["count"], sparse["indices"]
        whole = np.dtype(_NUMBERS[indices["componentType"]])
        at = self._rows(number, indices, whole, count, 1)[:, 0].astype(np.int64)
        values = self._rows(number, sparse["values"], rows.dtype, count, rows.shape[1])
        if (at < 0).any() or (at >= len(rows)).any():
            raise InputError(f"accessor {number} replaces rows that it does not have; export it again")
        rows = rows.copy()
        rows[at] = values
        return rows


def remedy(extension: str) -> str:
    """What to do about an extension that is not read."""
    return _REMEDIES.get(extension, "export it without")
