"""Scene files: what loads, and what is refused in one line that says where and what."""

import dataclasses
import pathlib
import re

import equinox as eqx
import numpy as np
import pytest
from PIL import Image

from jaxrelight import InputError, Scene, ashikhmin_shirley, lambert, load_mesh, load_scene, phong, plane, write_image
from jaxrelight.brdf.factoring import Factoring
from jaxrelight.brdf.material import Component, as_material
from jaxrelight.brdf.texture import Texture
from tests.scene.scene_files import SMALL, values_of, write_scene
from tests.shared_data import shared

GOOD = """
[camera]
origin = [0, 1, 3]
target = [0, 0, 0]
up = [0, 1, 0]
fov_y = 40
width = 8
height = 6
[environment]
file = "sky.exr"
rotate_y = 30.0
scale = 2
[material.paper]
type = "lambert"
albedo = [0.5, 0.4, 0.3]
[material.lacquer]
type = "phong"
diffuse = 0.1
specular = [0.2, 0.3, 0.4]
exponent = 12
[material.brushed]
type = "lafortune"
diffuse = 0.05
[[material.brushed.lobes]]
C = [-1.0, -1.0, 0.5]
exponent = 3
specular = 0.5
[[mesh]]
primitive = "plane"
size = [2, 3]
resolution = 2
normalize = 1.5
transform = [[1, 0, 0, 1], [0, 1, 0, 2], [0, 0, 1, 3], [0, 0, 0, 1]]
material = "paper"
[[mesh]]
primitive = "sphere"
radius = 0.25
resolution = 2
material = "lacquer"
[[mesh]]
primitive = "box"
size = [1, 2, 3]
resolution = 1
material = "brushed"
"""


def _refusal(folder: pathlib.Path, text: str, names: str = "scene.toml") -> str:
    """The message with which a scene is refused: one line that names the file."""
    with pytest.raises(InputError) as caught:
        load_scene(write_scene(folder, text))
    message = str(caught.value)
    assert len(message.splitlines()) == 1
    assert names in message
    return message


def _changed(text: str, old: str, new: str) -> str:
    assert text.count(old) == 1
    return text.replace(old, new)


def _brdf(folder: pathlib.Path, lines: str):
    text = _changed(SMALL, 'type = "lambert"\nalbedo = 0.5', lines)
    return load_scene(write_scene(folder, text)).materials["paper"]


def test_every_key_is_read(folder):
    scene = load_scene(write_scene(folder, GOOD))
    camera, sky = scene.camera, scene.lights.environment
    assert (tuple(camera.origin), tuple(camera.target), tuple(camera.up)) == ((0, 1, 3), (0, 0, 0), (0, 1, 0))
    assert (camera.fov_y, camera.width, camera.height) == (40, 8, 6)
    assert sky is not None
    assert (sky.rotate_y, sky.scale, sky.pixels.shape) == (30, 2, (4, 8, 3))
    assert [(part.name, part.material) for part in scene.parts] == [
        ("plane", "paper"),
        ("sphere", "lacquer"),
        ("box", "brushed"),
    ]
    assert scene.name == "scene"
    floor, ball, block = (part.mesh.vertices for part in scene.parts)
    # Longest side 1.5, then moved by (1, 2, 3).
    np.testing.assert_allclose([floor.min(axis=0), floor.max(axis=0)], [[0.5, 2, 2.25], [1.5, 2, 3.75]], atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(ball, axis=-1), 0.25)
    np.testing.assert_allclose(np.ptp(block, axis=0), [1, 2, 3])
    np.testing.assert_allclose(values_of(scene.materials["paper"]), values_of(lambert([0.5, 0.4, 0.3])))
    np.testing.assert_allclose(values_of(scene.materials["lacquer"]), values_of(phong(0.1, [0.2, 0.3, 0.4], 12)))


def test_defaults(folder):
    scene = load_scene(write_scene(folder, SMALL))
    assert not scene.lights
    assert (scene.camera.width, scene.camera.height, scene.camera.fov_y) == (512, 512, 38)
    np.testing.assert_array_equal(scene.parts[0].mesh.vertices, plane(resolution=2).vertices)


