"""The command line: what it writes, what it says, and how it ends."""

import importlib.metadata
import json
import pathlib
import re
import subprocess
import sys

import numpy as np
import pytest

from jaxrelight import cli, read_image, write_image
from jaxrelight.files import store
from jaxrelight.methods import Transport
from jaxrelight.precomputation import layers as stages
from tests.brdf.files import writers
from tests.commands.running import DIALS, NO_BOUNCES, SCENE, refusal_of, summary_of

COMMANDS = "demo", "render", "precompute", "relight", "info"


# How it ends, seen from outside.


@pytest.mark.parametrize(
    ("arguments", "status", "said"),
    [
        (
            ["info", "none.toml"],
            1,
            "jaxrelight: none.toml: cannot be read as a scene: No such file or directory; check the path\n",
        ),
        (["info", "scene.toml", "--bogus"], 2, "--bogus"),
        (["info", "scene.toml", "--json"], 0, ""),
    ],
)
def test_exit_status_of_the_process(folder, arguments, status: int, said: str):
    command = [sys.executable, "-c", "from jaxrelight.cli import main; main()", *arguments]
    root = pathlib.Path(cli.__file__).parents[1]
    done = subprocess.run(
        command, capture_output=True, text=True, cwd=folder, env={"PYTHONPATH": str(root)}, check=False
    )
    assert done.returncode == status
    assert "Traceback" not in done.stderr
    if status == 1:
        assert done.stderr == said
    assert said in done.stdout + done.stderr


@pytest.mark.parametrize("command", ["", *COMMANDS])
def test_help(run, command: str):
    status, out, err = run(*[command] * bool(command), "--help")
    assert (status, err) == (0, "")
    for word in (*COMMANDS, "--version") if not command else ("--json",):
        assert word in out
    if command in ("render", "precompute"):
        for dial in ("--resolution", "--terms", "--coefficients", "--receivers", "--store", "--lighting"):
            assert dial in out
    if command in ("render", "relight"):
        for dial in ("--env", "--rotate-y", "--scale", "--origin", "--fov-y", "--width", "--background", "--exposure"):
            assert dial in out


def test_version(run):
    status, out, err = run("--version")
    assert (status, out, err) == (0, f"{importlib.metadata.version('jaxrelight')}\n", "")


@pytest.mark.parametrize(
    "arguments",
    [
        [],
        ["paint"],
        ["render"],
        ["render", "scene.toml"],
        ["relight", "-o", "out.exr"],
        ["render", "scene.toml", "-o", "out.exr", "--resolution", "many"],
        ["render", "scene.toml", "-o", "out.exr", "--receivers", "texels"],
        ["render", "scene.toml", "-o", "out.exr", "--origin", "1", "2"],
        ["render", "scene.toml", "-o", "out.exr", "--lighting", "bright"],
    ],
    ids=" ".join,
)
def test_wrong_command_line(folder, run, arguments):
    status, out, err = run(*arguments)
    assert status == 2
    assert out == ""
    assert err != ""
    assert {path.name for path in folder.iterdir()} == {"scene.toml", "sky.exr", "other.hdr"}


def test_memory_that_does_not_suffice_is_one_line(folder, run, monkeypatch):
    def take_much(*_):
        raise MemoryError

    monkeypatch.setattr(stages, "trace_adaptively", take_much)
    assert "the memory is used up; lower --width" in refusal_of(run("render", "scene.toml", "-o", "out.exr", *DIALS))
    assert not (folder / "out.exr").exists()


