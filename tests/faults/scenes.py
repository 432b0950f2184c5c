"""Scenes with one fault each, and how commands end that are given them: one line that says where and what."""

import pathlib
from collections.abc import Mapping
from typing import NamedTuple

import numpy as np

from jaxrelight.images import write_image
from tests.commands.running import DIALS, NO_BOUNCES, run

SCENE = """
[camera]
origin = [0, 1, 3]
target = [0, 0.1, 0]
up = [0, 1, 0]
fov_y = 40
width = 8
height = 6
[environment]
file = "sky.exr"
rotate_y = 30
scale = 1
[material.paper]
type = "lambert"
albedo = [0.5, 0.4, 0.3]
[material.wood]
type = "phong"
diffuse = "wood.png"
specular = 0.2
exponent = 5
normal_map = "bumps.png"
[material.brushed]
type = "lafortune"
diffuse = 0.1
lobes = [{ C = [-1, -1, 0.9], exponent = 3, specular = 0.2 }]
[material.metal]
type = "ashikhmin_shirley"
kd = 0.1
ks = 0.5
nu = 10
nv = 20
[material.both]
type = "mixture"
terms = 2
parts = [{ material = "paper", weight = 0.5 }, { material = "brushed", weight = "mask.png" }]
[[mesh]]
primitive = "plane"
size = [2, 2]
resolution = 2
material = "both"
[[mesh]]
primitive = "box"
resolution = 1
max_edge = 0.8
tangents = "uv"
material = "metal"
[[mesh]]
file = "card.obj"
normalize = 0.5
two_sided = true
transform = [[1, 0, 0, 0.5], [0, 1, 0, 0.1], [0, 0, 1, 0], [0, 0, 0, 1]]
material = "wood"
[[mesh]]
file = "bare.obj"
materials = { steel = "paper" }
"""

_CARD = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nvt 0 0\nvt 1 0\nvt 1 1\nvt 0 1\nf 1/1 2/2 3/3 4/4\n"
_BARE = "v 0 0 0\nv 1 0 0\nv 1 1 0\nv 0 1 0\nusemtl steel\nf 1 2 3 4\n"


class Fault(NamedTuple):
    """One fault of a scene.

    Attributes:
        old: what is replaced in the sound scene, where it stands once; all of it, where this is empty.
        new: by what.
        says: what the message must hold, beside the name of the scene.
        receivers: that are asked for.
    """

    old: str
    new: str | bytes
    says: tuple[str, ...]
    receivers: str = "pixels"


def _fault(old: str, new: str | bytes, *says: str, receivers: str = "pixels") -> Fault:
    return Fault(old, new, says, receivers)


