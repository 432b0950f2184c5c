"""PLY files with what scanners and their programs write beside triangles."""

import struct

import numpy as np
import pytest

from jaxrelight.geometry.file_materials import FilePicture
from jaxrelight.geometry.mesh import load_mesh, load_parts
from jaxrelight.images.tone import srgb_decode

SQUARE = [(-1, -1, 0), (1, -1, 0), (1, 1, 0), (-1, 1, 0)]
XYZ = "property float x\nproperty float y\nproperty float z\n"


def written(folder, header: str, rows: str, name: str = "it.ply"):
    path = folder / name
    path.write_text(f"ply\nformat ascii 1.0\n{header}end_header\n{rows}")
    return path


def points(extra: tuple = ()) -> str:
    return "".join(
        " ".join(map(str, (*place, *more))) + "\n" for place, more in zip(SQUARE, extra or [()] * 4, strict=True)
    )


def test_texture_coordinates_of_corners(tmp_path):
    (tmp_path / "t.png").write_bytes(b"x")
    header = (
        f"comment TextureFile t.png\nelement vertex 4\n{XYZ}element face 2\n"
        "property list uchar int vertex_indices\nproperty list uchar float texcoord\n"
    )
    rows = points() + "3 0 1 2 6 0 0 1 0 1 1\n3 0 2 3 6 0.5 0 1 1 0 1\n"
    (part,) = load_parts(written(tmp_path, header, rows))
    assert part.material is not None
    assert part.material.diffuse_picture == FilePicture(tmp_path / "t.png")
    assert part.mesh.uv is not None
    np.testing.assert_allclose(part.mesh.uv[part.mesh.faces], [[[0, 0], [1, 0], [1, 1]], [[0.5, 0], [1, 1], [0, 1]]])
    assert len(part.mesh.vertices) == 5
    np.testing.assert_allclose(part.mesh.normals, [[0, 0, 1]] * 5)


def test_faces_of_several_images(tmp_path):
    header = (
        f"comment TextureFile a.png\ncomment TextureFile b.png\nelement vertex 4\n{XYZ}element face 2\n"
        "property list uchar int vertex_indices\nproperty list uchar float texcoord\nproperty int texnumber\n"
    )
    rows = points() + "3 0 1 2 6 0 0 1 0 1 1 1\n3 0 2 3 6 0 0 1 1 0 1 0\n"
    parts = load_parts(written(tmp_path, header, rows))
    assert [part.name for part in parts] == ["a", "b"]
    assert [len(part.mesh.faces) for part in parts] == [1, 1]
    np.testing.assert_array_equal(parts[1].mesh.vertices, SQUARE[:3])


@pytest.mark.parametrize(("kind", "value", "wanted"), [("uchar", 200, srgb_decode(200 / 255)), ("float", 0.5, 0.5)])
def test_colours_of_vertices_and_of_faces(tmp_path, kind: str, value: float, wanted: float):
    names = "".join(f"property {kind} {name}\n" for name in ("red", "green", "blue"))
    face = "element face 1\nproperty list uchar int vertex_indices\n"
    of_vertices = written(
        tmp_path, f"element vertex 4\n{XYZ}{names}{face}", points(((value, 0, value),) * 4) + "4 0 1 2 3\n"
    )
    of_faces = written(
        tmp_path, f"element vertex 4\n{XYZ}{face}{names}", f"{points()}4 0 1 2 3 {value} 0 {value}\n", "f.ply"
    )
    for path in (of_vertices, of_faces):
        (part,) = load_parts(path)
        assert part.mesh.colours is not None
        np.testing.assert_allclose(part.mesh.colours, [[wanted, 0, wanted]] * 4, atol=1e-6)
        assert any("taken as sRGB" in note for note in part.mesh.notes) == (kind == "uchar")


@pytest.mark.parametrize("order", ["little", "big"])
def test_triangle_strips(tmp_path, order: str):
    sign = "<" if order == "little" else ">"
    places = [(-1, -1, 0), (1, -1, 0), (-1, 1, 0), (1, 1, 0)]
    strip = (0, 1, 2, 3, -1, 4, 5, 6)
    more = [(5, 0, 0), (6, 0, 0), (5, 1, 0)]
    header = (
        f"ply\nformat binary_{order}_endian 1.0\nelement vertex 7\n{XYZ}"
        "element tristrips 1\nproperty list int int vertex_indices\nend_header\n"
    )
    body = b"".join(struct.pack(f"{sign}3f", *place) for place in places + more)
    path = tmp_path / "strips.ply"
    path.write_bytes(header.encode() + body + struct.pack(f"{sign}i8i", 8, *strip))
    mesh = load_mesh(path)
    assert len(mesh.faces) == 3
    np.testing.assert_allclose(mesh.normals, [[0, 0, 1]] * 7)
    assert mesh.notes == ()


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian"])
def test_notches_of_polygons_stay_open(tmp_path, encoding: str):
    places = [(-1, -1, 0), (0, 0, 0), (1, -1, 0), (0, 1, 0)]
    header = (
        f"ply\nformat {encoding} 1.0\nelement vertex 4\n{XYZ}element face 2\n"
        "property list uchar int vertex_indices\nend_header\n"
    )
    rows = "".join("{} {} {}\n".format(*place) for place in places) + "4 0 1 2 3\n3 0 1 3\n"
    binary = b"".join(struct.pack("<3f", *place) for place in places) + struct.pack(
        "<B4iB3i", 4, 0, 1, 2, 3, 3, 0, 1, 3
    )
    path = tmp_path / "notch.ply"
    path.write_bytes(header.encode() + (rows.encode() if encoding == "ascii" else binary))
    mesh = load_mesh(path)
    corners = mesh.vertices[mesh.faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] / 2
    assert (area > 0).all()
    assert len(mesh.faces) == 2  # the third is a repetition
    np.testing.assert_allclose(area.sum(), 1)