def test_interruption_says_what_is_kept(folder, run, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(stages, "trace_adaptively", interrupt)
    status, _, err = run("precompute", "scene.toml", "-o", "made", *DIALS)
    assert status == 130
    said = "jaxrelight: stopped at 0 % of visibility; what is done is kept, run the same command to go on"
    assert err.splitlines() == [said]


# Bad input, one line each.


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["render", "none.toml", "-o", "out.exr"], "none.toml: cannot be read as a scene"),
        (["render", "scene.toml", "-o", "out.exr", "--resolution", "7"], "resolution is 7; it must be a power of two"),
        (["render", "scene.toml", "-o", "out.exr", "--resolution", "1024"], "resolution is 1024"),
        (["render", "scene.toml", "-o", "out.exr", "--terms", "0"], "terms are 0"),
        (["render", "scene.toml", "-o", "out.exr", "--coefficients", "0"], "coefficients are 0"),
        (["render", "scene.toml", "-o", "out.exr", "--visibility-samples", "3"], "visibility samples are 3"),
        (["render", "scene.toml", "-o", "out.exr", "--width", "0"], "image is 0 × 10 pixels"),
        (["render", "scene.toml", "-o", "out.exr", "--fov-y", "180"], "fov_y is 180.0"),
        (["render", "scene.toml", "-o", "out.exr", "--origin", "0", "0.1", "0"], "nor origin equal target"),
        (["render", "scene.toml", "-o", "out.exr", "--env", "none.exr"], "none.exr: no such file"),
        (["render", "scene.toml", "-o", "out.exr", "--env", "sky.exr", "--scale", "-1"], "rotate_y must be"),
        (["precompute", "scene.toml", "-o", "sky.exr", *DIALS], "sky.exr: cannot be used as a store"),
        (["relight", "none", "-o", "out.exr"], "none: not a store"),
        (["relight", "sky.exr", "-o", "out.exr"], "sky.exr: not a store"),
        (["info", "none"], "none: no such file"),
        (["info", "none.exr"], "none.exr: no such file"),
        (["info", "scene.txt"], "scene.txt: unknown kind of image '.txt'"),
        (["info", "."], ".: not a store"),
        (["demo", "--detail", "0"], "detail goes from 0.05 to 8"),
        (["demo", "--height", "8"], "height from 16 to 4,096"),
    ],
    ids=lambda value: " ".join(value) if isinstance(value, list) else "",
)
def test_bad_input_is_one_line(folder, run, arguments, said: str):
    (folder / "scene.txt").write_text("a scene")
    assert said in refusal_of(run(*arguments))
    assert not (folder / "out.exr").exists()


@pytest.mark.parametrize("output", ["out.gif", "out", "none/out.exr", "."])
@pytest.mark.parametrize("command", ["render", "relight"])
def test_output_is_checked_before_any_work(folder, run, monkeypatch, command: str, output: str):
    """Even before the scene or the store is looked at: neither exists here."""
    message = refusal_of(run(command, "none.toml", "-o", output))
    assert output in message
    assert "scene" not in message
    assert "store" not in message
    assert not (folder / "cache").exists()


def test_scene_without_environment_is_found_before_any_ray(folder, run, monkeypatch):
    (folder / "dark.toml").write_text(SCENE.replace('[environment]\nfile = "sky.exr"\n', ""))
    monkeypatch.setattr(stages, "trace_adaptively", None)
    message = refusal_of(run("render", "dark.toml", "-o", "out.exr", *DIALS))
    assert "there is no light; name an environment with --env MAP, or give the scene a [[light]]" in message


def test_dark_store_needs_an_environment(folder, run):
    (folder / "dark.toml").write_text(SCENE.replace('[environment]\nfile = "sky.exr"\n', ""))
    assert run("precompute", "dark.toml", "-o", "made", *DIALS)[0] == 0
    assert "--env MAP" in refusal_of(run("relight", "made", "-o", "out.exr"))
    assert run("relight", "made", "-o", "out.exr", "--env", "sky.exr")[0] == 0
    assert summary_of(run("info", "dark.toml", "--json"))["environment"] is None


