"""What moves and bends meshes of glTF files: instances, skins, morph targets; and how their numbers are stored."""

import numpy as np
import pytest

from jaxrelight.errors import InputError
from jaxrelight.geometry.mesh import Mesh, face_normals, load_mesh, load_parts
from tests.geometry.gltf_writer import Gltf
from tests.shared_data import shared

TRIANGLE = [[0, 0, 0], [1, 0, 0], [0, 1, 0]]
UP = [[0, 0, 1]] * 3
QUARTER = [0.0, 0.0, np.sqrt(0.5), np.sqrt(0.5)]  # +x to +y


def _loaded(folder, gltf: Gltf) -> Mesh:
    (folder / "it.glb").write_bytes(gltf.glb())
    return load_mesh(folder / "it.glb")


def _refusal(folder, gltf: Gltf) -> str:
    (folder / "it.glb").write_bytes(gltf.glb())
    with pytest.raises(InputError) as caught:
        load_mesh(folder / "it.glb")
    assert "\n" not in str(caught.value)
    return str(caught.value)


def _places(mesh: Mesh) -> set[tuple[float, ...]]:
    return {tuple(row) for row in (mesh.vertices.round(4) + 0.0).tolist()}


# ---- instances -------------------------------------------------------------------------------------------------------


def test_instances_are_turned_and_scaled_in_their_node(tmp_path):
    gltf = Gltf()
    attributes = {
        "TRANSLATION": gltf.accessor([[0, 0, 0], [10, 0, 0]]),
        "ROTATION": gltf.accessor([[0, 0, 0, 1], QUARTER]),
        "SCALE": gltf.accessor([[1, 1, 1], [2, 3, 1]]),
        "_ID": gltf.accessor([0, 1]),
    }
    node = {"mesh": gltf.mesh(TRIANGLE, normals=UP), "translation": [0, 0, 5]}
    gltf.json["nodes"] = [{**node, "extensions": {"EXT_mesh_gpu_instancing": {"attributes": attributes}}}]
    gltf.json["extensionsRequired"] = ["EXT_mesh_gpu_instancing"]
    mesh = _loaded(tmp_path, gltf)
    assert _places(mesh) == {(0, 0, 5), (1, 0, 5), (0, 1, 5), (10, 0, 5), (10, 2, 5), (7, 0, 5)}
    np.testing.assert_allclose(mesh.normals, [[0, 0, 1]] * 6, atol=1e-6)
    assert mesh.notes == ()


def test_rotations_of_instances_may_be_small_whole_numbers(tmp_path):
    gltf = Gltf()
    rotation = gltf.accessor(np.round(32767 * np.array([QUARTER])), "<i2", normalized=True)
    extension = {"EXT_mesh_gpu_instancing": {"attributes": {"ROTATION": rotation}}}
    gltf.json["nodes"] = [{"mesh": gltf.mesh(TRIANGLE), "extensions": extension}]
    assert _places(_loaded(tmp_path, gltf)) == {(0, 0, 0), (0, 1, 0), (-1, 0, 0)}


def test_instances_that_differ_in_number_or_are_too_many_are_refused(tmp_path):
    gltf = Gltf()
    attributes = {"TRANSLATION": gltf.accessor([[0, 0, 0]]), "SCALE": gltf.accessor([[1, 1, 1]] * 2)}
    extension = {"EXT_mesh_gpu_instancing": {"attributes": attributes}}
    gltf.json["nodes"] = [{"mesh": gltf.mesh(TRIANGLE), "extensions": extension}]
    assert "instances differ in length" in _refusal(tmp_path, gltf)
    attributes.pop("SCALE")
    gltf.json["accessors"][0] = {"componentType": 5126, "type": "VEC3", "count": 2**27}  # zeros that take no bytes
    assert "more than 4,194,304 instances" in _refusal(tmp_path, gltf)
    gltf.json["accessors"][0]["count"] = 2**19
    gltf.json["meshes"][0]["primitives"] *= 96
    assert "more than 268 million" in _refusal(tmp_path, gltf)