def test_lights_are_an_environment_and_local_ones_together(folder):
    """From a file as from code, and in any form that stands for them."""
    lamp = '[[light]]\ntype = "point"\nposition = [0, 1, 0]\nintensity = 2\n'
    scene = load_scene(write_scene(folder, SMALL + '[environment]\nfile = "sky.exr"\n' + lamp))
    environment, local = scene.lights.environment, scene.lights.local
    assert environment is not None
    assert [type(light).__name__ for light in local] == ["Point"]
    for given in (scene.lights, [environment, *local], [*local, environment]):
        other = Scene(scene.parts, scene.materials, scene.camera, given)
        assert (other.lights.environment, other.lights.local) == (environment, local)
    for given, wanted in ((environment, (environment, ())), (local[0], (None, local)), (None, (None, ()))):
        other = dataclasses.replace(scene, lights=given)
        assert (other.lights.environment, other.lights.local) == wanted
    with pytest.raises(InputError, match="2 environments were given; a scene has one at most"):
        dataclasses.replace(scene, lights=[environment, environment])


def test_factors_of_a_material(folder):
    for asked, wanted in (
        ("terms = 7", Factoring(7)),
        ('form = "nonnegative"', Factoring(form="nonnegative")),
        ('terms_error = 0.1\nparametrisation = "polar"', Factoring(error=0.1, parametrisation="polar")),
    ):
        scene = load_scene(write_scene(folder, _changed(GOOD, "exponent = 12", f"exponent = 12\n{asked}")))
        assert scene.factors == {"lacquer": wanted}
    assert load_scene(write_scene(folder, GOOD)).factors == {}


def test_emission_of_a_material(folder):
    for number, radiance in (("2.5", [2.5, 2.5, 2.5]), ("[3, 2, 0]", [3, 2, 0])):
        scene = load_scene(write_scene(folder, _changed(SMALL, "albedo = 0.5", f"albedo = 0.5\nemission = {number}")))
        assert scene.emits
        np.testing.assert_array_equal(as_material(scene.materials["paper"]).emission, radiance)
    assert not load_scene(write_scene(folder, _changed(SMALL, "albedo = 0.5", "albedo = 0.5\nemission = 0"))).emits


def test_mesh_file_is_relative_to_the_scene(folder):
    (folder / "sub").mkdir()
    (folder / "sub" / "one.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\n")
    scene = load_scene(
        write_scene(folder, _changed(SMALL, 'primitive = "plane"\nresolution = 2', 'file = "sub/one.obj"'))
    )
    assert scene.parts[0].name == "one.obj"
    np.testing.assert_array_equal(scene.parts[0].mesh.vertices, load_mesh(folder / "sub" / "one.obj").vertices)


def test_notes_name_the_part(folder):
    (folder / "one.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nf 1 2 3\nf 1 2 3\n")
    write_image(folder / "sky.exr", np.full((4, 8, 3), -1.0))
    text = _changed(SMALL, 'primitive = "plane"\nresolution = 2', 'file = "one.obj"')
    scene = load_scene(write_scene(folder, text + '[environment]\nfile = "sky.exr"\n'))
    assert len(scene.notes) == 2
    assert scene.notes[0].startswith("one.obj: ")
    assert scene.notes[1].startswith("sky.exr: 32 ")


@pytest.mark.parametrize("name", ["bunny_lambert", "bunny_phong", "spot_lafortune"])
def test_reference_scene_loads(name: str):
    scene = load_scene(shared("reference", f"{name}.toml"))
    assert scene.name == name
    assert set(scene.materials) == {"object", "floor"}
    assert [part.material for part in scene.parts] == ["object", "floor"]
    assert (scene.camera.width, scene.camera.height) == (256, 256)
    assert scene.lights.environment is not None
    assert scene.lights.environment.scale == (10 if name == "bunny_phong" else 1)
    figure = scene.parts[0].mesh.vertices
    assert np.ptp(figure, axis=0).max() == pytest.approx(1)
    assert figure[:, 1].min() == pytest.approx(0, abs=1e-12)
    assert len(scene.parts[1].mesh.vertices) == 177**2
    assert scene.materials["object"].is_constant == (name == "bunny_lambert")