@pytest.mark.slow
def test_surfaces_that_emit_need_no_environment(folder, run):
    lit = SCENE.replace('[environment]\nfile = "sky.exr"\n', "").replace("diffuse = 0.1", "diffuse = 0.1\nemission = 5")
    (folder / "lit.toml").write_text(lit)
    dials = *DIALS, "--bounces", "1", "--gather-resolution", "8"
    made = summary_of(run("render", "lit.toml", "-o", "a.exr", "--store", "made", *dials, "--json"))
    assert made["mean_radiance"] > 0.1
    assert made["seconds"]["bounce 1"] > 0
    assert 0 < made["gather_rays"]["traced"] <= made["gather_rays"]["above_horizons"]
    again = summary_of(run("relight", "made", "-o", "b.exr", "--json"))
    assert again["mean_radiance"] == pytest.approx(made["mean_radiance"])
    # What is lit without bounces shows no more than the surface that emits.
    alone = summary_of(run("render", "lit.toml", "-o", "c.exr", "--lighting", "prefiltered", "--json"))
    assert 0 < alone["mean_radiance"] < made["mean_radiance"]


# What is done.


def test_render_then_again(folder, run):
    hard = "--antialiasing", "1"
    first = summary_of(run("render", "scene.toml", "-o", "a.exr", "--store", "made", *DIALS, *hard, "--json"))
    assert first["rays"] > 0
    assert all(seconds >= 0 for seconds in first["seconds"].values())
    assert set(first["bytes"]) == {"geometry", "environment", "visibility", "factors", "transport"}
    assert 0.5 < first["kept_energy"] < 1
    assert first["settings"] == {
        "receivers": "pixels",
        "resolution": 8,
        "visibility_samples": 1,
        "rays": "adaptive",
        "receiver_tolerance": 0.0,
        "reflection": "filtered",
        "reflection_tolerance": 0.01,
        "reflection_rays": 64,
        "terms": 2,
        "coefficients": 32,
        "factor_resolution": 8,
        "compression_tolerance": 0.02,
        "bits": 32,
        "bounces": 0,
        "split_sun": True,
        "gather_resolution": 32,
        "gather": "barycentric",
    }
    assert set(first["versions"]) == {"jaxrelight", "jax", "embreex"}
    assert (first["width"], first["height"], first["picture"], first["store"]) == (12, 10, "a.exr", "made")
    image = read_image("a.exr")
    assert image.shape == (10, 12, 4)
    assert first["covered"] == image[..., 3].mean()
    assert first["receivers"] == image[..., 3].sum()
    assert first["mean_radiance"] == pytest.approx(image[image[..., 3] == 1][:, :3].mean(), rel=1e-5)

    again = summary_of(run("render", "scene.toml", "-o", "b.exr", "--store", "made", *DIALS, *hard, "--json"))
    assert again["rays"] == 0
    assert pathlib.Path("a.exr").read_bytes() == pathlib.Path("b.exr").read_bytes()


def test_render_without_a_store_uses_the_cache(folder, run):
    for rays in (True, False):
        summary = summary_of(run("render", "scene.toml", "-o", "a.png", *DIALS, "--json"))
        assert (summary["rays"] > 0) == rays
        assert pathlib.Path(summary["store"]).parent == folder / "cache" / "jaxrelight"


def test_render_in_words(folder, run):
    status, out, err = run("render", "scene.toml", "-o", "a.hdr", *DIALS)
    assert (status, err) == (0, f"{NO_BOUNCES}\n")
    lines = {line[:16].strip(): line[18:] for line in out.splitlines()}
    assert lines["picture"] == "a.hdr"
    assert (lines["width"], lines["height"]) == ("12", "10")
    assert re.search(r"visibility [0-9.]+ s, transport", lines["seconds"])
    assert re.fullmatch(r"[0-9.]+ %", lines["kept energy"])
    assert re.search(r"geometry [0-9.]+ kB", lines["bytes"])
    assert read_image("a.hdr").shape == (10, 12, 3)


def test_notes_go_to_standard_error(folder, run):
    pixels = np.ones((8, 16, 3))
    pixels[0, 0] = -1
    write_image("sky.exr", pixels)
    status, out, err = run("info", "scene.toml", "--json")
    assert (status, err) == (0, "note: sky.exr: 1 pixels had negative channels, clamped to 0\n")
    json.loads(out)


