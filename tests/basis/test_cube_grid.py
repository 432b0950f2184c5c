"""A grid on the sphere: its points are shared by faces, and what lies between them is continuous and differentiable."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxrelight.basis.cube_grid import bilinear, directions, point_count

_bilinear = jax.jit(jax.vmap(bilinear, in_axes=(0, None)), static_argnums=1)


def unit_vectors(number: int, seed: int = 0) -> np.ndarray:
    vectors = np.random.default_rng(seed).normal(size=(number, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


@pytest.mark.parametrize("cells", [1, 2, 3, 4])
def test_points_are_unit_vectors_and_none_comes_twice(cells: int):
    points = directions(cells)
    assert points.shape == (point_count(cells), 3)
    np.testing.assert_allclose(np.linalg.norm(points, axis=1), 1, atol=1e-12)
    cosines = points @ points.T - 2 * np.eye(len(points))
    # Lines are 90°/cells apart in the middle of a face, and closer towards its corners.
    assert cosines.max() < np.cos(np.radians(0.6 * 90 / cells))


def test_at_a_point_it_alone_counts():
    points = directions(3).astype(np.float32)
    numbers, weights = (np.asarray(part) for part in _bilinear(points, 3))
    values = np.zeros((len(points), len(points)))
    np.add.at(values, (np.arange(len(points))[:, None], numbers), weights)
    np.testing.assert_allclose(values, np.eye(len(points)), atol=1e-5)


def test_weights_are_shares_and_the_length_of_a_direction_does_not_matter():
    directed = unit_vectors(2000)
    numbers, weights = _bilinear(directed.astype(np.float32), 3)
    assert np.asarray(weights).min() >= 0
    np.testing.assert_allclose(np.sum(weights, axis=1), 1, atol=1e-6)
    again, _ = _bilinear((7 * directed).astype(np.float32), 3)
    assert np.mean(np.asarray(again) == np.asarray(numbers)) > 0.999


def test_what_varies_smoothly_is_met_between_points_and_nothing_jumps_at_edges():
    axis = np.array([0.36, 0.48, 0.8])
    values, directed = directions(4) @ axis, unit_vectors(4000)
    numbers, weights = (np.asarray(part) for part in _bilinear(directed.astype(np.float32), 4))
    between = np.sum(values[numbers] * weights, axis=1)
    # Chords of a cosine over cells of 22.5° are off by 2 % at most.
    np.testing.assert_allclose(between, directed @ axis, atol=0.04)
    # Across edges and corners of the cube.
    path = np.stack([np.cos(turn := np.linspace(0, 2 * np.pi, 8001)), np.sin(turn), 0.99 * np.cos(3 * turn)], axis=1)
    numbers, weights = (np.asarray(part) for part in _bilinear(path.astype(np.float32), 3))
    noise = np.random.default_rng(1).normal(size=point_count(3))
    steps = np.abs(np.diff(np.sum(noise[numbers] * weights, axis=1)))
    assert steps.max() < 0.03


def test_slopes_are_those_of_differences(x64):
    values = jnp.asarray(np.random.default_rng(2).normal(size=point_count(3)))

    def at(direction):
        numbers, weights = bilinear(direction, 3)
        return values[numbers] @ weights

    check_grads(jax.jit(at), (np.array([0.31, -0.52, 0.8]),), order=1, modes=["fwd", "rev"])
    # On the axes, edges and corners, too, there is a slope.
    for direction in ([0, 0, 1.0], [1, 1, 0.2], [1.0, 1, 1], [-1.0, 1, -1]):
        assert np.isfinite(jax.jit(jax.grad(at))(np.array(direction))).all()
