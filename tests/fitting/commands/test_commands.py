"""jaxrelight-fit: what its commands write, say and refuse."""

import dataclasses
import functools
import re

import jax
import numpy as np
import pytest

import fitting.commands
from fitting import lafortune
from fitting.brdf_samples import Grid, sample
from jaxrelight import load_scene, read_image, write_image
from jaxrelight.brdf.files import load_brdf
from jaxrelight.brdf.files.fitted import read_fitted
from jaxrelight.brdf.files.sbrdf import read_sbrdf
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.separable import Separable
from tests.brdf.files import writers
from tests.commands import running
from tests.commands.running import refusal_of, summary_of
from tests.fitting.synthetic import COARSE

refusal = functools.partial(refusal_of, program="jaxrelight-fit")
ONE = "--lobes", "1"


SCENE = """
[camera]
origin = [0, 1, 3]
target = [0, 0.1, 0]
width = 12
height = 10
[environment]
file = "sky.exr"
[material.paint]
type = "fitted"
file = "{}"
[[mesh]]
primitive = "plane"
resolution = 3
material = "paint"
"""


def _of_a_scene(folder, file: str):
    """What one line of a scene makes of a file."""
    write_image(folder / "sky.exr", np.ones((2, 4, 3), np.float32))
    (folder / "scene.toml").write_text(SCENE.format(file))
    return load_scene(folder / "scene.toml").materials["paint"]


def _documented(summary: dict):
    """Every key stands in the page of the commands."""
    page = set(re.findall(r"\w+", fitting.commands.__doc__ or ""))
    assert summary.keys() <= page
    assert summary["seconds"].keys() <= page
    assert {"jaxrelight", "jax", "embreex"} == summary["versions"].keys()


def test_lafortune_writes_a_material_and_says_how_good_it_is(folder, run):
    pytest.importorskip("matplotlib")
    summary = summary_of(run("lafortune", "paint.bsdf", "-o", "paint.toml", *ONE, "--report", "report", "--json"))
    _documented(summary)
    made = read_fitted(folder / "paint.toml")
    assert isinstance(made, LobeSum)
    np.testing.assert_array_equal(np.float32(summary["exponents"]), made.exponent)
    jax.tree.map(np.testing.assert_array_equal, _of_a_scene(folder, "paint.toml"), made)
    text = (folder / "paint.toml").read_text()
    assert "# data      paint.bsdf (RGL)" in text
    assert f"# residual  {100 * summary['residual']:.3g} % of the data" in text
    assert f"# held out  {100 * summary['held_out']:.3g} %" in text
    assert f"# verdict   {summary['verdict']}: {summary['meaning']}" in text
    # Random numbers are no lobes, and are told to be none.
    assert summary["verdict"] == "poor"
    assert 0.3 < summary["residual"] < 1
    assert summary["report"] == ["report/curves.png", "report/spheres.png", "report/residuals.png"]
    for picture in summary["report"]:
        assert read_image(folder / picture).std() > 0.05


@pytest.mark.slow
def test_lafortune_in_words_and_with_every_choice(folder, run):
    (folder / "paint.bsdf").write_bytes(writers.rgl(azimuths=5, scale=0.5))
    dials = "--weight", "cosine", "--anisotropic", "--per-channel", "--hold-out", "0"
    status, out, err = run("lafortune", "paint.bsdf", "-o", "paint.toml", *ONE, *dials)
    assert (status, err) == (0, "")
    lines = dict(line.strip().split("  ", 1) for line in out.splitlines())
    assert lines["held out"] == "none"
    assert lines["weight"] == "cosine"
    assert lines["residual"].endswith(" %")
    made = read_fitted(folder / "paint.toml")
    assert isinstance(made, LobeSum)
    assert made.C.shape == (1, 3, 3)
    assert (made.C[..., 0] != made.C[..., 1]).any()
    assert "# held out  not known" in (folder / "paint.toml").read_text()


@dataclasses.dataclass(frozen=True)
class _Retro(Grid):
    """One pair, of a direction with itself, as often as the command samples any: no other program is compiled."""

    omega: np.ndarray = dataclasses.field(kw_only=True)

    def directions(self):
        """ω_i and ω_o."""
        return (np.broadcast_to(self.omega, (len(COARSE.directions()[0]), 3)),) * 2


