"""glTF files: nodes in their places, a part for each material, and files that lie."""

import base64
import io
import json

import numpy as np
import pytest
import trimesh
from PIL import Image

from jaxrelight.errors import InputError
from jaxrelight.geometry.file_materials import FilePicture
from jaxrelight.geometry.mesh import face_normals, load_mesh, load_parts
from tests.geometry.gltf_writer import Gltf
from tests.shared_data import shared

TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
QUAD, QUAD_FACES = [[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 1, 2], [0, 2, 3]]


def _written(folder, gltf: Gltf, name: str = "it.glb"):
    path = folder / name
    path.write_bytes(gltf.glb())
    return path


def _refusal(path) -> str:
    with pytest.raises(InputError) as caught:
        load_mesh(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    return message


def test_what_another_writer_wrote(tmp_path):
    """trimesh as oracle: two moved meshes, one of them mirrored."""
    scene = trimesh.Scene()
    ball = trimesh.creation.icosphere(2)
    mirror = np.diag([-1.0, 2.0, 1.0, 1.0])
    mirror[:3, 3] = 3, 0, 1
    scene.add_geometry(ball, node_name="a")
    scene.add_geometry(trimesh.creation.box((1, 2, 3)), node_name="b", transform=mirror)
    path = tmp_path / "scene.glb"
    path.write_bytes(scene.export(file_type="glb"))  # pyright: ignore[reportArgumentType]
    mesh, wanted = load_mesh(path), scene.to_mesh()
    corners = np.sort(mesh.vertices[mesh.faces].mean(axis=1).round(4), axis=0)
    np.testing.assert_allclose(corners, np.sort(wanted.triangles_center.round(4), axis=0), atol=2e-4)
    a, b, c = (mesh.vertices[mesh.faces[:, k]] for k in range(3))
    volume = float(np.sum(a * np.cross(b, c)))
    assert volume / 6 == pytest.approx(ball.volume + 12, rel=1e-5)  # all faces still turn outwards


def test_parts_are_materials_with_what_is_said_of_them(tmp_path):
    gltf, picture = Gltf(), io.BytesIO()
    Image.fromarray(np.full((2, 2, 3), 255, np.uint8)).save(picture, "PNG")
    gltf.json["images"] = [{"bufferView": gltf.view(picture.getvalue()), "mimeType": "image/png"}]
    gltf.json["textures"] = [{"source": 0}]
    gltf.json["materials"] = [
        {"name": "wood", "pbrMetallicRoughness": {"baseColorTexture": {"index": 0}, "metallicFactor": 0}},
        {
            "name": "steel",
            "doubleSided": True,
            "alphaMode": "BLEND",
            "pbrMetallicRoughness": {"baseColorFactor": [0.5, 0.6, 0.7, 1], "roughnessFactor": 0.3},
        },
    ]
    uv = [[0, 0], [1, 0], [0, 0.25]]
    meshes = [gltf.mesh(TRIANGLE, uv=uv, material=0), gltf.mesh(QUAD, QUAD_FACES, material=1), gltf.mesh(TRIANGLE)]
    gltf.json["nodes"] = [{"mesh": number, "translation": [0, 0, number]} for number in meshes]
    bare, wood, steel = load_parts(_written(tmp_path, gltf))
    assert [part.name for part in (bare, wood, steel)] == ["default", "wood", "steel"]
    assert bare.material is None
    assert wood.mesh.uv is not None
    np.testing.assert_allclose(wood.mesh.uv, [[0, 1], [1, 1], [0, 0.75]])
    assert wood.material is not None
    assert wood.material.diffuse_picture == FilePicture(picture.getvalue())
    assert wood.material.specular == (0, 0, 0)  # as rough as can be
    assert steel.material is not None
    assert steel.mesh.two_sided
    assert not wood.mesh.two_sided
    assert steel.material.diffuse == (0, 0, 0)
    np.testing.assert_allclose(steel.material.specular, (0.5, 0.6, 0.7))
    assert steel.material.exponent == pytest.approx((1 / 0.3**4 - 1) / 2)
    assert steel.material.notes == ["transparency (alphaMode BLEND) is left out; it is opaque"]


def test_nodes_compose_and_a_mesh_may_be_used_again(tmp_path):
    gltf = Gltf()
    number = gltf.mesh(TRIANGLE, normals=[[0, 0, 1]] * 3)
    quarter = [0, 0, np.sqrt(0.5), np.sqrt(0.5)]  # +x to +y
    gltf.json["nodes"] = [
        {"children": [1], "rotation": quarter, "translation": [10, 0, 0]},
        {"mesh": number, "scale": [2, 2, 2], "translation": [1, 0, 0]},
        {"mesh": number, "matrix": [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, -1, 0, 0, 0, 5, 1]},
    ]
    mesh = load_mesh(_written(tmp_path, gltf))
    places = {tuple(row) for row in mesh.vertices.round(5).tolist()}
    assert places == {(10, 1, 0), (10, 3, 0), (8, 1, 0), (0, 0, 5), (1, 0, 5), (0, 1, 5)}
    flipped = mesh.vertices[:, 2] == 5
    np.testing.assert_allclose(mesh.normals, np.where(flipped[:, None], [0, 0, -1], [0, 0, 1]), atol=1e-6)
    np.testing.assert_allclose(face_normals(mesh)[:, 2], np.where(flipped[mesh.faces[:, 0]], -1, 1), atol=1e-6)


@pytest.mark.parametrize(("mode", "order"), [(5, [0, 1, 3, 2]), (6, [0, 1, 2, 3])])
def test_strips_and_fans(tmp_path, mode, order):
    gltf = Gltf()
    gltf.json["nodes"] = [{"mesh": gltf.mesh(QUAD, order, mode=mode)}]
    mesh = load_mesh(_written(tmp_path, gltf))
    assert len(mesh.faces) == 2
    np.testing.assert_allclose(face_normals(mesh), [[0, 0, 1]] * 2)


def test_text_with_its_buffer_within_and_beside(tmp_path):
    gltf = Gltf()
    gltf.json["nodes"] = [{"mesh": gltf.mesh(TRIANGLE)}]
    gltf.glb()
    path = tmp_path / "it.gltf"
    within = "data:application/octet-stream;base64," + base64.b64encode(gltf.binary).decode()
    for uri in (within, "it.bin"):
        gltf.json["buffers"] = [{"byteLength": len(gltf.binary), "uri": uri}]
        path.write_text(json.dumps(gltf.json))
        if uri == "it.bin":
            assert "its buffer 'it.bin' cannot be read" in _refusal(path)
            (tmp_path / "it.bin").write_bytes(gltf.binary)
        np.testing.assert_array_equal(load_mesh(path).vertices, TRIANGLE)
    (tmp_path / "it.bin").rename(tmp_path / "my buffer.bin")
    gltf.json["buffers"][0]["uri"] = "my%20buffer.bin"
    path.write_text(json.dumps(gltf.json))
    np.testing.assert_array_equal(load_mesh(path).vertices, TRIANGLE)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda j: j["accessors"][0].update(count=10**9), "reaches beyond its buffer"),
        (lambda j: j["accessors"][0].update(byteOffset=-4), "reaches beyond its buffer"),
        (lambda j: j["bufferViews"][0].update(byteLength=10**12), "reaches beyond its buffer"),
        (lambda j: j["accessors"][0].pop("bufferView"), "1 of 1 faces are unusable"),
        (lambda j: j["accessors"][0].update(type="VEC2"), "is of type VEC2, not of 3 numbers"),
        (lambda j: j["nodes"][0].update(children=[0]), "is below several others"),
        (lambda j: j.update(extensionsRequired=["KHR_draco_mesh_compression"]), "KHR_draco_mesh_compression"),
        (lambda j: j["asset"].update(version="1.0"), "not a glTF 2.0 file"),
        (lambda j: j["nodes"][0].update(mesh=7), "damaged or no GLB file"),
        (lambda j: j["nodes"][0].update(rotation=[0, 0]), "damaged or no GLB file"),
        (lambda j: j["meshes"].clear(), "damaged or no GLB file"),
        (lambda j: j["nodes"].clear(), "empty, no vertices"),
    ],
)
def test_files_that_lie_are_refused(tmp_path, change, words):
    gltf = Gltf()
    gltf.json["nodes"] = [{"mesh": gltf.mesh(TRIANGLE)}]
    gltf.json["scenes"] = [{"nodes": [0] if words != "empty, no vertices" else []}]
    change(gltf.json)
    assert words in _refusal(_written(tmp_path, gltf))


def test_cut_anywhere_is_refused(tmp_path):
    gltf = Gltf()
    gltf.json["nodes"] = [{"mesh": gltf.mesh(QUAD, QUAD_FACES)}]
    content, path = gltf.glb(), tmp_path / "cut.glb"
    for length in np.linspace(0, len(content) - 1, 20).astype(int):
        path.write_bytes(content[:length])
        _refusal(path)


def test_the_staircase_comes_whole():
    parts = load_parts(shared("data", "mesh", "staircase", "staircase_by_material.glb"))
    assert len(parts) == len({part.name for part in parts}) == 24
    assert sum(len(part.mesh.faces) for part in parts) > 0.999 * 262_661
    assert all(
        part.material is not None and part.material.diffuse[0] == pytest.approx(0.7843, abs=1e-4) for part in parts
    )