def test_local_lights_are_read():
    point, spot = (load_scene(shared("reference", f"room_{name}.toml")).lights.local[0] for name in ("point", "spot"))
    np.testing.assert_allclose(spot.target, [-0.9, 0.2, -0.6], rtol=1e-6)
    assert (spot.cutoff, spot.beam) == (25, 18)
    assert point.position.shape == point.intensity.shape == (3,)


LIGHT = '[[light]]\ntype = "point"\nposition = [0, 1, 0]\nintensity = 2\n[[mesh]]'


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ('"point"', '"lamp"', "[[light]] number 1: type 'lamp' is not known; known are point, spot, directional, "),
        ("intensity = 2", "intensity = -2", "'intensity' must not be negative"),
        ("position = [0, 1, 0]", "position = [0, 1]", "'position' must be 3 numbers"),
        ("position", "postion", "'postion' is not known; did you mean 'position'?"),
        ("intensity", "beam = 3\nintensity", "'beam' is not known"),
    ],
)
def test_lights_that_are_none_are_refused(folder, old: str, new: str, what: str):
    assert what in _refusal(folder, _changed(SMALL, "[[mesh]]", LIGHT.replace(old, new)))


# A key, in the table it belongs to, and how it may be misspelt where it need not be there.
@pytest.mark.parametrize(
    ("line", "misspelt", "right"),
    [
        ("[camera]", "camra", "camera"),
        ("origin = ", "orgin", "origin"),
        ("target = ", "traget", "target"),
        ("up = ", "upp", "up"),
        ("fov_y = ", "fovy", "fov_y"),
        ("width = ", "widht", "width"),
        ("height = ", "heigth", "height"),
        ("[environment]", "enviroment", "environment"),
        ("file = ", "fil", "file"),
        ("rotate_y = ", "rotatey", "rotate_y"),
        ("scale = ", "scal", "scale"),
        ("albedo = ", "albdo", "albedo"),
        ("radius = ", "raduis", "radius"),
        ("normalize = ", "normalise", "normalize"),
        ("transform = ", "tranform", "transform"),
    ],
)
def test_misspelt_key_is_told_the_right_one(folder, line: str, misspelt: str, right: str):
    message = _refusal(folder, _changed(GOOD, line, line.replace(right, misspelt)))
    assert f"'{misspelt}' is not known; did you mean '{right}'?" in message


@pytest.mark.parametrize(
    ("lines", "misspelt", "right"),
    [
        ('type = "phong"\ndifuse = 0.1\nspecular = 0.2\nexponent = 3', "difuse", "diffuse"),
        ('type = "phong"\ndiffuse = 0.1\nspecualr = 0.2\nexponent = 3', "specualr", "specular"),
        ('type = "phong"\ndiffuse = 0.1\nspecular = 0.2\nexponnet = 3', "exponnet", "exponent"),
        ('type = "lafortune"\ndiffuse = 0.1\nlobs = []', "lobs", "lobes"),
        ('tpye = "lambert"\nalbedo = 0.5', "tpye", "type"),
        ('type = "lambert"\nalbedo = 0.5\nnormalmap = "x.png"', "normalmap", "normal_map"),
    ],
)
def test_misspelt_material_key_is_told_the_right_one(folder, lines: str, misspelt: str, right: str):
    message = _refusal(folder, _changed(SMALL, 'type = "lambert"\nalbedo = 0.5', lines))
    assert f"'{misspelt}' is not known; did you mean '{right}'?" in message
    assert "[paper]" in message


