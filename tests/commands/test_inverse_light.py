"""Light solved for by the command, its report, and what is refused."""

import numpy as np
import pytest

from jaxrelight import read_image
from tests.commands.running import SCENE, refusal_of, run, summary_of
from tests.commands.summary_keys import KEYS, keys_of

HOW = "--lighting", "transport", "--resolution", "8", "--coefficients", "all"


def solve(*arguments: str) -> tuple[int, str, str]:
    return run("inverse", "light", *arguments)


@pytest.mark.slow
def test_light_is_written_that_makes_the_picture(folder):
    (folder / "scene.toml").write_text(SCENE.replace("width = 12\nheight = 10", "width = 24\nheight = 20"))
    assert run("render", "scene.toml", "-o", "picture.exr", "--background", "none", *HOW)[0] == 0
    told = summary_of(
        solve("scene.toml", "picture.exr", "-o", "found.exr", "--report", "report", "--unknowns", "4", *HOW, "--json")
    )
    assert keys_of(told) == KEYS["inverse light"]
    assert told["command"] == "inverse light"
    assert told["residual"] < 0.1
    assert told["unknowns"] == 96
    assert all(0 < count <= 96 for count in told["told"])
    assert told["exposures"] == [[1.0, 1.0, 1.0]]
    for name in set(told["report"]) - {"folder"}:
        assert (folder / "report" / name).stat().st_size > 0
    again = run("render", "scene.toml", "--env", "found.exr", "-o", "again.exr", "--background", "none", *HOW)
    assert again[0] == 0
    given, made = read_image("picture.exr"), read_image("again.exr")
    assert np.linalg.norm(made - given) < 0.1 * np.linalg.norm(given)


def test_what_is_wrong_is_one_line(folder):
    for name in ("lamp", "dark"):
        (folder / f"{name}.toml").write_text(SCENE)
    wrong = {
        "no such file": solve("scene.toml", "nothing.exr", *HOW),
        "no PICTURE": solve("scene.toml", *HOW),
        "radiance is written as .exr or .hdr": solve("scene.toml", "sky.exr", "-o", "found.png", *HOW),
    }
    for message, done in wrong.items():
        assert message in refusal_of(done, "jaxrelight inverse")


def test_what_is_sought_has_a_name():
    status, _, err = run("inverse", "lihgt", "scene.toml")
    assert status == 2
    assert "did you mean 'light'?" in err
