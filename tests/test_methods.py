"""The four lighting methods: their dials, the limits of each, and what they say of themselves."""

import ast
import dataclasses
import inspect
import re
from typing import Any

import pytest

from jaxrelight.errors import InputError
from jaxrelight.methods import METHODS, Adaptive, Indirect, Method, Prefiltered, Transport

DEFAULTS: dict[type[Method], dict[str, Any]] = {
    Transport: {
        "receivers": "pixels",
        "resolution": 64,
        "visibility_samples": 1,
        "rays": "adaptive",
        "receiver_tolerance": 0.1,
        "reflection": "filtered",
        "reflection_tolerance": 0.01,
        "reflection_rays": 64,
        "terms": 4,
        "coefficients": "shared",
        "factor_resolution": 48,
        "compression_tolerance": 0.02,
        "bits": 32,
        "bounces": 0,
        "split_sun": True,
        "gather_resolution": 32,
        "gather": "barycentric",
    },
    Indirect: {
        "gather_samples": 16384,
        "bounces": 3,
        "sky": False,
        "sky_samples": 256,
        "coefficients": "shared",
        "compression_tolerance": 0.02,
        "bits": 32,
        "solid_angle": 0.1,
        "peak": 0.01,
        "near": "disc",
        "importance": False,
        "photons": 0,
        "seed": 0,
    },
    Prefiltered: {
        "shadows": True,
        "texels": "parameters",
        "minification": "levels",
        "occlusion_resolution": 8,
        "receiver_tolerance": 0.2,
        "horizon": "cut",
        "map_rows": 512,
    },
    Adaptive: {
        "tolerance": None,
        "samples": None,
        "shadows": True,
        "minification": "levels",
        "exposure": "auto",
        "seed": 0,
    },
}


# What they say of themselves.


@pytest.mark.parametrize("kind", DEFAULTS)
def test_defaults(kind: type[Method]):
    assert dataclasses.asdict(kind()) == DEFAULTS[kind]


def test_each_has_a_name_of_its_own():
    assert {kind().name: kind for kind in DEFAULTS} == METHODS
    assert list(METHODS) == ["transport", "indirect", "prefiltered", "adaptive"]
    assert [name for name, kind in METHODS.items() if kind.is_stored] == ["transport", "indirect"]


@pytest.mark.parametrize("kind", DEFAULTS)
def test_dials_follow_from_what_a_store_keeps_of_them(kind: type[Method]):
    """Methods are equal where their dials are, and their dials are plain numbers and texts."""
    assert kind(**dataclasses.asdict(kind())) == kind()
    assert hash(kind()) == hash(kind())
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(kind(), next(iter(DEFAULTS[kind])), 1)


@pytest.mark.parametrize("kind", DEFAULTS)
def test_every_dial_is_documented(kind: type[Method]):
    """The command line and the guide take the text below each dial."""
    (tree,) = ast.parse(inspect.getsource(kind)).body
    assert isinstance(tree, ast.ClassDef)
    documented = {
        dial.target.id
        for dial, text in zip(tree.body, tree.body[1:], strict=False)
        if isinstance(dial, ast.AnnAssign) and isinstance(dial.target, ast.Name)
        if isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant) and isinstance(text.value.value, str)
    }
    assert documented == set(DEFAULTS[kind])
    assert kind.advanced < documented


@pytest.mark.parametrize(
    ("method", "environment", "local", "what"),
    [
        (Transport(), True, False, ["light that surfaces reflect onto each other"]),
        (Transport(), True, True, ["light that surfaces reflect onto each other"]),
        (Transport(bounces=1), True, False, []),
        (Transport(bounces=1), True, True, ["light of local lights that surfaces reflect onto each other"]),
        (Indirect(), True, True, ["caustics", "what glossy surfaces show of each other", "what sharp lobes show"]),
        (Indirect(), False, True, ["caustics", "what glossy surfaces show of each other"]),
        (
            Prefiltered(occlusion_resolution=0),
            True,
            False,
            ["shadows of the environment", "light that surfaces reflect onto each other"],
        ),
        (Prefiltered(), True, False, ["light that surfaces reflect onto each other"]),
        (Prefiltered(), False, True, ["light that surfaces reflect onto each other"]),
        (Adaptive(), True, True, ["light that surfaces reflect onto each other"]),
    ],
    ids=str,
)
def test_what_is_left_out(method: Method, environment: bool, local: bool, what: list[str]):
    lines = method.leaves_out(environment, local)
    assert len(lines) == len(what)
    assert all(line.startswith(start) for line, start in zip(lines, what, strict=True))