@pytest.mark.parametrize(
    ("line", "misspelt", "right"),
    [
        ("primitive = ", "primitve", "primitive"),
        ("resolution = ", "resoltion", "resolution"),
    ],
)
def test_misspelt_mesh_key_is_named(folder, line: str, misspelt: str, right: str):
    message = _refusal(folder, _changed(SMALL, line, line.replace(right, misspelt)))
    assert "[[mesh]] number 1" in message
    assert right in message


def test_misspelt_top_level_array(folder):
    message = _refusal(folder, SMALL + '[[lihgt]]\ntype = "point"\n')
    assert "'lihgt' is not known; did you mean 'light'?" in message


def test_unknown_key_without_a_like_lists_the_known(folder):
    message = _refusal(folder, _changed(SMALL, "target = ", "zzz = 1\ntarget = "))
    assert "'zzz' is not known; known are fov_y, height, origin, target, up, width" in message


@pytest.mark.parametrize(
    ("old", "new", "where"),
    [
        ("[0, 1, 3]", "[0, 1]", "[camera]: 'origin' must be 3 numbers"),
        ("[0, 1, 3]", "3", "[camera]: 'origin' must be 3 numbers"),
        ("[0, 1, 3]", '"eye"', "[camera]: 'origin' must be 3 numbers"),
        ("[0, 1, 3]", "[0, [1], 3]", "[camera]: 'origin' must be 3 numbers"),
        ("[0, 1, 3]", "[0, nan, 3]", "[camera]: 'origin' must be finite"),
        ("[0, 1, 3]", "[0, -inf, 3]", "[camera]: 'origin' must be finite"),
        ("[0, 1, 3]", "[0, 0, 0]", "[camera]: the camera's view direction"),
        ("[0, 0, 0]", "[0, 0, 0]\nfov_y = 0", "[camera]: the camera's fov_y is 0.0"),
        ("[0, 0, 0]", "[0, 0, 0]\nfov_y = [1]", "[camera]: 'fov_y' must be a number"),
        ("[0, 0, 0]", "[0, 0, 0]\nwidth = 1.5", "[camera]: 'width' must be a whole number"),
        ("[0, 0, 0]", "[0, 0, 0]\nheight = true", "[camera]: 'height' must be a whole number"),
        ("[0, 0, 0]", "[0, 0, 0]\nheight = 0", "[camera]: the camera's image is 512 × 0"),
        ("albedo = 0.5", "albedo = [0.5, 0.5]", "[paper]: 'albedo' must be a number or 3 numbers"),
        ("albedo = 0.5", "albedo = -0.5", "[paper]: 'albedo' must not be negative"),
        ("albedo = 0.5", "albedo = 0.5\nemission = [1, -1, 1]", "[paper]: 'emission' must not be negative"),
        ("albedo = 0.5", "albedo = nan", "[paper]: 'albedo' must be finite"),
        ("albedo = 0.5", "albedo = true", "[paper]: 'albedo' must be a number"),
        ("albedo = 0.5", "albedo = 0.5\nterms = 0", "[paper]: 'terms' must be at least 1, not 0"),
        ("albedo = 0.5", "albedo = 0.5\nterms = 1.5", "[paper]: 'terms' must be a whole number"),
        ('"lambert"', "3", "[paper]: 'type' must be text"),
        ('"lambert"', '"lambart"', "[paper]: type 'lambart' is not known; known are lambert, phong, lafortune"),
        ('"plane"', '"plain"', "number 1: primitive 'plain' is not known; known are plane, sphere, box"),
        ('material = "paper"', 'material = "papre"', "no [material.papre]; did you mean 'paper'?"),
        ('material = "paper"', 'material = "zzz"', "there is no [material.zzz]"),
        ('material = "paper"', "", "number 1: 'material' is missing"),
        ("resolution = 2", "resolution = 2.0", "'resolution' must be a whole number"),
        ("resolution = 2", "transform = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]", "'transform' must be 4 × 4 numbers"),
        ("resolution = 2", 'file = "a.ply"', "give either 'file' or 'primitive'"),
        ("[[mesh]]", "[mesh]", "'mesh' must be written as [[mesh]]"),
        ("[camera]", "[[camera]]", "[camera] must be a table"),
        ("[material.paper]", "[[material]]", "[material] must be a table"),
    ],
)
def test_wrong_values_are_refused(folder, old: str, new: str, where: str):
    assert where in _refusal(folder, _changed(SMALL, old, new))


