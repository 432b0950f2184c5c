"""Factors refined where they are looked up."""

import functools

import jax.numpy as jnp
import numpy as np
import pytest

from fitting.factors import Refined, refined
from jaxrelight.brdf.factored import Factored
from jaxrelight.brdf.factors import factor
from jaxrelight.brdf.lobes import LobeSum, lambert, lobe, lobe_sum
from jaxrelight.brdf.parametrisation import DISC
from jaxrelight.numerics.arrays import as_array

# Two channels: each is a program of its own.
BRDF = LobeSum(*(as_array(part, jnp.float32) for part in ([0.4, 0.1], [[[-1, -1, 1]]], [[12]], [[0.9, 0.9]])))


@functools.cache
def _start() -> Factored:
    return factor(BRDF, 12, 10)


@functools.cache
def _found() -> Refined:
    return refined(BRDF, _start())


def test_refining_lowers_the_error_of_look_ups_on_other_directions():
    refinement = _found()
    assert refinement.after < 0.97 * refinement.before
    assert refinement.factors.light_maps.shape == _start().light_maps.shape
    assert 0 < refinement.steps <= 60


@pytest.mark.slow
def test_maps_that_are_wrong_are_brought_near_the_best():
    """From maps with noise, most of the way back to those of the singular values."""
    brdf = lobe_sum(0.2, [lobe([-1, -1, 0.9], 4, peak=0.5)])
    best = factor(brdf, 3, 10)
    noise = np.random.default_rng(0).normal(0, 0.1, (2, *best.light_maps.shape))
    start = Factored(best.light_maps + jnp.asarray(noise[0], jnp.float32), best.view_maps, DISC)
    recovered, reached = refined(brdf, start, steps=200), refined(brdf, best)
    assert recovered.before > 1.1 * reached.after
    assert recovered.after < 1.01 * reached.after


def test_the_same_seed_gives_the_same_and_a_constant_stays_as_it_is():
    again = refined(BRDF, _start())
    np.testing.assert_array_equal(again.factors.light_maps, _found().factors.light_maps)
    flat = factor(lambert(0.5), 2, 8)
    assert refined(lambert(0.5), flat).factors is flat