# ---- skins -----------------------------------------------------------------------------------------------------------


def _arm(gltf: Gltf, node: dict | None = None, **skin) -> None:
    """A triangle, whose first two corners follow joint 0 and whose third follows joint 1; both are nodes above it."""
    attributes = {
        "JOINTS_0": gltf.accessor([[0, 0, 0, 0], [0, 0, 0, 0], [1, 0, 0, 0]], "|u1"),
        "WEIGHTS_0": gltf.accessor([[1, 0, 0, 0]] * 3),
    }
    mesh = gltf.mesh(TRIANGLE, normals=UP, attributes=attributes)
    gltf.json["nodes"] = [
        {"translation": [0, 0, 3], "children": [1]},
        {"translation": [0, 2, 0]},
        {"mesh": mesh, "skin": 0, **(node or {})},
    ]
    gltf.json["skins"] = [{"joints": [0, 1], **skin}]


def test_skinned_vertices_follow_joints_and_not_their_node(tmp_path):
    gltf = Gltf()
    _arm(gltf, {"translation": [100, 0, 0], "rotation": QUARTER})
    mesh = _loaded(tmp_path, gltf)
    assert _places(mesh) == {(0, 0, 3), (1, 0, 3), (0, 3, 3)}  # the third one by both joints' transforms
    assert mesh.notes == ("meshes with skins stand as their joints do",)


def test_inverse_bind_matrices_come_first(tmp_path):
    gltf = Gltf()
    back = np.tile(np.eye(4), (2, 1, 1))
    back[1, :3, 3] = -1, 0, 0
    _arm(gltf, inverseBindMatrices=gltf.accessor(back.transpose(0, 2, 1).reshape(2, 16)))
    assert _places(_loaded(tmp_path, gltf)) == {(0, 0, 3), (1, 0, 3), (-1, 3, 3)}


def test_two_skins_and_weights_of_two_sets_and_small_numbers(tmp_path):
    """One mesh with two skins stands twice; shares in bytes that do not add up to one are scaled."""
    gltf = Gltf()
    joints, halves = np.zeros((3, 4)), np.tile([100, 0, 0, 0], (3, 1))
    attributes = {"JOINTS_0": gltf.accessor(joints, "<u2"), "WEIGHTS_0": gltf.accessor(halves, "|u1", normalized=True)}
    attributes |= {"JOINTS_1": gltf.accessor(joints + 1, "|u1"), "WEIGHTS_1": gltf.accessor(halves, "|u1")}
    mesh = gltf.mesh(TRIANGLE, attributes=attributes)
    gltf.json["nodes"] = [{"mesh": mesh, "skin": 0}, {"mesh": mesh, "skin": 1}]
    gltf.json["nodes"] += [{"translation": [0, 0, height]} for height in (2, 4, 12, 14)]
    gltf.json["skins"] = [{"joints": [2, 3]}, {"joints": [4, 5]}]
    heights = {place[2] for place in _places(_loaded(tmp_path, gltf))}
    assert heights == {3, 13}


def test_a_mirroring_joint_keeps_the_front(tmp_path):
    gltf = Gltf()
    _arm(gltf)
    gltf.json["nodes"][0]["scale"] = [-1, 1, 1]
    mesh = _loaded(tmp_path, gltf)
    np.testing.assert_allclose(mesh.normals, UP, atol=1e-6)
    np.testing.assert_allclose(face_normals(mesh), [[0, 0, 1]], atol=1e-6)


def test_joints_that_a_skin_does_not_have_are_refused(tmp_path):
    gltf = Gltf()
    _arm(gltf)
    gltf.json["skins"][0]["joints"] = [0]
    assert "a joint that its skin does not have" in _refusal(tmp_path, gltf)
    _arm(gltf := Gltf())
    gltf.json["nodes"][1]["children"] = [0]
    assert "node" in _refusal(tmp_path, gltf)


# ---- morph targets ---------------------------------------------------------------------------------------------------