def test_scene_without_mesh(folder):
    assert "the scene has no [[mesh]]" in _refusal(folder, SMALL.partition("[[mesh]]")[0])


def test_scene_without_camera(folder):
    assert "[material" not in _refusal(folder, "")
    assert "'camera' is missing" in _refusal(folder, "")


@pytest.mark.parametrize("text", ["camera = = 1", "[camera", 'a = "b', "[camera]\n[camera]\n", "\x00"])
def test_invalid_toml(folder, text: str):
    assert "not a TOML file" in _refusal(folder, text)


def test_ashikhmin_shirley_material(folder):
    lines = 'type = "ashikhmin_shirley"\nkd = [0.1, 0.2, 0.3]\nks = 0.75\nnu = 10\nnv = 100.5'
    assert eqx.tree_equal(_brdf(folder, lines), ashikhmin_shirley([0.1, 0.2, 0.3], 0.75, 10, 100.5))


@pytest.mark.parametrize(
    ("old", "new", "fault"),
    [
        ("kd = 0.5", "kd = 1.5", "'kd' must be from 0 to 1"),
        ("nu = 10", "nu = -1", "'nu' must be one finite number of at least 0"),
        ("nu = 10", "", "'nu' is missing"),
        ("nv = 1", "nvv = 1", "'nvv' is not known; did you mean 'nv'?"),
    ],
)
def test_faults_of_an_ashikhmin_shirley_material_are_named(folder, old: str, new: str, fault: str):
    lines = 'type = "ashikhmin_shirley"\nkd = 0.5\nks = 0.5\nnu = 10\nnv = 1'
    message = _refusal(folder, _changed(SMALL, 'type = "lambert"\nalbedo = 0.5', _changed(lines, old, new)))
    assert "[paper]" in message
    assert fault in message


def test_unreadable_scene_files(folder):
    for path in (folder, folder / "none.toml"):
        with pytest.raises(InputError, match=re.escape(f"{path}: cannot be read as a scene: ")) as caught:
            load_scene(path)
        assert len(str(caught.value).splitlines()) == 1
    path = folder / "latin.toml"
    path.write_bytes(b'# \xe9t\xe9\n[camera]\nname = "\xff"\n')
    with pytest.raises(InputError, match=re.escape(f"{path}: cannot be read as a scene: it is not UTF-8 text")):
        load_scene(path)


@pytest.mark.parametrize(
    ("old", "new", "names"),
    [
        ('primitive = "plane"\nresolution = 2', 'file = "none.ply"', "none.ply"),
        ('primitive = "plane"\nresolution = 2', 'file = "sky.exr"', "sky.exr"),
        ("[[mesh]]", '[environment]\nfile = "none.hdr"\n[[mesh]]', "none.hdr"),
        ("[[mesh]]", '[environment]\nfile = "scene.toml"\n[[mesh]]', "scene.toml"),
        ("[[mesh]]", '[environment]\nfile = "square.exr"\nlayout = "cross"\n[[mesh]]', "square.exr is 4 × 4 pixels"),
        ("[[mesh]]", '[environment]\nfile = "square.exr"\nlayout = "cube"\n[[mesh]]', "layout 'cube' is not known"),
        ("[[mesh]]", '[environment]\nfile = "nan.exr"\n[[mesh]]', "nan.exr has 1 NaN or infinite pixels"),
        ("[[mesh]]", '[environment]\nfile = "sky.exr"\nscale = -1\n[[mesh]]', "rotate_y must be"),
    ],
)
def test_bad_files_are_named(folder, old: str, new: str, names: str):
    write_image(folder / "square.exr", np.ones((4, 4, 3)))
    pixels = np.ones((4, 8, 3))
    pixels[1, 2, 0] = np.nan
    write_image(folder / "nan.exr", pixels)
    _refusal(folder, _changed(SMALL, old, new), names)


