"""The pieces of the solve against NumPy, scipy and differentiation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.optimize

import fitting
from fitting.chart import EXPONENTS, chart_around
from fitting.gauss_newton import by_differentiation
from fitting.non_negative import solve_non_negative
from fitting.residuals import normal_equations, residual
from fitting.samples import prepare
from fitting.small_systems import solve_positive
from tests.fitting.synthetic import texels


@pytest.mark.parametrize("k", [1, 2, 4, 9])
def test_small_systems_are_solved(x64, k):
    random = np.random.default_rng(k)
    root = random.normal(size=(k, k + 2))
    A = root @ root.T
    b = random.normal(size=k)
    np.testing.assert_allclose(solve_positive(jnp.asarray(A), jnp.asarray(b)), np.linalg.solve(A, b))


@pytest.mark.parametrize("m", [1, 2, 3, 4])
def test_non_negative_least_squares_is_that_of_scipy(x64, m):
    random = np.random.default_rng(m)
    columns, targets = random.normal(size=(30, 20, m)), random.normal(size=(30, 20))
    gram, moment = jnp.einsum("bsm,bsn->bmn", columns, columns), jnp.einsum("bsm,bs->bm", columns, targets)
    expected = [scipy.optimize.nnls(G, y)[0] for G, y in zip(columns, targets, strict=True)]
    np.testing.assert_allclose(jax.vmap(solve_non_negative)(gram, moment), expected, atol=1e-10)


def test_columns_of_zeros_get_nothing_and_equal_ones_what_they_have_in_common():
    G = np.array([[0, 1, 1], [0, 2, 2], [0, 1, 1]], np.float32)
    found = np.asarray(solve_non_negative(jnp.asarray(G.T @ G), jnp.asarray(G.T @ np.array([2, 4, 2], np.float32))))
    assert found[0] == 0
    assert (found >= 0).all()
    np.testing.assert_allclose(found.sum(), 2, rtol=1e-4)


@pytest.mark.parametrize("anisotropic", [False, True])
def test_the_model_of_the_projected_residual_is_that_of_its_derivatives(x64, anisotropic):
    data = texels(1, 60, 0.05, seed=7)
    omega_i, omega_o, values = (jnp.asarray(a[0]) for a in (data.omega_i, data.omega_o, data.values))
    samples = prepare(omega_i, omega_o, values, jnp.ones(60))
    C = jnp.asarray([[-1.0, -1.0, 0.8], [0.3, 0.3, 1.0]])
    chart, unknowns = chart_around(C, jnp.asarray([8.0, 2.0]), anisotropic)
    given = (chart, samples)
    by_hand = jax.jit(normal_equations)(unknowns, given)
    differentiate = jax.jit(lambda u, given: by_differentiation(lambda u, g: (residual(u, g), None), u, given))
    expected = differentiate(unknowns, given)
    for a, b in zip(jax.tree.leaves(by_hand), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-10)


@pytest.mark.parametrize("anisotropic", [False, True])
def test_a_chart_starts_at_its_lobes_and_stays_within_bounds(x64, anisotropic):
    C = jnp.asarray([[-1.0, -1.0, 0.9], [0.2, 0.2, -1.0]])
    chart, unknowns = chart_around(C, jnp.asarray([20.0, 3.0]), anisotropic)
    found, exponent = chart.lobes(unknowns)
    np.testing.assert_allclose(found, C, atol=1e-12)
    np.testing.assert_allclose(exponent, [20, 3], rtol=1e-9)
    far, extreme = chart.lobes(unknowns + jnp.asarray([[40.0, *[5.0] * (unknowns.shape[1] - 1)]]))
    assert (extreme <= EXPONENTS[1] * (1 + 1e-9)).all()
    np.testing.assert_allclose(np.abs(far).max(axis=-1), 1)
    if not anisotropic:
        np.testing.assert_array_equal(far[:, 0], far[:, 1])


@pytest.mark.parametrize("name", fitting.__all__)
def test_public_name_loads(name):
    found = getattr(fitting, name)
    assert found.__doc__
    assert name in (fitting.__doc__ or "")
