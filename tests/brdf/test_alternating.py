"""Factors as a function of the BRDF: the same values, and derivatives that differences confirm."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxrelight.brdf.alternating import refactored
from jaxrelight.brdf.ashikhmin_shirley import ashikhmin_shirley
from jaxrelight.brdf.factors import COSINE, factor
from jaxrelight.brdf.lobes import LobeSum, lambert, lobe, lobe_sum, phong
from jaxrelight.brdf.parametrisation import DISC, POLAR

SIDE, TERMS = 8, 12
OMEGA = np.array([[0, 0, 1], [0.6, 0, 0.8], [-0.36, 0.48, 0.8], [0.1, 0.7, 0.7071], [0.9, 0, 0.43589]], np.float32)
PHONG = phong([0.2, 0.1, 0.3], [0.5, 0.4, 0.6], 8)


@jax.jit
def _products(factors):
    light, view = jax.vmap(factors.light_side)(OMEGA), jax.vmap(factors.view_side)(OMEGA)
    return jnp.einsum("ikc,okc->ioc", light, view)


@pytest.mark.parametrize(
    ("brdf", "parametrisation", "cosine"),
    [
        pytest.param(PHONG, DISC, (0, 0), id="phong-disc"),
        pytest.param(PHONG, POLAR, COSINE, id="phong-polar", marks=pytest.mark.slow),
        pytest.param(ashikhmin_shirley(0.5, 0.75, 2, 12), POLAR, COSINE, id="ashikhmin_shirley-polar"),
        pytest.param(
            ashikhmin_shirley(0.5, 0.75, 2, 12), DISC, COSINE, id="ashikhmin_shirley-disc", marks=pytest.mark.slow
        ),
        pytest.param(lambert([0.2, 0.5, 0.9]), DISC, COSINE, id="lambert"),
    ],
)
def test_factors_of_the_brdf_itself_stay_what_they_are(brdf, parametrisation, cosine):
    start = factor(brdf, TERMS, SIDE, parametrisation=parametrisation, cosine=cosine)
    again = refactored(brdf, start, cosine)
    whole = np.asarray(_products(start))
    np.testing.assert_allclose(_products(again), whole, atol=2e-3 * whole.max())
    assert again.light_maps.shape == start.light_maps.shape


@jax.jit
def _pairs(brdf, omega):
    return jax.vmap(lambda i: jax.vmap(lambda o: brdf.evaluate(i, o))(omega))(omega)


def test_factors_of_another_brdf_come_nearer_to_it():
    """In the sum of squares over the texels: a step of least squares on either side."""
    other = phong(0.3, 0.4, 9)
    omega, inside = DISC.directions(SIDE)
    exact = np.asarray(_pairs(other, omega[inside].astype(np.float32)))

    def error(factors):
        light, view = (
            np.asarray(m).reshape(TERMS, 3, -1)[..., inside] for m in (factors.light_maps, factors.view_maps)
        )
        return np.linalg.norm(np.einsum("kci,kco->ioc", light, view) - exact)

    first, last = (factor(brdf, TERMS, SIDE, cosine=(0, 0)) for brdf in (PHONG, other))
    start, best, refitted = error(first), error(last), error(refactored(other, first, (0, 0)))
    assert best <= refitted < 1.05 * best
    assert refitted < 0.85 * start


@pytest.mark.slow
def test_gradients_in_the_parameters(x64):
    """Phong's singular values come in pairs, where those of a singular value decomposition are NaN."""
    with jax.enable_x64(False):
        start = factor(PHONG, TERMS, SIDE, cosine=(0, 0))
    start = jax.tree.map(lambda leaf: np.asarray(leaf, float), start)
    C = jnp.asarray(np.asarray([[[-1.0, -0.9, 0.8]]]))

    @jax.jit
    def total(diffuse, exponent, scale):
        again = refactored(LobeSum(diffuse, C, exponent, scale), start, (0, 0))
        light, view = jax.vmap(again.light_side)(OMEGA), jax.vmap(again.view_side)(OMEGA)
        return jnp.sum(jnp.einsum("ikc,okc->ioc", light, view) ** 2)

    parameters = np.full(3, 0.2), np.full((1, 1), 8.0), np.full((1, 3), 0.5)
    check_grads(total, parameters, order=1, modes=("fwd", "rev"), rtol=1e-5)


def test_gradients_are_finite_where_terms_are_dead():
    """Two equal lobes and rank one: the other terms hold nothing but rounding."""
    brdf = lobe_sum(0, [lobe([0, 0, 1], 1, peak=1.0)] * 2)
    start = factor(brdf, 3, SIDE, parametrisation=POLAR)

    def total(scale):
        return jnp.sum(_products(refactored(LobeSum(brdf.diffuse, brdf.C, brdf.exponent, scale), start)))

    value, slope = map(np.asarray, jax.jit(jax.value_and_grad(total))(np.ones((2, 3), np.float32)))
    assert np.isfinite(value)
    # The sum of both is what is seen: proportional to each.
    np.testing.assert_allclose(slope, value / 6, rtol=1e-3)


def test_a_black_channel_has_black_maps():
    """Its normal equations are all zeros."""
    black = phong([0.2, 0, 0.3], [0.5, 0, 0.6], 8)
    start = factor(PHONG, TERMS, SIDE, parametrisation=DISC, cosine=(0, 0))
    channel = np.array([1, 0, 1], np.float32)[None, :, None, None]
    start = dataclasses.replace(start, view_maps=start.view_maps * channel, light_maps=start.light_maps * channel)
    for brdf in (black, PHONG):
        again = refactored(brdf, start, (0, 0))
        for maps in (again.light_maps, again.view_maps):
            assert np.isfinite(np.asarray(maps)).all()
            assert not np.asarray(maps)[:, 1].any()