def _camera() -> dict[str, Fault]:
    width, fov, origin = "width = 8", "fov_y = 40", "origin = [0, 1, 3]"
    return {
        "no camera": _fault(SCENE[: SCENE.index("[environment]")], "", "'camera' is missing"),
        "camera misspelt": _fault("[camera]", "[camrea]", "'camrea' is not known; did you mean 'camera'?"),
        "camera as a list": _fault("[camera]", "[[camera]]", "[camera] must be a table"),
        "camera as a number": _fault(SCENE[: SCENE.index("[environment]")], "camera = 3\n", "[camera] must be a table"),
        "no origin": _fault(origin, "", "[camera]", "'origin' is missing"),
        "origin of two numbers": _fault(origin, "origin = [0, 1]", "'origin' must be 3 numbers"),
        "origin nested": _fault(origin, "origin = [[0, 1, 3]]", "'origin' must be 3 numbers"),
        "origin as text": _fault(origin, 'origin = "0 1 3"', "'origin' must be 3 numbers"),
        "origin with true": _fault(origin, "origin = [0, true, 3]", "'origin' must be 3 numbers"),
        "origin with nan": _fault(origin, "origin = [0, nan, 3]", "'origin' must be finite"),
        "origin with inf": _fault(origin, "origin = [0, -inf, 3]", "'origin' must be finite"),
        "origin of 1e999": _fault(origin, "origin = [0, 1e999, 3]", "'origin' must be finite"),
        "origin beyond float32": _fault(origin, "origin = [0, 1e39, 3]", "'origin' must be finite, also as float32"),
        "origin is target": _fault(origin, "origin = [0, 0.1, 0]", "[camera]", "origin equal target"),
        "up along the view": _fault("up = [0, 1, 0]", "up = [0, 0.9, 3]", "[camera]", "up must not be parallel"),
        "up of length 0": _fault("up = [0, 1, 0]", "up = [0, 0, 0]", "[camera]", "up must not be parallel"),
        "view past all surfaces": _fault("target = [0, 0.1, 0]", "target = [0, 9, 9]", "the camera sees no surface"),
        "field of view 0": _fault(fov, "fov_y = 0", "fov_y is 0.0; it must lie between 0 and 180"),
        "field of view 180": _fault(fov, "fov_y = 180", "fov_y is 180.0; it must lie between 0 and 180"),
        "field of view negative": _fault(fov, "fov_y = -40", "fov_y is -40.0; it must lie between 0 and 180"),
        "field of view nan": _fault(fov, "fov_y = nan", "'fov_y' must be finite"),
        "width 0": _fault(width, "width = 0", "0 × 6 pixels; it needs at least one"),
        "width negative": _fault(width, "width = -8", "-8 × 6 pixels; it needs at least one"),
        "width broken": _fault(width, "width = 8.5", "'width' must be a whole number"),
        "width true": _fault(width, "width = true", "'width' must be a whole number"),
        "width beyond memory": _fault(width, "width = 1_000_000_000_000", "pixels; it may have at most"),
        "key misspelt": _fault(width, "widht = 8", "'widht' is not known; did you mean 'width'?"),
        "key unlike any": _fault(width, "exposure_time = 8", "'exposure_time' is not known; known are fov_y"),
        "key given twice": _fault(width, "width = 8\nwidth = 8", "not a TOML file", "line 8"),
        "key with a line break": _fault(width, '"wi\\ndth" = 8', "is not known"),
    }


def _environment() -> dict[str, Fault]:
    file, scale = 'file = "sky.exr"', "scale = 1"
    lamp = '[[light]]\ntype = "point"\nposition = [0, 1, 0]\nintensity = 1\n'
    table = SCENE[SCENE.index("[environment]") : SCENE.index("[material.paper]")]
    return {
        "no light": _fault(table, "", "there is no light; name an environment with --env MAP, or give the scene a"),
        "environment misspelt": _fault("[environment]", "[enviroment]", "did you mean 'environment'?"),
        "environment as text": _fault(SCENE, 'environment = "sky.exr"\n' + SCENE.replace(table, ""), "must be a table"),
        "environment as a list": _fault("[environment]", "[[environment]]", "[environment] must be a table"),
        "environment without file": _fault(file, "", "[environment]", "'file' is missing"),
        "environment file is no text": _fault(file, "file = 3", "'file' must be text, not 3"),
        "environment missing": _fault(file, 'file = "none.exr"', "[environment]", "none.exr: no such file; check"),
        "environment empty": _fault(file, 'file = "empty.exr"', "empty.exr: the file is empty; export or copy"),
        "environment a folder": _fault(file, 'file = "folder.exr"', "folder.exr: is a folder; give the path of"),
        "environment no picture": _fault(file, 'file = "text.hdr"', "[environment]", "text.hdr: ", "; "),
        "environment of another kind": _fault(file, 'file = "card.obj"', "unknown kind of image '.obj'; use one of"),
        "environment with nan": _fault(file, 'file = "nan.exr"', "nan.exr has 1 NaN or infinite pixels", "row 1"),
        "environment path with a zero": _fault(file, 'file = "sky\\u0000.exr"', "no such file; check the path"),
        "layout unknown": _fault(scale, 'layout = "dome"', "layout", "dome"),
        "layout that does not fit": _fault(scale, 'layout = "cross"', "layout", "cross"),
        "rotation as text": _fault("rotate_y = 30", 'rotate_y = "30°"', "'rotate_y' must be a number"),
        "rotation inf": _fault("rotate_y = 30", "rotate_y = inf", "'rotate_y' must be finite"),
        "scale negative": _fault(scale, "scale = -1", "[environment]", "scale finite and not negative"),
        "scale nan": _fault(scale, "scale = nan", "'scale' must be finite"),
        "scale misspelt": _fault(scale, "sacle = 1", "'sacle' is not known; did you mean 'scale'?"),
        "lights": _fault("[environment]", '[[light]]\ntype = "point"\n[environment]', "'position' is missing"),
        "light of negative intensity": _fault(
            "[environment]", f"{lamp}[environment]".replace("intensity = ", "intensity = -"), "must not be negative"
        ),
        "light with nan": _fault("[environment]", f"{lamp}[environment]".replace("[0, 1", "[0, nan"), "must be finite"),
        "light of another kind": _fault("[environment]", f"{lamp}[environment]".replace("point", "lamp"), "'lamp'"),
    }


