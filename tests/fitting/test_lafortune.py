import json

import numpy as np
import pytest

from fitting.brdf_samples import BrdfSamples, Grid, sample
from fitting.lafortune import fit_lafortune
from fitting.residual_by_angle import DEGREES
from fitting.solve import Options, Verdict
from fitting.weights import weights
from jaxrelight.brdf.ashikhmin_shirley import ashikhmin_shirley
from jaxrelight.brdf.lobes import lobe, lobe_sum
from jaxrelight.errors import InputError
from tests.fitting.synthetic import COARSE
from tests.shared_data import shared

THREE = Options(lobes=3, per_channel=True)


def published(name: str):
    material = json.loads(shared("data", "published", "lafortune_published.json").read_text())["materials"][name]
    lobes = [
        lobe(np.stack([one["Cxy"], one["Cxy"], one["Cz"]], axis=-1), one["n"], specular=1) for one in material["lobes"]
    ]
    return lobe_sum(material["diffuse"], lobes)


@pytest.mark.slow
@pytest.mark.parametrize("name", ["clay", "skin", "felt", "primer", "bluepaint", "brushedmetal"])
def test_a_published_material_is_recovered_to_its_noise(name):
    exact = sample(published(name))
    noise = 0.01 * exact.values * np.random.default_rng(0).normal(size=exact.values.shape)
    noisy = exact.values + noise
    fit = fit_lafortune(BrdfSamples(exact.omega_i, exact.omega_o, noisy), THREE, weight="plain")
    level = np.linalg.norm(noise) / np.linalg.norm(noisy)
    # Below the noise by what the unknowns take up, above it by nothing.
    assert 0.97 * level < fit.residual <= level
    assert fit.held_out < 1.35 * level
    assert np.all(np.diff(np.asarray(fit.brdf.exponent), axis=0) >= 0)
    assert fit.brdf.C.shape == (3, 3, 3)


def test_a_lobe_is_recovered_and_accounted_for():
    truth = lobe_sum([0.3, 0.2, 0.1], [lobe([-1, -1, 0.9], 40.0, specular=[0.5, 0.6, 0.7])])
    fit = fit_lafortune(truth, grid=COARSE)
    assert fit.verdict == Verdict.GOOD
    assert fit.residual < 1e-4
    assert fit.held_out < 1e-4
    assert (fit.masked, fit.below, fit.used) == (0, 0, len(COARSE.directions()[0]))
    assert fit.notes == ()
    assert fit.albedo_error < 1e-3
    np.testing.assert_allclose(fit.brdf.exponent, truth.exponent, rtol=1e-3)
    np.testing.assert_allclose(fit.brdf.C, truth.C, atol=1e-3)
    np.testing.assert_allclose(fit.brdf.scale, truth.scale, rtol=2e-3)
    np.testing.assert_allclose(fit.brdf.diffuse, truth.diffuse, rtol=2e-3)
    assert fit.exponent_deviation.shape == fit.C_deviation.shape == (1, 1)


def test_residuals_by_angle_add_up_to_the_whole():
    """Where f is one constant, and the weight plain, the bins' squares are weighed by their counts."""
    samples = sample(lobe_sum(0.5, []), COARSE)
    ripple = np.where(np.arange(len(samples.values)) % 2, 1.1, 0.9)[:, None]
    samples = BrdfSamples(samples.omega_i, samples.omega_o, samples.values * ripple)
    fit = fit_lafortune(samples, weight="plain")
    for relative in fit.by_angle.values():
        assert len(relative) == len(DEGREES) - 1
        shown = relative[np.isfinite(relative)]
        assert shown.min() - 1e-6 <= fit.residual <= shown.max() + 1e-6
        assert np.all((shown > 0.02) & (shown < 0.2))


