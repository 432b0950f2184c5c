"""The pieces of the solve against NumPy, scipy and differentiation."""

import functools

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
    np.testing.assert_allclose(jax.jit(solve_positive)(A, b), np.linalg.solve(A, b))


@pytest.mark.parametrize("m", [1, 2, 3, 4])
def test_non_negative_least_squares_is_that_of_scipy(x64, m):
    random = np.random.default_rng(m)
    columns, targets = random.normal(size=(30, 20, m)), random.normal(size=(30, 20))
    gram, moment = np.einsum("bsm,bsn->bmn", columns, columns), np.einsum("bsm,bs->bm", columns, targets)
    expected = [scipy.optimize.nnls(G, y)[0] for G, y in zip(columns, targets, strict=True)]
    np.testing.assert_allclose(jax.jit(jax.vmap(solve_non_negative))(gram, moment), expected, atol=1e-10)


def test_columns_of_zeros_get_nothing_and_equal_ones_what_they_have_in_common():
    G = np.array([[0, 1, 1], [0, 2, 2], [0, 1, 1]], np.float32)
    solution = np.asarray(jax.jit(solve_non_negative)(G.T @ G, G.T @ np.array([2, 4, 2], np.float32)))
    assert solution[0] == 0
    assert (solution >= 0).all()
    np.testing.assert_allclose(solution.sum(), 2, rtol=1e-4)


@functools.partial(jax.jit, static_argnames="anisotropic")
def _models(omega_i, omega_o, values, anisotropic: bool):
    """The normal equations around two lobes, by hand and by differentiation."""
    samples = prepare(omega_i, omega_o, values, jnp.ones(len(values)))
    C = jnp.asarray([[-1.0, -1.0, 0.8], [0.3, 0.3, 1.0]])
    chart, unknowns = chart_around(C, jnp.asarray([8.0, 2.0]), anisotropic)
    given = (chart, samples)
    return normal_equations(unknowns, given), by_differentiation(lambda u, g: (residual(u, g), None), unknowns, given)


@pytest.mark.parametrize("anisotropic", [pytest.param(False, marks=pytest.mark.slow), True])
def test_the_model_of_the_projected_residual_is_that_of_its_derivatives(x64, anisotropic):
    data = texels(1, 60, 0.05, seed=7)
    by_hand, expected = _models(data.omega_i[0], data.omega_o[0], data.values[0], anisotropic)
    for a, b in zip(jax.tree.leaves(by_hand), jax.tree.leaves(expected), strict=True):
        np.testing.assert_allclose(a, b, rtol=1e-7, atol=1e-10)


@functools.partial(jax.jit, static_argnames="anisotropic")
def _near_and_far(C, exponent, anisotropic: bool):
    """Lobes at the start of a chart around them, and far away in it."""
    chart, unknowns = chart_around(C, exponent, anisotropic)
    away = jnp.full(unknowns.shape, 5.0).at[:, 0].set(40.0)
    return chart.lobes(unknowns), chart.lobes(unknowns + away)


@pytest.mark.parametrize("anisotropic", [False, True])
def test_a_chart_starts_at_its_lobes_and_stays_within_bounds(x64, anisotropic):
    C, n = np.array([[-1.0, -1.0, 0.9], [0.2, 0.2, -1.0]]), np.array([20.0, 3.0])
    (near, exponent), (far, extreme) = jax.tree.map(np.asarray, _near_and_far(C, n, anisotropic))
    np.testing.assert_allclose(near, C, atol=1e-12)
    np.testing.assert_allclose(exponent, n, rtol=1e-9)
    assert (extreme <= EXPONENTS[1] * (1 + 1e-9)).all()
    np.testing.assert_allclose(np.abs(far).max(axis=-1), 1)
    if not anisotropic:
        np.testing.assert_array_equal(far[:, 0], far[:, 1])


@pytest.mark.parametrize("name", fitting.__all__)
def test_public_name_loads(name):
    member = getattr(fitting, name)
    assert member.__doc__
    assert name in (fitting.__doc__ or "")
