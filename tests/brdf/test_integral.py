"""Sums over many directions are those of single evaluations, for every kind of BRDF."""

from typing import Any

import jax
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.material import white_lambert
from jaxrelight.brdf.reflection import FixedView
from tests.operators.derivatives import check_derivatives

LOBES = jr.lobe_sum(
    [0.2, 0.1, 0.3], [jr.lobe([-1, -0.8, 0.9], 20, specular=0.5), jr.lobe([-0.5, -0.5, 1], 0, peak=0.1)], turn=0.4
)
BY_CHANNEL = jr.lobe_sum(0.1, [jr.lobe([[-1, -1, 1], [-1, -1, 0.8], [-1, -1, 0.9]], [3, 20, 60], peak=[0.1, 0.2, 0.3])])
BRDFS = {
    "lobes": LOBES,
    "lobes by channel": BY_CHANNEL,
    "lambert": jr.lambert([0.7, 0.2, 0.1]),
    "white": white_lambert(),
    "microfacets": jr.ashikhmin_shirley([0.2, 0.1, 0.3], [0.3, 0.2, 0.1], 20.0, 60.0),
}


def directions(count: int, dtype: Any = np.float32) -> Any:
    vectors = np.random.default_rng(0).normal(size=(3, count))
    return (vectors / np.linalg.norm(vectors, axis=0)).astype(dtype)


def given(dtype: Any = np.float32) -> Any:
    omega_i = directions(200, dtype)
    weights = np.random.default_rng(1).random((3, 200)).astype(dtype) * np.maximum(omega_i[2:], 0)
    return omega_i, np.array([0.36, 0.48, 0.8], dtype), weights


@jax.jit
def both(brdf: Brdf, omega_i, omega_o, weights):
    each = jax.vmap(lambda omega: brdf.evaluate(omega, omega_o), in_axes=1)(omega_i)
    return brdf.integral(omega_i, omega_o, weights), (each.T * weights).sum(axis=1)


@pytest.mark.parametrize("name", BRDFS)
def test_integral_is_the_sum(name: str):
    integral, wanted = both(BRDFS[name], *given())
    assert np.all(np.asarray(wanted) > 0)
    np.testing.assert_allclose(integral, wanted, rtol=2e-5)


def test_light_terms_are_those_of_light_sides():
    """Of a fixed view, 0 where the eye is below."""
    omega_i, omega_o, weights = given()
    view = FixedView(LOBES, omega_o)
    terms = view.light_terms(omega_i, weights[None])
    np.testing.assert_allclose(terms[0], both(LOBES, omega_i, omega_o, weights)[1], rtol=2e-5)
    assert not np.any(FixedView(LOBES, -omega_o).light_terms(omega_i, weights[None]))


@pytest.mark.usefixtures("x64")
def test_derivatives_of_sums_of_lobes():
    omega_i, omega_o, weights = given(np.float64)
    lobes = jax.tree.map(lambda leaf: np.asarray(leaf, np.float64), LOBES)
    check_derivatives(lambda brdf, weights: brdf.integral(omega_i, omega_o, weights), (lobes, weights))