def test_nonfinite_sky_is_zeroed_when_asked(folder, run):
    pixels = np.ones((8, 16, 3))
    pixels[0, 0] = np.nan
    write_image("sky.exr", pixels)
    assert "1 NaN or infinite pixels" in refusal_of(run("render", "scene.toml", "-o", "a.exr", *DIALS))
    status, _, err = run("render", "scene.toml", "-o", "a.exr", *DIALS, "--zero-nonfinite")
    assert status == 0
    assert "note: sky.exr: 1 NaN or infinite pixels were set to 0" in err
    assert np.isfinite(read_image("a.exr")).all()


def test_relight(folder, run, made):
    def relit(*arguments) -> np.ndarray:
        summary_of(run("relight", "made", "-o", "out.exr", *arguments, "--json"))
        return read_image("out.exr")

    plain = relit()
    assert plain.shape == (10, 12, 4)
    surface = plain[..., 3] == 1
    assert surface.any()
    assert not surface.all()
    # The same sky by name, and in both halves of a turn.
    np.testing.assert_allclose(relit("--env", "sky.exr"), plain, rtol=1e-6)
    np.testing.assert_allclose(relit("--rotate-y", "360"), plain, rtol=1e-5)
    turned = relit("--rotate-y", "90")
    assert np.abs(turned - plain)[surface].max() > 0.01
    write_image("turned.exr", np.roll(read_image("sky.exr"), -4, axis=1))
    np.testing.assert_allclose(relit("--env", "turned.exr"), turned, rtol=1e-5)
    np.testing.assert_allclose(relit("--scale", "3")[..., :3], 3 * plain[..., :3], rtol=1e-5)
    assert np.abs(relit("--env", "other.hdr") - plain)[surface][:, :3].min() > 0
    bare = relit("--background", "none")
    np.testing.assert_array_equal(bare[surface], plain[surface])
    assert not bare[plain[..., 3] == 0].any()
    moved = relit(
        "--origin", "1", "2", "2", "--target", "0", "0", "0", "--fov-y", "30", "--width", "9", "--height", "7"
    )
    assert moved.shape == (7, 9, 4)
    assert moved[3, 4, 3] == 1


def test_relight_keeps_the_scenes_rotation_and_scale(folder, run):
    text = SCENE.replace('file = "sky.exr"', 'file = "sky.exr"\nrotate_y = 90\nscale = 2')
    (folder / "scene.toml").write_text(text)
    assert run("precompute", "scene.toml", "-o", "made", *DIALS)[0] == 0
    images = []
    for options in (
        [],
        ["--rotate-y", "90"],
        ["--scale", "2"],
        ["--env", "sky.exr", "--rotate-y", "90", "--scale", "2"],
    ):
        assert run("relight", "made", "-o", "out.exr", *options)[0] == 0
        images.append(read_image("out.exr"))
    for image in images[1:]:
        np.testing.assert_allclose(image, images[0], rtol=1e-6)
    assert run("relight", "made", "-o", "out.exr", "--rotate-y", "0", "--scale", "1")[0] == 0
    assert np.abs(read_image("out.exr") - images[0]).max() > 0.01


def test_exposure_is_for_png(folder, run, made):
    means = []
    for stops in ("0", "2"):
        assert run("relight", "made", "-o", "out.png", "--exposure", stops)[0] == 0
        means.append(read_image("out.png").mean())
        assert run("relight", "made", "-o", f"out{stops}.exr", "--exposure", stops)[0] == 0
    assert means[1] > 1.2 * means[0]
    np.testing.assert_array_equal(read_image("out0.exr"), read_image("out2.exr"))


def test_pngs_are_exposed_automatically_and_say_how(folder, run, made):
    shown = [summary_of(run("relight", "made", "-o", "out.png", "--scale", scale, "--json")) for scale in ("1", "1e-4")]
    assert shown[1]["exposure"] - shown[0]["exposure"] == pytest.approx(np.log2(1e4), abs=1e-3)
    assert shown[0]["clipped"] == shown[1]["clipped"] < 0.05
    status, out, _ = run("relight", "made", "-o", "out.png", "--exposure", "1.5")
    assert status == 0
    assert re.search(r"exposure  \+1.50 stops\n +clipped  \d", out)
    assert summary_of(run("relight", "made", "-o", "out.exr", "--json"))["exposure"] is None


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ("--exposure 9", "note: 100% of what is seen is clipped to white; --exposure auto takes "),
        ("--exposure -9", "note: the picture is nearly black at an exposure of -9.0; --exposure auto takes "),
        ("--scale 0", "note: the picture is black: no light reaches what is seen"),
    ],
)
def test_clipped_and_black_pngs_are_told(folder, run, made, options: str, said: str):
    assert said in run("relight", "made", "-o", "out.png", *options.split())[2]
    assert said not in run("relight", "made", "-o", "out.exr", *options.split())[2]


