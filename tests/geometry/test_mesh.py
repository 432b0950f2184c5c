"""Mesh files: what they load as, what is repaired and reported, what is refused."""

import logging
import random
import struct
from typing import Any

import numpy as np
import pytest
import trimesh

from jaxrelight.errors import InputError
from jaxrelight.geometry.mesh import Mesh, bounds, face_normals, load_mesh, normalized, transformed
from jaxrelight.geometry.primitives import box, sphere
from jaxrelight.geometry.raw_mesh import FilePart, RawMesh
from jaxrelight.geometry.repair import repaired
from tests.shared_data import shared

REFUSED = "refused"
INWARD = "closed mesh faces inward"

# Each broken file: faces loaded, and the beginnings of all its notes; or REFUSED, and words of the message.
BROKEN = {
    "capsule.obj": (10000, ["dropped 200 of 10,200 faces: zero area", "dropped 2 vertices"]),
    "chair_model.obj": (12748, ["dropped 8 of 12,756 faces: repeated"]),
    "derived_degenerate_duplicate_faces.ply": (
        847,
        ["dropped 100 of 998 faces: zero area", "dropped 51 of 998 faces: repeated"],
    ),
    "derived_half_flipped_winding.ply": (
        923,
        ["dropped 25 of 948 faces: repeated", "turned 421 of 923 faces: inconsistent winding"],
    ),
    "derived_index_out_of_range.ply": (
        937,
        ["dropped 2 of 948 faces: index out of range", "dropped 9 of 948 faces: repeated"],
    ),
    "derived_nan_inf_vertices.ply": (
        919,
        ["dropped 20 of 948 faces: NaN, infinite", "dropped 9 of 948 faces: repeated", "dropped 4 vertices"],
    ),
    "empty.ply": (REFUSED, "empty, no vertices and no faces"),
    "empty.stl": (REFUSED, "empty, no vertices and no faces"),
    "face_in_group_name.obj": (REFUSED, "points or lines only"),
    "multibody.stl": (32, ["turned 6 of 32 faces: inconsistent winding", INWARD]),
    "nancolor.obj": (12, []),
    "negative_indices.obj": (12, []),
    "not_convex.obj": (96, []),
    "notenoughindices.obj": (1, ["dropped 1 of 2 faces: fewer than three vertex numbers"]),
    "obj_wireframe.obj": (REFUSED, "points or lines only"),
    "ply_empty_header.ply": (REFUSED, "empty, no vertices and no faces"),
    "points_emptyface.ply": (REFUSED, "points or lines only"),
    "polygonfaces.obj": (2, []),
    "singlevn.obj": (2, []),
    "soup.stl": (100, []),
    "stl_empty_bin.stl": (REFUSED, "empty, no vertices and no faces"),
    "two_objects.obj": (16, []),
    "wallhole.obj": (
        57,
        ["dropped 9 of 66 faces: zero area", "dropped 9 vertices"],
    ),
}


def check(mesh: Mesh) -> None:
    """What holds for every mesh."""
    assert mesh.vertices.dtype == mesh.normals.dtype == np.float64
    assert mesh.faces.dtype == np.int64
    assert mesh.vertices.shape == mesh.normals.shape == (len(mesh.vertices), 3)
    assert len(mesh.faces) > 0
    assert np.isfinite(mesh.vertices).all()
    np.testing.assert_array_equal(np.unique(mesh.faces), np.arange(len(mesh.vertices)))
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(face_normals(mesh), axis=1), 1, atol=1e-12)
    assert all(note and "\n" not in note for note in mesh.notes)


def repairs(mesh: Mesh) -> tuple[str, ...]:
    """Its notes, without that on sharp edges."""
    return tuple(note for note in mesh.notes if "creases" not in note)


def written(folder, name: str, content: str | bytes):
    path = folder / name
    path.write_bytes(content.encode() if isinstance(content, str) else content)
    return path


def refusal(path) -> str:
    with pytest.raises(InputError) as caught:
        load_mesh(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    assert "; " in message  # what to do
    return message


def volume(mesh: Mesh) -> float:
    corners = mesh.vertices[mesh.faces]
    return float(np.einsum("fi,fi->", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])) / 6)


