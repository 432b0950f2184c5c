"""The summaries of --json: their keys are pinned here, and documented; and how values are put in words."""

import json
import pathlib
import re

import numpy as np
import pytest

from jaxrelight import write_image
from jaxrelight.commands.summary import summarize
from jaxrelight.methods import Transport
from tests.commands.running import DIALS, SCENE, summary_of
from tests.commands.summary_keys import DIALS_OF, KEYS, keys_of

PAGE = pathlib.Path(__file__).parents[2] / "notebooks" / "guide" / "json.md"


@pytest.mark.parametrize(
    ("kind", "arguments"),
    [
        ("precompute", ["precompute", "scene.toml", "-o", "store", *DIALS]),
        ("transport", ["render", "scene.toml", "-o", "a.exr", "--store", "store", *DIALS]),
        ("relight", ["relight", "made", "-o", "a.exr"]),
        ("store", ["info", "made"]),
        ("scene", ["info", "scene.toml"]),
        ("image", ["info", "sky.exr"]),
    ],
)
def test_keys(run, folder, request, kind: str, arguments: list[str]):
    """Those of other lighting methods are compared where their pictures are tested."""
    if "made" in arguments:
        request.getfixturevalue("made")
    summary = summary_of(run(*arguments, "--json"))
    assert keys_of(summary) == KEYS[kind]
    assert summary["command"] == arguments[0]
    assert summary.get("kind", kind) == kind


@pytest.fixture
def fitted(folder, run, monkeypatch) -> tuple[dict, str]:
    """The summary and the notes of a store whose resolution was chosen."""
    monkeypatch.setattr("jaxrelight.precomputation.chosen_resolution.RESOLUTIONS_BY_NEED", (8, 16, 32))
    scene = SCENE.replace('"phong"\ndiffuse = 0.1\nspecular = 0.3\nexponent = 5', '"lambert"\nalbedo = 0.1')
    (folder / "plain.toml").write_text(scene)
    dials = "--resolution", "auto", "--compression-tolerance", "0.1", "--coefficients", "32", "-o", "store"
    status, out, err = run("precompute", "plain.toml", *dials, "--json")
    assert status == 0
    return json.loads(out), err


def test_a_chosen_resolution_is_told(fitted, run):
    summary, notes = fitted
    chosen = summary["chosen_resolution"]
    assert (summary["settings"]["resolution"], chosen["resolution"], chosen["finest"]) == (8, 8, 32)
    assert set(chosen["errors"]) == set(chosen["untrimmed"]) == {"8", "16"}
    assert f"note: {chosen['line']}\n" in notes
    assert {"sample", "resolution"} < set(summary["bytes"])
    assert {"chosen_resolution", *chosen} <= set(re.findall(r"\w+", PAGE.read_text(encoding="utf-8")))
    told = summary_of(run("info", "store", "--json"))
    assert told["chosen_resolution"] == chosen
    assert not told["unused_layers"]


@pytest.mark.slow
@pytest.mark.usefixtures("fitted")
def test_a_sharper_environment_is_told(folder, run):
    pixels = np.full((64, 128, 3), 0.01, np.float32)
    pixels[28, 30] = 1e5
    write_image(folder / "sun.exr", pixels)
    assert "resolution 8 was chosen: " in run("info", "store")[1]
    assert "sharper than the one that resolution 8 was" in run("relight", "store", "--env", "sun.exr", "-o", "a.exr")[2]
    assert "sharper" not in run("relight", "store", "-o", "a.exr")[2]
    # A picture is rendered by what its own light needs.
    arguments = "plain.toml", "--env", "sun.exr", "--resolution", "auto", "-o", "b.exr", "--store", "other"
    assert "note: resolution 32 was chosen: " in run("render", *arguments)[2]


def test_keys_of_the_demo(folder, run, monkeypatch):
    small = Transport(
        "vertices",
        receiver_tolerance=0,
        reflection="factors",
        resolution=8,
        terms=2,
        coefficients=32,
        factor_resolution=8,
    )
    monkeypatch.setattr("jaxrelight.commands.demo.Transport", lambda *_, **__: small)
    summary = summary_of(run("demo", "-o", "shown", "--detail", "0.05", "--height", "16", "--json"))
    assert keys_of(summary) == KEYS["demo"]


def test_every_key_is_documented():
    """Those of settings are the options' names, and say so."""
    words = set(re.findall(r"\w+", PAGE.read_text(encoding="utf-8"))) | {
        "*",
        "factors",
        *set().union(*DIALS_OF.values()),
    }
    for kind, keys in KEYS.items():
        # Kinds of layers and maps are names that the command gives.
        named = (key for key in keys if not key.startswith(("bytes.", "maps.")))
        assert {part for key in named for part in key.split(".")} <= words, kind


@pytest.mark.parametrize(
    ("name", "value", "words"),
    [
        ("seconds", {"open": 0.123, "visibility": 75.32}, "open 0.12 s, visibility 75 s"),
        ("bytes", {"geometry": 2_319_745, "factors": 882}, "geometry 2.3 MB, factors 0.9 kB"),
        ("operator_bytes", 34_603_008, "34.6 MB"),
        ("rays", 523_763_711, "523.8 million"),
        ("rays", 1234, "1,234"),
        ("kept_energy", 0.98132, "98.13 %"),
        ("milliseconds", {"change_of_light": 31.234}, "change of light 31.2 ms"),
        ("receivers", 42496, "42,496"),
        ("unused_layers", [], "none"),
        ("environment", None, "none"),
        ("mean_radiance", 0.353964, "0.354"),
    ],
)
def test_words(capsys, name: str, value, words: str):
    summarize({name: value}, as_json=False)
    assert capsys.readouterr().out == f"{name.replace('_', ' '):>16}  {words}\n"
    summarize({name: value}, as_json=True)
    assert json.loads(capsys.readouterr().out) == {name: value}
