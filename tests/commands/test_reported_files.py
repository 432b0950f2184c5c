"""Pictures of small files of kinds that people reported as faults of other programs: pixels whose value is known."""

import tomllib

import numpy as np
import pytest

from jaxrelight.images import read_image
from tests.commands.running import run
from tests.shared_data import shared

# Those of glTF, and one of a textured material without texture coordinates.
NAMES = (
    *("g01_spaces", "g02_textransform", "g03_gltfpack", "g04_color0", "g06_emissive", "g07_instancing"),
    *("g08_specgloss", "g10_skin", "a4_morph", "n4_uv1", "v3_clamp", "y1_novt"),
)


@pytest.mark.slow
@pytest.mark.parametrize("name", NAMES)
def test_reported_picture(tmp_path, name):
    cases = tomllib.loads(shared("data", "reported", "cases.toml").read_text())["case"]
    case = next(case for case in cases if case["name"] == name)
    scene, out = shared("data", "reported", name, "scene.toml"), tmp_path / "out.exr"
    store = () if "--lighting" in case["args"] else ("--store", tmp_path / "store")
    status, _, err = run("render", scene, "-o", out, *case["args"], *store)
    assert status == 0, err
    image = read_image(out)
    for pixel in case["pixels"]:
        row, column = pixel["at"]
        np.testing.assert_allclose(image[row, column, :3], pixel["value"], atol=case.get("tolerance", 0.025))
