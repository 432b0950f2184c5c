"""Options of `render` and `precompute`: those of one lighting method, which Python has under the same names."""

import dataclasses
import re
from typing import Any

import pytest

from jaxrelight.commands.dials import method_of
from jaxrelight.commands.precompute import Precompute
from jaxrelight.commands.render import Render
from jaxrelight.methods import METHODS, Transport, documentation
from tests.commands.running import refusal_of, run

# Every dial of every method, as a command line sets it, and the value that it has then.
SET: dict[str, dict[str, tuple[str, object]]] = {
    "transport": {
        "receivers": ("--receivers vertices", "vertices"),
        "resolution": ("--resolution 8", 8),
        "visibility_samples": ("--visibility-samples 4", 4),
        "rays": ("--rays all", "all"),
        "receiver_tolerance": ("--receiver-tolerance 0.05", 0.05),
        "reflection": ("--reflection traced", "traced"),
        "reflection_tolerance": ("--reflection-tolerance 0.05", 0.05),
        "reflection_rays": ("--reflection-rays 9", 9),
        "terms": ("--terms 2", 2),
        "coefficients": ("--coefficients 17", 17),
        "factor_resolution": ("--factor-resolution 9", 9),
        "compression_tolerance": ("--compression-tolerance 0.5", 0.5),
        "bits": ("--bits 8", 8),
        "bounces": ("--bounces 2", 2),
        "split_sun": ("--no-split-sun", False),
        "gather_resolution": ("--gather-resolution 6", 6),
        "gather": ("--gather nearest", "nearest"),
    },
    "indirect": {
        "gather_samples": ("--gather-samples 64", 64),
        "bounces": ("--bounces 1", 1),
        "sky": ("--sky", True),
        "sky_samples": ("--sky-samples 5", 5),
        "coefficients": ("--coefficients 17", 17),
        "compression_tolerance": ("--compression-tolerance 0", 0.0),
        "bits": ("--bits 16", 16),
        "solid_angle": ("--solid-angle 0.2", 0.2),
        "peak": ("--peak 1", 1.0),
        "near": ("--near clamp", "clamp"),
        "importance": ("--importance", True),
        "photons": ("--photons 0", 0),
        "seed": ("--seed 3", 3),
    },
    "prefiltered": {
        "shadows": ("--no-shadows", False),
        "texels": ("--texels reflectance", "reflectance"),
        "minification": ("--minification averaged", "averaged"),
        "occlusion_resolution": ("--occlusion-resolution 16", 16),
        "receiver_tolerance": ("--receiver-tolerance 0.05", 0.05),
        "horizon": ("--horizon outside", "outside"),
        "map_rows": ("--map-rows 64", 64),
    },
    "adaptive": {
        "tolerance": ("--tolerance 0.1", 0.1),
        "samples": ("", None),
        "shadows": ("--no-shadows", False),
        "minification": ("--minification none", "none"),
        "exposure": ("--exposure 1", 1.0),
        "seed": ("--seed 3", 3),
    },
}


def help_of(*arguments: str) -> str:
    status, out, err = run(*arguments)
    assert (status, err) == (0, "")
    return out


def options_in(shown: str) -> list[str]:
    """The options that a help text lists, by their long names."""
    invocations = re.findall(r"^  (-.*?)(?:  |$)", shown.replace("│", " "), flags=re.MULTILINE)
    return [re.findall(r"--[a-z-]+", one)[-1] for one in invocations if one.strip("-")]


@pytest.fixture
def parsed(monkeypatch):
    """What a command line becomes, instead of what it does."""

    def parse(*arguments: str) -> Any:
        caught = []
        for command in (Render, Precompute):
            monkeypatch.setattr(command, "run", lambda self: caught.append(self))
        assert run(*arguments) == (0, "", "")
        return caught[0]

    return parse


@pytest.mark.parametrize("lighting", METHODS)
def test_help_is_of_one_method_and_short(lighting: str):
    options = options_in(help_of("render", "--lighting", lighting, "--help"))
    assert len(options) == len(set(options)) <= 28
    dials = {field.name: f"--{field.name.replace('_', '-')}" for field in dataclasses.fields(METHODS[lighting])}
    plain = {option.replace("--no-", "--") for option in options}
    assert {name for name, option in dials.items() if option in plain} == set(dials) - METHODS[lighting].advanced
    others = set().union(*(documentation(kind) for kind in METHODS.values())) - set(dials) - {"exposure"}
    assert not plain & {f"--{name.replace('_', '-')}" for name in others}


@pytest.mark.parametrize("command", ["render", "precompute"])
@pytest.mark.parametrize("lighting", METHODS)
def test_help_all_has_every_dial_with_its_documentation(command: str, lighting: str):
    method = METHODS[lighting]
    if command == "precompute" and not method.is_stored:
        return
    shown = help_of(command, "--lighting", lighting, "--help-all")
    options, words = options_in(shown), " ".join(shown.replace("│", " ").split())
    texts = documentation(method)
    assert set(texts) == {field.name for field in dataclasses.fields(method)}
    for field in set(texts) - {"exposure"}:
        default = next(one.default for one in dataclasses.fields(method) if one.name == field)
        assert f"--{'no-' if default is True else ''}{field.replace('_', '-')}" in options
        # Other dials that a text names go by their options.
        for name in re.findall(r"[a-z]+_[a-z_]+", texts[field]):
            texts[field] = texts[field].replace(name, f"--{name.replace('_', '-')}")
        assert len(texts[field]) > 20
        assert texts[field][1:] in words
    assert "--import" in options