def test_default_weights_of_morph_targets_and_of_their_node(tmp_path):
    gltf = Gltf()
    up, right = (gltf.accessor([delta] * 3) for delta in ([0, 0, 1], [2, 0, 0]))
    mesh = gltf.mesh(TRIANGLE, targets=[{"POSITION": up}, {"POSITION": right}])
    gltf.json["meshes"][mesh]["weights"] = [0.5, 0]
    gltf.json["nodes"] = [{"mesh": mesh}, {"mesh": mesh, "weights": [0, 1], "translation": [0, 0, 9]}]
    mesh = _loaded(tmp_path, gltf)
    assert _places(mesh) == {(0, 0, 0.5), (1, 0, 0.5), (0, 1, 0.5), (2, 0, 9), (3, 0, 9), (2, 1, 9)}


def test_targets_without_weights_do_nothing(tmp_path):
    gltf = Gltf()
    gltf.json["nodes"] = [{"mesh": gltf.mesh(TRIANGLE, targets=[{"POSITION": gltf.accessor([[9, 9, 9]] * 3)}])}]
    mesh = _loaded(tmp_path, gltf)
    assert _places(mesh) == {(0, 0, 0), (1, 0, 0), (0, 1, 0)}
    assert mesh.notes == ()


def test_normals_and_coordinates_morph_too(tmp_path):
    """Normals are of unit length again, and displacements may be sparse."""
    gltf = Gltf()
    targets = {"NORMAL": gltf.accessor([[1, 0, 0]] * 3), "POSITION": gltf.sparse(3, [2], [[0, 0, 4]])}
    targets |= {"TEXCOORD_0": gltf.accessor([[0, 0.5]] * 3)}
    mesh = gltf.mesh(TRIANGLE, normals=UP, uv=[[0, 0]] * 3, targets=[targets])
    gltf.json["meshes"][mesh]["weights"] = [1]
    gltf.json["nodes"] = [{"mesh": mesh}]
    mesh = _loaded(tmp_path, gltf)
    assert _places(mesh) == {(0, 0, 0), (1, 0, 0), (0, 1, 4)}
    np.testing.assert_allclose(mesh.normals, [[np.sqrt(0.5), 0, np.sqrt(0.5)]] * 3, atol=1e-6)
    assert mesh.uv is not None
    np.testing.assert_allclose(mesh.uv, [[0, 0.5]] * 3)


def test_a_morphed_mesh_is_skinned_afterwards(tmp_path):
    gltf = Gltf()
    _arm(gltf)
    gltf.json["meshes"][0]["primitives"][0]["targets"] = [{"POSITION": gltf.accessor([[1, 0, 0]] * 3)}]
    gltf.json["meshes"][0]["weights"] = [2]
    assert _places(_loaded(tmp_path, gltf)) == {(2, 0, 3), (3, 0, 3), (2, 3, 3)}


def test_targets_of_another_length_are_refused(tmp_path):
    gltf = Gltf()
    mesh = gltf.mesh(TRIANGLE, targets=[{"POSITION": gltf.accessor([[1, 0, 0]] * 2)}])
    gltf.json["meshes"][mesh]["weights"] = [1]
    gltf.json["nodes"] = [{"mesh": mesh}]
    assert "differs in length from its mesh" in _refusal(tmp_path, gltf)


# ---- numbers ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("base", [None, [[0, 0, 0], [7, 7, 7], [0, 1, 0]]])
def test_sparse_accessors(tmp_path, base):
    gltf = Gltf()
    gltf.json["nodes"] = [{"mesh": gltf.mesh(TRIANGLE)}]
    at, rows = ([1, 2], [[1, 0, 0], [0, 1, 0]]) if base is None else ([1], [[1, 0, 0]])
    number = gltf.sparse(3, at, rows, base)
    gltf.json["meshes"][0]["primitives"][0]["attributes"]["POSITION"] = number
    assert _places(_loaded(tmp_path, gltf)) == {(0, 0, 0), (1, 0, 0), (0, 1, 0)}
    gltf.json["accessors"][number]["count"] = 1
    assert "replaces rows that it does not have" in _refusal(tmp_path, gltf)
    gltf.json["accessors"][number]["sparse"]["count"] = 10**6
    assert "reaches beyond its buffer" in _refusal(tmp_path, gltf)


