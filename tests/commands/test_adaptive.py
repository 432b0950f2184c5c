"""`render --lighting adaptive`: pictures without a store, by a budget or a quality, and maps of what was planned."""

import numpy as np
import pytest

from jaxrelight import read_image
from tests.commands.running import refusal_of, run, summary_of
from tests.commands.summary_keys import KEYS, keys_of

pytestmark = pytest.mark.usefixtures("lit_scenes")


def picture(name: str, *dials) -> tuple[np.ndarray, dict]:
    summary = summary_of(run("render", f"{name}.toml", "-o", "out.exr", "--lighting", "adaptive", *dials, "--json"))
    assert summary["lighting"] == "adaptive"
    pixels = read_image("out.exr")
    assert 0.2 < summary["covered"] < 1
    return np.where(pixels[..., 3:] > 0, pixels[..., :3], 0), summary


@pytest.mark.slow
def test_environment_lights_and_shadows_add_up():
    (sky, told), (lamp, _) = picture("sky"), picture("lamp")
    assert told["samples"] > 0
    assert 0 < told["shaded"] <= 1
    assert told["predicted_error"]["samples"] <= 0.01
    np.testing.assert_allclose(picture("both")[0], sky + lamp, rtol=2e-3, atol=1e-4)


@pytest.mark.slow
def test_without_shadows_all_is_lit_more():
    whole, lit = picture("both")[0], picture("both", "--no-shadows")[0]
    assert (lit >= whole - 0.02).all()
    assert (lit > whole + 0.02).any()


@pytest.mark.slow
def test_surfaces_are_sampled_more_often_where_asked():
    """Pictures of few pixels cover what they happen to; of more samples, what there is."""
    once, four, sixteen = (
        picture("sky", "--background", "none", "--antialiasing", count)[0] for count in ("1", "4", "16")
    )
    assert once.shape == four.shape == sixteen.shape
    np.testing.assert_allclose(four.mean(), sixteen.mean(), rtol=0.05)
    assert np.abs(four - sixteen).mean() < 0.5 * np.abs(once - sixteen).mean()


@pytest.mark.slow
def test_budget_seed_and_maps(tmp_path):
    sky, told = picture("sky", "--samples", "40", "--maps", "maps/of_it")
    assert keys_of(told) == KEYS["adaptive"]
    assert told["settings"]["samples"] == 40
    assert told["samples"] <= 44
    again, _ = picture("sky", "--samples", "40")
    np.testing.assert_array_equal(again, sky)
    assert (picture("sky", "--samples", "40", "--seed", "1")[0] != sky).any()
    for name in ("bandwidth", "level", "samples", "error"):
        assert read_image(tmp_path / "maps" / "of_it" / f"{name}.png").shape[:2] == (2 * sky.shape[0], 2 * sky.shape[1])
        low, high = told["maps"][name]
        assert 0 <= low <= high


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        ("sky.toml --samples 8 --tolerance 0.1", "samples are a budget and tolerance is a quality; give one of both"),
        ("sky.toml --samples 0", "samples are 0.0; they must be above 0, and finite"),
        ("sky.toml --tolerance nan", "tolerance is nan; it must be above 0, and finite"),
        ("sky.toml --exposure inf", "exposure is inf; it must be finite, or 'auto'"),
        ("sky.toml --seed -1", "seed is -1; it must be a whole number from 0"),
        ("dark.toml", "there is no light; name an environment with --env MAP"),
        ("lamp.toml --maps maps", "--maps shows how an environment is sampled"),
        ("sky.toml --maps sky.exr/x", "--maps sky.exr/x: "),
    ],
)
def test_what_does_not_go_together_is_refused(arguments, what, tmp_path):
    assert what in refusal_of(run("render", "-o", "out.exr", "--lighting", "adaptive", *arguments.split()))
    assert not (tmp_path / "maps").exists()
