"""Plans: budgets and tolerances are kept, samples go where noise is, pixels are left out where that is cheap."""

import functools

import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.lighting.adaptive.estimate import RUN
from jaxrelight.lighting.adaptive.hierarchy import Hierarchy, hierarchy, shade_all
from jaxrelight.lighting.adaptive.planning import AIM, LayerEstimate, make_plan
from jaxrelight.numerics.random_numbers import MAX_POINTS
from tests.lighting.adaptive.test_hierarchy import H, W, features, plain

PIXELS = H * W


@functools.cache
def noise() -> np.ndarray:
    """Four times as large in the right half."""
    return np.where(np.arange(W) < W // 2, 0.1, 0.4) * np.ones((H, 1))


@functools.cache
def fast() -> Hierarchy:
    """Of which little lies between others."""
    return hierarchy(features(angular=8.0))


def plan(samples=None, tolerance=None, deviation=None, factor=1, power=1.0, between: Hierarchy | None = None):
    of = jnp.asarray(noise() if deviation is None else deviation, jnp.float32)
    none = jnp.zeros((H, W))
    estimate = LayerEstimate(0, between or plain(), of, none, none)
    return make_plan([estimate], power, (H, W), PIXELS, factor, samples, tolerance, shadows=False)


@pytest.mark.parametrize("samples", [8, 64, 256])
def test_budgets_are_kept(samples: int):
    planned = plan(samples=samples)
    assert 0.8 * samples < planned.samples / PIXELS < 1.05 * samples
    counts = np.asarray(planned.layers[0].counts)
    assert (counts % RUN == 0).all()
    assert ((counts > 0) == np.asarray(planned.layers[0].hierarchy.shaded)).all()
    assert planned.shaded == (counts > 0).sum()


@pytest.mark.parametrize("tolerance", [0.1, 0.03, 0.01])
def test_tolerances_are_kept_by_both_errors_together(tolerance: float):
    planned = plan(tolerance=tolerance)
    assert np.hypot(planned.interpolation, planned.noise) <= 1.01 * tolerance
    mean = float(np.sqrt(np.mean(planned.maps()["error"] ** 2)))
    assert mean <= 1.2 * tolerance


@pytest.mark.parametrize("power", [1.0, 1.6])
def test_samples_go_where_noise_is(power: float):
    """Where every pixel is shaded, n ∝ σ^(2 / (1 + power)) makes Σ σ² / n^power the least that Σ n allows."""
    steps = np.linspace(0, 4, W)
    planned = plan(samples=512, deviation=1e-3 * 2**steps * np.ones((H, 1)), power=power, between=fast())
    assert planned.shaded > 0.9 * PIXELS
    counts = np.median(planned.layers[0].counts, axis=0)
    assert np.polyfit(steps, np.log2(counts), 1)[0] == pytest.approx(2 / (1 + power), rel=0.1)


def test_the_more_noise_the_fewer_pixels_share_a_budget():
    between = hierarchy(features(angular=2.0))
    shaded = [plan(samples=64, deviation=scale * noise(), between=between).shaded for scale in (0.01, 0.3, 10)]
    assert shaded == sorted(shaded, reverse=True)
    assert shaded[-1] < shaded[0] / 2


def test_pixels_of_a_fine_view_share_the_samples_of_the_picture():
    one, four = plan(samples=64), plan(samples=64, factor=2)
    assert four.samples == pytest.approx(one.samples / 4, rel=0.1)


def test_noise_that_neighbours_have_in_common_is_no_smaller_between_them():
    none, one = jnp.zeros((H, W)), jnp.ones((H, W))
    of = jnp.asarray(noise(), jnp.float32)
    plans = [
        make_plan([LayerEstimate(0, plain(), of, none, alike)], 1.0, (H, W), PIXELS, 1, None, 0.03, shadows=False)
        for alike in (none, one)
    ]
    assert plans[1].samples > 2 * plans[0].samples
    assert all(of.is_met for of in plans)


def test_an_even_plan_shades_every_pixel():
    none = jnp.zeros((H, W))
    estimate = LayerEstimate(0, shade_all(jnp.ones((H, W), bool)), jnp.full((H, W), 0.3), none, none)
    planned = make_plan([estimate], 1.0, (H, W), PIXELS, 1, None, 0.03, shadows=False, even=True)
    counts = np.unique(planned.layers[0].counts)
    assert planned.shaded == PIXELS
    assert len(counts) == 1
    assert 0.8 * 0.03 < planned.error < AIM * 0.03 * 1.01
    assert float(planned.interpolation) == 0


def test_a_tolerance_that_cannot_be_met_is_said_to_be_and_has_the_best():
    """The more is asked for the less is predicted, down to what all samples leave."""
    between = hierarchy(features(angular=2.0))
    tolerances = [0.1 * 2**-k for k in range(8)]
    planned = [plan(tolerance=tolerance, deviation=3 * noise(), between=between) for tolerance in tolerances]
    errors = [of.error for of in planned]
    assert errors == sorted(errors, reverse=True)
    met = [of.is_met for of in planned]
    assert met == sorted(met, reverse=True)
    assert met[0]
    assert not met[-1]
    for of, tolerance in zip(planned, tolerances, strict=True):
        assert of.is_met == (of.error <= 1.01 * tolerance)
    # All samples that there can be, wherever pixels are shaded.
    counts = np.asarray(planned[-1].layers[0].counts)
    assert counts[counts > 0].min() > 0.9 * MAX_POINTS
    assert plan(samples=64).is_met