@pytest.mark.parametrize(("rays", "side"), [(1, 1), (4, 2), (9, 3), (16, 4), (25, 5)])
def test_rays_of_a_texel_make_a_square(rays, side):
    assert Transport(visibility_samples=rays).samples_per_side == side


# Limits.


@pytest.mark.parametrize(
    ("kind", "good"),
    [
        (Transport, {"receivers": "vertices"}),
        (Transport, {"resolution": 4, "coefficients": 96}),
        (Transport, {"resolution": 512}),
        (Transport, {"resolution": "auto", "coefficients": 6 * 256**2}),
        (Transport, {"terms": 1}),
        (Transport, {"coefficients": 1}),
        (Transport, {"coefficients": 6 * 64**2}),
        (Transport, {"coefficients": "all"}),
        (Transport, {"factor_resolution": 4}),
        (Transport, {"factor_resolution": 128}),
        (Transport, {"compression_tolerance": 0}),
        (Transport, {"bits": 8}),
        (Transport, {"gather_resolution": 4}),
        (Transport, {"gather_resolution": 256, "gather": "nearest"}),
        (Indirect, {"gather_samples": 64, "coefficients": 64}),
        (Indirect, {"bounces": 1}),
        (Indirect, {"sky_samples": 1}),
        (Indirect, {"solid_angle": 0}),
        (Indirect, {"peak": 1}),
        (Indirect, {"near": "clamp"}),
        (Indirect, {"photons": 10**7}),
        (Prefiltered, {"texels": "reflectance", "minification": "none"}),
        (Prefiltered, {"minification": "averaged", "horizon": "outside"}),
        (Prefiltered, {"map_rows": 32}),
        (Prefiltered, {"map_rows": 4096}),
        (Adaptive, {"tolerance": 1e-9}),
        (Adaptive, {"samples": 0.5}),
        (Adaptive, {"exposure": -100.0}),
        (Adaptive, {"exposure": "auto"}),
    ],
)
def test_the_ends_of_every_range_are_accepted(kind: type[Method], good: dict):
    method = kind(**good)
    assert {name: getattr(method, name) for name in good} == good