@pytest.mark.parametrize("form", [pytest.param("svd", marks=pytest.mark.slow), "nonnegative"])
def test_factors_are_those_of_the_material(folder, run, form):
    dials = "--form", form, "--terms", "3", "--resolution", "3"
    summary = summary_of(run("factors", "paint.bsdf", "-o", "paint.npz", *dials, "--json"))
    _documented(summary)
    made = read_fitted(folder / "paint.npz")
    assert isinstance(made, Separable)
    jax.tree.map(np.testing.assert_array_equal, _of_a_scene(folder, "paint.npz"), made)
    assert made.light_maps.shape == (3, 3, 3, 3)
    assert (summary["terms"], summary["resolution"], summary["bytes"]) == (3, 3, 2 * 4 * 9 * 9)
    assert (np.asarray(made.light_maps).min() < 0) == (form == "svd")
    # At the centre of a texel of either side, up to what three terms leave out.
    omega = np.asarray([-2 / 3, 0, np.sqrt(5 / 9)], np.float32)
    exact = sample(load_brdf(folder / "paint.bsdf").brdf, _Retro(omega=omega)).values[0]
    np.testing.assert_allclose(made.evaluate(omega, omega), exact, rtol=0.5)
    assert 0 < summary["residual"] < 1


def test_factors_that_miss_much_say_so(folder, run):
    short = "factors", "paint.bsdf", "-o", "paint.npz", "--resolution", "3", "--terms"
    missed = summary_of(run(*short, "1", "--json"))["residual"]
    _, _, err = run(*short, "1")
    assert missed > 0.25
    assert f"the factors miss {100 * missed:.3g} % of the reflected light; ask for more --terms" in err


def test_an_error_asks_for_as_few_terms_as_it_takes(folder, run):
    dials = "--resolution", "3", "--terms", "9", "--json"
    few, more = (
        summary_of(run("factors", "paint.bsdf", "-o", "paint.npz", "--error", error, *dials))["terms"]
        for error in ("0.4", "0.2")
    )
    assert 1 <= few < more < 9


@pytest.mark.slow
def test_refined_factors_say_what_refining_did(folder, run):
    dials = "--refine", "--resolution", "6", "--terms", "2", "--json"
    summary = summary_of(run("factors", "paint.bsdf", "-o", "paint.npz", *dials))
    _documented(summary)
    assert summary["refined"].keys() == {"before", "after"}
    assert summary["refining_steps"] > 0


@pytest.mark.slow
def test_sbrdf_writes_maps_and_predicts_images(folder, run):
    pytest.importorskip("matplotlib")
    arguments = "sbrdf", "bump.npz", "-o", "maps.exr", "--report", "report", "--storage", "half", "--json"
    summary = summary_of(run(*arguments))
    _documented(summary)
    levels = read_sbrdf(folder / "maps.exr")
    assert [level.lobes.shape for level in levels] == [(3, 4)]
    assert summary["storage"] == "half"
    assert summary["bytes"] == (folder / "maps.exr").stat().st_size
    assert summary["levels"] == [[4, 3]]
    np.testing.assert_allclose(levels[0].lobes.exponent, 20, rtol=0.05)
    assert (summary["texels"], summary["images"], summary["held_out_images"]) == (12, 224, 32)
    assert summary["verdicts"] == {"good": 12}
    assert summary["residual"] < 0.01
    assert summary["held_out"]["lobes"] < 0.01 < summary["held_out"]["lambert"]
    assert not summary["estimated_normals"]
    for picture in summary["report"]:
        assert read_image(folder / picture).std() > 0.01
    # What a run that is stopped would go on with is cleared away.
    assert not list(folder.glob(".*"))


@pytest.mark.slow
def test_sbrdf_writes_coarser_levels(folder, run):
    summary = summary_of(run("sbrdf", "bump.npz", "-o", "maps.exr", "--levels", "--storage", "8bit", "--json"))
    assert [level.lobes.shape for level in read_sbrdf(folder / "maps.exr")] == [(3, 4), (2, 2), (1, 1)]
    assert summary["levels"] == [[4, 3], [2, 2], [1, 1]]