def ply(vertices, faces, encoding: str = "ascii", extra: str = "") -> bytes:
    """A PLY file of polygons that may differ in length."""
    header = (
        f"ply\nformat {encoding} 1.0\nelement vertex {len(vertices)}\nproperty float x\nproperty float y\n"
        f"property float z\nelement face {len(faces)}\nproperty list uchar int vertex_indices\n{extra}end_header\n"
    ).encode()
    if encoding == "ascii":
        rows = [" ".join(map(str, row)) for row in vertices] + [" ".join(map(str, (len(f), *f))) for f in faces]
        return header + "\n".join(rows).encode() + b"\n"
    order = "<" if "little" in encoding else ">"
    body = b"".join(struct.pack(f"{order}3f", *row) for row in vertices)
    return header + body + b"".join(struct.pack(f"{order}B{len(f)}i", len(f), *f) for f in faces)


def obj(mesh: Mesh, normals: bool = False) -> str:
    lines = ["v {} {} {}".format(*row) for row in mesh.vertices.tolist()]
    lines += ["vn {} {} {}".format(*row) for row in mesh.normals.tolist()] if normals else []
    corner = "{0}//{0}" if normals else "{0}"
    return "\n".join([*lines, *("f " + " ".join(corner.format(i + 1) for i in f) for f in mesh.faces), ""])


def ascii_stl(mesh: Mesh) -> str:
    facets = (
        "facet normal 0 0 0\nouter loop\n{}\nendloop\nendfacet".format(
            "\n".join("vertex {} {} {}".format(*corner) for corner in corners)
        )
        for corners in mesh.vertices[mesh.faces].tolist()
    )
    return "\n".join(["solid thing", *facets, "endsolid thing", ""])


def binary_stl(mesh: Mesh) -> bytes:
    corners = mesh.vertices[mesh.faces].reshape(-1, 9)
    return bytes(80) + struct.pack("<I", len(corners)) + b"".join(struct.pack("<12fH", 0, 0, 0, *c, 0) for c in corners)


SMALL = sphere(0.5, 2)
FILES = {
    "ascii.ply": ply(SMALL.vertices.tolist(), SMALL.faces.tolist()),
    "binary.ply": ply(SMALL.vertices.tolist(), SMALL.faces.tolist(), "binary_little_endian"),
    "big.ply": ply(SMALL.vertices.tolist(), SMALL.faces.tolist(), "binary_big_endian"),
    "ascii.stl": ascii_stl(SMALL).encode(),
    "binary.stl": binary_stl(SMALL),
    "plain.obj": obj(SMALL).encode(),
    "normals.obj": obj(SMALL, normals=True).encode(),
}
TETRAHEDRON = ([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], [(0, 2, 1), (0, 1, 3), (0, 3, 2), (1, 2, 3)])


# ---- given data ------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(BROKEN))
def test_broken_files_end_as_documented(name):
    outcome, expected = BROKEN[name]
    path = shared("data", "mesh_broken", name)
    if outcome == REFUSED:
        assert expected in refusal(path)
        return
    mesh = load_mesh(path)
    check(mesh)
    assert len(mesh.faces) == outcome
    notes = repairs(mesh)
    assert len(notes) == len(expected), notes
    for note, begin in zip(notes, expected, strict=True):
        assert note.startswith(begin)


def test_every_broken_file_is_in_the_table():
    assert {path.name for path in shared("data", "mesh_broken").iterdir()} == set(BROKEN)


@pytest.mark.parametrize("name", ["bunny_mitsuba.ply", "spot.obj", "teapot.obj"])
def test_sound_meshes_are_as_trimesh_loads_them(name):
    path = shared("data", "mesh", name)
    mesh, reference = load_mesh(path, 180.0), trimesh.load_mesh(path, process=True)
    check(mesh)
    assert mesh.notes == ()
    np.testing.assert_array_equal(mesh.vertices[mesh.faces], reference.vertices[reference.faces])
    uv = getattr(reference.visual, "uv", None)
    assert (mesh.uv is None) == (uv is None)
    if mesh.uv is not None and uv is not None:
        np.testing.assert_allclose(mesh.uv[mesh.faces], uv[reference.faces], atol=1e-12)
    # Normals are shared where texture coordinates part.
    reference.merge_vertices(merge_tex=True, merge_norm=True)
    differ = np.abs(mesh.normals[mesh.faces] - reference.vertex_normals[reference.faces]).max(axis=2) > 1e-12
    # At the teapot's knob surfaces touch in a vertex, which has the normal of each of them.
    assert len(np.unique(reference.faces[differ])) <= (1 if name == "teapot.obj" else 0)