def _materials() -> dict[str, Fault]:
    lobe, paper, wood = "C = [-1, -1, 0.9], exponent = 3, specular = 0.2", "albedo = [0.5, 0.4, 0.3]", '"wood.png"'
    parts = SCENE[SCENE.index("parts = ") : SCENE.index('[[mesh]]\nprimitive = "plane"')]
    return {
        "material as a list": _fault("[material.paper]", "[[material.paper]]", "[paper] must be a table"),
        "material given twice": _fault("[material.wood]", "[material.paper]", "not a TOML file", "line 16"),
        "type missing": _fault('type = "lambert"', "", "[paper]", "'type' is missing"),
        "type misspelt": _fault('"lambert"', '"lambret"', "[paper]", "type 'lambret' is not known; known are"),
        "type that needs maps": _fault('"lambert"', '"sbrdf"', "'maps' is missing"),
        "albedo negative": _fault(paper, "albedo = [0.5, -0.4, 0.3]", "[paper]", "'albedo' must not be negative"),
        "albedo of two numbers": _fault(paper, "albedo = [0.5, 0.4]", "'albedo' must be a number or 3 numbers"),
        "albedo true": _fault(paper, "albedo = true", "'albedo' must be a number or 3 numbers"),
        "albedo nan": _fault(paper, "albedo = [0.5, nan, 0.3]", "'albedo' must be finite"),
        "albedo misspelt": _fault(paper, "albdeo = 0.5", "'albdeo' is not known; did you mean 'albedo'?"),
        "exponent negative": _fault("exponent = 5", "exponent = -5", "[wood]", "'exponent' must not be negative"),
        "exponent a picture": _fault("exponent = 5", 'exponent = "wood.png"', "'exponent' must be a number"),
        "terms 0": _fault("terms = 2", "terms = 0", "[both]", "'terms' must be at least 1, not 0"),
        "terms broken": _fault("terms = 2", "terms = 2.5", "[both]", "'terms' must be a whole number"),
        "terms past the map": _fault(
            "terms = 2", "terms = 65", "material 'both'", "65 terms cannot be had", receivers="vertices"
        ),
        "lobes as a table": _fault("[{ " + lobe + " }]", "{ " + lobe + " }", "'lobes' must be written as [[lobes]]"),
        "lobe without factor": _fault(", specular = 0.2 }]", " }]", "[brushed]", "one of 'specular' and 'peak'"),
        "lobe with both factors": _fault(lobe, f"{lobe}, peak = 1", "[brushed]", "one of 'specular' and 'peak'"),
        "lobe without C": _fault("C = [-1, -1, 0.9], ", "", "[[lobes]] number 1", "'C' is missing"),
        "lobe with C of two numbers": _fault("[-1, -1, 0.9]", "[-1, -1]", "'C' must be 3 numbers or 3 × 3 numbers"),
        "lobe past float32": _fault(lobe, "C = [-9, -9, 9], exponent = 99, specular = 1", "[brushed]", "give 'peak'"),
        "lobe negative": _fault("specular = 0.2 }", "specular = -0.2 }", "'specular' must not be negative"),
        "kd above 1": _fault("kd = 0.1", "kd = 1.1", "[metal]", "'kd' must be from 0 to 1"),
        "ks negative": _fault("ks = 0.5", "ks = -0.5", "[metal]", "'ks' must be from 0 to 1"),
        "nu negative": _fault("nu = 10", "nu = -10", "[metal]", "'nu' must be one finite number of at least 0"),
        "nv by channel": _fault("nv = 20", "nv = [1, 2, 3]", "[metal]", "'nv' must be a number"),
        "mixture without parts": _fault(parts, "", "[both]", "a mixture needs 'parts'"),
        "mixture of nothing": _fault(parts, "parts = []\n", "[both]", "a mixture needs 'parts'"),
        "mixture of numbers": _fault(parts, "parts = [1, 2]\n", "[both]", "number 1 must be a table"),
        "mixture of the unknown": _fault('material = "brushed", w', 'material = "brused", w', "did you mean 'brushed'"),
        "mixture of itself": _fault('material = "brushed", w', 'material = "both", w', "no mixture itself"),
        "mixture of a bumpy one": _fault('material = "brushed", w', 'material = "wood", w', "give it to the mixture"),
        "weight missing": _fault(', weight = "mask.png"', "", "[both]", "number 2", "'weight' is missing"),
        "weight negative": _fault("weight = 0.5", "weight = -0.5", "[both]", "'weight' must not be negative"),
        "weight misspelt": _fault("weight = 0.5", "wieght = 0.5", "'wieght' is not known; did you mean 'weight'?"),
        "mask missing": _fault('"mask.png"', '"none.png"', "[both]", "none.png: no such file; check the path"),
        "texture missing": _fault(wood, '"none.png"', "[wood]", "none.png: no such file; check the path"),
        "texture a folder": _fault(wood, '"folder.png"', "[wood]", "folder.png: is a folder; give the path of"),
        "texture empty": _fault(wood, '"empty.png"', "[wood]", "empty.png: the file is empty; export or copy"),
        "texture no picture": _fault(wood, '"text.png"', "[wood]", "text.png: not a PNG file"),
        "texture with nan": _fault(wood, '"nan.exr"', "[wood]", "nan.exr: a texture needs pixels that are finite"),
        "texture negative": _fault(wood, '"negative.exr"', "[wood]", "not negative; repair the image"),
        "texture of another kind": _fault(wood, '"card.obj"', "[wood]", "unknown kind of image '.obj'; use one of"),
        "normal map of one number": _fault('"bumps.png"', "0.5", "[wood]", "'normal_map' must be 3 numbers"),
        "normal map missing": _fault('"bumps.png"', '"none.png"', "[wood]", "none.png: no such file; check the path"),
        "normal map with nan": _fault('"bumps.png"', '"nan.exr"', "[wood]", "finite and not negative; repair"),
        "normal map misspelt": _fault("normal_map", "normalmap", "'normalmap' is not known; did you mean 'normal_map'"),
    }  # fmt: skip


