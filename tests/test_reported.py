"""Scenes of kinds that people reported as faults of other programs: each pixel is right, or a note says what is not."""

import pathlib
import shutil
import tomllib

import numpy as np
import pytest

from jaxrelight.images import open_image, read_image
from tests.commands.running import run
from tests.shared_data import shared

# Its camera stands above the sheet, whose upper side is lit; the test below looks at the floor under it.
ABOVE_THE_SHEET = "w2_bigscene"
NAMES = [
    "c1_stlcube",
    "n1_flat",
    "n2_soff",
    "z3_explicit_normals",
    "z3_shared_nonormals",
    "y3_sheet",
    "o01_hash",
    "o02_bom_v",
    "o03_mtl_subfolder",
    "o04_two_mtls",
    "o05_map_s",
    "o07_vcolour",
    "g04_color0",
    "o08_concave",
    "p06_concave",
    "o09_illum1",
    "o10_Ks1Ns0",
    "o13_jpeg_named_png",
    "y1_novt",
    "v1_normals_against",
    "g01_spaces",
    "g02_textransform",
    "g03_gltfpack",
    "g06_emissive",
    "g07_instancing",
    "g08_specgloss",
    "g10_skin",
    "a4_morph",
    "n4_uv1",
    "n7_bm",
    "v3_clamp",
    "p02_wedge",
    "p03_tristrips",
    "k1_envcube",
    "a3_probe",
    "w2_bigscene",
]


def cases() -> dict[str, dict]:
    content = tomllib.loads(shared("data", "reported", "cases.toml").read_text())
    return {case["name"]: case for case in content["case"]}


def picture(scene: pathlib.Path, folder: pathlib.Path, *args: str) -> tuple[np.ndarray, str]:
    """The picture of a scene, and what was said beside it."""
    output = folder / "picture.exr"
    status, _, said = run("render", str(scene), "-o", str(output), *args)
    assert status == 0, said
    return read_image(output)[..., :3], said


def test_every_case_is_in_the_list():
    assert set(cases()) == set(NAMES)


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name in NAMES if name != ABOVE_THE_SHEET])
def test_pixels_are_right(tmp_path, name: str):
    case = cases()[name]
    pixels, _ = picture(shared("data", "reported", name, "scene.toml"), tmp_path, *case["args"])
    for pixel in case["pixels"]:
        value = np.broadcast_to(pixel["value"], 3)
        np.testing.assert_allclose(pixels[tuple(pixel["at"])], value, atol=case.get("tolerance", 0.025), rtol=0)


@pytest.mark.slow
def test_under_a_sheet_of_a_centimetre_over_two_kilometres_it_is_dark(tmp_path):
    for file in shared("data", "reported", ABOVE_THE_SHEET).iterdir():
        shutil.copyfile(file, tmp_path / file.name)
    scene = (tmp_path / "scene.toml").read_text()
    assert "0.045000000000000005" in scene
    (tmp_path / "scene.toml").write_text(scene.replace("0.045000000000000005", "0.0045"))
    pixels, _ = picture(tmp_path / "scene.toml", tmp_path, "--resolution", "8")
    np.testing.assert_allclose(pixels[8, 8], 0, atol=0.01)


@pytest.mark.slow
def test_one_sphere_in_two_materials_is_that_in_one(tmp_path):
    one, two = (
        picture(shared("data", "reported", name, "scene.toml"), tmp_path, "--lighting", "prefiltered")[0]
        for name in ("c4_one", "c4_two")
    )
    np.testing.assert_allclose(two, one, atol=1e-4)


@pytest.mark.slow
def test_nothing_lit_is_black_at_the_terminator(tmp_path):
    scene = shared("data", "reported", "v4_terminator", "scene.toml")
    for lighting in ("prefiltered", "transport"):
        pixels, _ = picture(scene, tmp_path, "--lighting", lighting)
        lit = pixels[..., 0] > 0
        # Rows and columns of the lit side have no gaps.
        for row in lit[10:54:4]:
            if row.any():
                assert row[np.argmax(row) : len(row) - np.argmax(row[::-1])].all()


def test_the_beauty_pass_of_several_parts_is_read():
    assert open_image(shared("data", "reported", "img", "e3.exr")).pixels[..., :3].mean() == pytest.approx(
        0.5075, abs=1e-4
    )


def test_a_header_without_primaries_is_read_as_rec_709():
    (path,) = shared("data", "reported", "x1_polyhaven").glob("*.hdr")
    image = open_image(path)
    assert np.isfinite(image.pixels).all()
    assert "Rec.709" in " ".join(image.notes)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["x2_lights", "x3_sparse", "x3_webp"])
def test_scenes_without_values_are_read(tmp_path, name: str):
    (scene,) = list(shared("data", "reported", name).glob("scene.toml")) or list(
        shared("data", "reported", name).glob("*.gl*")
    )
    pixels, _ = picture(scene, tmp_path, "--resolution", "8", "--width", "32", "--height", "32")
    assert pixels.max() > 0
    assert np.isfinite(pixels).all()


@pytest.mark.slow
def test_a_closed_leaf_alone_has_no_black_pixels(tmp_path):
    pixels, _ = picture(
        shared("data", "reported", "w1_leaf", "q.obj"), tmp_path, "--resolution", "8", "--width", "96", "--height", "96"
    )
    assert (pixels.max(axis=-1) == 0).mean() < 1e-3


@pytest.mark.slow
@pytest.mark.parametrize("options", ["--lighting prefiltered", "--lighting transport --resolution 8"])
def test_a_leaf_of_faces_and_their_reverses_is_black_nowhere(tmp_path, options: str):
    leaf = shared("data", "reported", "w1_leaf", "q.obj")
    pixels, said = picture(leaf, tmp_path, *options.split(), "--width", "64", "--height", "64")
    assert pixels.max(axis=2).min() > 0.02 * np.median(pixels)
    assert "backs of faces" not in said