def test_normalized_and_transformed_are_as_in_the_reference_script():
    path = shared("data", "mesh", "spot.obj")
    matrix = np.array([[0, 0, 2, 1], [0, 1, 0, 0.5], [-1, 0, 0, 3], [0, 0, 0, 1.0]])
    reference = trimesh.load_mesh(path, process=True)
    low, high = reference.bounds
    reference.apply_translation([-(low[0] + high[0]) / 2, -low[1], -(low[2] + high[2]) / 2])
    reference.apply_scale(0.8 / (high - low).max())
    reference.apply_transform(matrix)
    mesh = transformed(normalized(load_mesh(path), 0.8), matrix)
    np.testing.assert_allclose(mesh.vertices[mesh.faces], reference.vertices[reference.faces], atol=1e-12)


def test_relative_indices_are_those_of_the_absolute_file():
    relative = load_mesh(shared("data", "mesh", "CornellBox-Original.obj"))
    absolute = load_mesh(shared("data", "mesh", "CornellBox-Original_abs.obj"))
    check(relative)
    np.testing.assert_array_equal(relative.vertices, absolute.vertices)
    np.testing.assert_array_equal(relative.faces, absolute.faces)
    np.testing.assert_allclose(relative.normals, absolute.normals, atol=1e-12)
    assert repairs(relative) == repairs(absolute) == ("dropped 4 of 36 faces: repeated",)


def test_negative_indices_load_as_the_cube_they_describe():
    mesh = load_mesh(shared("data", "mesh_broken", "negative_indices.obj"))
    np.testing.assert_allclose(volume(mesh), 8)
    assert len(mesh.vertices) == 24  # texture coordinates and normals keep the sides apart
    np.testing.assert_allclose(np.abs(mesh.normals).max(axis=1), 1)


def test_turned_faces_agree_with_the_unflipped_mesh():
    flipped = load_mesh(shared("data", "mesh_broken", "derived_half_flipped_winding.ply"))
    sound = load_mesh(shared("data", "mesh_broken", "derived_nan_inf_vertices.ply"))
    centres = {
        tuple(c): n for c, n in zip(sound.vertices[sound.faces].mean(axis=1).tolist(), face_normals(sound), strict=True)
    }
    agreement = [
        np.dot(normal, centres[tuple(centre)])
        for centre, normal in zip(
            flipped.vertices[flipped.faces].mean(axis=1).tolist(), face_normals(flipped), strict=True
        )
        if tuple(centre) in centres
    ]
    assert len(agreement) > 400
    assert np.mean(np.array(agreement) > 0) > 0.9  # the rest lies beyond edges of four faces, where any side fits


# ---- formats ---------------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("name", sorted(FILES))
def test_every_format_gives_the_same_mesh(tmp_path, name):
    mesh = load_mesh(written(tmp_path, name, FILES[name]), None if name == "normals.obj" else 180.0)
    check(mesh)
    assert mesh.notes == ()
    assert len(mesh.vertices) == len(SMALL.vertices)
    np.testing.assert_allclose(mesh.vertices[mesh.faces], SMALL.vertices[SMALL.faces], atol=1e-7)


@pytest.mark.parametrize("name", sorted(FILES))
def test_a_file_cut_short_is_refused_or_loads_consistently(tmp_path, name):
    content = FILES[name]
    for length in np.linspace(0, len(content) - 1, 20).astype(int):
        path = written(tmp_path, name, content[:length])
        if name.endswith("obj"):
            try:
                check(load_mesh(path))
            except InputError:
                refusal(path)
        elif length < len(content.rstrip()) - 6 or not name.startswith("ascii"):  # less than the last number is missing
            refusal(path)


