"""Lights of scene files: every kind, its defaults, and what each refuses."""

import numpy as np
import pytest

from jaxrelight import InputError, load_scene, write_image
from tests.scene.test_scene import SMALL

KINDS = {
    "Point": 'type = "point"\nposition = [0, 1, 0]\nintensity = 2',
    "Spot": 'type = "spot"\nposition = [0, 1, 0]\ntarget = [0, 0, 0]\nintensity = [1, 2, 3]\ncutoff = 30.0',
    "Directional": 'type = "directional"\ndirection = [0, -1, 0]\nirradiance = 2',
    "Projector": 'type = "projector"\nposition = [0, 1, 1]\ntarget = [0, 0, 0]\nimage = "slide.exr"\nintensity = 2\n'
    "fov_y = 40",
    "Shaped": 'type = "shaped"\nposition = [0, 1, 1]\ntarget = [0, 0, 0]\nintensity = 2\ninner = [20, 10]\nouter = 30\n'
    "roundness = 0.5\nnear = [0, 0.1]\nfar = [2, 3]\nfalloff = 1\nreference = 2",
    "Area": 'type = "area"\ncentre = [0, 1, 0]\nu = [1, 0, 0]\nv = [0, 0, 1]\nradiance = 2',
    "Sky": 'type = "sky"\nradiance = 2\nsamples = 8',
}


def loaded(tmp_path, lines: str):
    write_image(tmp_path / "slide.exr", np.random.default_rng(0).uniform(1, 2, (3, 4, 3)).astype(np.float32))
    path = tmp_path / "scene.toml"
    path.write_text(f"{SMALL}\n[[light]]\n{lines}\n")
    return load_scene(path)


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_is_read(tmp_path, kind: str):
    (light,) = loaded(tmp_path, KINDS[kind]).lights.local
    assert type(light).__name__ == kind
    assert light.parts()


def test_images_are_multiplied_by_their_intensity(tmp_path):
    (light,) = loaded(tmp_path, KINDS["Projector"]).lights.local
    assert light.image.shape == (3, 4, 3)  # pyright: ignore[reportAttributeAccessIssue]
    assert 2 < float(light.image.min()) < float(light.image.max()) < 4  # pyright: ignore[reportAttributeAccessIssue]


def test_a_sky_may_be_a_map(tmp_path):
    lines = 'type = "sky"\nfile = "slide.exr"\nrotate_y = 30\nscale = 2\nsamples = 9'
    (light,) = loaded(tmp_path, lines).lights.local
    assert len(light.parts()) == 9


@pytest.mark.parametrize("kind", KINDS)
def test_what_a_kind_does_not_know_is_refused(tmp_path, kind: str):
    with pytest.raises(InputError, match=r"\[\[light\]\] number 1: 'colour' is not known"):
        loaded(tmp_path, f"{KINDS[kind]}\ncolour = 3")


@pytest.mark.parametrize("kind", KINDS)
def test_what_a_kind_needs_is_asked_for(tmp_path, kind: str):
    needed = [line for line in KINDS[kind].splitlines()[1:] if line.split(" = ")[0] not in OPTIONAL]
    for line in needed:
        with pytest.raises(InputError, match=rf"\[\[light\]\] number 1: .*{line.split(' = ')[0]}"):
            loaded(tmp_path, KINDS[kind].replace(line, ""))


OPTIONAL = "outer", "roundness", "near", "far", "falloff", "reference", "samples"


@pytest.mark.parametrize(
    ("kind", "old", "new", "what"),
    [
        ("Projector", "slide.exr", "missing.exr", "missing.exr"),
        ("Projector", "fov_y = 40", "fov_y = 200", "fov_y must lie between 0 and 180"),
        ("Shaped", "outer = 30", "outer = 5", "0 < inner ≤ outer < 90"),
        ("Area", "v = [0, 0, 1]", "v = [2, 0, 0]", "lie along each other"),
        ("Sky", "samples = 8", "samples = 0", "samples must be 1 or more"),
    ],
)
def test_numbers_that_make_no_light_are_refused(tmp_path, kind: str, old: str, new: str, what: str):
    with pytest.raises(InputError, match=what) as caught:
        loaded(tmp_path, KINDS[kind].replace(old, new))
    assert "[[light]] number 1" in str(caught.value)
    assert "\n" not in str(caught.value)
