"""The summaries of --json: their keys are pinned here, and documented; and how values are put in words."""

import json
import re

import pytest

from jaxrelight.commands import summary
from jaxrelight.commands.summary import summarize
from tests.commands.running import DIALS, summary_of

# Every key down to numbers and texts; `*` stands for names that the scene gives.
SETTINGS = (
    *("receivers", "resolution", "visibility_samples", "terms", "coefficients", "factor_resolution"),
    *("tolerance", "bits", "bounces", "gather_resolution", "gather"),
    *("gather_samples", "solid_angle", "peak", "near", "importance", "photons", "sky", "seed"),
)
MADE = {"command", "store", "receivers", "operator_bytes", "kept_energy"}
MADE |= {f"versions.{name}" for name in ("jaxrelight", "jax", "embreex")} | {f"settings.{name}" for name in SETTINGS}
DONE = {"rays", "rays_per_second"}
DONE |= {f"seconds.{stage}" for stage in ("imports", "load", "geometry", "visibility", "transport", "open")}
DONE |= {f"bytes.{kind}" for kind in ("geometry", "environment", "visibility", "factors", "transport")}
PICTURE = {"picture", "width", "height", "covered", "mean_radiance"} | {
    f"seconds.{stage}" for stage in ("view", "light", "shade", "write", "total")
}
KEYS = {
    "precompute": MADE | DONE | {"lighting", "seconds.total"},
    "render": MADE | DONE | PICTURE | {"lighting"},
    "relight": MADE - {"receivers"} | PICTURE | {"seconds.imports", "seconds.open", "seconds.environment"},
    "demo": MADE | DONE - {"seconds.load", "seconds.open"} | {"picture", "seconds.total"} | {
        "milliseconds.change_of_view", "milliseconds.change_of_light", "milliseconds.shading",
        "error.coefficients", "error.without_worst_5_percent",
    },
    "store": MADE | {"kind", "scene", "rows", "materials.*", "bytes.*", "unused_layers"}
    | {"largest_error_for_unit_light"},
    "scene": {"command", "kind", "scene", "vertices", "materials.*", "camera.width", "camera.height", "camera.fov_y"}
    | {"meshes.*.vertices", "meshes.*.faces", "meshes.*.material", "environment.width", "environment.height"},
    "image": {"command", "kind", "image", "width", "height", "channels", "largest", "mean"}
    | {"negative_pixels", "not_finite_pixels"},
}  # fmt: skip
NAMED = "materials", "meshes"


def _keys(value, named: bool = False) -> set[str]:
    if not isinstance(value, dict):
        return {""}
    return {
        f"{'*' if named else key}.{rest}".rstrip(".")
        for key, entry in value.items()
        for rest in _keys(entry, key in NAMED or (key == "bytes" and value.get("kind") == "store"))
    }


@pytest.mark.parametrize(
    ("kind", "arguments"),
    [
        ("precompute", ["precompute", "scene.toml", "-o", "made", *DIALS]),
        ("render", ["render", "scene.toml", "-o", "a.exr", "--store", "other", *DIALS]),
        ("relight", ["relight", "made", "-o", "a.exr"]),
        ("store", ["info", "made"]),
        ("scene", ["info", "scene.toml"]),
        ("image", ["info", "sky.exr"]),
    ],
)
def test_keys(run, made, kind: str, arguments: list[str]):
    found = summary_of(run(*arguments, "--json"))
    assert _keys(found) == KEYS[kind]
    assert found["command"] == arguments[0]
    assert found.get("kind", kind) == kind


def test_keys_of_the_demo(folder, run, monkeypatch):
    from jaxrelight.methods import Transport

    small = Transport("vertices", resolution=8, terms=2, coefficients=32, factor_resolution=8)
    monkeypatch.setattr("jaxrelight.methods.Settings", lambda **_: small)
    found = summary_of(run("demo", "-o", "shown", "--detail", "0.05", "--height", "16", "--json"))
    assert _keys(found) == KEYS["demo"]


def test_every_key_is_documented():
    """Those of settings are the options' names, and say so."""
    assert summary.__doc__ is not None
    words = set(re.findall(r"\w+", summary.__doc__)) | {"*", "factors", *SETTINGS}
    for kind, keys in KEYS.items():
        assert {part for key in keys for part in key.split(".")} <= words, kind


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