@pytest.mark.parametrize("name", sorted(FILES))
def test_mutated_files_are_refused_or_load_consistently(tmp_path, name, capfd, caplog):
    chance = random.Random(name)
    for _ in range(60):
        content = bytearray(FILES[name])
        for _ in range(chance.choice([1, 3, 30])):
            at = chance.randrange(len(content))
            if chance.random() < 0.3:
                del content[at : at + chance.randrange(9)]
            elif name.startswith(("ascii", "plain", "normals")) or at < 200:
                content[at : at + 1] = chance.choice(
                    [b"-", b"9", b" ", b"\n", b"nan", b"1e999", b"/", b"\\\n", b"\xff", b"#"]
                )
            else:
                content[at] = chance.randrange(256)
        path = written(tmp_path, name, bytes(content))
        try:
            check(load_mesh(path))
        except InputError:
            refusal(path)
    assert capfd.readouterr() == ("", "")
    assert not caplog.records


def test_quads_and_polygons_in_ply_become_fans(tmp_path):
    vertices = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0.5, 1.5, 0), (2, 0, 0)]
    polygons = [(0, 1, 2, 4, 3), (1, 5, 2)]
    for encoding in ("ascii", "binary_little_endian", "binary_big_endian"):
        mesh = load_mesh(written(tmp_path, "mixed.ply", ply(vertices, polygons, encoding)))
        assert len(mesh.faces) == 4
        np.testing.assert_allclose(face_normals(mesh), [[0, 0, 1]] * 4)
        quad = load_mesh(written(tmp_path, "quad.ply", ply(vertices, [(0, 1, 2, 3)] * 1, encoding)))
        assert len(quad.faces) == 2
        assert len(quad.vertices) == 4


@pytest.mark.parametrize("encoding", ["ascii", "binary_little_endian", "binary_big_endian"])
def test_short_polygons_in_ply_are_counted(tmp_path, encoding):
    vertices = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0)]
    mesh = load_mesh(written(tmp_path, "short.ply", ply(vertices, [(0, 1, 2), (0, 2, 3), (0, 1), ()], encoding)))
    assert len(mesh.faces) == 2
    assert mesh.notes == ("dropped 2 of 4 faces: fewer than three vertex numbers",)
    assert "points or lines only" in refusal(written(tmp_path, "lines.ply", ply(vertices, [(0, 1)], encoding)))


def test_surplus_unended_and_broken_rows_of_an_ascii_ply_are_told(tmp_path):
    whole = FILES["ascii.ply"]
    fewer = load_mesh(written(tmp_path, "fewer.ply", whole.replace(b"face 48", b"face 40")))
    assert len(fewer.faces) == 40
    assert fewer.notes[0] == "ignored 8 rows after the promised ones"
    assert "may be cut short" in load_mesh(written(tmp_path, "end.ply", whole[:-1])).notes[0]
    assert "damaged" in refusal(written(tmp_path, "part.ply", whole.replace(b"\n3 ", b"\n3 0.", 1)))
    lost = load_mesh(written(tmp_path, "row.ply", whole.replace(b"\n3 7 16 15", b"\n3 7 16")))
    assert repairs(lost)[-1] == "dropped 1 of 48 faces: fewer than three vertex numbers"


def test_ply_extras_are_passed_over(tmp_path):
    body = "0 0 0 9 .5 .5\n1 0 0 9 .5 .5\n0 1 0 9 .5 .5\n1 3 0 1 7 255\n0 1\n"
    header = (
        "ply\ncomment TextureFile none.png\nformat ascii 1.0\nobj_info made up\nelement vertex 3\nproperty float x\n"
        "property double y\nproperty float z\nproperty uchar red\nproperty float s\nproperty float t\nelement face 1\n"
        "property int material\nproperty list uchar int vertex_index\nproperty uchar flags\nelement edge 1\n"
        "property int vertex1\nproperty int vertex2\nend_header\n"
    )
    mesh = refusal(written(tmp_path, "bad.ply", header + body))  # index 7 of 3 vertices
    assert "1 of 1 faces are unusable (index out of range: 1)" in mesh
    mesh = load_mesh(written(tmp_path, "good.ply", header + body.replace(" 7 ", " 2 ")))
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2]])