def test_nonfinite_environment_is_zeroed_when_asked(folder):
    pixels = np.ones((4, 8, 3))
    pixels[1, 2, 0] = np.inf
    write_image(folder / "sky.exr", pixels)
    scene = load_scene(write_scene(folder, SMALL + '[environment]\nfile = "sky.exr"\n'), zero_nonfinite=True)
    assert scene.lights.environment is not None
    assert np.sum(scene.lights.environment.pixels) == 3 * 31
    assert scene.notes == ("sky.exr: 1 NaN or infinite pixels were set to 0",)


def test_lafortune_numbers_may_differ_by_channel(folder):
    head = 'type = "lafortune"\ndiffuse = {0}\nlobes = [{{C = {1}, exponent = {2}, specular = {3}}}]'
    C = [[-1, -1, 0.9], [-0.8, -0.9, 0.7], [0.6, 0.5, 0.95]]
    diffuse, exponent, specular = [0.1, 0.2, 0.3], [2, 5, 9], [0.4, 0.5, 0.6]
    together = values_of(_brdf(folder, head.format(diffuse, C, exponent, specular)))
    assert together.shape == (20, 3)
    for c in range(3):
        alone = values_of(_brdf(folder, head.format(diffuse[c], C[c], exponent[c], specular[c])))
        np.testing.assert_allclose(together[:, c], alone[:, c], rtol=1e-6)
    assert np.ptp(together, axis=-1).max() > 0.05


def test_peak_and_specular_forms_agree(folder):
    head = 'type = "lafortune"\ndiffuse = 0.1\nlobes = [{{C = [-0.8, -0.8, 0.5], exponent = 7, {}}}]'
    specular = values_of(_brdf(folder, head.format("specular = [1, 2, 3]")))
    largest = [factor * 0.8**7 for factor in (1, 2, 3)]
    np.testing.assert_allclose(values_of(_brdf(folder, head.format(f"peak = {largest}"))), specular, rtol=1e-6)


@pytest.mark.parametrize(
    ("lobe", "what"),
    [
        ("C = [-1, -1, 1], exponent = 3", "exactly one of 'specular' and 'peak'"),
        ("C = [-1, -1, 1], exponent = 3, specular = 1, peak = 1", "exactly one of 'specular' and 'peak'"),
        ("C = [-1, -1], exponent = 3, specular = 1", "'C' must be 3 numbers or 3 × 3 numbers"),
        ("C = [-1, -1, 1], exponent = -3, specular = 1", "'exponent' must not be negative"),
        ("C = [-1, -1, 1], exponent = [1, 2], specular = 1", "'exponent' must be a number or 3 numbers"),
        ("C = [-1.1, -1, 1], exponent = 1e4, specular = 1", "give 'peak', its largest value, instead"),
        ("C = [-1, -1, inf], exponent = 3, specular = 1", "'C' must be finite"),
        ("C = [-1, -1, 1], exponent = 3, specular = 1, shape = 2", "'shape' is not known"),
    ],
)
def test_bad_lobes_are_refused(folder, lobe: str, what: str):
    lines = f'type = "lafortune"\ndiffuse = 0.1\nlobes = [{{{lobe}}}]'
    message = _refusal(folder, _changed(SMALL, 'type = "lambert"\nalbedo = 0.5', lines))
    assert what in message
    assert "[paper]" in message


def test_second_lobe_is_named(folder):
    good, bad = "C = [-1, -1, 1], exponent = 3, peak = 1", "C = [-1, -1, 1], exponent = nan, peak = 1"
    lines = f'type = "lafortune"\ndiffuse = 0.1\nlobes = [{{{good}}}, {{{bad}}}]'
    message = _refusal(folder, _changed(SMALL, 'type = "lambert"\nalbedo = 0.5', lines))
    assert "[paper]: [[lobes]] number 2: 'exponent' must be finite" in message