def test_tones_are_for_png(folder, run, made):
    pictures = []
    for tone in ("linear", "filmic", "agx"):
        assert run("relight", "made", "-o", "out.png", "--tone", tone)[0] == 0
        pictures.append(read_image("out.png"))
    assert np.abs(pictures[1] - pictures[0]).max() > 0.02 < np.abs(pictures[2] - pictures[1]).max()
    message = refusal_of(run("relight", "made", "-o", "b.exr", "--tone", "agx"))
    assert "b.exr: holds radiance, to which no tone curve applies; name a .png, or leave --tone out" in message


def test_other_camera_of_a_store_of_pixels_is_refused(folder, run):
    assert run("render", "scene.toml", "-o", "a.exr", "--store", "made", *DIALS)[0] == 0
    message = refusal_of(run("relight", "made", "-o", "b.exr", "--fov-y", "50"))
    assert "--receivers vertices" in message
    assert not (folder / "b.exr").exists()


def test_a_camera_that_pixel_receivers_are_precomputed_for_is_told(folder, run):
    said = "with --receivers vertices, one store shows all of them at no cost"
    assert said in run("render", "scene.toml", "-o", "a.exr", "--fov-y", "50", *DIALS)[2]
    assert said not in run("render", "scene.toml", "-o", "a.exr", *DIALS)[2]
    assert said not in run("render", "scene.toml", "-o", "a.exr", "--fov-y", "50", *DIALS, "--receivers", "vertices")[2]


def test_backs_of_faces_are_told(folder, run, made):
    """From inside the ball, which the floor cuts in half."""
    inside = "--origin", "0", "0", "0.1", "--target", "0", "0", "0"
    said = "% of what is seen are backs of faces, which are black; put the camera between the walls"
    assert said in run("relight", "made", "-o", "a.exr", *inside)[2]
    assert "backs of faces" not in run("relight", "made", "-o", "a.exr")[2]


def test_render_with_another_camera(folder, run):
    summary = summary_of(
        run("render", "scene.toml", "-o", "a.exr", "--origin", "0", "2", "2", "--width", "8", *DIALS, "--json")
    )
    assert (summary["width"], summary["height"]) == (8, 10)
    assert read_image("a.exr").shape == (10, 8, 4)


def test_info_on_a_store(folder, run, made):
    summary = summary_of(run("info", "made", "--json"))
    assert summary["scene"] == "scene"
    assert summary["receivers"] == 16 + 56
    # A Lambert floor, and what is diffuse of the other material; its lobe is filtered.
    assert summary["rows"] == 128 + 128
    assert summary["materials"] == {"gloss": 1, "paper": 1}
    assert set(summary["filtered_lobes"]) == {"gloss"}
    assert summary["settings"]["coefficients"] == 32
    assert set(summary["bytes"]) == {path.name for path in made.iterdir() if path.is_dir()}
    assert summary["unused_layers"] == []
    assert 0.5 < summary["kept_energy"] < 1
    assert 0 < summary["largest_error_for_unit_light"] < 10
    # A layer that another material left behind is named.
    changed = SCENE.replace("albedo = [0.5, 0.4, 0.3]", "albedo = 0.9")
    (folder / "scene.toml").write_text(changed)
    assert run("precompute", "scene.toml", "-o", "made", "--receivers", "vertices", *DIALS)[0] == 0
    unused = summary_of(run("info", "made", "--json"))["unused_layers"]
    assert sorted(name.partition("-")[0] for name in unused) == ["factors", "transport"]


