"""Sharp edges: by crease angle, by smoothing groups, by format; and smooth ones across materials."""

import json
from typing import Any

import numpy as np
import pytest
import trimesh

from jaxrelight.errors import InputError
from jaxrelight.geometry.creases import BY_ANGLE, FLAT_FACE, smooth_normals, split_vertices
from jaxrelight.geometry.mesh import Mesh, face_normals, load_mesh, load_parts
from jaxrelight.geometry.primitives import sphere

CUBE = trimesh.creation.box((1, 1, 1))
# Two slopes that meet in a ridge at x = 0, whose normals differ by 2 atan(0.8) = 77 degrees.
RIDGE = "v -1 -1 -0.8\nv 0 -1 0\nv 0 1 0\nv -1 1 -0.8\nv 1 -1 -0.8\nv 1 1 -0.8\n"
SLOPES = "f 1 2 3 4\n", "f 2 5 6 3\n"


def is_flat(mesh: Mesh) -> bool:
    """Whether all corners have their face's normal."""
    return bool(np.abs(mesh.normals[mesh.faces] - face_normals(mesh)[:, None]).max() < 1e-9)


def written(folder, name: str, text: str):
    path = folder / name
    path.write_text(text)
    return path


@pytest.mark.parametrize("suffix", ["stl", "ply", "obj"])
def test_a_box_is_sharp_in_every_format(tmp_path, suffix: str):
    path = tmp_path / f"box.{suffix}"
    options: Any = {"ply": {"vertex_normal": False}, "obj": {"include_normals": False}}.get(suffix, {})
    content: Any = CUBE.export(file_type=suffix, **options)
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    mesh = load_mesh(path)
    assert is_flat(mesh)
    assert len(mesh.vertices) == 24
    assert "12 edges sharper than 40 degrees are creases (crease_angle)" in mesh.notes[-1]
    round_box = load_mesh(path, 180.0)
    assert len(round_box.vertices) == 8
    np.testing.assert_allclose(np.abs(round_box.normals), 3**-0.5, atol=0.2)


@pytest.mark.parametrize(("angle", "flat"), [(30.0, True), (76.0, True), (78.0, False), (180.0, False)])
def test_the_crease_angle_decides(tmp_path, angle: float, flat: bool):
    path = written(tmp_path, "ridge.obj", RIDGE + "".join(SLOPES))
    assert is_flat(load_mesh(path, angle)) == flat
    assert is_flat(load_mesh(path))


def test_smoothing_groups_decide_whatever_the_angle(tmp_path):
    for first, second, flat in (("off", "off", True), ("0", "0", True), ("1", "1", False), ("1", "2", True)):
        text = f"{RIDGE}s {first}\n{SLOPES[0]}s {second}\n{SLOPES[1]}"
        assert is_flat(load_mesh(written(tmp_path, "ridge.obj", text))) == flat
    gentle = RIDGE.replace("-0.8", "-0.1")
    assert is_flat(load_mesh(written(tmp_path, "gentle.obj", f"{gentle}s off\n{''.join(SLOPES)}")))
    assert not is_flat(load_mesh(written(tmp_path, "gentle.obj", gentle + "".join(SLOPES))))
    # What a scene asks for takes the place of what the file says.
    assert not is_flat(load_mesh(written(tmp_path, "ridge.obj", f"{RIDGE}s off\n{''.join(SLOPES)}"), 80.0))


def test_gltf_without_normals_is_flat(tmp_path):
    ball = sphere(0.5, 4)
    points, faces = ball.vertices.astype("<f4").tobytes(), ball.faces.astype("<u4").tobytes()
    (tmp_path / "it.bin").write_bytes(points + faces)
    views = [{"buffer": 0, "byteOffset": 0, "byteLength": len(points)}]
    views.append({"buffer": 0, "byteOffset": len(points), "byteLength": len(faces)})
    accessors = [
        {"bufferView": 0, "componentType": 5126, "count": len(ball.vertices), "type": "VEC3"},
        {"bufferView": 1, "componentType": 5125, "count": ball.faces.size, "type": "SCALAR"},
    ]
    text = {
        "asset": {"version": "2.0"},
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0}],
        "meshes": [{"primitives": [{"attributes": {"POSITION": 0}, "indices": 1}]}],
        "accessors": accessors,
        "bufferViews": views,
        "buffers": [{"uri": "it.bin", "byteLength": len(points) + len(faces)}],
    }
    path = written(tmp_path, "it.gltf", json.dumps(text))
    assert is_flat(load_mesh(path))
    assert not is_flat(load_mesh(path, 60.0))


