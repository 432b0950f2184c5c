"""Lobes for a scene: in place of what has none, fitted once, and told with their error."""

import numpy as np
import pytest

import fitting.scene_lobes
import jaxrelight as jr
from fitting import with_lobes
from jaxrelight.brdf.lobes import LobeSum

PAINT = jr.ashikhmin_shirley([0.3, 0.2, 0.1], [0.05] * 3, 80, 80)
CAMERA = jr.Camera((0, 1, 3), (0, 0, 0), fov_y=40, width=8, height=8)


def scene(paint, **materials) -> jr.Scene:
    parts = [jr.Part(jr.sphere(0.5, 2), name) for name in ("paint", *materials)]
    return jr.Scene(parts, {"paint": paint, **materials}, CAMERA)


@pytest.fixture(autouse=True)
def cache(tmp_path, monkeypatch):
    """Fits are kept there."""
    monkeypatch.setattr("jaxrelight.files.store.default_folder", lambda key: tmp_path / key)
    return tmp_path


@pytest.fixture
def fits(monkeypatch) -> list:
    """What was fitted: a fit that takes no time, and is 7 % off."""
    made = []

    def fit(brdf, options):
        made.append(brdf)
        lobes = jr.lobe_sum(0.1, [jr.lobe([-1, -1, 1], 40.0, peak=2.0)])
        nothing = np.zeros((0, 0))
        account = [lobes, 0.07, 0.08, {}, nothing, fitting.Verdict.GOOD, nothing, nothing, 10, 0, 0, 0.05]
        return fitting.LafortuneFit(*account)

    monkeypatch.setattr(fitting.scene_lobes, "fit_lafortune", fit)
    return made


def test_what_has_no_lobes_gets_some_and_is_told(fits):
    floor, weighted = (
        jr.lambert(0.5),
        jr.Material((jr.Component(PAINT, (jr.constant(0.5),)), jr.Component(jr.lambert(0.1)))),
    )
    lit, lines = with_lobes(scene(PAINT, floor=floor, both=weighted))
    assert isinstance(lit.materials["paint"], LobeSum)
    assert lit.materials["floor"] is floor
    both = lit.materials["both"]
    assert isinstance(both, jr.Material)
    assert [type(one.brdf) for one in both.components] == [LobeSum, LobeSum]
    assert both.components[0].weight == weighted.components[0].weight
    assert len(lines) == 2
    assert "both: 3 fitted lobes stand for its BRDF; they are 7.0% off (8.0% where not fitted), good" in lines[0]


def test_a_fit_is_kept_by_what_was_fitted(fits, cache):
    first, lines = with_lobes(scene(PAINT))
    again, others = with_lobes(scene(PAINT))
    assert len(fits) == 1
    assert lines == others
    kept = again.materials["paint"]
    assert isinstance(kept, LobeSum)
    np.testing.assert_array_equal(kept.exponent, first.materials["paint"].exponent)
    with_lobes(scene(jr.ashikhmin_shirley([0.3, 0.2, 0.1], [0.05] * 3, 81, 80)))
    assert len(fits) == 2
    for file in cache.rglob("*.toml"):
        file.write_text("damaged")
    with_lobes(scene(PAINT))
    assert len(fits) == 3


def test_lobes_and_factors_stay(fits):
    gloss = jr.phong(0.1, 0.5, 20)
    lit, lines = with_lobes(scene(gloss))
    assert lit.materials["paint"] is gloss
    assert not lines
    assert not fits


@pytest.mark.slow
def test_a_real_fit_is_near(tmp_path):
    lit, lines = with_lobes(scene(PAINT))
    lobes = lit.materials["paint"]
    assert isinstance(lobes, LobeSum)
    assert "good" in lines[0]
    up = np.array([0.0, 0, 1], np.float32)
    np.testing.assert_allclose(lobes.evaluate(up, up), PAINT.evaluate(up, up), rtol=0.2)
