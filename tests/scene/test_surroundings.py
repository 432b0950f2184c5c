"""Lights and cameras of mesh files: used where the scene names none, moved with the mesh, and reported."""

import json

import numpy as np
import pytest

from jaxrelight import InputError
from jaxrelight.lights.local import Directional, Point, Spot
from jaxrelight.scene.mesh_scene import scene_of_mesh
from jaxrelight.scene.scene import Scene
from jaxrelight.scene.scene_file import load_scene
from tests.geometry.gltf_writer import Gltf
from tests.shared_data import shared

QUAD, FACES = [[-1, 0, -1], [1, 0, -1], [1, 2, 1], [-1, 2, 1]], [[0, 2, 1], [0, 3, 2]]
TURNED = [0.0, np.sqrt(0.5), 0.0, np.sqrt(0.5)]  # −z to −x


def _lit_quad(folder, lights, *, camera=None, below=(0, 0, 0)):
    """A file whose lights and camera hang below a node that is moved and turned."""
    gltf = Gltf()
    gltf.json["nodes"] = [{"mesh": gltf.mesh(QUAD, FACES)}]
    gltf.json["extensions"] = {"KHR_lights_punctual": {"lights": lights}}
    gltf.json["extensionsUsed"] = ["KHR_lights_punctual"]
    children: list[dict] = [{"extensions": {"KHR_lights_punctual": {"light": i}}} for i in range(len(lights))]
    if camera is not None:
        gltf.json["cameras"] = [camera]
        children.append({"camera": 0, "name": "eye"})
    numbers = [2 + i for i in range(len(children))]
    gltf.json["nodes"] += [{"translation": list(below), "rotation": TURNED, "children": numbers}, *children]
    (folder / "it.glb").write_bytes(gltf.glb())


def _scene(folder, more: str = "", keys: str = "") -> Scene:
    (folder / "scene.toml").write_text(f'{more}\n[[mesh]]\nfile = "it.glb"\n{keys}\n')
    return load_scene(folder / "scene.toml")


CAMERA = "[camera]\norigin = [0, 0, 5]\ntarget = [0, 0, 0]\n"
SUN = {"type": "directional", "color": [1, 0.5, 0], "intensity": 3, "name": "sun"}
LAMP = {"type": "point", "intensity": 8}
CONE = {"type": "spot", "intensity": 2, "range": 9, "spot": {"innerConeAngle": 0.2, "outerConeAngle": 0.5}}