def _fault(tmp_path, text: str) -> str:
    path = tmp_path / "scene.toml"
    path.write_text(text)
    with pytest.raises(InputError) as caught:
        load_scene(path)
    message = str(caught.value)
    assert message.startswith(str(path))
    assert "\n" not in message
    return message


_CAMERA = "[camera]\norigin = [0, 1, 2]\ntarget = [0, 0, 0]\n"
_PAPER = '[material.paper]\ntype = "lambert"\nalbedo = 0.5\n'


def test_a_misspelt_required_key_is_found_wherever_it_stands(tmp_path):
    assert "'orign'" in _fault(tmp_path, "[camera]\ntarget = [0, 0, 0]\nup = [0, 1, 0]\norign = [0, 1, 2]\n")
    part = '[[mesh]]\nprimitive = "box"\nmaterail = "paper"\n'
    assert "materail" in _fault(tmp_path, _CAMERA + _PAPER + part)
    assert "there is no [material.paper]" in _fault(tmp_path, _CAMERA + part.replace("materail", "material"))


@pytest.mark.parametrize(
    "part",
    [
        'primitive = "sphere"\nradius = -1\n',
        'primitive = "plane"\nsize = [-1, 1]\n',
        'primitive = "box"\nnormalize = -1\n',
        'primitive = "box"\ntransform = [[0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1]]\n',
        'file = "nowhere.ply"\n',
    ],
)
def test_faults_of_a_part_name_the_scene_and_the_part(tmp_path, part):
    assert "[[mesh]] number 1" in _fault(tmp_path, _CAMERA + _PAPER + f'[[mesh]]\nmaterial = "paper"\n{part}')


@pytest.mark.parametrize("albedo", ["1e300", "[0.5, true, 0.5]", '["0.5", "0.5", "0.5"]'])
def test_what_is_no_number_for_float32_is_refused(tmp_path, albedo):
    assert "albedo" in _fault(tmp_path, _CAMERA + f'[material.paper]\ntype = "lambert"\nalbedo = {albedo}\n')


@pytest.mark.parametrize(
    ("lines", "albedo"),
    [
        ('type = "lambert"\nalbedo = [0.5, 1.5, 0]', "1.5"),
        ('type = "phong"\ndiffuse = 0.7\nspecular = 0.5\nexponent = 9', "1.2"),
        ('type = "lafortune"\ndiffuse = 0.5\nlobes = [{C = [-1, -1, 0.5], exponent = 2, peak = 8}]', "3.64"),
        ('type = "lambert"\nalbedo = 1', None),
        ('type = "phong"\ndiffuse = 0.5\nspecular = 0.5\nexponent = 9', None),
    ],
)
def test_a_material_that_makes_light_is_told(folder, lines: str, albedo: str | None):
    scene = load_scene(write_scene(folder, _changed(SMALL, 'type = "lambert"\nalbedo = 0.5', lines)))
    told = [f"[material.paper]: reflects {albedo} times the light it gets; lower its colours"]
    assert list(scene.notes) == (told if albedo else [])


def test_light_made_by_a_mixture_is_told(folder):
    parts = ", ".join(f'{{material = "white", weight = {weight}}}' for weight in (0.7, 0.8))
    white = '[material.white]\ntype = "lambert"\nalbedo = 1\n[material.paper]\ntype = "mixture"\n'
    text = _changed(SMALL, '[material.paper]\ntype = "lambert"\nalbedo = 0.5', f"{white}parts = [{parts}]")
    (note,) = load_scene(write_scene(folder, text)).notes
    assert note.startswith("[material.paper]: reflects 1.5 times")


# Materials that vary over the surface, and those of mesh files.


def _image(folder, name: str, pixels) -> None:
    Image.fromarray(np.asarray(pixels, np.uint8)).save(folder / name)


def _image_of(component: Component) -> np.ndarray:
    """The pixels of a component's first texture."""
    texture = component.weight[0]
    assert isinstance(texture, Texture)
    return np.asarray(texture.pixels)


