"""Local lights in scenes that transport lights: direct light with shadow rays, in stores, too."""

import numpy as np
import pytest

from jaxrelight import read_image
from tests.commands.running import DIALS, LAMP, refusal_of, run, summary_of

pytestmark = pytest.mark.usefixtures("lit_scenes")


def picture(*arguments) -> np.ndarray:
    summary = summary_of(run(*arguments, "-o", "out.exr", "--background", "none", "--json"))
    assert (
        summary["lighting"] == "prefiltered" or "light that surfaces reflect onto each other" in summary["leaves_out"]
    )
    return read_image("out.exr")[..., :3]


def test_lamps_add_direct_light_to_transport():
    """As much as they are by themselves, which does not depend on the lighting method."""
    sky, both = picture("render", "sky.toml", *DIALS), picture("render", "both.toml", *DIALS)
    lamp = picture("render", "lamp.toml", "--lighting", "transport", *DIALS)
    np.testing.assert_allclose(both, sky + lamp, rtol=1e-5, atol=1e-6)
    prefiltered = picture("render", "lamp.toml", "--lighting", "prefiltered", "--receiver-tolerance", "0")
    np.testing.assert_allclose(lamp, prefiltered, rtol=1e-4, atol=1e-6)
    assert lamp.max() > 0.1


def test_lamps_of_a_store_are_moved_and_replaced(tmp_path):
    assert run("precompute", "both.toml", "-o", "made", "--receivers", "vertices", *DIALS)[0] == 0
    own = picture("relight", "made")
    (tmp_path / "moved.toml").write_text(LAMP.replace("[1, 1.2, -1.5]", "[-1, 1.2, -1.5]"))
    moved = picture("relight", "made", "--lights", "moved.toml")
    assert np.abs(moved - own).max() > 0.05
    np.testing.assert_array_equal(picture("relight", "made", "--lights", "both.toml"), own)
    # Twice the lamp by itself, and the sky turned off.
    (tmp_path / "twice.toml").write_text(2 * LAMP)
    once, twice = (picture("relight", "made", "--scale", "0", "--lights", f"{name}.toml") for name in ("lamp", "twice"))
    np.testing.assert_allclose(twice, 2 * once, rtol=1e-5)
    assert once.max() > 0.1


def test_options_of_other_stores_are_refused():
    assert run("precompute", "lamp.toml", "-o", "made", "--lighting", "transport", *DIALS)[0] == 0
    refused = refusal_of(run("relight", "made", "-o", "out.exr", "--layers"))
    assert "--layers are for stores of --lighting indirect" in refused