@pytest.mark.usefixtures("wrong_types")
@pytest.mark.parametrize(
    ("kind", "bad", "message"),
    [
        (Transport, {"receivers": "texels"}, "receivers are 'texels'; they must be 'pixels' or 'vertices'"),
        (Transport, {"resolution": 2}, "resolution is 2; it must be a whole number from 4 to 512"),
        (Transport, {"resolution": 1024}, "resolution is 1024"),
        (Transport, {"resolution": "best"}, "resolution is 'best'; it must be a whole number from 4 to 512, or 'auto'"),
        (Transport, {"resolution": 64.0}, "resolution is 64.0"),
        (Transport, {"resolution": 48}, "resolution is 48; it must be a power of two from 4 to 512"),
        (Transport, {"resolution": 0}, "resolution is 0"),
        (Transport, {"resolution": -64}, "resolution is -64"),
        (Transport, {"visibility_samples": 0}, "visibility samples are 0; they must be 1, 4, 9, 16 or 25"),
        (Transport, {"visibility_samples": 2}, "visibility samples are 2"),
        (Transport, {"visibility_samples": 36}, "visibility samples are 36"),
        (Transport, {"rays": "few"}, "rays are 'few'"),
        (Transport, {"receiver_tolerance": 1.0}, "receiver tolerance is 1"),
        (Prefiltered, {"receiver_tolerance": -0.1}, "receiver tolerance is -0.1"),
        (Transport, {"terms": 0}, "terms are 0; they must be whole numbers from 1"),
        (Transport, {"factor_resolution": 3}, "factor resolution is 3; it must be a whole number from 4 to 128"),
        (Transport, {"factor_resolution": 129}, "factor resolution is 129"),
        (Transport, {"coefficients": 0}, "coefficients are 0; from 1 to 24,576 can be kept in a row"),
        (Transport, {"coefficients": 24577}, "coefficients are 24577"),
        (Transport, {"coefficients": 97, "resolution": 4}, "from 1 to 96 can be kept in a row, or they are 'shared'"),
        (Transport, {"coefficients": "some"}, "coefficients are 'some'"),
        (Transport, {"coefficients": 1.5}, "coefficients are 1.5"),
        (Transport, {"coefficients": None}, "coefficients are None"),
        (Transport, {"compression_tolerance": 1}, "compression tolerance is 1; it must be at least 0"),
        (Transport, {"compression_tolerance": -0.1}, "compression tolerance is -0.1"),
        (Transport, {"compression_tolerance": float("nan")}, "compression tolerance is nan"),
        (Transport, {"bits": 12}, "bits are 12; they must be 8, 16 or 32"),
        (Transport, {"bounces": -1}, "bounces are -1"),
        (Transport, {"gather_resolution": 33}, "gather resolution is 33; it must be even"),
        (Transport, {"gather_resolution": 258}, "gather resolution is 258; it must be a whole number from 4 to 256"),
        (Transport, {"gather": "random"}, "gather is 'random'; it must be 'barycentric' or 'nearest'"),
        (Indirect, {"gather_samples": 0}, "gather samples are 0; they must be a power of four"),
        (Indirect, {"gather_samples": 16}, "gather samples are 16"),
        (Indirect, {"gather_samples": 128}, "gather samples are 128"),
        (Indirect, {"gather_samples": 1000}, "gather samples are 1000"),
        (Indirect, {"bounces": 0}, "bounces are 0; they must be whole numbers from 1"),
        (Indirect, {"sky_samples": 0}, "sky samples are 0"),
        (Indirect, {"coefficients": "all"}, "coefficients are 'all'; .* a compression tolerance of 0 keeps all"),
        (Indirect, {"gather_samples": 64, "coefficients": 65}, "coefficients are 65; from 1 to 64 can be kept"),
        (Indirect, {"compression_tolerance": 1.0}, "compression tolerance is 1.0"),
        (Indirect, {"bits": 4}, "bits are 4"),
        (Indirect, {"solid_angle": 10}, "solid angle is 10; it must be at least 0, and below 10"),
        (Indirect, {"solid_angle": -0.1}, "solid angle is -0.1"),
        (Indirect, {"peak": 0}, "peak is 0; it must be above 0"),
        (Indirect, {"peak": 1.1}, "peak is 1.1"),
        (Indirect, {"near": "far"}, "near is 'far'; it must be 'disc' or 'clamp'"),
        (Indirect, {"photons": -1}, "photons are -1; they must be whole numbers from 0 to 10,000,000"),
        (Indirect, {"photons": 10**7 + 1}, "photons are 10000001"),
        (Indirect, {"photons": 1000, "sky": True}, "photons do not come from the sky"),
        (Indirect, {"seed": -1}, "seed is -1"),
        (Prefiltered, {"texels": "nearest"}, "texels are 'nearest'; they must be 'parameters' or 'reflectance'"),
        (Prefiltered, {"minification": "mipmap"}, "minification is 'mipmap'; .* 'levels', 'averaged' or 'none'"),
        (Prefiltered, {"horizon": "inside"}, "horizon is 'inside'"),
        (Prefiltered, {"occlusion_resolution": 5}, "occlusion resolution is 5; it must be 0, 4, 8, 16, 32 or 64"),
        (Prefiltered, {"map_rows": 16}, "map rows are 16; they must be whole numbers from 32 to 4,096"),
        (Prefiltered, {"map_rows": 8192}, "map rows are 8192"),
        (Prefiltered, {"map_rows": 500}, "map rows are 500; they must be a power of two"),
        (Adaptive, {"tolerance": 0}, "tolerance is 0; it must be above 0, and finite"),
        (Adaptive, {"tolerance": float("inf")}, "tolerance is inf"),
        (Adaptive, {"samples": 0}, "samples are 0; they must be above 0, and finite"),
        (Adaptive, {"samples": float("nan")}, "samples are nan"),
        (Adaptive, {"samples": 4, "tolerance": 0.1}, "samples are a budget and tolerance is a quality"),
        (Adaptive, {"minification": "mipmap"}, "minification is 'mipmap'"),
        (Adaptive, {"exposure": float("inf")}, "exposure is inf; it must be finite, or 'auto'"),
        (Adaptive, {"exposure": "bright"}, "exposure is 'bright'; it must be finite, or 'auto'"),
        (Adaptive, {"seed": -1}, "seed is -1; it must be a whole number from 0"),
    ],
)
def test_all_else_is_refused_in_one_line(kind: type[Method], bad: dict, message: str):
    with pytest.raises(InputError, match=message) as caught:
        kind(**bad)
    assert "\n" not in str(caught.value)


@pytest.mark.usefixtures("wrong_types")
@pytest.mark.parametrize("kind", DEFAULTS)
def test_what_is_of_another_type_is_refused(kind: type[Method]):
    """Texts for numbers, numbers for texts, what is no whole number, and truths for numbers, by the dial's name."""
    for name, default in DEFAULTS[kind].items():
        wrong = [[default], "x" if name != "coefficients" else 2.0]
        wrong += [] if default is None else [None]
        wrong += [0, 1.0] if isinstance(default, bool) else [True]
        wrong += [float(default)] if type(default) is int else []
        for value in wrong:
            plain = name.replace("_", " ")
            with pytest.raises(InputError, match=f"^{plain} (is|are) {re.escape(repr(value))};"):
                kind(**{name: value})
