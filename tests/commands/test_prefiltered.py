"""`render --lighting prefiltered`: pictures without a store."""

import functools

import numpy as np
import pytest

from jaxrelight import read_image
from jaxrelight.lights import prefiltered
from tests.commands.running import refusal_of, run, summary_of

pytestmark = pytest.mark.usefixtures("lit_scenes")


@pytest.fixture(autouse=True)
def _coarse_maps(monkeypatch):
    """Fine ones take their time."""
    monkeypatch.setattr(prefiltered, "prefilter", functools.partial(prefiltered.prefilter, finest=64))


def picture(name: str, *dials) -> np.ndarray:
    summary = summary_of(run("render", f"{name}.toml", "-o", "out.exr", "--lighting", "prefiltered", *dials, "--json"))
    assert summary["lighting"] == "prefiltered"
    assert summary["lights"] == ("sky" not in name)
    assert (summary["maps_bytes"] > 0) == ("lamp" not in name)
    pixels = read_image("out.exr")
    assert 0.2 < summary["covered"] < 1
    return np.where(pixels[..., 3:] > 0, pixels[..., :3], 0)


def test_environment_and_lights_add_up():
    sky, lamp, everywhere = picture("sky"), picture("lamp"), picture("lamp", "--no-shadows")
    np.testing.assert_allclose(picture("both"), sky + lamp, rtol=2e-3, atol=1e-4)
    assert (everywhere >= lamp).all()
    assert (everywhere > lamp).any()


@pytest.mark.slow
def test_scales_are_factors_and_lobes_that_are_the_same_everywhere_are_their_own_mean():
    np.testing.assert_array_equal(picture("lamp", "--texels", "reflectance"), picture("lamp"))
    np.testing.assert_allclose(picture("sky", "--scale", "3"), 3 * picture("sky"), rtol=1e-5)


def test_the_note_says_what_is_left_out():
    status, _, err = run("render", "sky.toml", "-o", "out.png", "--lighting", "prefiltered")
    assert status == 0
    assert "note: prefiltered: the environment casts no shadows" in err


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        ("both.toml -o out.exr", "transport is of distant light only, and the scene has [[light]]"),
        ("dark.toml -o out.exr --lighting prefiltered", "the scene has no environment"),
        ("sky.toml -o out.exr --lighting prefiltered --resolution 8", "--resolution is a dial of --lighting transport"),
        ("sky.toml -o out.exr --lighting prefiltered --store x", "--store is a dial of --lighting transport"),
        ("sky.toml -o out.exr --texels reflectance", "--texels is a dial of --lighting prefiltered"),
        ("sky.toml -o out.exr --no-shadows", "--no-shadows is a dial of --lighting prefiltered"),
    ],
)
def test_what_does_not_go_together_is_refused(arguments, what):
    assert what in refusal_of(run("render", *arguments.split()))


def test_transport_of_a_scene_with_lights_is_not_precomputed():
    assert "transport is of distant light only" in refusal_of(run("precompute", "both.toml", "-o", "made"))