def _meshes() -> dict[str, Fault]:
    card, size, matrix = 'file = "card.obj"', "size = [2, 2]", SCENE[SCENE.index("transform") :].splitlines()[0]
    meshes = SCENE[SCENE.index("[[mesh]]") :]

    def moved(*rows) -> str:
        return f"transform = {[list(row) for row in rows]}"

    flat = moved([1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 0], [0, 0, 0, 1])
    return {
        "no mesh": _fault(meshes, "", "the scene has no [[mesh]]"),
        "mesh as a table": _fault(meshes, meshes.split("[[mesh]]")[1].join(["[mesh]", ""]), "written as [[mesh]]"),
        "mesh misspelt": _fault(meshes, meshes.replace("[[mesh]]", "[[mehs]]"), "'mehs' is not known; did you mean"),
        "neither file nor primitive": _fault(card, "", "number 3", "give either 'file' or 'primitive'"),
        "file and primitive": _fault(card, f'{card}\nprimitive = "box"', "give either 'file' or 'primitive'"),
        "primitive unknown": _fault('"plane"', '"torus"', "number 1", "'torus' is not known; known are plane, sphere"),
        "primitive without material": _fault('material = "both"', "", "number 1", "'material' is missing"),
        "material unknown": _fault('material = "metal"', 'material = "metla"', "number 2", "did you mean 'metal'?"),
        "material no text": _fault('material = "metal"', "material = 3", "number 2", "'material' must be text, not 3"),
        "part unknown": _fault("{ steel", "{ stele", "number 4", "'stele' is not known; did you mean 'steel'?"),
        "part of an unknown material": _fault('{ steel = "paper" }', '{ steel = "papre" }', "did you mean 'paper'?"),
        "material twice": _fault('material = "wood"', 'material = "wood"\nmaterials = { a = "paper" }', "give either"),
        "size negative": _fault(size, "size = [2, -2]", "number 1", "is not 2 positive numbers of metres"),
        "size 0": _fault(size, "size = [0, 2]", "number 1", "is not 2 positive numbers of metres"),
        "size of a box": _fault(size, "size = [2, 2, 2]", "number 1", "'size' must be 2 numbers"),
        "radius of a plane": _fault(size, "radius = 2", "number 1", "'radius' is not known; known are"),
        "resolution 0": _fault("resolution = 2", "resolution = 0", "number 1", "is not a whole number"),
        "resolution past memory": _fault("resolution = 2", "resolution = 10_000_000", "quads; give a lower one"),
        "resolution broken": _fault("resolution = 2", "resolution = 2.0", "'resolution' must be a whole number"),
        "normalize 0": _fault("normalize = 0.5", "normalize = 0", "number 3", "give the longest side as a positive"),
        "normalize nan": _fault("normalize = 0.5", "normalize = nan", "number 3", "'normalize' must be finite"),
        "transform 3 × 3": _fault(matrix, "transform = [[1, 0, 0], [0, 1, 0], [0, 0, 1]]", "must be 4 × 4 numbers"),
        "transform ragged": _fault(matrix, "transform = [[1, 0], [0, 1, 0]]", "'transform' must be 4 × 4 numbers"),
        "transform flattens": _fault(matrix, flat, "number 3", "transform is singular"),
        "transform by columns": _fault(
            matrix, moved([1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, 0], [1, 2, 3, 1]), "row by row"
        ),
        "transform out of the world": _fault(
            matrix, moved([1e31, 0, 0, 0], [0, 1e31, 0, 0], [0, 0, 1e31, 0], [0, 0, 0, 1]), "scale it down"
        ),
        "max_edge negative": _fault("max_edge = 0.8", "max_edge = -1", "number 2", "give a positive number of metres"),
        "max_edge past memory": _fault("max_edge = 0.8", "max_edge = 1e-5", "number 2", "faces; choose a larger one"),
        "two_sided a number": _fault("two_sided = true", "two_sided = 1", "'two_sided' must be true or false"),
        "tangents unknown": _fault('tangents = "uv"', 'tangents = "vu"', 'is "normal" or "uv"'),
        "tangents without coordinates": _fault(
            'materials = { steel = "paper" }', 'tangents = "uv"', "needs texture coordinates, which 'steel'"
        ),
        "mesh file missing": _fault(card, 'file = "none.ply"', "number 3", "none.ply: cannot be read", "check the"),
        "mesh file empty": _fault(card, 'file = "empty.obj"', "number 3", "empty.obj: empty", "export a triangle mesh"),
        "mesh file a folder": _fault(card, 'file = "folder.obj"', "folder.obj: cannot be read", "not a regular file"),
        "mesh file without name": _fault(card, 'file = ""', "number 3", "unknown mesh format ''; use .ply"),
        "mesh file of another kind": _fault(card, 'file = "sky.exr"', "unknown mesh format '.exr'; use .ply"),
        "mesh file of points": _fault(card, 'file = "points.obj"', "points or lines only, no faces; export"),
        "mesh file without extent": _fault(card, 'file = "dot.obj"', "number 3", "dot.obj: "),
        "mesh file no text": _fault(card, "file = [1]", "number 3", "'file' must be text, not [1]"),
        "mesh path with a zero": _fault(card, 'file = "card\\u0000.obj"', "number 3", "check the path"),
    }  # fmt: skip


