"""Local lights by the command: rendered, precomputed, moved without precomputing, and what is refused."""

import pathlib

import numpy as np
import pytest

from jaxrelight import read_image, write_image
from jaxrelight.images.exr import read_channels
from tests.commands.running import refusal_of, run, summary_of
from tests.commands.summary_keys import KEYS, keys_of

CAMERA = "[camera]\norigin = [0, 0.6, 1.4]\ntarget = [0, 0.3, -1]\nfov_y = 60\nwidth = 16\nheight = 12\n"
MATERIALS = (
    '[material.wall]\ntype = "lambert"\nalbedo = [0.7, 0.5, 0.4]\n'
    '[material.floor]\ntype = "phong"\ndiffuse = [0.4, 0.4, 0.4]\nspecular = [0.3, 0.3, 0.3]\nexponent = 10\n'
)
MESHES = (
    '[[mesh]]\nprimitive = "plane"\nsize = [2, 2]\nresolution = 8\nmaterial = "floor"\n'
    '[[mesh]]\nprimitive = "plane"\nsize = [2, 2]\nresolution = 8\nmaterial = "wall"\n'
    "transform = [[1, 0, 0, 0], [0, 0, -1, 1], [0, 1, 0, -1], [0, 0, 0, 1]]\n"
)
LAMP = '[[light]]\ntype = "point"\nposition = [0.3, 0.8, 0]\nintensity = [2, 1, 1]\n'
MOVED = '[[light]]\ntype = "spot"\nposition = [-0.5, 0.9, 0]\ntarget = [0, 0, -1]\nintensity = 3\ncutoff = 50\n'
SKY = '[environment]\nfile = "sky.exr"\n'
FEW = "--gather-samples", "256", "--sky-samples", "4"


@pytest.fixture(autouse=True)
def _folder(tmp_path, monkeypatch):
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))
    monkeypatch.chdir(tmp_path)
    write_image("sky.exr", np.full((8, 16, 3), 0.3, np.float32))
    scene = CAMERA + MATERIALS + MESHES
    for name, text in {"lamp": scene + LAMP, "both": scene + SKY + LAMP, "dark": scene, "moved": MOVED}.items():
        (tmp_path / f"{name}.toml").write_text(text)


def test_a_scene_with_local_lights_alone_is_lit_by_them_and_what_they_light():
    arguments = "lamp.toml", "-o", "out.exr", "--store", "made", *FEW
    summary = summary_of(run("render", *arguments, "--json"))
    assert keys_of(summary) == KEYS["indirect"]
    assert summary["lighting"] == "indirect"
    assert (summary["lights"], summary["settings"]["bounces"]) == (1, 3)
    assert summary["rays"] > 1000
    first = read_image("out.exr")
    again = summary_of(run("render", *arguments, "--json"))
    assert again["rays"] == 0
    np.testing.assert_array_equal(read_image("out.exr"), first)
    direct = summary_of(run("render", "lamp.toml", "-o", "direct.exr", "--lighting", "prefiltered", "--json"))
    assert 1.02 * direct["mean_radiance"] < summary["mean_radiance"] < 1.6 * direct["mean_radiance"]


@pytest.mark.slow
def test_lights_are_moved_without_precomputing():
    made = summary_of(run("precompute", "lamp.toml", "-o", "made", *FEW, "--json"))
    assert made["lighting"] == "indirect"
    first = summary_of(run("relight", "made", "-o", "own.exr", "--json"))
    rendered = summary_of(run("render", "lamp.toml", "-o", "same.exr", "--store", "made", *FEW, "--json"))
    assert first["mean_radiance"] == pytest.approx(rendered["mean_radiance"], rel=1e-6)
    assert rendered["rays"] == 0
    summary_of(run("relight", "made", "-o", "moved.exr", "--lights", "moved.toml", "--json"))
    own, moved = read_image("own.exr"), read_image("moved.exr")
    assert np.abs(own - moved).mean() > 0.05 * own[..., :3].mean()
    # A whole scene's lights, too; the sky of the store's scene is none, that of the command line is added.
    summary_of(run("relight", "made", "-o", "again.exr", "--lights", "lamp.toml", "--json"))
    np.testing.assert_array_equal(read_image("again.exr"), own)
    summary_of(run("relight", "made", "-o", "sky.exr", "--env", "sky.exr", "--json"))
    seen = own[..., 3] == 1
    assert (read_image("sky.exr")[seen] >= own[seen] - 1e-6).all()