def test_a_smooth_surface_is_seamless_across_materials(tmp_path):
    ball = sphere(1.0, 8)
    lines = ["v {} {} {}".format(*row) for row in ball.vertices.tolist()]
    faces = ["f {} {} {}".format(*(face + 1)) for face in ball.faces]
    half = len(faces) // 2
    one = load_mesh(written(tmp_path, "one.obj", "\n".join([*lines, *faces, ""])))
    text = "\n".join([*lines, "usemtl a", *faces[:half], "usemtl b", *faces[half:], ""])
    parts = [part.mesh for part in load_parts(written(tmp_path, "two.obj", text))]
    normals = np.concatenate([part.normals[part.faces] for part in parts])
    np.testing.assert_allclose(normals, one.normals[one.faces], atol=1e-12)


def test_an_edge_that_ends_on_a_smooth_surface_fades_out():
    """A roof whose slopes level out: its ridge is sharp where it begins, and all faces share a normal where it ends."""
    x, y = np.meshgrid([-1.0, 0, 1], [0.0, 3, 6])
    z = np.where((x != 0) & (y == 0), -0.8, 0)
    vertices = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    faces = np.array(
        [[0, 1, 4], [0, 4, 3], [1, 2, 4], [2, 5, 4], [3, 4, 7], [3, 7, 6], [4, 5, 7], [5, 8, 7]],
    )
    normals, sharp = smooth_normals(vertices, faces, np.full(8, BY_ANGLE), 50.0)
    np.testing.assert_array_equal(sharp, [[0, 2]])
    assert np.ptp(normals[faces == 4], axis=0).max() < 1e-12
    begin = normals[faces == 1]
    assert begin[0] @ begin[1] < 0.3
    flat, none = smooth_normals(vertices, faces, np.full(8, FLAT_FACE), 180.0)
    assert len(none) == 0
    assert np.ptp(flat, axis=1).max() < 1e-12


def test_splitting_keeps_vertices_that_need_no_other_normal():
    ball = sphere(1.0, 4)
    corners = ball.normals[ball.faces]
    faces, of_vertex, normals = split_vertices(ball.faces, corners, np.zeros(ball.faces.shape, bool))
    np.testing.assert_array_equal(faces, ball.faces)
    np.testing.assert_array_equal(of_vertex, np.arange(len(ball.vertices)))
    np.testing.assert_array_equal(normals, ball.normals)


@pytest.mark.parametrize("angle", [-1.0, 181.0, float("nan")])
def test_angles_out_of_range_are_refused(tmp_path, angle: float):
    with pytest.raises(InputError, match="crease_angle is"):
        load_mesh(written(tmp_path, "ridge.obj", RIDGE + SLOPES[0]), angle)


# ---- normals of the file ---------------------------------------------------------------------------------------------


def plate(normal: str, two: bool = False) -> str:
    faces = "f 1//1 2//1 3//1 4//1\n" + ("f 4//2 3//2 2//2 1//2\n" if two else "")
    return f"v -1 -1 0\nv 1 -1 0\nv 1 1 0\nv -1 1 0\nvn {normal}\nvn 0 0 -1\n{faces}"


def test_normals_against_the_winding_turn_the_faces(tmp_path):
    mesh = load_mesh(written(tmp_path, "plate.obj", plate("0 0 -1")))
    np.testing.assert_allclose(face_normals(mesh), [[0, 0, -1]] * 2)
    assert mesh.notes == ("turned 2 of 2 faces: they faced away from the file's normals",)
    assert load_mesh(written(tmp_path, "plate.obj", plate("0 0 1"))).notes == ()


def test_normals_into_a_closed_surface_are_turned(tmp_path):
    ball = sphere(1.0, 6)
    lines = ["v {} {} {}".format(*row) for row in ball.vertices.tolist()]
    lines += ["vn {} {} {}".format(*(-row)) for row in ball.normals]
    lines += ["f {0}//{0} {1}//{1} {2}//{2}".format(*(face + 1)) for face in ball.faces]
    mesh = load_mesh(written(tmp_path, "ball.obj", "\n".join([*lines, ""])))
    np.testing.assert_allclose(np.sum(mesh.normals * mesh.vertices, axis=1), 1, atol=1e-6)
    assert (np.sum(face_normals(mesh) * mesh.vertices[mesh.faces[:, 0]], axis=1) > 0).all()
    assert "pointed into closed surfaces" in mesh.notes[0]


def test_a_face_among_others_whose_normals_oppose_it_gets_its_own(tmp_path):
    """As game foliage has: both sides of a card with the normals of one."""
    text = plate("0 0 1", two=True).replace("//2", "//1")
    mesh = load_mesh(written(tmp_path, "card.obj", text))
    assert is_flat(mesh)
    assert mesh.notes == ("normals computed for 2 faces: the file's point to their other side",)