def test_ply_normals_are_the_files_and_made_unit(tmp_path):
    header = "ply\nformat ascii 1.0\nelement vertex 4\n" + "".join(
        f"property float {name}\n" for name in ("x", "y", "z", "nx", "ny", "nz")
    )
    rows = "0 0 0 0 0 5\n1 0 0 1 0 1\n0 1 0 0 0 0\n1 1 0 nan 0 1\n3 0 1 2\n3 1 3 2\n"
    text = header + "element face 2\nproperty list uchar int vertex_indices\nend_header\n" + rows
    mesh = load_mesh(written(tmp_path, "n.ply", text))
    half = np.sqrt(0.5)
    np.testing.assert_allclose(mesh.normals, [[0, 0, 1], [half, 0, half], [0, 0, 1], [0, 0, 1]], atol=1e-12)
    assert mesh.notes == ("normals computed for 2 vertices: the file's are unusable",)


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (("element vertex 26", "element vertex 4000000000"), "cut short"),
        (("element face 48", "element face 99999999999999999999"), "cut short"),
        (("element vertex 26", "element vertex -26"), "not understood"),
        (("property float y", "property quad y"), "not understood"),
        (("property float y", "property float x"), "declares a name twice"),
        (("property float y", "property float why"), "lack x, y or z"),
        (("vertex_indices", "corners"), "lack the list vertex_indices"),
        (("format ascii", "format ebcdic"), "encoding 'ebcdic' is unknown"),
        (("end_header", "end"), "its header has no end"),
        (("ply\n", "obj\n"), "does not begin with 'ply'"),
    ],
)
def test_ply_headers_that_lie_are_refused(tmp_path, change, words):
    for name in ("ascii.ply", "binary.ply"):
        content = FILES[name].replace(change[0].encode(), change[1].encode(), 1)
        if name == "binary.ply" and "ascii" in change[0]:
            continue
        assert words in refusal(written(tmp_path, name, content))


def test_stl_headers_that_lie_are_refused(tmp_path):
    content = FILES["binary.stl"]
    assert "cut short" in refusal(written(tmp_path, "a.stl", content[:80] + b"\xff\xff\xff\xff" + content[84:]))
    assert "cut short" in refusal(written(tmp_path, "b.stl", b"solid" + content[5:-1]))
    assert "where a number belongs" in refusal(
        written(tmp_path, "d.stl", FILES["ascii.stl"].replace(b"vertex 0", b"vertex \xff"))
    )
    mesh = load_mesh(written(tmp_path, "c.stl", content + b"spare"))
    assert repairs(mesh) == ("ignored 5 bytes after the last triangle",)


def test_trailing_bytes_of_a_binary_ply_are_reported(tmp_path):
    mesh = load_mesh(written(tmp_path, "a.ply", FILES["binary.ply"] + b"spare"))
    assert repairs(mesh) == ("ignored 5 bytes after the promised ones",)


def test_obj_dialects(tmp_path):
    text = (
        "mtllib none.mtl\nv 0 0 0 1 0 0\nv\t1 0 0\n  v 1 1 0\nv 0 1 0\nvt 0 0\nvn 0 0 1\nvn 0 0 2\ng f 1 2 3\n"
        "f 1/1/1 2/1/2 3//-1 \\\n 4 # a quad\nusemtl other\nf -4//1 -3//1 4\nl 1 2\np 1\n"
    )
    mesh = load_mesh(written(tmp_path, "dialects.obj", text))
    assert len(mesh.faces) == 3
    np.testing.assert_allclose(mesh.normals, [[0, 0, 1]] * len(mesh.vertices), atol=1e-12)
    assert volume(mesh) == 0
    assert mesh.notes == ("texture coordinates are missing at 2 of 4 vertices; (0, 0) is taken",)


def test_obj_faults_are_counted_by_reason(tmp_path):
    good = "f 1 2 3\nf 1 3 4\nf 1 4 2\nf 2 4 3\n"
    vertices = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\n"
    text = vertices + good + "f 0 1 2\nf -9 1 2\nf 1 2\nf a b c\nv 1 2\n"
    mesh = load_mesh(written(tmp_path, "faults.obj", text))
    assert len(mesh.faces) == 4
    assert mesh.notes[:2] == (
        "dropped 2 of 8 faces: fewer than three vertex numbers",
        "dropped 2 of 8 faces: index out of range",
    )
    assert "5 of 9 faces are unusable" in refusal(written(tmp_path, "more.obj", text + "f 1 2 5\n"))
    assert "damaged or no OBJ file (something else where a number belongs)" in refusal(
        written(tmp_path, "words.obj", "v a b c\n" + vertices + good)
    )


