"""The meshes of scene files: their parts and materials, where they stand, and their edges."""

import re

import numpy as np
import pytest

from jaxrelight import InputError, load_scene, phong
from tests.scene.scene_files import SMALL, values_of, write_scene

TWO = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 1\nusemtl wood\nf 1/1 2/2 3/1\nusemtl steel\nf 1 3 4\n"


def _with_file(folder, lines: str, **options):
    (folder / "two.obj").write_text(TWO)
    text = SMALL.replace('primitive = "plane"\nresolution = 2\nmaterial = "paper"', lines)
    return load_scene(write_scene(folder, text), **options)


def test_a_files_own_materials_and_those_that_override_them(folder):
    scene = _with_file(folder, 'file = "two.obj"\nmaterials = {steel = "paper"}\nnormalize = 2')
    assert [part.material for part in scene.parts] == ["two.obj:wood", "paper"]
    assert "two.obj: says nothing about its materials, taken as grey: wood" in scene.notes[-1]
    both = np.concatenate([part.mesh.vertices for part in scene.parts])
    np.testing.assert_allclose([both.min(axis=0), both.max(axis=0)], [[-1, 0, 0], [1, 2, 0]], atol=1e-12)
    scene = _with_file(folder, 'file = "two.obj"\nmaterial = "paper"\ntwo_sided = true')
    assert [part.material for part in scene.parts] == ["paper"]
    assert scene.parts[0].mesh.two_sided
    (folder / "two.mtl").write_text(
        "newmtl wood\nKd 1 1 1\nKs 1 1 1\nNs 9\nmap_Kd none.png\nnewmtl steel\nKd 0.2 0.2 0.2\n"
    )
    (folder / "two.obj").write_text("mtllib two.mtl\n" + TWO)
    scene = load_scene(folder / "scene.toml")
    assert scene.notes == ()
    text = (folder / "scene.toml").read_text().replace('material = "paper"\ntwo_sided = true', "")
    scene = load_scene(write_scene(folder, text))
    np.testing.assert_allclose(values_of(scene.materials["two.obj:steel"]), 0.2 / np.pi, rtol=1e-6)
    np.testing.assert_allclose(values_of(scene.materials["two.obj:wood"]), values_of(phong(0.5, 0.5, 9)), rtol=1e-6)
    assert "none.png: no such file" in scene.notes[0]
    assert "diffuse and specular add up to 2, scaled down to 1" in scene.notes[1]


def test_parts_that_are_not_named_have_a_default(folder):
    scene = _with_file(folder, 'file = "two.obj"\nmaterials = {"*" = "paper"}')
    assert [part.material for part in scene.parts] == ["paper", "paper"]
    text = SMALL + '[material.ink]\ntype = "lambert"\nalbedo = 0.1\n'
    lines = 'file = "two.obj"\nmaterials = {steel = "ink", "*" = "paper"}'
    scene = load_scene(
        write_scene(folder, text.replace('primitive = "plane"\nresolution = 2\nmaterial = "paper"', lines))
    )
    assert [part.material for part in scene.parts] == ["paper", "ink"]


@pytest.mark.parametrize(
    ("lines", "corner"),
    [
        ("", (2, 0, 3)),
        ("translate = [1, 2, 3]", (3, 2, 6)),
        ("scale = 2", (4, 0, 6)),
        ("scale = [2, 1, -1]", (4, 0, -3)),
        ("rotate = [0, 90, 0]", (3, 0, -2)),
        ("rotate = [90, 90, 0]", (-0, -3, -2)),
        ("rotate = [0, 7, 0, 90]", (3, 0, -2)),
        # First scaled, then turned, then moved.
        ("scale = [1, 1, 2]\nrotate = [0, 0, 0.5, 90]\ntranslate = [0, 0, 1]", (0, 2, 7)),
    ],
)
def test_meshes_are_scaled_turned_and_moved(folder, lines: str, corner):
    lines = f'primitive = "plane"\nsize = [4, 6]\nresolution = 1\nmaterial = "paper"\n{lines}'
    text = SMALL.replace('primitive = "plane"\nresolution = 2\nmaterial = "paper"', lines)
    vertices = load_scene(write_scene(folder, text)).parts[0].mesh.vertices
    assert np.abs(vertices - corner).max(axis=1).min() < 1e-9