def test_quantized_positions_and_normals(tmp_path):
    """As gltfpack writes them: whole numbers that the node scales, normals in padded bytes."""
    gltf = Gltf()
    gltf.json["nodes"] = [{"scale": [1 / 16383] * 3, "mesh": gltf.mesh(TRIANGLE)}]
    attributes = gltf.json["meshes"][0]["primitives"][0]["attributes"]
    positions = np.zeros((3, 4), "<u2")
    positions[1, 0] = positions[2, 1] = 16383
    normals = np.array([[0, 0, 127, 0]] * 3, "|i1")
    for name, rows, kind in (("POSITION", positions, 5123), ("NORMAL", normals, 5120)):
        view = gltf.view(rows.tobytes())
        gltf.json["bufferViews"][view]["byteStride"] = rows.strides[0]
        entry = {"bufferView": view, "componentType": kind, "count": 3, "type": "VEC3"}
        gltf.json["accessors"].append(entry | ({"normalized": True} if name == "NORMAL" else {}))
        attributes[name] = len(gltf.json["accessors"]) - 1
    gltf.json["extensionsRequired"] = ["KHR_mesh_quantization"]
    mesh = _loaded(tmp_path, gltf)
    np.testing.assert_allclose(mesh.vertices, TRIANGLE, atol=1e-12)
    np.testing.assert_allclose(mesh.normals, UP)


@pytest.mark.parametrize(
    ("kind", "full", "width"), [("<f4", 1, 3), ("<f4", 1, 4), ("|u1", 255, 3), ("|u1", 255, 4), ("<u2", 65535, 4)]
)
def test_vertex_colours(tmp_path, kind, full, width):
    gltf = Gltf()
    colours = np.array([[1, 0, 0, 1], [0, 1, 0, 1], [0.2, 0.4, 0.6, 0.5]])[:, :width]
    number = gltf.accessor(np.round(full * colours) if full > 1 else colours, kind, normalized=full > 1)
    gltf.json["nodes"] = [{"mesh": gltf.mesh(TRIANGLE, attributes={"COLOR_0": number})}]
    assert _loaded(tmp_path, gltf).colours is None  # one mesh of all materials has none
    (part,) = load_parts(tmp_path / "it.glb")
    assert part.mesh.colours is not None
    np.testing.assert_allclose(part.mesh.colours, colours[:, :3], atol=1e-7)
    assert part.material is not None
    assert part.material.diffuse == (1, 1, 1)  # the colours are all that is said


def test_colours_out_of_range_and_primitives_without(tmp_path):
    gltf = Gltf()
    first = gltf.mesh(TRIANGLE, material=0, attributes={"COLOR_0": gltf.accessor([[2, 0, 0]] * 3)})
    second, third = gltf.mesh(TRIANGLE, material=0), gltf.mesh(TRIANGLE, material=1)
    gltf.json["materials"] = [{"name": "a"}, {"name": "b"}]
    gltf.json["nodes"] = [{"mesh": number, "translation": [0, 0, number]} for number in (first, second, third)]
    (tmp_path / "it.glb").write_bytes(gltf.glb())
    coloured, plain = load_parts(tmp_path / "it.glb")
    assert coloured.mesh.colours is not None
    order = np.argsort(coloured.mesh.vertices[:, 2], kind="stable")
    np.testing.assert_allclose(coloured.mesh.colours[order], [[1, 0, 0]] * 3 + [[1, 1, 1]] * 3)
    assert coloured.mesh.notes == ("a: colours of 3 vertices are clamped to 0 … 1",)
    assert plain.mesh.colours is None