def test_negative_numbers_count_from_their_line(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 0 1 0\nf -3 -2 -1\nv 5 5 5\nf -3 1 -1\n"
    mesh = load_mesh(written(tmp_path, "relative.obj", text), 180.0)
    np.testing.assert_array_equal(mesh.faces, [[0, 1, 2], [1, 0, 3]])
    assert mesh.notes == ()


def test_a_last_obj_line_without_end_is_reported(tmp_path):
    mesh = load_mesh(written(tmp_path, "cut.obj", FILES["plain.obj"][:-1]))
    assert repairs(mesh) == ("the last line has no end: the file may be cut short",)


def test_parts_of_different_material_are_not_merged(tmp_path):
    text = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nusemtl a\nf 1 2 3\nusemtl b\nf 1 3 4\n"
    assert len(load_mesh(written(tmp_path, "two.obj", text)).vertices) == 6
    assert len(load_mesh(written(tmp_path, "one.obj", text.replace("usemtl b\n", ""))).vertices) == 4


# ---- faults ----------------------------------------------------------------------------------------------------------


def test_what_is_no_readable_file(tmp_path):
    assert "No such file" in refusal(tmp_path / "absent.ply")
    (tmp_path / "folder.ply").mkdir()
    assert "cannot be read" in refusal(tmp_path / "folder.ply")
    with pytest.raises(InputError, match=r"unknown mesh format '\.fbx'; use \.ply, \.obj, \.stl, \.glb or \.gltf"):
        load_mesh(tmp_path / "a.fbx")
    with pytest.raises(InputError, match="unknown mesh format ''"):
        load_mesh("")
    with pytest.raises(InputError, match="cannot be read"):
        load_mesh("a\0b.ply")
    for name in ("a.ply", "a.obj", "a.stl"):
        refusal(written(tmp_path, name, b""))
        refusal(written(tmp_path, name, bytes(range(256)) * 10))
    assert repairs(load_mesh(str(written(tmp_path, "UPPER.PLY", FILES["ascii.ply"])))) == ()


def test_more_than_half_lost_is_refused_and_half_is_not(tmp_path):
    vertices, faces = TETRAHEDRON
    mesh = load_mesh(written(tmp_path, "half.ply", ply(vertices, faces + [(0, 0, 1)] * 4)))
    assert repairs(mesh) == ("dropped 4 of 8 faces: zero area",)
    message = refusal(written(tmp_path, "more.ply", ply(vertices, faces + [(0, 0, 1)] * 4 + [faces[0]])))
    assert "5 of 9 faces are unusable (zero area: 4, repeated: 1)" in message


def test_collinear_corners_have_no_area_at_any_place_and_size(tmp_path):
    for size in (1e-6, 1.0, 1e6):
        for offset in (0.0, 1e3 * size):
            vertices, faces = TETRAHEDRON
            points = [
                [c * size + offset for c in row] for row in [*vertices, (0.1, 0.3, 0), (0.2, 0.6, 0), (0.3, 0.9, 0)]
            ]
            text = obj(Mesh(np.array(points), np.array([*faces, (4, 5, 6)]), np.zeros((7, 3))))
            mesh = load_mesh(written(tmp_path, "thin.obj", text))
            assert mesh.notes[0] == "dropped 1 of 5 faces: zero area"
            assert len(mesh.faces) == 4


def test_two_sided_sheets_stay(tmp_path):
    vertices, _ = TETRAHEDRON
    mesh = load_mesh(written(tmp_path, "sheet.ply", ply(vertices[:3], [(0, 1, 2), (0, 2, 1)])))
    assert len(mesh.faces) == 2
    assert repairs(mesh) == ()
    check(mesh)
    np.testing.assert_allclose(mesh.normals[mesh.faces], face_normals(mesh)[:, None].repeat(3, 1), atol=1e-12)
    repeated = load_mesh(written(tmp_path, "twice.ply", ply(vertices[:3], [(0, 1, 2), (1, 2, 0)])))
    assert repeated.notes == ("dropped 1 of 2 faces: repeated",)


@pytest.mark.parametrize("flipped", [[5], [0, 3, 30, 31], list(range(0, 48, 2)), list(range(48))])
def test_winding_is_made_consistent_and_only_where_it_is_not(tmp_path, flipped):
    faces = SMALL.faces.copy()
    faces[flipped] = faces[flipped][:, ::-1]
    mesh = load_mesh(written(tmp_path, "f.ply", ply(SMALL.vertices.tolist(), faces.tolist())))
    check(mesh)
    if len(flipped) == len(faces):
        assert [note.split(":")[0] for note in repairs(mesh)] == [INWARD]
        assert volume(mesh) < 0
    else:
        assert repairs(mesh) == (f"turned {len(flipped)} of 48 faces: inconsistent winding",)
        np.testing.assert_allclose(volume(mesh), volume(SMALL), rtol=1e-6)


def test_file_normals_decide_which_side_a_contradicting_piece_faces(tmp_path):
    faces = SMALL.faces[:, ::-1].copy()  # inward, as a room
    faces[3] = faces[3][::-1]
    room = Mesh(SMALL.vertices, faces, -SMALL.normals)
    inward = load_mesh(written(tmp_path, "room.obj", obj(room, normals=True)))
    assert volume(inward) < 0
    assert inward.notes[0] == "turned 1 of 48 faces: inconsistent winding"
    ball = load_mesh(written(tmp_path, "ball.obj", obj(Mesh(SMALL.vertices, faces, SMALL.normals), normals=True)))
    assert volume(ball) > 0
    assert ball.notes == ("turned 47 of 48 faces: inconsistent winding",)


def test_a_moebius_strip_is_reported(tmp_path):
    count = 12
    turn = np.arange(count) * 2 * np.pi / count
    across = np.stack([np.cos(turn / 2) * np.cos(turn), np.sin(turn / 2), np.cos(turn / 2) * np.sin(turn)], axis=1)
    middle = np.stack([np.cos(turn), 0 * turn, np.sin(turn)], axis=1)
    vertices = np.concatenate([middle + 0.3 * across, middle - 0.3 * across])
    quads = [(i, i + 1, i + 1 + count, i + count) for i in range(count - 1)] + [(count - 1, count, 0, 2 * count - 1)]
    mesh = load_mesh(written(tmp_path, "moebius.ply", ply(vertices.tolist(), quads)))
    check(mesh)
    assert len(mesh.faces) == 2 * count
    assert mesh.notes == ("winding stays inconsistent along 1 edges: no choice of sides fits them all",)


def test_repair_leaves_nothing_to_repair():
    for name in ("derived_half_flipped_winding.ply", "derived_degenerate_duplicate_faces.ply", "capsule.obj"):
        mesh = load_mesh(shared("data", "mesh_broken", name))
        none = np.zeros(len(mesh.vertices), bool)
        uv, part = np.full((len(none), 2), np.nan), np.zeros(len(none), int)
        raw = RawMesh(mesh.vertices, mesh.faces, mesh.normals, none, uv, part, [FilePart("all")])
        again = repaired(raw)
        assert [note for note in again.notes if "dropped" in note or "turned" in note] == []


def test_nothing_is_logged_or_printed(tmp_path, capfd, caplog):
    caplog.set_level(logging.DEBUG)
    for path in (
        written(tmp_path, "bad.obj", "v 1 x 2\nf 1 1 1\n"),
        written(tmp_path, "bad.ply", FILES["ascii.ply"][:-9]),
    ):
        refusal(path)
    load_mesh(shared("data", "mesh_broken", "chair_model.obj"))
    assert capfd.readouterr() == ("", "")
    assert not caplog.records


# ---- laws ------------------------------------------------------------------------------------------------------------


def test_size_and_place_change_nothing(tmp_path):
    for scale in (1e-3, 1.0, 1e6):
        for offset in (0.0, 1e6):
            mesh = transformed(box((1, 2, 3), 2), np.diag([scale, scale, scale, 1.0]) + offset * np.eye(4, k=3))
            again = load_mesh(written(tmp_path, "m.obj", obj(mesh)))
            check(again)
            assert repairs(again) == ()
            assert len(again.faces) == len(mesh.faces)
            welded = load_mesh(written(tmp_path, "b.obj", obj(box((1, 2, 3), 2))))
            np.testing.assert_allclose(again.normals, welded.normals, atol=1e-4)


@pytest.mark.usefixtures("wrong_types")
def test_normalized_stands_centred_on_the_ground():
    mesh = normalized(transformed(SMALL, np.diag([2.0, 5, 3, 1]) + 7 * np.eye(4, k=3)), 0.25)
    np.testing.assert_allclose(bounds(mesh), [[-0.05, 0, -0.075], [0.05, 0.25, 0.075]], atol=1e-15)
    sizes: list[Any] = [0, -1, np.nan, np.inf, "1", None]
    for size in sizes:
        with pytest.raises(InputError, match="normalize is"):
            normalized(mesh, size)


def test_transformed_composes_and_keeps_fronts():
    rng = np.random.default_rng(3)
    for _ in range(20):
        first, second = np.eye(4), np.eye(4)
        first[:3], second[:3] = rng.normal(size=(2, 3, 4))
        once, twice = transformed(SMALL, second @ first), transformed(transformed(SMALL, first), second)
        np.testing.assert_allclose(once.vertices, twice.vertices, atol=1e-12)
        np.testing.assert_allclose(once.normals, twice.normals, atol=1e-9)
        np.testing.assert_array_equal(once.faces, twice.faces)
        np.testing.assert_allclose(
            volume(once), volume(SMALL) * abs(np.linalg.det((second @ first)[:3, :3])), rtol=1e-9
        )
        turned = face_normals(SMALL) @ np.linalg.inv((second @ first)[:3, :3])
        turned /= np.linalg.norm(turned, axis=1, keepdims=True)
        np.testing.assert_allclose(face_normals(once), turned, atol=1e-9)


def test_normals_stay_perpendicular_under_shear():
    shear = np.eye(4)
    shear[0, 1] = 3
    mesh = transformed(box(), shear)
    np.testing.assert_allclose((mesh.normals[mesh.faces] * face_normals(mesh)[:, None]).sum(axis=2), 1, atol=1e-12)


@pytest.mark.usefixtures("wrong_types")
@pytest.mark.parametrize(
    "matrix",
    [
        np.diag([1.0, 0, 1, 1]),
        np.diag([0.0, 0, 0, 1]),
        np.ones((4, 4)),
        np.eye(3),
        np.full((4, 4), np.nan),
        np.diag([1, 1, 1, 2.0]),
        np.eye(4) + np.eye(4, k=-3),
        np.diag([1e300, 1e300, 1e300, 1]),
        [[1, 2], [3]],
        "identity",
        None,
    ],
)
def test_matrices_that_cannot_move_a_mesh_are_refused(matrix):
    with pytest.raises(InputError, match="transform") as caught:
        transformed(SMALL, matrix)
    assert "\n" not in str(caught.value)


def test_face_normals_of_a_face_without_area_point_up():
    mesh = Mesh(np.zeros((3, 3)), np.array([[0, 1, 2]]), np.tile([0.0, 1, 0], (3, 1)))
    np.testing.assert_array_equal(face_normals(mesh), [[0, 1, 0]])
    with pytest.raises(InputError, match="without extent"):
        normalized(mesh, 1)


def test_vertices_of_different_coordinates_or_colours_stay_apart():
    """Two triangles that share an edge: its vertices are one where all that they carry is equal."""
    corners = [[0.0, 0, 0], [1, 0, 0], [0, 1, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]]
    faces, none = np.arange(6).reshape(2, 3), np.zeros((6, 3))

    def count(uv: np.ndarray, colours: np.ndarray | None) -> int:
        parts = np.zeros(6, np.int64), [FilePart("default")]
        raw = RawMesh(np.array(corners), faces, none, np.zeros(6, bool), uv, *parts, colours=colours)
        return len(repaired(raw).vertices)

    uv = np.zeros((6, 4))
    assert count(uv, None) == count(uv, np.full((6, 3), np.nan)) == 4
    assert count(uv, np.repeat([[1.0, 0, 0], [0, 1, 0]], 3, axis=0)) == 6
    uv[3:, 3] = 1  # of the second set
    assert count(uv, None) == 6
