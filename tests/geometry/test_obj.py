"""OBJ files with materials and texture coordinates."""

import numpy as np
import pytest

from jaxrelight.geometry.file_materials import FilePicture
from jaxrelight.geometry.mesh import load_mesh, load_parts
from tests.shared_data import shared

SQUARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nv 2 0 1\n"


def _parts(folder, text: str):
    path = folder / "it.obj"
    path.write_text(text)
    return load_parts(path)


def test_materials_of_a_library(tmp_path):
    (tmp_path / "it.mtl").write_text(
        "# made up\nnewmtl wood\nKd 0.5 0.4 0.3\nmap_Kd -s 2 1 1 -cc on maps\\wood grain.png\n"
        "newmtl steel plate\nKd 0.1\nKs .6 .6 .6\nNs 80\nd 0.5\nKe 0 0 0\nnewmtl odd\nKd red\n"
    )
    faces = "usemtl wood\nf 1 2 3\nusemtl steel plate\nf 1 3 4\nusemtl odd\nf 2 5 3\nusemtl lost\nf 3 5 4\n"
    wood, steel, odd, lost = _parts(tmp_path, f"mtllib it.mtl\n{SQUARE}{faces}")
    assert [part.name for part in (wood, steel, odd, lost)] == ["wood", "steel plate", "odd", "lost"]
    assert wood.material is not None
    assert steel.material is not None
    assert odd.material is not None
    assert lost.material is None
    assert wood.material.diffuse == (0.5, 0.4, 0.3)
    placement = (2.0, 0.0, 0.0), (0.0, 1.0, 0.0)
    assert wood.material.diffuse_picture == FilePicture(tmp_path / "maps" / "wood grain.png", placement=placement)
    assert wood.material.notes == ["options -cc of the image wood grain.png are left out"]
    assert (steel.material.diffuse, steel.material.specular) == ((0.1, 0.1, 0.1), (0.6, 0.6, 0.6))
    assert steel.material.exponent == 80
    assert steel.material.notes == ["transparency is left out; it is opaque"]
    assert "'Kd red' of the library is not understood" in odd.material.notes[0]


def test_texture_coordinates_below_0_and_beyond_1_stay(tmp_path):
    text = SQUARE + "vt -3.5 0\nvt 7 0\nvt 7 1e3 0.5\nf 1/1 2/2 3/3\nf 1/-3 3/-1 4/1\n"
    (part,) = _parts(tmp_path, text)
    assert part.mesh.notes == ()
    assert part.mesh.uv is not None
    np.testing.assert_array_equal(part.mesh.uv, [[-3.5, 0], [7, 0], [7, 1000], [-3.5, 0]])


@pytest.mark.parametrize("bad", ["3", "3/9", "3/-9", "3/2"])
def test_texture_coordinates_that_are_missing_are_told(tmp_path, bad):
    (part,) = _parts(tmp_path, f"{SQUARE}vt 0.5 0.5\nvt nan 1\nf 1/1 2/1 {bad}\n")
    assert part.mesh.notes == ("default: texture coordinates are missing at 1 of 3 vertices; (0, 0) is taken",)
    np.testing.assert_array_equal(part.mesh.uv, [[0.5, 0.5], [0.5, 0.5], [0, 0]])


def test_without_texture_coordinates(tmp_path):
    (part,) = _parts(tmp_path, f"{SQUARE}vt inf 0\nf 1/1 2/1 3/1\nf 1 3 4\n")
    assert part.mesh.uv is None
    assert part.mesh.notes == ()


def test_normals_are_shared_across_seams_and_materials(tmp_path):
    roof = "v 0 0 0\nv 1 .3 0\nv 2 0 0\nv 0 0 1\nv 1 .3 1\nv 2 0 1\nvt 0 0\nvt 1 1\n"
    left, right = "f 1/1 4/1 5/1\nf 1/1 5/1 2/1\n", "f 2/2 5/2 6/2\nf 2/2 6/2 3/2\n"
    path = tmp_path / "roof.obj"
    for between in ("", "usemtl other\n"):
        path.write_text(roof + left + between + right)
        mesh = load_mesh(path)
        top = mesh.vertices[:, 1] == 0.3
        assert top.sum() == 4  # texture coordinates differ
        np.testing.assert_allclose(mesh.normals[top], [[0, 1, 0]] * 4, atol=1e-12)
        sharp = load_mesh(path, 20.0)
        assert np.abs(sharp.normals[sharp.vertices[:, 1] == 0.3][:, 0]).min() > 0.2


def test_sponza_comes_whole():
    parts = load_parts(shared("data", "mesh", "sponza_crytek_stripped.obj"))
    assert len(parts) == 11
    assert all(part.material is None and part.mesh.uv is not None for part in parts)


# ---- as people's programs write them ---------------------------------------------------------------------------------

FACE = "f 1 2 3\nf 1 3 4\n"


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16", "utf-32"])
def test_byte_order_marks(tmp_path, encoding: str):
    (tmp_path / "it.obj").write_bytes((SQUARE + FACE).encode(encoding))
    mesh = load_mesh(tmp_path / "it.obj")
    np.testing.assert_array_equal(mesh.vertices, [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]])


