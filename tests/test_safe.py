"""Powers, norms and angles where the plain formulas fail."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxrelight import safe

pytestmark = pytest.mark.usefixtures("strict_ranks")

power, norm, normalize, angle = (jax.jit(f) for f in (safe.power, safe.norm, safe.normalize, safe.angle))
BASES = [-1e30, -1.0, -1e-30, 0.0, 1e-20, 1e-8, 0.5, 1.0, 1.1, 5.0]
EXPONENTS = [0.0, 0.5, 1.0, 50.0, 1e4, 16600.0]


@pytest.mark.parametrize("exponent", [0.0, 0.5, 1.0, 2.5, 20.0])
def test_power_is_the_plain_one_above_zero(exponent):
    base = np.geomspace(1e-3, 3, 50, dtype=np.float32)
    found = power(jnp.asarray(base), jnp.float32(exponent))
    np.testing.assert_allclose(found, base.astype(float) ** exponent, rtol=3e-5, atol=1e-37)


def test_power_is_exact_in_float64(x64):
    base, exponent = np.meshgrid(np.geomspace(1e-3, 3, 30), [0.0, 0.5, 3.0, 60.0])
    found = power(jnp.asarray(base), jnp.asarray(exponent))
    assert found.dtype == np.float64
    np.testing.assert_allclose(found, base**exponent, rtol=1e-12)


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_power_of_nothing_and_of_negatives_is_zero(exponent):
    found = power(jnp.asarray([0.0, -1e-30, -1.0, -1e30]), jnp.float32(exponent))
    np.testing.assert_array_equal(found, 0)


@pytest.mark.parametrize("derivative", [jax.jacfwd, jax.jacrev])
def test_power_and_its_gradients_are_finite_everywhere(derivative):
    base, exponent = (jnp.asarray(grid.ravel(), jnp.float32) for grid in np.meshgrid(BASES, EXPONENTS))
    assert np.isfinite(power(base, exponent)).all()
    for slope in jax.jit(jax.vmap(derivative(safe.power, argnums=(0, 1))))(base, exponent):
        assert np.isfinite(slope).all()
        np.testing.assert_array_equal(slope[base <= 0], 0)


def test_power_has_the_textbook_gradients(x64):
    for base, exponent in [(0.3, 0.0), (0.3, 0.5), (0.9, 50.0), (1.2, 3.0)]:
        slopes = jax.jit(jax.grad(safe.power, argnums=(0, 1)))(base, exponent)
        expected = exponent * base ** (exponent - 1), np.log(base) * base**exponent
        np.testing.assert_allclose(slopes, expected, rtol=1e-12)
    check_grads(power, (jnp.asarray([0.2, 0.7, 1.1]), jnp.asarray([0.5, 3.0, 30.0])), 1, ["fwd", "rev"])


def test_power_is_held_where_it_would_overflow():
    found = power(jnp.float32(1.1), jnp.float32(1e4))
    np.testing.assert_allclose(found, np.exp(80), rtol=1e-4)
    np.testing.assert_allclose(power(jnp.float32(1.1), jnp.float32(800)), np.exp(800 * np.log(1.1)), rtol=1e-3)


def test_norm_is_the_euclidean_one():
    vectors = np.random.default_rng(0).normal(size=(50, 4)).astype(np.float32)
    np.testing.assert_allclose(norm(jnp.asarray(vectors)), np.linalg.norm(vectors, axis=-1), rtol=1e-6)


@pytest.mark.parametrize("size", [1e-30, 1e-20, 1e20, 1e37])
def test_norm_neither_over_nor_underflows(size):
    np.testing.assert_allclose(norm(jnp.asarray([3 * size, -4 * size, 0], jnp.float32)), 5 * size, rtol=1e-6)


@pytest.mark.parametrize("derivative", [jax.jacfwd, jax.jacrev])
def test_norm_has_unit_gradients_and_none_at_the_zero_vector(derivative):
    slope = jax.jit(jax.vmap(derivative(safe.norm)))
    np.testing.assert_array_equal(slope(jnp.zeros((1, 3))), 0)
    vectors = np.array([[1.0, 1, 1], [0, 0, -2], [3, 4, 0], [1e15, -1e15, 0], [1e-8, 2e-8, 2e-8]], np.float32)
    expected = vectors / np.linalg.norm(vectors.astype(float), axis=-1, keepdims=True)
    np.testing.assert_allclose(slope(jnp.asarray(vectors)), expected, rtol=1e-5, atol=1e-7)


def test_normalize_gives_unit_vectors_and_keeps_zero():
    vectors = jnp.asarray([[0.0, 0, 0], [2, 0, 0], [1e30, 1e30, 0], [1e-30, 0, -1e-30]])
    half = np.sqrt(0.5)
    expected = [[0, 0, 0], [1, 0, 0], [half, half, 0], [half, 0, -half]]
    np.testing.assert_allclose(normalize(vectors), expected, rtol=1e-6)


def test_normalize_has_no_gradient_at_zero_and_the_right_one_elsewhere(x64):
    for derivative in (jax.jacfwd, jax.jacrev):
        np.testing.assert_array_equal(jax.jit(derivative(safe.normalize))(jnp.zeros(3)), 0)
    check_grads(normalize, (jnp.asarray([0.3, -2.0, 0.7]),), 1, ["fwd", "rev"])


def test_angle_is_accurate_from_zero_to_pi():
    x = jnp.asarray([1.0, 0, 0])
    for true in [1e-6, 1e-3, 0.5, np.pi / 2, 3.0]:
        other = jnp.asarray([np.cos(true), np.sin(true), 0], jnp.float32)
        np.testing.assert_allclose(angle(x, other), true, rtol=1e-5)
        np.testing.assert_allclose(angle(x, -other), np.pi - true, rtol=1e-6)
    assert angle(x, x) == 0
    np.testing.assert_allclose(angle(x, -3 * x), np.pi, rtol=1e-7)


def test_angle_does_not_depend_on_length():
    a, b = jnp.asarray([1.0, 2, 3]), jnp.asarray([-2.0, 0.5, 1])
    np.testing.assert_allclose(angle(1e-4 * a, 1e6 * b), angle(a, b), rtol=1e-6)
    cosine = 2 / np.sqrt(14 * 5.25)
    np.testing.assert_allclose(angle(a, b), np.arccos(cosine), rtol=1e-6)


@pytest.mark.parametrize("derivative", [jax.jacfwd, jax.jacrev])
@pytest.mark.parametrize("other", [[0.0, 0, 1], [0.0, 0, -1], [0.0, 0, 0], [1.0, 0, 0]])
def test_angle_has_finite_gradients_at_0_at_pi_and_at_the_zero_vector(derivative, other):
    slopes = jax.jit(derivative(safe.angle, argnums=(0, 1)))(jnp.asarray(other), jnp.asarray([0.0, 0, 1]))
    assert np.isfinite(slopes).all()
    if other[0] == 0:
        np.testing.assert_array_equal(slopes, 0)
    else:
        np.testing.assert_allclose(slopes, [[0, 0, -1], [-1, 0, 0]], atol=1e-7)


def test_angle_of_a_zero_vector_is_zero():
    assert angle(jnp.zeros(3), jnp.asarray([0.0, 1, 0])) == 0


def test_angle_has_the_right_gradient(x64):
    vectors = jnp.asarray([0.3, -2.0, 0.7]), jnp.asarray([1.0, 0.2, 0.1])
    check_grads(angle, vectors, 1, ["fwd", "rev"])


@pytest.mark.parametrize("size", [1e-19, 1e-25, 1e25])
def test_gradients_of_lengths_do_not_depend_on_size(size):
    vector = jnp.full(3, size, jnp.float32)
    np.testing.assert_allclose(jax.grad(safe.norm)(vector), np.full(3, 3**-0.5), rtol=1e-6)
    assert np.isfinite(jax.jacobian(safe.normalize)(vector)).all()


def test_angles_of_nearly_parallel_and_of_long_vectors():
    gradient = jax.grad(safe.angle)(jnp.asarray([1e-19, 0, 1.0]), jnp.asarray([0, 0, 1.0]))
    assert np.isfinite(gradient).all()
    long = safe.angle(jnp.asarray([1e25, 0, 0]), jnp.asarray([1e25, 1e25, 0]))
    np.testing.assert_allclose(long, np.pi / 4, rtol=1e-6)


@pytest.mark.parametrize("exponent", [0.0, 0.5, 1e4, 16600.0])
def test_power_of_a_tiny_base_is_finite_forwards(exponent):
    value, tangent = jax.jvp(lambda base: safe.power(base, exponent), (jnp.float32(1e-36),), (jnp.float32(1),))
    assert np.isfinite(value)
    assert np.isfinite(tangent)


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 9])
def test_vectors_of_any_length(n: int):
    """Short ones are summed component by component, long ones by a reduction."""
    vectors = np.random.default_rng(n).normal(size=(6, n)).astype(np.float32)
    length = np.linalg.norm(vectors, axis=-1)
    np.testing.assert_allclose(safe.norm(jnp.asarray(vectors)), length, rtol=1e-6)
    np.testing.assert_allclose(safe.normalize(jnp.asarray(vectors)), vectors / length[:, None], rtol=1e-5)
    slope = jax.grad(lambda v: jnp.sum(safe.norm(v)))(jnp.asarray(vectors))
    np.testing.assert_allclose(slope, vectors / length[:, None], rtol=1e-5)
