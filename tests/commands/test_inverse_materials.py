"""Materials by the command line: what is found is written as a scene's materials, and what is wrong is one line."""

import dataclasses
import pathlib

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.commands.inverse_materials import write_materials
from jaxrelight.images import write_image
from jaxrelight.inverse.solve_materials import InverseMaterials
from jaxrelight.scene.scene_file import load_scene
from tests.commands import running
from tests.commands.summary_keys import KEYS, keys_of

SCENE = running.SCENE.replace('[environment]\nfile = "sky.exr"', running.LAMP)


@pytest.fixture
def folder(tmp_path) -> pathlib.Path:
    """A scene, and a picture of it, all grey."""
    (tmp_path / "scene.toml").write_text(SCENE)
    write_image(tmp_path / "picture.exr", np.full((10, 12, 3), 0.2, np.float32))
    return tmp_path


def command(folder: pathlib.Path, *options: str | pathlib.Path) -> tuple[int, str, str]:
    given = folder / "scene.toml", folder / "picture.exr", "--lighting", "prefiltered", "--map-rows", "32"
    return running.run("inverse", "materials", *given, *options)


@pytest.mark.slow
def test_found_materials_are_those_of_a_scene_file(folder):
    scene = load_scene(folder / "scene.toml")
    true = {**scene.materials, "paper": jr.lambert([0.7, 0.2, 0.6])}
    relighter = jr.prepare(
        dataclasses.replace(scene, materials=true), jr.Prefiltered(map_rows=32, receiver_tolerance=0)
    )
    write_image(folder / "picture.exr", np.ascontiguousarray(relighter.picture(background=False)[..., :3]))
    out = folder / "found.toml"
    options = "--unknown", "paper", "-o", out, "--report", folder / "report", "--json"
    summary = running.summary_of(command(folder, *options))
    np.testing.assert_allclose(summary["materials"]["paper.albedo"]["value"], [0.7, 0.2, 0.6], rtol=1e-3)
    assert keys_of(summary) == KEYS["inverse materials"]
    assert summary["undetermined"] == []
    assert summary["residual"] < 1e-3
    assert {path.name for path in (folder / "report").glob("*.png")} == {"picture.png", "found.png", "difference.png"}
    (folder / "again.toml").write_text(SCENE.split("[material.paper]")[0] + out.read_text() + _rest())
    paper = load_scene(folder / "again.toml").materials["paper"]
    assert isinstance(paper, LobeSum)
    np.testing.assert_allclose(paper.diffuse, [0.7, 0.2, 0.6], rtol=1e-3)


def _rest() -> str:
    """The scene behind its first material."""
    return "[material.gloss]" + SCENE.split("[material.gloss]")[1]


def test_what_is_wrong_is_one_line(folder):
    wrong = {
        "the scene has no material 'wood'; it has paper, gloss": ["--unknown", "wood"],
        "'shine' is no parameter of this material": ["--unknown", "paper:shine"],
        "write it as NAME:PART=ROWSxCOLUMNS": ["--unknown", "paper", "--texture", "paper:albedo"],
        "name it with --unknown gloss, too": ["--unknown", "paper", "--texture", "gloss:diffuse=4x4"],
        "materials are written as .toml": ["--unknown", "paper", "-o", folder / "found.json"],
        "there is no folder": ["--unknown", "paper", "-o", folder / "none" / "found.toml"],
        "--report": ["--unknown", "paper", "--report", folder / "picture.exr"],
        "--noise is 0; it must be above 0": ["--unknown", "paper", "--noise", "0"],
    }
    for message, options in wrong.items():
        assert message in running.refusal_of(command(folder, *options), "jaxrelight inverse")


def test_lobes_are_written_as_a_scene_has_them(folder):
    """As a Lafortune BRDF, and as Phong's."""
    lobes = jr.lobe_sum(0.1, [jr.lobe([-1, -1, 0.8], 9, peak=[0.3, 0.2, 0.1])])
    given = {"lobes": lobes, "shine": jr.phong([0.2, 0.3, 0.4], 0.3, 20), "flat": jr.lambert([0.1, 0.2, 0.3])}
    nothing = (), None, 0.0, None, (), (), 0, 0, (), 0, True, 0.0
    write_materials(folder / "found.toml", InverseMaterials(given, {}, *nothing))
    (folder / "read.toml").write_text((folder / "found.toml").read_text() + SCENE)
    read = load_scene(folder / "read.toml").materials
    for name, brdf in given.items():
        again = read[name]
        assert isinstance(again, LobeSum)
        for part in ("diffuse", "C", "exponent", "scale"):
            np.testing.assert_allclose(getattr(again, part), getattr(brdf, part), rtol=1e-5)
