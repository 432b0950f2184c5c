"""Bidiagonalisation against NumPy's singular values and least squares."""

import numpy as np
import pytest

from jaxrelight.inverse.bidiagonalisation import begin, step
from jaxrelight.inverse.light_regularisation import is_converged, ridge_weights, spectrum_of

RANDOM = np.random.default_rng(0)
# Singular values over four decades, of a map for each channel.
MAPS = [
    np.linalg.qr(RANDOM.normal(size=(30, 12)))[0]
    * np.geomspace(1, 1e-4, 12)[None]
    @ np.linalg.qr(RANDOM.normal(size=(12, 12)))[0]
    for _ in range(3)
]
B = RANDOM.normal(size=(30, 3))


def product(x: np.ndarray) -> np.ndarray:
    return np.stack([A @ of for A, of in zip(MAPS, x.T, strict=True)], axis=1)


def back(y: np.ndarray) -> np.ndarray:
    return np.stack([A.T @ of for A, of in zip(MAPS, y.T, strict=True)], axis=1)


def run(steps: int, *, joint: bool = False):
    state = begin(B, back, joint=joint)
    while state.steps < steps and not state.is_done:
        state = step(state, product(state.next_vector), back)
    return state


def test_singular_values_are_those_of_the_map():
    values = spectrum_of(run(12)).values
    for channel, A in enumerate(MAPS):
        np.testing.assert_allclose(values[:, channel], np.linalg.svd(A, compute_uv=False), rtol=1e-3)


@pytest.mark.parametrize("strength", [1e-3, 0.1])
def test_ridge_solution_is_that_of_numpy(strength: float):
    state = run(12)
    x = state.mixed(ridge_weights(spectrum_of(state), strength))
    for channel, A in enumerate(MAPS):
        expected = np.linalg.solve(A.T @ A + strength**2 * np.eye(12), A.T @ B[:, channel])
        np.testing.assert_allclose(x[:, channel], expected, rtol=1e-3, atol=1e-3 * np.abs(expected).max())


def test_all_channels_as_one_problem():
    strength, state = 0.01, run(36, joint=True)
    x = state.mixed(ridge_weights(spectrum_of(state), strength))
    for channel, A in enumerate(MAPS):
        expected = np.linalg.solve(A.T @ A + strength**2 * np.eye(12), A.T @ B[:, channel])
        np.testing.assert_allclose(x[:, channel], expected, atol=1e-3 * np.abs(expected).max())


def test_few_steps_know_how_far_they_are():
    """The gradient that is left, told without a product, is that of the solution."""
    strength, state = 0.03, run(5)
    weights = ridge_weights(spectrum_of(state), strength)
    x = state.mixed(weights)
    left = back(product(x) - B) + strength**2 * x
    share = np.linalg.norm(left, axis=0) / np.linalg.norm(back(B), axis=0)
    for channel in range(3):
        assert is_converged(state, weights, 1.01 * share[channel])[channel]
        assert not is_converged(state, weights, 0.99 * share[channel])[channel]


def test_it_ends_where_nothing_is_left():
    """Of a map of rank 2, after two steps or, where rounding leaves a trace of a third, few more."""
    left, right = RANDOM.normal(size=(30, 2)), RANDOM.normal(size=(2, 12))

    def transposed(y):
        return right.T @ (left.T @ y)

    state = begin(B, transposed)
    while not state.is_done:
        state = step(state, left @ (right @ state.next_vector), transposed)
        assert state.steps <= 3
    values = spectrum_of(state).values[:2, 0]
    np.testing.assert_allclose(values, np.linalg.svd(left @ right, compute_uv=False)[:2], rtol=1e-4)