@pytest.mark.slow
def test_a_sky_in_the_cloud_is_changed_without_precomputing():
    """What a sky adds to a lamp is twice as much for twice the sky."""
    arguments = "--lighting", "indirect", "--bounces", "1", "--background", "none", *FEW, "--json"
    first = summary_of(run("render", "both.toml", "-o", "out.exr", "--store", "made", "--sky", *arguments))
    assert first["settings"]["sky"] is True
    means = [
        summary_of(run("relight", "made", "-o", "out.exr", "--scale", scale, "--background", "none", "--json"))
        for scale in ("0", "1", "2")
    ]
    none, once, twice = (one["mean_radiance"] for one in means)
    assert once == pytest.approx(first["mean_radiance"], rel=1e-6)
    assert twice - once == pytest.approx(once - none, rel=1e-3)
    assert once > 1.05 * none


def test_layers_add_up():
    run("render", "both.toml", "-o", "out.exr", "--lighting", "indirect", "--layers", "--background", "none", *FEW)
    (channels,) = read_channels(pathlib.Path("out.exr"), 10000)
    for name in "RGB":
        parts = sum(channels[f"{layer}.{name}"] for layer in ("direct", "indirect.diffuse", "indirect.glossy"))
        np.testing.assert_allclose(parts, channels[name], rtol=1e-4, atol=1e-5)
        lights = sum(channels[f"{layer}.{name}"] for layer in ("light1", "sky"))
        np.testing.assert_allclose(lights, channels[name], rtol=1e-4, atol=1e-5)
        assert channels[f"indirect.glossy.{name}"].max() > 0
    np.testing.assert_array_equal(read_image("out.exr")[..., 0], channels["R"])


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        ("render lamp.toml -o out.exr --gather-samples 100", "gather samples are 100; they must be a power of four"),
        ("render lamp.toml -o out.exr --bounces 0", "bounces are 0"),
        ("render lamp.toml -o out.exr --seed -1", "seed is -1; it must be a whole number from 0"),
        ("render lamp.toml -o out.png --layers --gather-samples 64", "only an .exr holds layers"),
        ("render dark.toml -o out.exr --lighting indirect --gather-samples 64", "there is no light"),
        ("render lamp.toml -o out.exr --photons 8 --sky", "photons do not come from the sky"),
    ],
)
def test_what_does_not_go_together_is_refused_before_work(arguments, what, tmp_path):
    assert what in refusal_of(run(*arguments.split()))
    assert not (tmp_path / "cache" / "jaxrelight").exists()


def test_other_cameras_and_files_without_lights_are_refused():
    run("precompute", "lamp.toml", "-o", "made", *FEW)
    assert "precomputed for one camera" in refusal_of(run("relight", "made", "-o", "out.exr", "--width", "5"))
    assert "has no [[light]]" in refusal_of(run("relight", "made", "-o", "out.exr", "--lights", "dark.toml"))


@pytest.mark.slow
def test_direct_light_is_sampled_as_often_as_relight_says():
    """More samples of direct light are another picture, with the same indirect light."""
    summary_of(run("precompute", "lamp.toml", "-o", "made", *FEW, "--json"))
    own, once, four = (
        summary_of(run("relight", "made", "-o", f"{name}.exr", *options, "--json"))
        for name, options in (("own", ()), ("once", ("--antialiasing", "1")), ("four", ("--antialiasing", "16")))
    )
    assert [one["antialiasing"] for one in (own, once, four)] == [4, 1, 16]
    assert np.abs(read_image("own.exr") - read_image("once.exr")).max() > 0.01
    assert np.abs(read_image("four.exr") - read_image("once.exr")).max() > 0.01
    assert four["mean_radiance"] == pytest.approx(once["mean_radiance"], rel=0.1)
