"""`render --lighting prefiltered`: pictures without a store."""

import json

import numpy as np
import pytest

from jaxrelight import read_image
from tests.commands.running import refusal_of, run, summary_of
from tests.commands.summary_keys import KEYS, keys_of

pytestmark = pytest.mark.usefixtures("lit_scenes")


# Fine maps take their time.
LIT_BY = "--lighting", "prefiltered", "--map-rows", "64", "--receiver-tolerance", "0"


def picture(name: str, *dials) -> np.ndarray:
    summary = summary_of(run("render", f"{name}.toml", "-o", "out.exr", *LIT_BY, *dials, "--json"))
    assert summary["lighting"] == "prefiltered"
    assert summary["lights"] == ("sky" not in name)
    # Lamps are taken as they are: nothing makes their light differ from the reference's.
    assert keys_of(summary) == KEYS["prefiltered"] - ({"error.parts.*"} if name == "lamp" else set())
    pixels = read_image("out.exr")
    assert 0.2 < summary["covered"] < 1
    return np.where(pixels[..., 3:] > 0, pixels[..., :3], 0)


@pytest.mark.slow
def test_environment_and_lights_add_up():
    sky, lamp, everywhere = picture("sky"), picture("lamp"), picture("lamp", "--no-shadows")
    np.testing.assert_allclose(picture("both"), sky + lamp, rtol=2e-3, atol=1e-4)
    assert (everywhere >= lamp).all()
    assert (everywhere > lamp).any()


@pytest.mark.slow
def test_scales_are_factors_and_lobes_that_are_the_same_everywhere_are_their_own_mean():
    np.testing.assert_array_equal(picture("lamp", "--texels", "reflectance"), picture("lamp"))
    np.testing.assert_allclose(picture("sky", "--scale", "3"), 3 * picture("sky"), rtol=1e-5)


def test_notes_say_what_is_left_out():
    for scene, left_out in (
        ("sky", ["light that surfaces reflect onto each other"]),
        ("sky --occlusion-resolution 0", ["shadows of the environment", "light that surfaces reflect onto each other"]),
        ("lamp", ["light that surfaces reflect onto each other"]),
    ):
        name, *dials = scene.split()
        status, out, err = run(
            "render", f"{name}.toml", "-o", "out.png", *LIT_BY, *dials, "--json", "--error-samples", "0"
        )
        assert status == 0
        assert err.splitlines() == [f"note: prefiltered lighting leaves out {line}" for line in left_out]
        assert json.loads(out)["leaves_out"] == left_out


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        ("dark.toml", "there is no light; name an environment with --env MAP"),
        ("sky.toml --map-rows 100", "map rows are 100; they must be a power of two"),
    ],
)
def test_what_does_not_go_together_is_refused(arguments, what):
    assert what in refusal_of(run("render", "-o", "out.exr", "--lighting", "prefiltered", *arguments.split()))