@pytest.mark.parametrize(
    ("arguments", "what"),
    [
        ("lafortune paint.bsdf -o paint.exr", "paint.exr: cannot write lobes of kind '.exr'; use .toml"),
        ("lafortune paint.bsdf -o none/paint.toml", "none/paint.toml: its folder does not exist"),
        ("lafortune none.bsdf -o paint.toml", "none.bsdf: cannot be read"),
        ("lafortune bump.npz -o paint.toml", "bump.npz: is no BRDF file"),
        ("lafortune paint.bsdf -o paint.toml --starts 9", "starts must be from 1 to 7, not 9"),
        ("lafortune paint.bsdf -o paint.toml --hold-out 0.9", "hold_out must be from 0 to 0.5"),
        ("lafortune paint.bsdf -o paint.toml --report paint.bsdf", "paint.bsdf: cannot be made"),
        ("factors paint.bsdf -o paint.toml", "cannot write factors of kind '.toml'; use .npz"),
        ("factors paint.bsdf -o paint.npz --terms 0", "0 terms cannot be had"),
        ("factors paint.bsdf -o paint.npz --resolution 1", "--resolution must be at least 2"),
        ("factors paint.bsdf -o paint.npz --error 2", "must lie between 0 and 1"),
        ("factors paint.bsdf -o paint.npz --form normalised", "the normalised form has one term, not 4"),
        ("factors paint.bsdf -o paint.npz --resolution 3 --form symmetric", "needs a reciprocal BRDF"),
        ("factors paint.bsdf -o paint.npz --form nonnegative --refine", "--refine is for the form svd"),
        ("sbrdf bump.npz -o maps.png", "cannot write maps of kind '.png'; use .exr"),
        ("sbrdf paint.bsdf -o maps.exr", "a stack of images is a .npz file"),
        ("sbrdf bump.npz -o maps.exr --hold-out 1", "--hold-out must be 0, or at least 2, not 1"),
    ],
)
def test_bad_input_is_one_line(folder, run, arguments: str, what: str):
    pytest.importorskip("matplotlib")
    before = sorted(folder.iterdir())
    assert what in refusal(run(*arguments.split()))
    assert sorted(folder.iterdir()) == before


def test_a_stop_says_that_nothing_is_kept(folder, run, monkeypatch):
    def interrupt(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(lafortune, "fit_lafortune", interrupt)
    status, out, err = run("lafortune", "paint.bsdf", "-o", "paint.toml", *ONE)
    assert (status, out) == (130, "")
    assert err.splitlines()[-1].startswith("jaxrelight-fit: stopped at 0 % of fit; nothing is written yet")
    assert not (folder / "paint.toml").exists()


def test_no_other_file_is_harmed_by_a_damaged_one(folder, run):
    (folder / "paint.toml").write_text("earlier")
    (folder / "short.bsdf").write_bytes(writers.rgl()[:-9])
    assert "short.bsdf" in refusal(run("lafortune", "short.bsdf", "-o", "paint.toml", *ONE))
    assert (folder / "paint.toml").read_text() == "earlier"


@pytest.mark.parametrize(("typed", "meant"), [("lafortun", "lafortune"), ("factor", "factors"), ("sbdrf", "sbrdf")])
def test_misspelt_command_suggests_the_right_one(run, typed: str, meant: str):
    assert run(typed, "x") == (2, "", f"jaxrelight-fit: '{typed}' is not a command; did you mean '{meant}'?\n")


def test_wrong_command_lines_are_status_two(folder, run):
    status, out, err = run("lafortune", "paint.bsdf", "-o", "a.toml", "--lobes", "4")
    assert (status, out) == (2, "")
    assert "--lobes" in err
    status, out, err = run("lafortune", "paint.bsdf", "-o", "a.toml", "--lobs", "2")
    assert (status, out) == (2, "")
    assert "--lobes" in err


@pytest.mark.slow
@pytest.mark.parametrize(
    ("arguments", "file"),
    [(("lafortune", *ONE), "paint.toml"), (("factors", "--resolution", "8"), "paint.npz")],
    ids=["lafortune", "factors"],
)
def test_what_was_written_renders(folder, run, arguments, file: str):
    """By one line of a scene."""
    command, *dials = arguments
    assert run(command, "paint.bsdf", "-o", file, *dials, "--json")[0] == 0
    write_image(folder / "sky.exr", np.random.default_rng(0).gamma(0.5, size=(8, 16, 3)))
    (folder / "scene.toml").write_text(SCENE.format(file))
    status, _, err = running.run("render", "scene.toml", "-o", "a.exr", "--store", "made", *running.DIALS)
    assert (status, err) == (0, f"{running.NO_BOUNCES}\n")
    picture = read_image(folder / "a.exr")
    assert np.isfinite(picture).all()
    assert picture[-1, :, :3].min() > 0