def _whole() -> dict[str, Fault]:
    return {
        "empty": _fault("", b"", "'camera' is missing"),
        "not UTF-8": _fault("", SCENE.encode().replace(b"paper", b"\xe9t\xe9"), "it is not UTF-8 text; save it as"),
        "UTF-16": _fault("", SCENE.encode("utf-16"), "it is not UTF-8 text; save it as"),
        "not TOML": _fault("", b"{'camera': {'origin': [0, 1, 3]}}", "not a TOML file", "line 1"),
        "a table that does not end": _fault("[camera]", "[camera", "not a TOML file", "line 2"),
        "a text that does not end": _fault('"sky.exr"', '"sky.exr', "not a TOML file", "line 10"),
        "a zero": _fault("[camera]", "\0[camera]", "not a TOML file", "line 2"),
        "a number without end": _fault("width = 8", f"width = {'8' * 5000}", "not a TOML file"),
        "lists without end": _fault("width = 8", f"width = {'[' * 5000}", "not a TOML file"),
        "a picture": _fault("", b"\x89PNG\r\n\x1a\n\0\0\0\rIHDR", "it is not UTF-8 text; save it as"),
    }


FAULTS: Mapping[str, Fault] = _whole() | _camera() | _environment() | _materials() | _meshes()

# Commands over the sound scene: the option, and what is said of it. Those that are no command line end with 2.
WRONG: Mapping[str, tuple[int, str]] = {
    "render missing.toml -o out.exr": (1, "missing.toml: cannot be read as a scene: No such file or directory; check"),
    "render folder.exr -o out.exr": (1, "folder.exr: cannot be read as a scene: Is a directory; check"),
    "render scene.toml -o out.exr --terms 0": (1, "terms are 0; they must be whole numbers from 1"),
    "render scene.toml -o out.exr --terms 65 --receivers vertices": (1, "65 terms cannot be had"),
    "render scene.toml -o out.exr --factor-resolution 3": (
        1,
        "factor resolution is 3; it must be a whole number from 4",
    ),
    "render scene.toml -o out.exr --factor-resolution 4000 --receivers vertices": (1, "from 4 to 128"),
    "render scene.toml -o out.exr --resolution 12": (1, "resolution is 12; it must be a power of two"),
    "render scene.toml -o out.exr --coefficients 97": (1, "coefficients are 97; from 1 to 96"),
    "render scene.toml -o out.exr --visibility-samples 2": (1, "visibility samples are 2; they must be"),
    "render scene.toml -o out.exr --fov-y nan": (1, "fov_y one"),
    "render scene.toml -o out.exr --origin 0 inf 0": (1, "three finite numbers"),
    "render scene.toml -o out.exr --width 1000000 --height 1000000": (1, "pixels; it may have at most"),
    "render scene.toml -o out.exr --scale nan": (1, "scale finite"),
    "render scene.toml -o out.exr --env nan.exr": (1, "nan.exr has 1 NaN or infinite pixels"),
    "render scene.toml -o out.exr --env folder.exr": (1, "folder.exr: is a folder"),
    "render scene.toml -o out.gif": (1, "out.gif: cannot write an image of kind '.gif'; use one of"),
    "render scene.toml -o none/out.exr": (1, "its folder does not exist or cannot be written to; make it first"),
    "render scene.toml -o folder.exr": (1, "folder.exr: is a folder"),
    "precompute scene.toml -o sky.exr": (1, "sky.exr: cannot be used as a store"),
    "relight folder.exr -o out.exr": (1, "folder.exr: not a store"),
    "render scene.toml -o out.exr --import no_such_module": (1, "'no_such_module' cannot be imported"),
    "render scene.toml -o out.exr --photons 8": (2, "--photons is a dial of --lighting indirect; this scene does"),
    "precompute scene.toml --lighting adaptive": (2, "--lighting adaptive precomputes nothing; render with it"),
    "render scene.toml": (2, "output"),
    "render scene.toml -o out.exr --resolution many": (2, "resolution"),
    "render scene.toml -o out.exr --receivers texels": (2, "receivers"),
    "render scene.toml -o out.exr --origin 1 2": (2, "origin"),
    "render scene.toml -o out.exr --resolutoin 8": (2, "--resolution"),
    "rendr scene.toml -o out.exr": (2, "did you mean 'render'?"),
}
_DIALS = dict(zip(DIALS[::2], DIALS[1::2], strict=True)) | {"--resolution": "4"}