def test_info_on_a_scene(folder, run):
    summary = summary_of(run("info", "scene.toml", "--json"))
    assert summary["vertices"] == 16 + 56
    assert summary["materials"] == {"gloss": "glossy", "paper": "diffuse"}
    assert summary["meshes"] == {
        "0:plane": {"vertices": 16, "faces": 18, "material": "paper"},
        "1:sphere": {"vertices": 56, "faces": 108, "material": "gloss"},
    }
    seen = {"origin": [0, 1, 3], "target": [0, 0.1, 0], "fov_y": 38.0}
    assert summary["camera"] == {**seen, "width": 12, "height": 10}
    assert summary["bounds"]["low"][::2] == [-1, -1]
    assert summary["bounds"]["high"][::2] == [1, 1]
    assert summary["file_bounds"] is None
    assert not summary["framing_camera"]["inside"]
    assert summary["lamp"]["position"][1] > 0.4
    shown = run("info", "scene.toml")[1]
    assert "  (smallest and largest x, y and z of all meshes in the scene, in metres)" in shown
    assert summary["environment"] == {"width": 16, "height": 8}


def test_a_mesh_alone(folder, run):
    """Precomputed, rendered under a sky that is named or not, and told of; what was assumed is told too."""
    pathlib.Path("thing.obj").write_text("v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n")
    told = summary_of(run("info", "thing.obj", "--json"))["meshes"]["0:thing.obj"]
    assert told == {"vertices": 12, "faces": 4, "material": "plaster"}
    size = ("--width", "12", "--height", "10", "--resolution", "8")
    result = run("render", "thing.obj", "-o", "own.exr", *size, "--json")
    assert 0.2 < summary_of(result)["covered"] < 1
    assert "under a built-in sky" in result[2]
    summary_of(run("render", "thing.obj", "-o", "other.exr", "--env", "sky.exr", *size, "--json"))
    assert not np.array_equal(read_image("own.exr"), read_image("other.exr"))


def test_info_on_an_image(folder, run):
    pixels = np.full((4, 6, 3), 0.5)
    pixels[0, 0] = np.nan
    pixels[1, 1] = -1, 3, 0.5
    write_image("image.exr", pixels)
    summary = summary_of(run("info", "image.exr", "--json"))
    assert (summary["width"], summary["height"], summary["channels"]) == (6, 4, 3)
    assert (summary["largest"], summary["negative_pixels"], summary["not_finite_pixels"]) == (3, 1, 1)
    np.testing.assert_allclose(summary["mean"], [(22 * 0.5 - 1) / 23, (22 * 0.5 + 3) / 23, 0.5])


def test_info_on_a_measured_brdf(folder, run):
    pathlib.Path("paint.bsdf").write_bytes(writers.rgl())
    summary = summary_of(run("info", "paint.bsdf", "--json"))
    assert (summary["kind"], summary["format"], summary["channels"]) == ("brdf", "RGL", 3)
    assert [*summary["albedo_at_degrees"]] == ["0", "30", "60", "80"]
    _, out, err = run("info", "paint.bsdf")
    assert f"0 {100 * summary['albedo_at_degrees']['0']:.4g} %" in out
    assert "times the light is reflected at" in err


def test_damaged_store_is_one_line(folder, run, made):
    part = made / store.read_header(made)["materials"][0]["transport"] / "000000"
    part.write_bytes(part.read_bytes()[:-1])
    for arguments in (["relight", "made", "-o", "out.exr"], ["info", "made"]):
        assert f"{part.name}: damaged, its checksum is wrong; run precompute again" in refusal_of(run(*arguments))
    assert not (folder / "out.exr").exists()