def test_what_is_held_out_is_not_seen():
    """Samples that contradict all others: the fit that does without them cannot predict them."""
    samples = sample(lobe_sum(0.5, []), COARSE)
    held = np.arange(len(samples.values)) * ((5**0.5 - 1) / 2) % 1 < 0.1
    values = samples.values * np.where(held, 3, 1)[:, None]
    fit = fit_lafortune(BrdfSamples(samples.omega_i, samples.omega_o, values), weight="plain")
    np.testing.assert_allclose(fit.held_out, 2 / 3, rtol=0.02)
    assert fit.residual < fit.held_out


@pytest.mark.slow
def test_an_anisotropic_material_needs_an_anisotropic_lobe():
    truth = lobe_sum(0.1, [lobe([-1, -0.8, 0.9], 20.0, specular=0.7)])
    grid = Grid(half=10, difference=6, azimuth=6, rotations=8)
    uneven = fit_lafortune(truth, Options(anisotropic=True), grid=grid)
    even = fit_lafortune(truth, grid=grid)
    assert uneven.residual < 1e-3
    assert even.residual > 0.05
    np.testing.assert_allclose(uneven.brdf.C, truth.C, atol=2e-3)
    np.testing.assert_array_equal(even.brdf.C[..., 0], even.brdf.C[..., 1])


@pytest.mark.slow
def test_another_model_is_fitted_as_far_as_lobes_can():
    material = ashikhmin_shirley([0.3, 0.2, 0.1], 0.05, 60, 60)
    one, two = (fit_lafortune(material, Options(lobes=n), grid=COARSE).residual for n in (1, 2))
    assert two < 0.9 * one


@pytest.mark.parametrize("name", ["plain", "cosine", "log-cosine"])
def test_weights_are_those_documented(name):
    samples = sample(lobe_sum([0.3, 0.2, 0.1], [lobe([-1, -1, 1], 40.0, specular=1.0)]), COARSE)
    cosine, mean = samples.omega_i[:, 2], samples.values.mean(axis=1)
    # The squared differences that the weight stands for, by a small change of the samples.
    changed = mean * (1 + 1e-5)
    typical = np.median(mean * cosine)
    compress = {
        "plain": lambda f: f,
        "cosine": lambda f: f * cosine,
        "log-cosine": lambda f: np.log1p(f * cosine / typical),
    }
    expected = np.square((compress[name](changed) - compress[name](mean)) / (changed - mean))
    weight = weights(name, samples)
    np.testing.assert_allclose(weight / weight[0], expected / expected[0], rtol=1e-3)


def test_the_grid_keeps_unit_directions_above_the_horizon():
    grid = Grid(rotations=3)
    for omega in grid.directions():
        np.testing.assert_allclose(np.linalg.norm(omega, axis=-1), 1, rtol=1e-12)
        assert omega[:, 2].min() >= grid.least_cosine


@pytest.mark.usefixtures("wrong_types")
def test_bad_input_is_named():
    samples = sample(lobe_sum(0.5, []), COARSE)
    with pytest.raises(InputError, match="unknown weight 'sine'; there are plain, cosine, log-cosine"):
        fit_lafortune(samples, weight="sine")
    with pytest.raises(InputError, match="hold_out must be from 0 to"):
        fit_lafortune(samples, hold_out=0.9)
    with pytest.raises(InputError, match="a grid is for a BRDF"):
        fit_lafortune(samples, grid=COARSE)
    with pytest.raises(InputError, match="omega_i must have the shape"):
        BrdfSamples(samples.omega_i[:3], samples.omega_o, samples.values)
    with pytest.raises(InputError, match=r"\d+ of \d+ vectors of omega_o are not of length 1, the first of 2"):
        BrdfSamples(samples.omega_i, 2 * samples.omega_o, samples.values)
    with pytest.raises(InputError, match="shape \\[samples, channels\\]"):
        BrdfSamples(samples.omega_i, samples.omega_o, samples.values[:, 0])


def _scattered(count=500, seed=0):
    """Directions of all of the sphere but a little."""
    z = np.random.default_rng(seed).normal(size=(2, count, 3))
    return z / np.linalg.norm(z, axis=-1, keepdims=True)