def test_pictures_for_colours(folder):
    _image(folder, "wood.png", [[[255, 0, 188]], [[0, 255, 255]]])
    text = GOOD.replace("albedo = [0.5, 0.4, 0.3]", 'albedo = "wood.png"').replace(
        "diffuse = 0.1", 'diffuse = "wood.png"'
    )
    scene = load_scene(write_scene(folder, text))
    wood, lacquer = as_material(scene.materials["paper"]), as_material(scene.materials["lacquer"])
    linear = ((188 / 255 + 0.055) / 1.055) ** 2.4
    (component,) = wood.components
    np.testing.assert_allclose(_image_of(component)[:, 0], [[1, 0, linear], [0, 1, 1]], rtol=1e-5)
    np.testing.assert_allclose(values_of(component.brdf), 1 / np.pi, rtol=1e-6)
    diffuse, specular = lacquer.components
    # The ball has no texture coordinates.
    np.testing.assert_allclose(_image_of(diffuse)[0, 0], component.weight[0].mean, rtol=1e-6)
    np.testing.assert_allclose(_image_of(specular), [[[0.2, 0.3, 0.4]]], rtol=1e-6)
    np.testing.assert_allclose(values_of(specular.brdf)[:, 0], values_of(phong(0, 1, 12))[:, 0], rtol=1e-6)


def test_mixtures_and_normal_maps(folder):
    _image(folder, "mask.png", [[[0, 51, 255]]])
    _image(folder, "bumps.png", [[[128, 128, 255]]])
    parts = (
        '{material = "paper", weight = "mask.png"}',
        '{material = "lacquer", weight = 0.5}',
        '{material = "brushed", weight = [0, 1, 0]}',
    )
    mixed = f'[material.mixed]\ntype = "mixture"\nnormal_map = "bumps.png"\nparts = [{", ".join(parts)}]\n'
    mixed += '[[mesh]]\nprimitive = "plane"\n'
    scene = load_scene(write_scene(folder, GOOD.replace('[[mesh]]\nprimitive = "plane"\n', mixed)))
    material = as_material(scene.materials["mixed"])
    factors = [factor for component in material.components for factor in component.weight]
    weights = [np.asarray(factor.pixels).ravel() for factor in factors if isinstance(factor, Texture)]
    np.testing.assert_allclose(weights[0], [0, 0.2, 1], atol=1e-6)  # masks are data, not colours
    np.testing.assert_allclose(weights[1], [0.5])
    np.testing.assert_allclose(weights[2], [0, 1, 0])
    assert material.normal_map is not None
    np.testing.assert_allclose(material.normal_map.pixels[0, 0], [128 / 255, 128 / 255, 1], atol=1e-6)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ("albedo = 0.5", 'albedo = "none.png"', "none.png: no such file"),
        ("albedo = 0.5", "albedo = 0.5\nnormal_map = [0, 0, 1]\nx = 1", "'x' is not known"),
        ("albedo = 0.5", "albedo = 0.5\nnormal_map = 3", "'normal_map' must be 3 numbers, not 3"),
        ('type = "lambert"\nalbedo = 0.5', 'type = "mixture"', "a mixture needs 'parts'"),
        (
            'type = "lambert"\nalbedo = 0.5',
            'type = "mixture"\nparts = [{material = "paper", weight = 1}]',
            "there is no [material.paper] to mix",
        ),
        ("resolution = 2", "two_sided = 1", "'two_sided' must be true or false, not 1"),
        ("resolution = 2", 'tangents = "vu"', '\'tangents\' is "normal" or "uv"'),
        ('primitive = "plane"', 'primitive = "sphere"\ntangents = "uv"', "needs texture coordinates"),
        (
            "resolution = 2",
            'materials = {top = "paper"}',
            "give either 'material' for all of it or 'materials' by part",
        ),
    ],
)
def test_faults_of_what_varies(folder, old: str, new: str, what: str):
    assert what in _refusal(folder, _changed(SMALL, old, new))
