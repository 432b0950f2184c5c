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