def test_names_with_hashes_and_comments_after_them(tmp_path):
    (tmp_path / "my #1 lib.mtl").write_text("newmtl Rough #1\nKd .1\nnewmtl Rough #2\nKd .2\nnewmtl plain\nKd .3\n")
    names = "usemtl\tRough #1\nf\t1 2 3 # one\nusemtl Rough #2\nf 1 3 4#two\nusemtl plain # three\nf 2 5 3\n"
    parts = _parts(tmp_path, f"# it\nmtllib my #1 lib.mtl\n{SQUARE}{names}")
    assert [part.material.diffuse[0] if part.material else None for part in parts] == [0.1, 0.2, 0.3]


def test_several_libraries_on_a_line(tmp_path):
    for name, kd in (("a.mtl", 0.1), ("my b.mtl", 0.2), ("c", 0.3)):
        (tmp_path / name).write_text(f"newmtl {name[-5] if len(name) > 4 else 'c'}\nKd {kd}\n")
    text = f"{SQUARE}usemtl a\nf 1 2 3\nusemtl b\nf 1 3 4\n"
    for line in ("a.mtl my b.mtl", "a.mtl  my b.mtl ", ".\\a.mtl my b.mtl"):
        parts = _parts(tmp_path, f"mtllib {line}\n{text}")
        assert [part.material.diffuse[0] if part.material else None for part in parts] == [0.1, 0.2]
    (part,) = _parts(tmp_path, f"mtllib a.mtl c\n{SQUARE}usemtl c\nf 1 2 3\n")
    assert part.material is not None
    parts = _parts(tmp_path, f"mtllib lost.mtl\n{text}")
    assert "its material library 'lost.mtl' is missing" in parts[0].mesh.notes[0]


def test_images_lie_beside_their_library(tmp_path):
    (tmp_path / "mats").mkdir()
    (tmp_path / "mats" / "it.mtl").write_text("newmtl a\nmap_Kd t.png\n")
    (tmp_path / "mats" / "t.png").write_bytes(b"x")
    (part,) = _parts(tmp_path, f"mtllib mats\\it.mtl\n{SQUARE}usemtl a\nf 1 2 3\n")
    assert part.material is not None
    assert part.material.diffuse_picture == FilePicture(tmp_path / "mats" / "t.png")


@pytest.mark.parametrize("colour", ["0.7 0.1 0.2", "178.5 25.5 51", "1 0.7 0.1 0.2"])
def test_colours_of_vertices(tmp_path, colour: str):
    """With positions alone, of 255, and after a weight."""
    words = colour.split()
    colour = colour if len(words) == 3 else " ".join([*words[1:], words[0]])
    rows = "".join(f"v {place} {colour}\n" for place in ("0 0 0", "1 0 0", "1 1 0", "0 1 0"))
    (part,) = _parts(tmp_path, rows + FACE)
    assert part.mesh.colours is not None
    np.testing.assert_allclose(part.mesh.colours, [[0.7, 0.1, 0.2]] * 4)
    assert part.material is not None
    assert part.material.diffuse == (1.0, 1.0, 1.0)


NOTCHED = "v -1 -1 0\nv 0 0 0\nv 1 -1 0\nv 0 1 0\n"


@pytest.mark.parametrize("turn", range(4))
@pytest.mark.parametrize("tilt", [0.0, 1.0])
def test_notches_of_polygons_stay_open(tmp_path, turn: int, tilt: float):
    corners = np.roll([1, 2, 3, 4], turn)
    rows = "".join(f"v {x} {y} {tilt * x + 2 * tilt * y}\n" for x, y in ((-1, -1), (0, 0), (1, -1), (0, 1)))
    mesh = load_mesh(_written(tmp_path, f"{rows}f {' '.join(map(str, corners))}\n"))
    places = mesh.vertices[mesh.faces]
    area = np.cross(places[:, 1] - places[:, 0], places[:, 2] - places[:, 0])
    assert (area[:, 2] > 0).all()
    np.testing.assert_allclose(area[:, 2].sum() / 2, 1)
    assert mesh.notes == ()


def test_a_star_is_triangulated_with_its_texture_coordinates(tmp_path):
    turn = np.linspace(0, 2 * np.pi, 10, endpoint=False)
    reach = np.where(np.arange(10) % 2, 0.4, 1.0)
    rows = "".join(f"v {r * np.cos(t)} {r * np.sin(t)} 0\nvt {t} {r}\n" for t, r in zip(turn, reach, strict=True))
    mesh = load_mesh(_written(tmp_path, f"{rows}f {' '.join(f'{i}/{i}' for i in range(1, 11))}\n"))
    corners = mesh.vertices[mesh.faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] / 2
    np.testing.assert_allclose(area.sum(), 10 * 0.5 * 0.4 * np.sin(np.pi / 5))
    assert mesh.uv is not None
    np.testing.assert_allclose(mesh.uv[:, 1], np.linalg.norm(mesh.vertices, axis=1), atol=1e-9)


def _written(folder, text: str):
    path = folder / "polygon.obj"
    path.write_text(text)
    return path
