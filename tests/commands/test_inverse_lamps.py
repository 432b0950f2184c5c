"""Lamps solved for by the command: targets of sensors and pictures from files, reports, and what is refused."""

import csv

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import load_lights, read_image
from jaxrelight.scene.light_text import lights_text
from tests.commands.running import refusal_of, run, summary_of
from tests.commands.summary_keys import KEYS, keys_of
from tests.commands.test_indirect import CAMERA, LAMP, MATERIALS, MESHES

SENSORS = (
    '[[sensor]]\nname = "floor"\npoints = [[0, 0, 0.5]]\n'
    '[[sensor]]\nname = "desk"\norigin = [-0.5, 0.2, 0]\nu = [1, 0, 0]\nv = [0, 0, 0.5]\ncolumns = 2\nrows = 2\n'
)
TARGETS = 'starts = 1\n[[target]]\nsensor = "desk"\nmean = 900\n'


def solve(*arguments: str) -> tuple[int, str, str]:
    return run("inverse", "lamps", *arguments)


@pytest.fixture(autouse=True)
def _folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    (tmp_path / "lamp.toml").write_text(CAMERA + MATERIALS + MESHES + LAMP + SENSORS)
    (tmp_path / "targets.toml").write_text(TARGETS)


@pytest.mark.slow
def test_lamps_are_written_that_meet_the_targets():
    how = "--lighting", "transport"
    told = summary_of(solve("lamp.toml", "targets.toml", "-o", "found.toml", "--report", "report", *how, "--json"))
    assert keys_of(told) == KEYS["inverse lamps"]
    (fit,) = told["targets"]
    assert (fit["what"], fit["target"]) == ("desk: mean", 900)
    assert fit["found"] == pytest.approx(900, rel=1e-4)
    (unknown,) = told["unknowns"]
    assert (unknown["name"], unknown["unit"], unknown["determined"]) == ("lamp 1: intensity", "W/sr", True)
    assert told["undetermined"] == []
    measured = summary_of(run("measure", "lamp.toml", "--lights", "found.toml", *how, "--json"))
    assert measured["sensors"]["desk"]["mean"] == pytest.approx(900, rel=1e-4)
    with open("report/targets.csv", encoding="utf-8") as file:
        assert [row["target"] for row in csv.DictReader(file)] == ["desk: mean"]
    status, out, err = solve("lamp.toml", "targets.toml", *how)
    assert status == 0, err
    assert out.splitlines()[0].split() == ["target", "asked", "found", "off"]
    assert out.splitlines()[1].split()[:3] == ["desk:", "mean", "900"]


@pytest.mark.slow
def test_a_painted_picture_is_met(tmp_path):
    (tmp_path / "painted.toml").write_text(
        'picture = "painted.exr"\nstarts = 1\n[[lamp]]\nlight = 1\nfree = ["colour"]\n'
    )
    how = "--lighting", "prefiltered"
    assert run("render", "lamp.toml", "-o", "painted.exr", *how)[0] == 0
    dim = LAMP.replace("[2, 1, 1]", "[0.5, 0.5, 0.7]")
    (tmp_path / "dim.toml").write_text(CAMERA + MATERIALS + MESHES + dim)
    told = summary_of(solve("dim.toml", "painted.toml", "-o", "found.toml", "--report", "report", *how, "--json"))
    assert told["targets"][0]["error"] < 1e-3
    (lamp,) = load_lights("found.toml")
    np.testing.assert_allclose(lamp.intensity, [2, 1, 1], rtol=1e-3)  # pyright: ignore[reportAttributeAccessIssue]
    pictures = [read_image(tmp_path / "report" / f"{name}.png") for name in ("target", "found", "difference")]
    assert all(picture.shape[:2] == (12, 16) for picture in pictures)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "give either [[target]] for sensors or 'picture'"),
        (TARGETS + TARGETS.partition("\n")[2], "sensor 'desk' has a target already"),
        (TARGETS.replace("mean = 900", "mean = -1"), "number 1: a target's mean must be"),
        (TARGETS.replace("mean = 900", ""), "number 1: a target of lux asks for nothing"),
        (TARGETS.replace("mean", "means"), "'means' is not known; did you mean 'mean'?"),
        (TARGETS.replace("desk", "door"), "there is no sensor 'door' for a target"),
        (TARGETS + '[[lamp]]\nlight = 1\nfree = "aim"\n', "'free' must be a list of names"),
        (TARGETS + '[[lamp]]\nlight = 7\nfree = ["intensity"]\n', "free: there is no lamp of number 6"),
        (TARGETS + '[[lamp]]\nlight = 0\nfree = ["intensity"]\n', "from 1, not 0"),
        (TARGETS + '[[lamp]]\nlight = 1\nfree = ["aim"]\n', "which has no aim"),
        (TARGETS + 2 * '[[lamp]]\nlight = 1\nfree = ["intensity"]\n', "light 1 is named already"),
        ('picture = "none.exr"\n', "no such file"),
    ],
)
def test_bad_targets_are_refused_in_one_line(tmp_path, text, said):
    (tmp_path / "targets.toml").write_text(text)
    refusal = refusal_of(solve("lamp.toml", "targets.toml", "--lighting", "transport"), "jaxrelight inverse")
    assert said in refusal


def test_outputs_that_cannot_be_written_are_refused():
    assert "lamps are written as .toml" in refusal_of(
        solve("lamp.toml", "targets.toml", "-o", "a.exr"), "jaxrelight inverse"
    )
    assert "no folder" in refusal_of(solve("lamp.toml", "targets.toml", "-o", "b/a.toml"), "jaxrelight inverse")


def test_lights_are_read_as_they_were_written(tmp_path):
    lights = [
        jr.point([0.1, 1, 2], [3, 2, 1]),
        jr.spot([0, 2, 0], [0.5, 0, 0.25], 2.0, 40.0, 10.0),
        jr.directional([0, -1, 0.5], 2.0),
        jr.area([0, 2, 0], [1, 0, 0], [0, 0, 1], [4, 5, 6], samples=2),
        jr.shaped([0, 2, 0], [0, 0, 0.1], 2.0, [20, 10], far=(4.0, 5.0)),
    ]
    (tmp_path / "lights.toml").write_text(lights_text(lights))
    for light, again in zip(lights, load_lights(tmp_path / "lights.toml"), strict=True):
        assert type(light) is type(again)
        for one, other in zip(vars(light).values(), vars(again).values(), strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-6)
    with pytest.raises(jr.InputError, match=r"light 1 is a .* which a scene file is not written of"):
        lights_text([jr.even_sky(1.0)])