def prepare(folder: pathlib.Path) -> None:
    """The files of the sound scene, and those that no scene should name."""
    from PIL import Image

    generator = np.random.default_rng(0)
    pixels = generator.gamma(0.5, size=(8, 16, 3))
    write_image(folder / "sky.exr", pixels)
    for name in ("wood", "mask", "bumps"):
        Image.fromarray(generator.integers(100, 255, (2, 3, 3), np.uint8)).save(folder / f"{name}.png")
    for name, value in (("nan", np.nan), ("negative", -1.0)):
        pixels[1, 2] = value
        write_image(folder / f"{name}.exr", pixels)
    for suffix in ("exr", "png", "obj"):
        (folder / f"folder.{suffix}").mkdir()
        (folder / f"empty.{suffix}").touch()
    for name in ("text.png", "text.hdr"):
        (folder / name).write_text("a picture\n" * 20)
    (folder / "card.obj").write_text(_CARD)
    (folder / "bare.obj").write_text(_BARE)
    (folder / "points.obj").write_text("v 0 0 0\nv 1 0 0\n")
    (folder / "dot.obj").write_text("v 1 1 1\nv 1 1 1\nv 1 1 1\nf 1 2 3\n")
    (folder / "scene.toml").write_text(SCENE)


def wrong_with_sound(folder: pathlib.Path) -> str:
    """What is wrong if the sound scene is not rendered, or something else is told than what the method leaves out."""
    status, _, err = run(*_render(folder))
    wrong = f"ended with {status}: {err}" if status or err != f"{NO_BOUNCES}\n" else ""
    return wrong or ("" if (folder / "out.exr").exists() else "no picture was written")


