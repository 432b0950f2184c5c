"""Factors refined where they are looked up."""

import jax.numpy as jnp
import numpy as np
import pytest

from fitting.factors import refined
from jaxrelight.brdf.factored import Factored
from jaxrelight.brdf.factors import factor
from jaxrelight.brdf.lobes import lambert, lobe, lobe_sum, phong
from jaxrelight.brdf.parametrisation import DISC


def test_refining_lowers_the_error_of_look_ups_on_other_directions():
    brdf = phong([0.4, 0.1, 0.2], 0.4, 12)
    start = factor(brdf, 12, 10)
    found = refined(brdf, start)
    assert found.after < 0.97 * found.before
    assert found.factors.light_maps.shape == start.light_maps.shape
    assert 0 < found.steps <= 60


@pytest.mark.slow
def test_maps_that_are_wrong_are_brought_near_the_best():
    """From maps with noise, most of the way back to those of the singular values."""
    brdf = lobe_sum(0.2, [lobe([-1, -1, 0.9], 4, peak=0.5)])
    best = factor(brdf, 3, 10)
    noise = np.random.default_rng(0).normal(0, 0.1, (2, *best.light_maps.shape))
    start = Factored(best.light_maps + jnp.asarray(noise[0], jnp.float32), best.view_maps, DISC)
    found, reached = refined(brdf, start, steps=200), refined(brdf, best)
    assert found.before > 1.1 * reached.after
    assert found.after < 1.01 * reached.after


def test_the_same_seed_gives_the_same_and_a_constant_stays_as_it_is():
    brdf = phong(0.2, 0.4, 5)
    start = factor(brdf, 2, 8)
    one, two = refined(brdf, start, steps=5), refined(brdf, start, steps=5)
    np.testing.assert_array_equal(one.factors.light_maps, two.factors.light_maps)
    flat = factor(lambert(0.5), 2, 8)
    assert refined(lambert(0.5), flat).factors is flat
