"""Sound files of every format, made by code, and headers that lie about them."""

import io
import json
import struct
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from jaxrelight.geometry.primitives import sphere
from jaxrelight.images import tone_map
from jaxrelight.images.radiance_hdr import encode_radiance
from tests.brdf.files import writers
from tests.geometry.test_mesh import ascii_stl, binary_stl, obj, ply
from tests.images import exr_writer, radiance_writer


@dataclass
class Format:
    """One file format.

    Attributes:
        files: sound files by name.
        lies: files whose header promises more than there is, or more than memory holds, by what they claim.
        by_lines: whether nothing in a file says how long it is, so that a cut at the end of a line cannot be seen.
    """

    files: Mapping[str, bytes]
    lies: Mapping[str, bytes] = field(default_factory=dict)
    by_lines: bool = False


def formats() -> dict[str, Format]:
    """Every format, by its extension."""
    return {".exr": _exr(), ".hdr": _hdr(), ".png": _pillow("PNG"), ".jpg": _pillow("JPEG")} | {
        ".tga": _pillow("TGA"),
        ".webp": _pillow("WEBP"),
        ".ply": _ply(),
        ".obj": Format(
            {"plain": obj(_MESH).encode(), "normals": obj(_MESH, normals=True).encode(), "dialect": _obj_dialect()},
            by_lines=True,
        ),
        ".stl": _stl(),
        ".glb": _glb(),
        ".bsdf": _bsdf(),
        ".brdf": _brdf(),
    }


_MESH = sphere(0.5, 2)


def _picture() -> np.ndarray:
    """Radiance [24, 40, 3] with runs, noise, black and a sun."""
    pixels = np.random.default_rng(0).random((24, 40, 3)).astype(np.float32)
    pixels[:8, 10:30] = 0.25
    pixels[20:] = 0
    pixels[10, 10] = 1e4
    return pixels


def _changed(data: bytes, old: bytes, new: bytes) -> bytes:
    assert old in data
    return data.replace(old, new, 1)


def _exr() -> Format:
    import OpenEXR

    pixels, files = _picture(), {}
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder, "a.exr")
        for name in ("RLE", "ZIPS", "ZIP", "PIZ", "PXR24", "B44A", "DWAA", "DWAB"):
            for dtype in (np.float16, np.float32):
                header = {"compression": getattr(OpenEXR, f"{name}_COMPRESSION"), "type": OpenEXR.scanlineimage}
                OpenEXR.File(header, {"RGB": pixels.astype(dtype)}).write(str(path))
                files[f"{name} {np.dtype(dtype)}"] = path.read_bytes()
    planes = exr_writer.planes(pixels, "RGB")
    files["lines"] = exr_writer.picture(exr_writer.Part(planes))
    files["tiles"] = exr_writer.picture(exr_writer.Part(planes, tile=16))
    files["levels"] = exr_writer.picture(exr_writer.Part(planes, tile=16, mipmap=True))
    files["parts"] = exr_writer.picture(
        exr_writer.Part(exr_writer.planes(pixels, "Z")), exr_writer.Part(planes, tile=16)
    )
    lies, window = {}, b"\0box2i\0" + struct.pack("<5i", 16, 0, 0, 39, 23)
    for kind in ("lines", "tiles", "ZIP float32", "PIZ float16", "DWAB float16"):
        for width, height in (
            (2**30, 2**30),
            (65536, 65536),
            (11_000, 11_000),
            (2**22, 16),
            (40, 2**20),
            (41, 24),
            (40, 12),
            (39, 24),
            (20, 24),
        ):
            claimed = b"\0box2i\0" + struct.pack("<5i", 16, 0, 0, width - 1, height - 1)
            if (kind, width) == ("DWAB float16", 39):
                continue  # its blocks of 8 x 8 pixels are as many
            lies[f"{kind}, {width}x{height}"] = files[kind].replace(window, claimed)
    for size in (2**31 - 1, -1, 10**8):
        at = files["lines"].index(b"chlist\0") + 7
        data = files["lines"]
        lies[f"channel list of {size} bytes"] = data[:at] + struct.pack("<i", size) + data[at + 4 :]
    at = files["tiles"].index(b"tiledesc\0") + 13
    lies["tiles of 2^31"] = files["tiles"][:at] + struct.pack("<2I", 2**31, 2**31) + files["tiles"][at + 8 :]
    return Format(files, lies)