def test_directions_with_y_up_are_refused_by_what_is_wrong():
    up = _scattered()
    up[..., 1] = np.abs(up[..., 1])
    with pytest.raises(InputError, match=r"3\d\d of 500 samples have a direction below the surface .* the normal is z"):
        BrdfSamples(up[0], up[1], np.ones((500, 3)))
    turned = np.stack([up[..., 0], -up[..., 2], up[..., 1]], axis=-1)
    assert BrdfSamples(turned[0], turned[1], np.ones((500, 3))).is_above().all()


def test_samples_below_the_surface_are_counted_and_change_nothing():
    truth = lobe_sum([0.3, 0.2, 0.1], [lobe([-1, -1, 0.9], 10.0, specular=0.5)])
    samples = sample(truth, COARSE)
    fit = fit_lafortune(samples)
    omega_i, omega_o, values = samples.omega_i.copy(), samples.omega_o.copy(), samples.values.copy()
    omega_i[::5, 2] *= -1
    values[::5] = 1e3
    values[1] = np.nan
    other = fit_lafortune(BrdfSamples(omega_i, omega_o, values))
    count = len(values)
    assert (other.below, other.masked, other.used) == (-(-count // 5), 1, count - 1 - -(-count // 5))
    assert [line.split(" ", 1)[1] for line in other.notes] == [
        "samples have a direction below the surface and were left out; the normal is z, not y",
        "samples are not finite and were left out",
    ]
    assert other.verdict == fit.verdict == Verdict.GOOD
    assert max(other.residual, other.held_out, other.albedo_error) < 1e-3


def test_verdicts_print_their_names():
    assert [f"{verdict}" for verdict in Verdict] == [str(verdict) for verdict in Verdict]
    assert f"{Verdict.NO_DATA} {Verdict.GOOD!s:>6}" == "no_data   good"
    assert all(verdict.message for verdict in Verdict)


def test_a_fit_that_reflects_another_share_of_light_is_not_good():
    """By plain weights, a highlight outweighs the rest: one lobe for two of which the other is wide."""
    truth = lobe_sum([0.05, 0.05, 0.05], [lobe([-1, -1, 1], n, specular=s) for n, s in ((400.0, 0.3), (8.0, 0.2))])
    for material in (truth, sample(truth, COARSE)):
        fit = fit_lafortune(material, weight="plain", grid=None if isinstance(material, BrdfSamples) else COARSE)
        assert fit.residual < Options().poor
        assert fit.albedo_error > 0.2
        assert fit.verdict == Verdict.ENERGY


def test_a_fit_that_does_not_predict_what_was_held_out_is_not_good():
    samples = sample(lobe_sum(0.3, [lobe([-1, -1, 1], 20.0, specular=0.5)]), COARSE)
    held = np.arange(len(samples.values)) * ((5**0.5 - 1) / 2) % 1 < 0.1
    highlight = np.flatnonzero(held & (samples.values.mean(axis=-1) < 0.2))[:3]
    values = samples.values.copy()
    values[highlight] *= 6
    fit = fit_lafortune(BrdfSamples(samples.omega_i, samples.omega_o, values), weight="plain")
    assert fit.residual < Options().poor < fit.held_out
    assert fit.verdict == Verdict.HELD_OUT


@pytest.mark.parametrize("name", ["cornell_garnet_red.brdf", "rgl_cc_ibiza_sunset_rgb.bsdf"])
@pytest.mark.slow
def test_a_good_fit_of_a_measured_material_has_its_albedo_under_any_weight(name):
    from jaxrelight.brdf.files import load_brdf

    material = load_brdf(shared("data", "brdf", name)).brdf
    for weight in ("plain", "cosine", "log-cosine"):
        for lobes in (1, 2, 3):
            fit = fit_lafortune(material, Options(lobes=lobes), weight)
            assert fit.verdict != Verdict.GOOD or max(fit.albedo_error, fit.held_out) < 0.25
            if weight == "plain":
                assert fit.verdict in (Verdict.ENERGY, Verdict.UNCERTAIN)