def test_files_may_have_z_up(folder):
    for lines, up in (('up = "z"', "y"), ("", "z")):
        mesh = _with_file(folder, f'file = "two.obj"\nmaterial = "paper"\n{lines}', up=up).parts[0].mesh
        np.testing.assert_allclose([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)], [[0, 0, -1], [1, 0, 0]])
        np.testing.assert_allclose(mesh.normals, np.broadcast_to([0.0, 1, 0], mesh.normals.shape), atol=1e-12)
    mesh = _with_file(folder, 'file = "two.obj"\nmaterial = "paper"\nup = "y"', up="z").parts[0].mesh
    assert mesh.vertices[:, 1].max() == 1
    # Before it is normalized: it lies on the ground.
    mesh = _with_file(folder, 'file = "two.obj"\nmaterial = "paper"\nup = "z"\nnormalize = 2').parts[0].mesh
    np.testing.assert_allclose([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)], [[-1, 0, -1], [1, 0, 1]])


@pytest.mark.parametrize(
    ("lines", "what"),
    [
        ('up = "x"', "'up' is \"y\" or \"z\", not 'x'"),
        ("scale = [1, 0, 1]", "'scale' is [1, 0, 1], which flattens the mesh"),
        ("rotate = [1, 2]", "'rotate' must be 3 numbers or 4 numbers"),
        ("rotate = [0, 0, 0, 90]", "'rotate' has an axis of length 0"),
        ("translate = 1", "'translate' must be 3 numbers"),
        (
            "rotate = [1, 2, 3]\ntransform = [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]",
            "give either 'transform' or 'rotate'; both would move the mesh",
        ),
    ],
)
def test_faults_of_places_are_named(folder, lines: str, what: str):
    with pytest.raises(InputError, match=re.escape(what)):
        _with_file(folder, f'file = "two.obj"\nmaterial = "paper"\n{lines}')


def test_primitives_have_no_other_axis(folder):
    with pytest.raises(InputError, match="'up' is not known"):
        load_scene(write_scene(folder, SMALL.replace("resolution = 2", 'resolution = 2\nup = "z"')))


def test_a_scene_needs_no_materials_of_its_own(folder):
    (folder / "two.obj").write_text(TWO)
    text = "[camera]\norigin = [0, 1, 3]\ntarget = [0, 0, 0]\n[[mesh]]\nfile = 'two.obj'\n"
    assert set(load_scene(write_scene(folder, text)).materials) == {"two.obj:wood", "two.obj:steel"}


@pytest.mark.parametrize(
    ("lines", "what"),
    [
        ('materials = {stele = "paper"}', "'stele' is not known; did you mean 'steel'?"),
        ('materials = {steel = "papre"}', "there is no [material.papre]; did you mean 'paper'?"),
        ("materials = 3", "must be a table"),
        ('tangents = "uv"', "needs texture coordinates, which 'steel' does not have"),
    ],
)
def test_faults_of_materials_by_part(folder, lines: str, what: str):
    with pytest.raises(InputError, match=re.escape(what)):
        _with_file(folder, f'file = "two.obj"\n{lines}')


RIDGE = "v -1 -1 -0.8\nv 0 -1 0\nv 0 1 0\nv -1 1 -0.8\nv 1 -1 -0.8\nv 1 1 -0.8\nf 1 2 3 4\nf 2 5 6 3\n"


def test_creases_and_shading_normals(folder):
    (folder / "ridge.obj").write_text(RIDGE)
    sharp, smooth, pure = (
        _with_file(folder, f'file = "ridge.obj"\nmaterial = "paper"\n{lines}').parts[0].mesh
        for lines in ("", "crease_angle = 90", 'shading_normals = "pure"')
    )
    assert (len(sharp.vertices), len(smooth.vertices)) == (8, 6)
    assert [mesh.pure_normals for mesh in (sharp, smooth, pure)] == [False, False, True]
    for lines, words in (
        ("crease_angle = 200", "crease_angle is 200; give degrees from 0"),
        ('shading_normals = "smooth"', "'shading_normals' is \"corrected\" or \"pure\", not 'smooth'"),
    ):
        with pytest.raises(InputError, match=words):
            _with_file(folder, f'file = "ridge.obj"\nmaterial = "paper"\n{lines}')
    with pytest.raises(InputError, match="crease_angle is for files"):
        _with_file(folder, 'primitive = "plane"\nmaterial = "paper"\ncrease_angle = 30')