def wrong_with(fault: Fault, folder: pathlib.Path) -> str:
    """What is wrong about how the scene with a fault ends; nothing if it ends as promised."""
    text = fault.new
    if fault.old:
        assert SCENE.count(fault.old) == 1, fault.old
        assert isinstance(text, str)
        text = SCENE.replace(fault.old, text)
    content = text.encode() if isinstance(text, str) else text
    (folder / "scene.toml").write_bytes(content)
    try:
        return _wrong((*_render(folder), "--receivers", fault.receivers), folder, 1, (*fault.says, "scene"))
    finally:
        (folder / "scene.toml").write_text(SCENE)


def wrong_with_command(line: str, folder: pathlib.Path) -> str:
    """What is wrong about how a command ends."""
    status, says = WRONG[line]
    command, *arguments = (str(folder / word) if "." in word else word for word in line.split())
    dials = [word for dial in _DIALS.items() if dial[0] not in line for word in dial]
    if command in ("render", "precompute"):
        arguments += [*dials, *(("--store", folder / "made") if command == "render" else ())]
    return _wrong((command, *arguments), folder, status, (says,))


def _render(folder: pathlib.Path) -> tuple:
    dials = (word for dial in _DIALS.items() for word in dial)
    return ("render", folder / "scene.toml", "-o", folder / "out.exr", "--store", folder / "made", *dials)


def _wrong(arguments: tuple, folder: pathlib.Path, promised: int, says: tuple[str, ...]) -> str:
    before = sorted(folder.iterdir())
    try:
        status, out, err = run(*arguments)
    except Exception as fault:
        return f"raised {type(fault).__name__}: {fault}"
    left = [path.name for path in sorted(folder.iterdir()) if path not in before]
    if left:
        return f"left {', '.join(left)}"
    if status != promised or out:
        return f"ended with {status} and said {out!r}, {err!r}"
    # The parser of command lines frames what it says.
    if promised == 1 and (len(err.splitlines()) != 1 or not err.startswith("jaxrelight: ")):
        return f"is not told in one line: {err!r}"
    told = err.replace(str(folder), "")
    missing = [word for word in says if word not in told]
    return f"{missing} is not said in {err!r}" if missing else ""
