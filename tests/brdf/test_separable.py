"""BRDFs that are given as factors."""

import jax
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxrelight.brdf.factors import factor
from jaxrelight.brdf.lobes import lambert, phong
from jaxrelight.brdf.parametrisation import DISC, POLAR
from jaxrelight.brdf.separable import Separable, separable

OMEGA = np.random.default_rng(0).normal(size=(40, 3)) * [1, 1, 0.7]
OMEGA = np.abs(OMEGA) * np.where(OMEGA < 0, [-1, -1, 1], 1)
OMEGA /= np.linalg.norm(OMEGA, axis=1, keepdims=True)


def _values(brdf, omega_i=OMEGA, omega_o=OMEGA[::-1]):
    return np.asarray(_evaluate(brdf, omega_i.astype(np.float32), omega_o.astype(np.float32)))


@jax.jit
def _evaluate(brdf, omega_i, omega_o):
    return jax.vmap(brdf.evaluate)(omega_i, omega_o)


@jax.jit
def _sides(factors, omega_i, omega_o):
    return jax.vmap(factors.light_side)(omega_i), jax.vmap(factors.view_side)(omega_o)


@pytest.mark.parametrize("parametrisation", [DISC, POLAR])
def test_it_is_the_sum_of_the_products_of_its_factors(parametrisation):
    factors = factor(phong(0.2, [0.1, 0.3, 0.5], 4), 5, 12, form="svd", parametrisation=parametrisation)
    light, view = _sides(factors, OMEGA.astype(np.float32), OMEGA[::-1].astype(np.float32))
    np.testing.assert_allclose(_values(separable(factors)), np.einsum("pkc,pkc->pc", light, view), rtol=1e-5, atol=1e-6)


def test_enough_terms_are_the_brdf_itself():
    """But at grazing angles, where maps end between texels."""
    brdf = phong(0.2, [0.1, 0.3, 0.5], 3)
    high = (OMEGA[:, 2] > 0.3) & (OMEGA[::-1, 2] > 0.3)
    apart = _values(separable(factor(brdf, 30, 32))) - _values(brdf)
    assert np.abs(apart[high]).max() < 0.01 * _values(brdf).max()


def test_symmetric_factors_stay_reciprocal():
    made = separable(factor(phong(0.2, 0.4, 6), 3, 12, form="symmetric"))
    np.testing.assert_allclose(_values(made), _values(made, OMEGA[::-1], OMEGA), rtol=1e-5, atol=1e-6)


def test_a_constant_stays_one():
    made = separable(factor(lambert([0.2, 0.4, 0.6])))
    assert made.is_constant
    assert made.channels == 3
    np.testing.assert_allclose(_values(made), np.broadcast_to(np.array([0.2, 0.4, 0.6]) / np.pi, (40, 3)), rtol=1e-6)
    assert not separable(factor(phong(0.2, 0.4, 6), 1, 12)).is_constant


@pytest.mark.usefixtures("x64")
def test_gradients_in_maps_and_directions():
    random = np.random.default_rng(1)
    maps = random.normal(size=(2, 2, 3, 4, 4))
    check_grads(jax.jit(lambda a, b, i, o: Separable(a, b).evaluate(i, o)), (*maps, OMEGA[0], OMEGA[1]), order=1)