@pytest.mark.parametrize("lighting", METHODS)
def test_pythons_defaults_are_those_of_the_command_line(parsed, lighting: str):
    command = parsed("render", "scene.toml", "-o", "a.exr", "--lighting", lighting)
    assert method_of(command, exposure=command.picture.exposure) == METHODS[lighting]()
    if METHODS[lighting].is_stored:
        assert method_of(parsed("precompute", "scene.toml", "--lighting", lighting)) == METHODS[lighting]()


@pytest.mark.parametrize("lighting", METHODS)
def test_every_dial_is_an_option(parsed, lighting: str):
    chosen, fields = SET[lighting], {field.name for field in dataclasses.fields(METHODS[lighting])}
    assert set(chosen) == fields
    words = " ".join(option for option, _ in chosen.values()).split()
    command = parsed("render", "scene.toml", "-o", "a.exr", "--lighting", lighting, *words)
    made = method_of(command, exposure=command.picture.exposure)
    assert {name: getattr(made, name) for name in fields} == {name: value for name, (_, value) in chosen.items()}


def test_a_resolution_may_be_chosen_by_need(parsed):
    command = parsed("precompute", "scene.toml", "--resolution", "auto")
    assert method_of(command) == Transport(resolution="auto")


TRANSPORT = "; this scene does not have local lights alone, so the lighting method is transport\n"
INDIRECT = "; this scene has local lights alone, so the lighting method is indirect\n"


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (
            "render sky.toml --lighting adaptive --resolution 8",
            "--resolution is a dial of --lighting transport; this is --lighting adaptive\n",
        ),
        (
            "render sky.toml --lighting=adaptive --store x",
            "--store is a dial of --lighting transport, indirect or prefiltered",
        ),
        ("render sky.toml --lighting prefiltered --resolution=8", "--resolution is a dial of --lighting transport"),
        ("render sky.toml --lighting adaptive --photons 8", "--photons is a dial of --lighting indirect"),
        ("render sky.toml --lighting adaptive --layers", "--layers is a dial of --lighting indirect"),
        ("render sky.toml --lighting adaptive --map_rows 64", "--map-rows is a dial of --lighting prefiltered"),
        ("render sky.toml --tolerance 0.1", "--tolerance is a dial of --lighting adaptive" + TRANSPORT),
        ("render both.toml --maps m", "--maps is a dial of --lighting adaptive" + TRANSPORT),
        ("render dark.toml --seed 1", "--seed is a dial of --lighting indirect or adaptive" + TRANSPORT),
        ("render sky.toml --no-shadows", "--no-shadows is a dial of --lighting prefiltered or adaptive" + TRANSPORT),
        ("render lamp.toml --resolution 8", "--resolution is a dial of --lighting transport" + INDIRECT),
        ("render lamp.toml --receivers pixels", "--receivers is a dial of --lighting transport" + INDIRECT),
        ("precompute lamp.toml --split-sun", "--split-sun is a dial of --lighting transport" + INDIRECT),
        ("render lamp.toml --env sky.exr --near disc", "--near is a dial of --lighting indirect" + TRANSPORT),
        ("precompute both.toml --sky", "--sky is a dial of --lighting indirect" + TRANSPORT),
        ("render none.toml --sky", "; as the scene cannot be read, the lighting method is transport\n"),
        (
            "precompute sky.toml --lighting adaptive",
            "--lighting adaptive precomputes nothing; render with it, or precompute transport or indirect\n",
        ),
    ],
)
def test_options_of_other_methods_are_refused_in_one_line(lit_scenes, arguments: str, said: str):
    before = sorted(lit_scenes.iterdir())
    assert said in refusal_of(run(*arguments.split(), "-o", "out.exr"), status=2)
    assert sorted(lit_scenes.iterdir()) == before


@pytest.mark.parametrize("lighting", ["transport", "indirect", "prefiltered", "adaptive"])
def test_options_that_all_methods_have_are_never_refused(parsed, lighting: str):
    command = parsed("render", "s.toml", "-o", "a.exr", "--lighting", lighting, "--exposure", "1", "--scale", "2")
    assert (command.picture.exposure, command.light.scale) == (1, 2)


def test_byte_order_marks_do_not_hide_the_lights(parsed, lit_scenes):
    text = (lit_scenes / "lamp.toml").read_bytes()
    (lit_scenes / "marked.toml").write_bytes(b"\xef\xbb\xbf" + text)
    assert parsed("precompute", "marked.toml").method == "indirect"


def test_help_comes_before_refusals():
    shown = help_of("render", "--lighting", "adaptive", "--resolution", "8", "--bogus", "--help")
    assert "--tolerance" in options_in(shown)