def _hdr() -> Format:
    pixels = _picture()
    rgbe = np.maximum(np.random.default_rng(0).integers(2, 256, (24, 40, 4)), 2).astype(np.uint8)
    rgbe[..., 3] = 120 + rgbe[..., 3] % 16
    rgbe[:, 10:30] = rgbe[:, 10:11]
    files = {coding: radiance_writer.picture(rgbe, coding) for coding in ("flat", "old", "new")}
    files["turned"] = radiance_writer.picture(rgbe, "new", "+X -Y", lines=["EXPOSURE=2", "FORMAT=32-bit_rle_rgbe"])
    files["ours"] = encode_radiance(pixels)
    sizes = ("-Y 65536 +X 65536", "-Y 999999999 +X 999999999", "-Y 24 +X 41", "-Y 25 +X 40", "-Y 1000000 +X 40",
             "-Y 40 +X 24", "-Y 12 +X 40", "-Y 24 +X 20", "-Y 2 +X 50000000")  # fmt: skip
    lies = {
        f"{coding}, {size}": _changed(files[coding], b"-Y 24 +X 40", size.encode())
        for coding in ("flat", "old", "new")
        for size in sizes
        if (coding, size) != ("flat", "-Y 40 +X 24")  # as many pixels, in rows that nothing marks
    }
    return Format(files, lies)


def _pillow(kind: str) -> Format:
    from PIL import Image

    stream = io.BytesIO()
    Image.fromarray(tone_map(_picture())).save(stream, kind)
    data = stream.getvalue()
    if kind in ("TGA", "WEBP"):
        return Format({"rgb": data})
    if kind == "JPEG":
        at = data.index(b"\xff\xc0") + 5
        return Format({"rgb": data}, {"65000x65000": data[:at] + struct.pack(">2H", 65000, 65000) + data[at + 4 :]})
    head = data.index(b"IHDR") + 4
    lies = {}
    for width, height in ((2**31 - 1, 2**31 - 1), (65536, 65536), (10_000, 10_000), (41, 24), (40, 25)):
        lies[f"{width}x{height}"] = data[:head] + struct.pack(">2I", width, height) + data[head + 8 :]
    return Format({"rgb": data}, lies)


def _ply() -> Format:
    vertices, faces = _MESH.vertices.tolist(), _MESH.faces.tolist()
    mixed = [*faces[2:], [0, 1, 2, 3]]
    files = {
        "ascii": ply(vertices, faces),
        "little": ply(vertices, faces, "binary_little_endian"),
        "big": ply(vertices, faces, "binary_big_endian"),
        "mixed": ply(vertices, mixed, "binary_little_endian"),
        "mixed ascii": ply(vertices, mixed),
        "corners": _ply_of_corners(),
        "strips": _ply_of_strips(),
    }
    counts = {
        b"element vertex 26": ("27", "4000000000", "99999999999999999999"),
        b"element face": ("40", "900", "4000000000"),
    }
    lies = {}
    for name in ("ascii", "little", "big", "mixed"):
        for line, claims in counts.items():
            start = files[name].index(line)
            end = files[name].index(b"\n", start)
            for claim in claims:
                new = b" ".join([*line.split()[:2], claim.encode()])
                lies[f"{name}, {new.decode()}"] = files[name][:start] + new + files[name][end:]
    for name, order in (("little", "<"), ("big", ">")):
        data = _changed(files[name], b"list uchar int", b"list uint int")
        body = data.index(b"end_header\n") + 11 + 12 * len(vertices)
        lies[f"{name}, a polygon of 2^32 corners"] = data[:body] + struct.pack(f"{order}I", 2**32 - 1) + data[body:]
    return Format(files, lies)


def _ply_of_corners() -> bytes:
    """Colours of vertices, and texture coordinates of the corners of faces."""
    header = (
        f"ply\nformat binary_little_endian 1.0\ncomment TextureFile a.png\nelement vertex {len(_MESH.vertices)}\n"
        "property float x\nproperty float y\nproperty float z\nproperty uchar red\nproperty uchar green\n"
        f"property uchar blue\nelement face {len(_MESH.faces)}\nproperty list uchar int vertex_indices\n"
        "property list uchar float texcoord\nend_header\n"
    )
    body = b"".join(struct.pack("<3f3B", *row, 9, 90, 200) for row in _MESH.vertices)
    uv = np.linspace(0, 1, 6).tolist()
    return header.encode() + body + b"".join(struct.pack("<B3iB6f", 3, *face, 6, *uv) for face in _MESH.faces)