def test_nodes_that_are_hidden_and_a_scene_of_several(tmp_path):
    gltf = Gltf()
    mesh = gltf.mesh(TRIANGLE)
    hidden = {"extensions": {"KHR_node_visibility": {"visible": False}}, "children": [2]}
    gltf.json["nodes"] = [{"mesh": mesh}, hidden, {"mesh": mesh, "translation": [9, 9, 9]}]
    gltf.json["scenes"] = [{"nodes": []}, {"nodes": [0, 1]}]
    gltf.json["scene"] = 1
    mesh = _loaded(tmp_path, gltf)
    assert _places(mesh) == {(0, 0, 0), (1, 0, 0), (0, 1, 0)}
    assert "nodes that the file hides are left out (KHR_node_visibility)" in mesh.notes
    assert "it has 2 scenes; the default one is taken" in mesh.notes


def test_all_that_is_dropped_is_told(tmp_path):
    gltf = Gltf()
    gltf.json["nodes"] = [{"mesh": gltf.mesh(TRIANGLE), "extensions": {"MSFT_lod": {}}}]
    gltf.json["nodes"].append({"mesh": gltf.mesh(TRIANGLE, mode=1)})
    gltf.json["meshes"][0]["primitives"][0]["extensions"] = {"KHR_materials_variants": {}}
    gltf.json["extensionsUsed"] = ["KHR_mesh_quantization", "MSFT_lod", "KHR_materials_variants"]
    gltf.json["animations"] = [{}]
    gltf.json["accessors"].append(gltf.json["accessors"][0])
    gltf.json["meshes"][0]["primitives"][0]["attributes"]["COLOR_1"] = 0
    notes = _loaded(tmp_path, gltf).notes
    for words in (
        "extensions are left out: KHR_materials_variants, MSFT_lod",
        "animations are left out: it stands as its nodes do without them",
        "points and lines are left out",
        "colours of vertices beyond the first set are left out",
    ):
        assert words in notes


@pytest.mark.parametrize(
    ("name", "words"),
    [
        ("KHR_draco_mesh_compression", "export it without compression of meshes"),
        ("EXT_meshopt_compression", "gltfpack without -c"),
        ("KHR_texture_basisu", "export its textures as PNG, JPEG or WebP"),
        ("KHR_materials_transmission", "export it without"),
        ("NOBODY_knows_this", "export it without"),
    ],
)
def test_what_is_required_and_not_read_is_refused_by_name(tmp_path, name, words):
    gltf = Gltf()
    gltf.json["nodes"] = [{"mesh": gltf.mesh(TRIANGLE)}]
    gltf.json["extensionsRequired"] = ["KHR_texture_transform", name]
    message = _refusal(tmp_path, gltf)
    assert f"needs the extension {name}, which is not read; " in message
    assert words in message


def test_compressed_meshes_that_are_not_said_to_be_required(tmp_path):
    gltf = Gltf()
    gltf.json["nodes"] = [{"mesh": gltf.mesh(TRIANGLE)}]
    gltf.json["meshes"][0]["primitives"][0]["extensions"] = {"KHR_draco_mesh_compression": {}}
    gltf.json["extensionsUsed"] = ["KHR_draco_mesh_compression"]
    assert "extensions are left out: KHR_draco_mesh_compression" in _loaded(tmp_path, gltf).notes
    gltf.json["accessors"][0].pop("bufferView")
    assert "is compressed (KHR_draco_mesh_compression)" in _refusal(tmp_path, gltf)


@pytest.mark.parametrize("case", ["a4_morph", "g07_instancing", "g10_skin", "x3_sparse"])
def test_reported_files(case):
    """Squares of a side of 0.6: moved by a target, at two places, left where the joint is; and one of 2, sparse."""
    mesh = load_mesh(shared("data", "reported", case, "q.gltf"))
    middles = mesh.vertices[mesh.faces].mean(axis=1)
    x = {"a4_morph": [0.6, 0.6], "g07_instancing": [-0.6, -0.6, 0.6, 0.6], "g10_skin": [0, 0], "x3_sparse": [0, 0]}
    size = 1.0 if case == "x3_sparse" else 0.3
    np.testing.assert_allclose(np.sort(middles[:, 0].round(1)), np.sort(x[case]), atol=size / 2)
    assert np.ptp(mesh.vertices[:, 1]) == pytest.approx(2 * size)
