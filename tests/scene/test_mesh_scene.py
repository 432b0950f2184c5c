"""A mesh file by itself as a scene."""

import numpy as np
import pytest

from jaxrelight import InputError
from jaxrelight.geometry.mesh import joint_bounds
from jaxrelight.lights.local import Point
from jaxrelight.scene.mesh_scene import open_scene, scene_of_mesh
from tests.geometry.test_mesh import FILES, written

# Longest along x, y and z in turn, far from the origin.
SHAPES = [(9.0, 1.0, 1.0), (1.0, 9.0, 1.0), (1.0, 1.0, 9.0)]


def _stretched(factors) -> str:
    lines = FILES["plain.obj"].decode().splitlines()
    moved = [
        " ".join(["v", *(str(1e3 + f * float(x)) for f, x in zip(factors, line.split()[1:], strict=True))])
        if line.startswith("v ")
        else line
        for line in lines
    ]
    return "\n".join([*moved, ""])


@pytest.mark.parametrize("factors", SHAPES)
def test_it_stands_on_the_floor_and_is_seen_whole(tmp_path, factors):
    scene = open_scene(written(tmp_path, "thing.obj", _stretched(factors)))
    thing, floor = scene.parts
    low, high = joint_bounds([thing.mesh])
    assert low[1] == pytest.approx(0, abs=1e-12)
    assert (high - low).max() == pytest.approx(1)
    assert floor.mesh.vertices[:, 1].max() == 0
    camera = scene.camera
    rays = camera.directions()
    forward = np.subtract(camera.target, camera.origin)
    forward /= np.linalg.norm(forward)
    right, down = rays[0, -1] - rays[0, 0], rays[-1, 0] - rays[0, 0]
    right, down = right / np.linalg.norm(right), down / np.linalg.norm(down)
    offset = thing.mesh.vertices - np.array(camera.origin)
    slope = np.stack([offset @ right, offset @ down], axis=1) / (offset @ forward)[:, None]
    filled = np.abs(slope).max() / np.tan(np.radians(camera.fov_y / 2))
    assert 0.6 < filled < 0.95
    assert scene.lights.environment is not None


def test_what_was_assumed_is_told(tmp_path):
    scene = scene_of_mesh(written(tmp_path, "thing.ply", FILES["ascii.ply"]))
    notes = " ".join(scene.notes)
    for words in ("scaled to a longest side of 1 m", "put on a floor", "built-in sky", "plaster is taken"):
        assert words in notes
    assert [part.material for part in scene.parts] == ["plaster", "floor"]


def test_materials_of_the_file_are_kept(tmp_path):
    (tmp_path / "it.mtl").write_text("newmtl a\nKd 0.25 0.5 0.75\n")
    text = "mtllib it.mtl\nv 0 0 0\nv 1 0 0\nv 0 1 0\nusemtl a\nf 1 2 3\nusemtl b\nf 1 3 2\n"
    scene = scene_of_mesh(written(tmp_path, "it.obj", text))
    assert [part.material for part in scene.parts] == ["it.obj:a", "plaster", "floor"]


def test_faults_are_those_of_the_file(tmp_path):
    with pytest.raises(InputError, match=r"a\.ply: not a PLY file|a\.ply: cannot be read"):
        open_scene(written(tmp_path, "a.ply", b"x"))
    with pytest.raises(InputError, match="cannot be read as a scene"):
        open_scene(tmp_path / "a.toml")


def _inward(text: str) -> str:
    return "\n".join(
        [" ".join(["f", *reversed(line.split()[1:])]) if line.startswith("f") else line for line in text.splitlines()]
        + [""]
    )


BOX = """v 0 0 0\nv 8 0 0\nv 8 3 0\nv 0 3 0\nv 0 0 4\nv 8 0 4\nv 8 3 4\nv 0 3 4
f 1 4 3 2\nf 5 6 7 8\nf 1 5 8 4\nf 2 3 7 6\nf 1 2 6 5\nf 4 8 7 3
"""


def test_rooms_are_seen_from_inside(tmp_path):
    """A room of 8 × 3 × 4 m, scaled to 1: the eye stands in it and looks along it."""
    scene = scene_of_mesh(written(tmp_path, "room.obj", _inward(BOX)))
    eye, target = np.asarray(scene.camera.origin), np.asarray(scene.camera.target)
    assert (np.abs(eye[[0, 2]]) < [0.5, 0.25]).all()
    assert 0.3 < eye[1] / 0.375 < 0.6
    along = (target - eye) / np.linalg.norm(target - eye)
    assert abs(along[0]) > 0.8
    assert abs(along[1]) < 1e-6
    notes = " ".join(scene.notes)
    assert "seen from inside, as its walls face inwards, under a built-in sky and a lamp near the ceiling" in notes
    assert "100% of what is seen are backs of faces; taken as two-sided" in notes
    (lamp,) = scene.lights.local
    assert isinstance(lamp, Point)
    assert eye[1] < np.asarray(lamp.position)[1] < 0.375
    assert scene.parts[0].mesh.two_sided


def test_closed_bodies_are_seen_from_outside(tmp_path):
    scene = scene_of_mesh(written(tmp_path, "box.obj", BOX))
    assert not scene.parts[0].mesh.two_sided
    assert scene.lights.local == ()
    assert "seen from the front (+z) by a camera that frames it" in " ".join(scene.notes)


def test_bodies_with_a_few_backs_are_two_sided_and_seen_from_outside(tmp_path):
    """A box without its lid: some of its inside is seen."""
    scene = scene_of_mesh(written(tmp_path, "open.obj", BOX.replace("f 4 8 7 3\n", "")))
    assert scene.parts[0].mesh.two_sided
    assert scene.lights.local == ()


def test_the_floor_keeps_clear_of_faces_at_its_height(tmp_path):
    flat = scene_of_mesh(written(tmp_path, "box.obj", BOX))
    assert flat.parts[-1].mesh.vertices[:, 1].max() == pytest.approx(-1e-3)


def test_meshes_may_have_z_up(tmp_path):
    path = written(tmp_path, "box.obj", BOX)
    low, high = joint_bounds([scene_of_mesh(path, up="z").parts[0].mesh])
    np.testing.assert_allclose(high - low, [1, 0.5, 0.375])
    low, high = joint_bounds([open_scene(path).parts[0].mesh])
    np.testing.assert_allclose(high - low, [1, 0.375, 0.5])