def _ply_of_strips() -> bytes:
    """Every triangle a strip of its own."""
    strip = [corner for face in _MESH.faces for corner in (*face, -1)]
    header = (
        f"ply\nformat binary_little_endian 1.0\nelement vertex {len(_MESH.vertices)}\nproperty float x\n"
        "property float y\nproperty float z\nelement tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    )
    body = b"".join(struct.pack("<3f", *row) for row in _MESH.vertices)
    return header.encode() + body + struct.pack(f"<{1 + len(strip)}i", len(strip), *strip)


def _obj_dialect() -> bytes:
    """Smoothing groups, colours, names with spaces, and a polygon with a notch."""
    lines = ["mtllib some file.mtl", "o it", "v -1 -1 0 1 .5 0", "v 0 0 0 1 .5 0", "v 1 -1 0 1 .5 0", "v 0 1 0 1 .5 0"]
    lines += ["v 0 0 1 0 0 1", "vt 0 0", "vt 1 0", "vt 1 1", "usemtl Grey #1", "s 1", "f 1/1 2/2 3/3 4/1 # notched"]
    lines += ["s off", "usemtl Grey #2", "f 1/1 2/2 5/3", "f -5/1 -1/2 -3/3 \\", " -2/1", ""]
    return "\n".join(lines).encode()


def _stl() -> Format:
    files = {"ascii": ascii_stl(_MESH).encode(), "binary": binary_stl(_MESH)}
    data = files["binary"]
    lies = {f"{n} triangles": data[:80] + struct.pack("<I", n) + data[84:] for n in (49, 10**6, 2**32 - 1)}
    return Format(files, lies)


def glb(document: dict, content: bytes) -> bytes:
    """A binary glTF file of one JSON and one binary chunk."""
    text = json.dumps(document).encode()
    text += b" " * (-len(text) % 4)
    content += b"\0" * (-len(content) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + struct.pack("<I4s", len(content), b"BIN\0") + content
    return struct.pack("<4s2I", b"glTF", 2, 12 + len(chunks)) + chunks


def _glb() -> Format:
    parts = [
        (_MESH.vertices.astype("<f4"), 5126, "VEC3"),
        (_MESH.normals.astype("<f4"), 5126, "VEC3"),
        (_MESH.faces.astype("<u2").reshape(-1), 5123, "SCALAR"),
    ]
    content, views, accessors = b"", [], []
    for number, (array, component, kind) in enumerate(parts):
        views.append({"buffer": 0, "byteOffset": len(content), "byteLength": array.nbytes})
        accessors.append({"bufferView": number, "componentType": component, "count": len(array), "type": kind})
        content += array.tobytes() + b"\0" * (-array.nbytes % 4)
    accessors[0] |= {"min": _MESH.vertices.min(axis=0).tolist(), "max": _MESH.vertices.max(axis=0).tolist()}
    document = {
        "asset": {"version": "2.0"},
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "materials": [{"name": "paint", "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.5, 0.5, 1]}}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0, "NORMAL": 1}, "indices": 2, "material": 0}]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"byteLength": len(content)}],
    }
    lies = {}
    for table, entry, key, values in (
        ("accessors", 0, "count", (27, 10**9)),
        ("accessors", 2, "count", (10**6, 2**31)),
        ("bufferViews", 0, "byteLength", (10**9,)),
        ("bufferViews", 1, "byteOffset", (10**9, -12)),
        ("buffers", 0, "byteLength", (10**9, 2**40)),
    ):
        for value in values:
            changed = json.loads(json.dumps(document))
            changed[table][entry][key] = value
            lies[f"{table}[{entry}].{key} = {value}"] = glb(changed, content)
    whole = glb(document, content)
    for at, what in ((8, "file"), (12, "JSON chunk")):
        for length in (2**32 - 1, 10**9):
            lies[f"{what} of {length} bytes"] = whole[:at] + struct.pack("<I", length) + whole[at + 4 :]
    return Format({"sphere": whole}, lies)


def _bsdf() -> Format:
    whole, lies = writers.rgl(), {}
    for count in (0, 8, 10, 2**31):
        lies[f"{count} fields"] = whole[:14] + struct.pack("<I", count) + whole[18:]
    for name in (b"theta_i", b"vndf", b"rgb"):
        at = whole.index(struct.pack("<H", len(name)) + name) + 2 + len(name)
        dimensions, _, offset = struct.unpack_from("<HBQ", whole, at)
        for claim in (2**16 - 1, dimensions + 1, dimensions - 1):
            lies[f"{name.decode()} of {claim} dimensions"] = whole[:at] + struct.pack("<H", claim) + whole[at + 2 :]
        for claim in (11, 1, 99):
            lies[f"{name.decode()} of type {claim}"] = whole[: at + 2] + bytes([claim]) + whole[at + 3 :]
        for claim in (0, offset - 8, offset + 8, 2**63):
            lies[f"{name.decode()} at {claim}"] = whole[: at + 3] + struct.pack("<Q", claim) + whole[at + 11 :]
        (size,) = struct.unpack_from("<Q", whole, at + 11)
        for claim in (0, size + 1, 2**20, 2**62):
            lies[f"{name.decode()} of {claim}"] = whole[: at + 11] + struct.pack("<Q", claim) + whole[at + 19 :]
    return Format({"isotropic": whole, "anisotropic": writers.rgl(5)}, lies)


def _brdf() -> Format:
    angles, spectra, wavelengths = writers.cornell_pairs()
    files = {name: writers.cornell(angles, spectra, wavelengths, end) for name, end in (("lf", "\n"), ("crlf", "\r\n"))}
    lies = {}
    for claim in (2, 15, 17, 36, 10**9, 10**18):
        lies[f"{claim} wavelengths"] = _changed(files["lf"], b"num wls\n16", b"num wls\n%d" % claim)
    return Format(files, lies, by_lines=True)
