"""Factors as a function of the BRDF: the same values, and derivatives that differences confirm."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxrelight.brdf.alternating import refactored
from jaxrelight.brdf.ashikhmin_shirley import ashikhmin_shirley
from jaxrelight.brdf.factors import factor
from jaxrelight.brdf.lobes import LobeSum, lambert, lobe, lobe_sum, phong
from jaxrelight.brdf.parametrisation import DISC, POLAR

SIDE = 8
OMEGA = np.array([[0, 0, 1], [0.6, 0, 0.8], [-0.36, 0.48, 0.8], [0.1, 0.7, 0.7071], [0.9, 0, 0.43589]])


def _products(factors):
    light = jax.vmap(factors.light_side)(jnp.asarray(OMEGA))
    view = jax.vmap(factors.view_side)(jnp.asarray(OMEGA))
    return jnp.einsum("ikc,okc->ioc", light, view)


@pytest.mark.parametrize("parametrisation", [DISC, POLAR], ids=["disc", "polar"])
@pytest.mark.parametrize(
    "brdf", [phong([0.2, 0.1, 0.3], [0.5, 0.4, 0.6], 8), ashikhmin_shirley(0.5, 0.75, 2, 12), lambert([0.2, 0.5, 0.9])],
    ids=["phong", "ashikhmin_shirley", "lambert"],
)  # fmt: skip
def test_factors_of_the_brdf_itself_stay_what_they_are(brdf, parametrisation):
    start = factor(brdf, 4, SIDE, parametrisation=parametrisation)
    again = jax.jit(refactored)(brdf, start)
    whole = _products(start)
    np.testing.assert_allclose(_products(again), whole, atol=2e-3 * float(jnp.max(whole)))
    assert again.light_maps.shape == start.light_maps.shape


def test_factors_of_another_brdf_come_nearer_to_it():
    """In the sum of squares over the texels: a step of least squares on either side."""
    one, other = phong(0.2, 0.5, 8), phong(0.3, 0.4, 9)
    omega, inside = DISC.directions(16)
    omega = jnp.asarray(omega[inside], jnp.float32)
    exact = jax.vmap(lambda i: jax.vmap(lambda o: other.evaluate(i, o))(omega))(omega)

    def error(factors):
        light, view = jax.vmap(factors.light_side)(omega), jax.vmap(factors.view_side)(omega)
        return float(jnp.linalg.norm(jnp.einsum("ikc,okc->ioc", light, view) - exact))

    start, best = (error(factor(brdf, 12, 16, cosine=(0, 0))) for brdf in (one, other))
    found = error(refactored(other, factor(one, 12, 16, cosine=(0, 0)), (0, 0)))
    assert best <= found < 1.05 * best
    assert found < 0.85 * start


def test_gradients_in_the_parameters():
    """Phong's singular values come in pairs, where those of a singular value decomposition are NaN."""
    with jax.enable_x64(True):
        start = factor(phong(0.2, 0.5, 8), 5, SIDE)
        C = jnp.asarray([[[-1.0, -0.9, 0.8]]])

        def total(diffuse, exponent, scale):
            brdf = LobeSum(diffuse, C, exponent, scale)
            return jnp.sum(_products(refactored(brdf, start)) ** 2)

        parameters = jnp.full(3, 0.2), jnp.full((1, 1), 8.0), jnp.full((1, 3), 0.5)
        check_grads(jax.jit(total), parameters, order=1, modes=("fwd", "rev"), rtol=1e-5)


def test_gradients_are_finite_where_terms_are_dead():
    """Two equal lobes and rank one: the other terms hold nothing but rounding."""
    made = [lobe([0, 0, 1], 1, peak=1.0)] * 2
    start = factor(lobe_sum(0, made), 3, SIDE)

    def total(scale):
        brdf = lobe_sum(0, made)
        brdf = LobeSum(brdf.diffuse, brdf.C, brdf.exponent, scale)
        return jnp.sum(_products(refactored(brdf, start)))

    value, slope = jax.value_and_grad(total)(jnp.ones((2, 3)))
    assert np.isfinite(value)
    # The sum of both is what is seen: proportional to each.
    np.testing.assert_allclose(slope, value / 6, rtol=1e-3)