def test_lights_stand_where_their_nodes_do(tmp_path):
    _lit_quad(tmp_path, [SUN, LAMP, CONE], below=(1, 2, 3))
    scene = _scene(tmp_path, CAMERA)
    sun, lamp, cone = scene.lights.local
    assert isinstance(sun, Directional)
    assert isinstance(lamp, Point)
    assert isinstance(cone, Spot)
    np.testing.assert_allclose(sun.direction, [-1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(sun.irradiance, [3, 1.5, 0])
    np.testing.assert_allclose(lamp.position, [1, 2, 3])
    np.testing.assert_allclose(lamp.intensity, [8, 8, 8])
    along = np.array([[-9.0, 2, 3], [1 - 9 * np.cos(0.6), 2 + 9 * np.sin(0.6), 3]], np.float32)
    np.testing.assert_allclose(np.asarray(cone.at(along).irradiance)[:, 0], [2 / 100, 0], rtol=1e-5)
    notes = "\n".join(scene.notes)
    assert (
        "it.glb: its lights are used, lux and candela as W/m² and W/sr: 'sun' (directional), 'point' (point)" in notes
    )
    assert "the range of lights is left out" in notes
    assert "spots fall off linearly" in notes


def test_lights_and_cameras_move_with_the_mesh(tmp_path):
    """Twice as large and one up: a lamp at twice the distance lights as before if it is four times as strong."""
    lens = {"type": "perspective", "perspective": {"yfov": 0.5, "znear": 0.1, "aspectRatio": 2}}
    _lit_quad(tmp_path, [SUN, LAMP], camera=lens, below=(4, 1, 0))
    transform = "transform = [[2, 0, 0, 0], [0, 2, 0, 1], [0, 0, 2, 0], [0, 0, 0, 1]]"
    scene = _scene(tmp_path, keys=transform)
    sun, lamp = scene.lights.local
    assert isinstance(sun, Directional)
    assert isinstance(lamp, Point)
    np.testing.assert_allclose(sun.irradiance, [3, 1.5, 0])
    np.testing.assert_allclose(lamp.position, [8, 3, 0], atol=1e-9)
    np.testing.assert_allclose(lamp.intensity, [32] * 3, rtol=1e-6)
    np.testing.assert_allclose(scene.camera.origin, [8, 3, 0], atol=1e-9)
    np.testing.assert_allclose(scene.camera.target, [0, 3, 0], atol=1e-9)  # the middle of the mesh, along its axis
    np.testing.assert_allclose(scene.camera.up, [0, 1, 0], atol=1e-9)
    assert scene.camera.fov_y == pytest.approx(np.degrees(0.5))
    assert (scene.camera.width, scene.camera.height) == (1024, 512)
    assert "it.glb: seen by its camera 'eye'" in scene.notes


def test_the_scenes_own_win(tmp_path):
    lens = {"type": "perspective", "perspective": {"yfov": 0.5, "znear": 0.1}}
    _lit_quad(tmp_path, [SUN], camera=lens)
    own = '[[light]]\ntype = "point"\nposition = [0, 3, 0]\nintensity = 1\n'
    scene = _scene(tmp_path, CAMERA + own)
    assert len(scene.lights.local) == 1
    assert isinstance(scene.lights.local[0], Point)
    assert scene.camera.origin == (0, 0, 5)
    assert "it.glb: its lights are left out, the scene has its own: 'sun' (directional)" in scene.notes
    assert "it.glb: its camera 'eye' is left out, the scene has one" in scene.notes


def test_a_scene_needs_a_camera_from_somewhere(tmp_path):
    _lit_quad(tmp_path, [], camera={"type": "orthographic", "orthographic": {"xmag": 1, "ymag": 1, "znear": 0}})
    with pytest.raises(InputError, match="'camera' is missing"):
        _scene(tmp_path)
    scene = _scene(tmp_path, CAMERA)
    assert any("the camera 'eye' is left out: only perspective ones are read" in note for note in scene.notes)


def test_lights_that_cannot_be_are_left_out(tmp_path):
    _lit_quad(tmp_path, [{"type": "spot", "spot": {"innerConeAngle": 0.5, "outerConeAngle": 0.2}}])
    scene = _scene(tmp_path, CAMERA)
    assert not scene.lights.local
    assert any("its light 'spot' is left out:" in note for note in scene.notes)
    _lit_quad(tmp_path, [{"type": "point", "intensity": -1}])
    with pytest.raises(InputError, match="intensity is not finite or negative"):
        _scene(tmp_path, CAMERA)


def test_a_mesh_file_alone_is_seen_by_its_camera_and_has_its_lights(tmp_path):
    """Its longest side of 2 m becomes 1 m: positions halve, intensities are a quarter."""
    lens = {"type": "perspective", "perspective": {"yfov": 0.5, "znear": 0.1}}
    _lit_quad(tmp_path, [LAMP], camera=lens, below=(4, 1, 0))
    scene = scene_of_mesh(tmp_path / "it.glb")
    np.testing.assert_allclose(scene.camera.origin, [2, 0.5, 0], atol=1e-9)
    (lamp,) = scene.lights.local
    assert isinstance(lamp, Point)
    np.testing.assert_allclose(lamp.position, [2, 0.5, 0], atol=1e-9)
    np.testing.assert_allclose(lamp.intensity, [2] * 3, rtol=1e-6)
    assert scene.lights.environment is not None
    assert scene.parts[-1].name == "floor"
    assert not any("a camera that frames it" in note for note in scene.notes)
    _lit_quad(tmp_path, [], camera=lens, below=(4, -1, 0))
    assert "floor" not in [part.name for part in scene_of_mesh(tmp_path / "it.glb").parts]


def test_a_reported_file():
    scene = load_scene(shared("data", "reported", "x2_lights", "scene.toml"))
    (sun,) = scene.lights.local
    assert isinstance(sun, Directional)
    np.testing.assert_allclose(sun.irradiance, [5, 5, 5])
    np.testing.assert_allclose(sun.direction, [0, 0, -1])
    description = json.loads(shared("data", "reported", "x2_lights", "q.gltf").read_text())
    assert description["cameras"][0]["perspective"]["yfov"] == 0.3
    assert any("its camera 'camera 0' is left out" in note for note in scene.notes)