@pytest.mark.parametrize("quick", [True, pytest.param(False, marks=pytest.mark.slow)], ids=["quick", "own dials"])
def test_demo(folder, run, monkeypatch, quick: bool):
    if quick:
        small = Transport(
            "vertices",
            receiver_tolerance=0,
            reflection="factors",
            resolution=8,
            terms=2,
            coefficients=32,
            factor_resolution=8,
        )
        monkeypatch.setattr("jaxrelight.commands.demo.Transport", lambda *_, **__: small)
    summary = summary_of(run("demo", "-o", "shown", "--detail", "0.05", "--height", "16", "--json"))
    pictures = {path.name for path in (folder / "shown").glob("*.png")}
    assert pictures == {"relit.png", "sky_turned_0.png", "sky_turned_70.png", "sky_turned_200.png"}
    turned = [read_image(f"shown/sky_turned_{degrees}.png") for degrees in (0, 70, 200)]
    assert all(image.shape == (16, 21, 3) for image in turned)
    assert read_image("shown/relit.png").shape == (32, 63, 3)
    assert all(np.abs(turned[0] - other).mean() > 0.01 for other in turned[1:])
    assert summary["rays"] > 0
    layers = {"geometry", "environment", "visibility", "factors", "transport"}
    assert set(summary["bytes"]) == layers | (set() if quick else {"filtered"})
    assert summary["versions"]["jaxrelight"]
    assert summary["settings"]["coefficients"] == (32 if quick else 256)
    assert (0.7 if quick else 0.9) < summary["kept_energy"] < 1
    whole, trimmed = (summary["error"][name] for name in ("coefficients", "without_worst_5_percent"))
    assert 0 < trimmed < whole < (0.2 if quick else 0.1)
    assert {path.name.partition("-")[0] for path in (folder / "shown" / "store").glob("*-*")} == set(summary["bytes"])


# Materials of lobes alone, and without any.


def test_a_scene_of_lobes_alone_has_no_rows(folder, run):
    """A tidy picture and summary all the same; and its terms are not used."""
    scene = SCENE.replace("diffuse = 0.1", "diffuse = 0.0\nterms = 2").replace(
        'material = "paper"', 'material = "gloss"'
    )
    (folder / "scene.toml").write_text(scene)
    dials = "--receivers", "vertices", *DIALS
    status, out, err = run("render", "scene.toml", "-o", "a.exr", "--store", "made", *dials, "--json")
    assert status == 0
    assert "gloss: what is said of its factors is not used, since its lobes are filtered" in err
    assert read_image("a.exr")[..., :3].max() > 0
    summary = summary_of(run("info", "made", "--json"))
    assert (summary["rows"], summary["materials"]) == (0, {})
    assert summary["operator_bytes"] == json.loads(out)["operator_bytes"] > 0
    assert run("relight", "made", "-o", "b.exr", "--rotate-y", "40")[0] == 0


@pytest.mark.parametrize(
    ("dials", "is_fitted"),
    [
        (["--receivers", "vertices"], True),
        (["--receivers", "vertices", "--reflection", "factors"], False),
        (["--receivers", "pixels"], False),
    ],
)
def test_lobes_are_fitted_where_lobes_are_filtered(folder, run, monkeypatch, dials, is_fitted: bool):
    asked = []

    def with_lobes(scene, report=None):
        asked.append(scene)
        return scene, ("gloss: told of its fit",)

    monkeypatch.setattr("fitting.scene_lobes.with_lobes", with_lobes)
    status, _, err = run("precompute", "scene.toml", "-o", "made", *DIALS, *dials)
    assert status == 0
    assert bool(asked) == is_fitted
    assert ("note: gloss: told of its fit" in err) == is_fitted


def test_the_error_of_a_picture_is_told_unless_it_is_not_wanted(folder, run, made):
    code, out, _ = run("relight", "made", "-o", "out.png", "--json", "--error-samples", "40")
    assert code == 0
    error = json.loads(out)["error"]
    assert error["samples"] == 40
    assert 0 <= error["trimmed"]["low"] <= error["trimmed"]["value"] <= error["trimmed"]["high"] < 1
    assert f"from {error['reference']}: " in error["line"]
    code, out, _ = run("relight", "made", "-o", "out.png", "--error-samples", "0")
    assert code == 0
    assert "error" not in out.replace("--error-samples", "").split("seconds")[0]
    refusal_of(run("relight", "made", "-o", "out.png", "--error-samples", "-1"))
