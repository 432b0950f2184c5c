"""Powers, norms and angles where the plain formulas fail."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.numerics import safe

power, norm, normalize, angle = (jax.jit(f) for f in (safe.power, safe.norm, safe.normalize, safe.angle))
BASES = [-1e30, -1.0, -1e-30, 0.0, 1e-36, 1e-20, 1e-8, 0.5, 1.0, 1.1, 5.0]
EXPONENTS = [0.0, 0.5, 1.0, 50.0, 1e4, 16600.0]
# Forwards and backwards, of each row of arrays.
DERIVATIVES = pytest.mark.parametrize("derivative", [jax.jacfwd, jax.jacrev])


@functools.cache
def slopes_of(function, derivative):
    arguments = {safe.power: (0, 1), safe.angle: (0, 1)}.get(function, 0)
    return jax.jit(jax.vmap(derivative(function, argnums=arguments)))


def rows(*vectors) -> np.ndarray:
    """Eight of them, of which the last one is repeated: one program serves all."""
    return np.asarray([*vectors, *[vectors[-1]] * (8 - len(vectors))], np.float32)


@pytest.mark.parametrize("exponent", [0.0, 0.5, 1.0, 2.5, 20.0])
def test_power_is_the_plain_one_above_zero(exponent):
    base = np.geomspace(1e-3, 3, 50, dtype=np.float32)
    powers = power(base, np.float32(exponent))
    np.testing.assert_allclose(powers, base.astype(float) ** exponent, rtol=3e-5, atol=1e-37)


def test_power_is_exact_in_float64(x64):
    base, exponent = np.meshgrid(np.geomspace(1e-3, 3, 30), [0.0, 0.5, 3.0, 60.0])
    powers = power(base, exponent)
    assert powers.dtype == np.float64
    np.testing.assert_allclose(powers, base**exponent, rtol=1e-12)


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_power_of_nothing_and_of_negatives_is_zero(exponent):
    powers = power(np.asarray([0.0, -1e-30, -1.0, -1e30], np.float32), np.float32(exponent))
    np.testing.assert_array_equal(powers, 0)


@DERIVATIVES
def test_power_and_its_gradients_are_finite_everywhere(derivative):
    base, exponent = (grid.ravel().astype(np.float32) for grid in np.meshgrid(BASES, EXPONENTS))
    assert np.isfinite(np.asarray(power(base, exponent))).all()
    for slope in map(np.asarray, slopes_of(safe.power, derivative)(base, exponent)):
        assert np.isfinite(slope).all()
        np.testing.assert_array_equal(slope[base <= 0], 0)


@DERIVATIVES
def test_power_has_the_textbook_gradients(x64, derivative):
    base, exponent = np.array([[0.3, 0.0], [0.3, 0.5], [0.9, 50.0], [1.2, 3.0], [0.2, 0.5], [0.7, 3], [1.1, 30]]).T
    slopes = slopes_of(safe.power, derivative)(base, exponent)
    expected = exponent * base ** (exponent - 1), np.log(base) * base**exponent
    np.testing.assert_allclose(slopes, expected, rtol=1e-12)


def test_power_is_held_where_it_would_overflow():
    held, free = np.asarray(power(np.full(2, 1.1, np.float32), np.asarray([1e4, 800], np.float32)))
    np.testing.assert_allclose(held, np.exp(80), rtol=1e-4)
    np.testing.assert_allclose(free, np.exp(800 * np.log(1.1)), rtol=1e-3)


def test_norm_is_the_euclidean_one():
    vectors = np.random.default_rng(0).normal(size=(50, 4)).astype(np.float32)
    np.testing.assert_allclose(norm(vectors), np.linalg.norm(vectors, axis=-1), rtol=1e-6)


@pytest.mark.parametrize("size", [1e-30, 1e-20, 1e20, 1e37])
def test_norm_neither_over_nor_underflows(size):
    np.testing.assert_allclose(norm(rows([3 * size, -4 * size, 0])), 5 * size, rtol=1e-6)


@DERIVATIVES
def test_norm_has_unit_gradients_and_none_at_the_zero_vector(derivative):
    vectors = rows([0, 0, 0], [1, 1, 1], [0, 0, -2], [3, 4, 0], [1e15, -1e15, 0], [1e-8, 2e-8, 2e-8])
    slope = np.asarray(slopes_of(safe.norm, derivative)(vectors))
    np.testing.assert_array_equal(slope[0], 0)
    expected = vectors[1:] / np.linalg.norm(vectors[1:].astype(float), axis=-1, keepdims=True)
    np.testing.assert_allclose(slope[1:], expected, rtol=1e-5, atol=1e-7)


def test_normalize_gives_unit_vectors_and_keeps_zero():
    unit = np.asarray(normalize(rows([0, 0, 0], [2, 0, 0], [1e30, 1e30, 0], [1e-30, 0, -1e-30])))
    half = np.sqrt(0.5)
    expected = [[0, 0, 0], [1, 0, 0], [half, half, 0], [half, 0, -half]]
    np.testing.assert_allclose(unit[:4], expected, rtol=1e-6)


@DERIVATIVES
def test_normalize_has_no_gradient_at_zero_and_the_right_one_elsewhere(x64, derivative):
    """(1 − u uᵀ) / |v|, with u along v."""
    vectors = np.asarray([[0, 0, 0], [0.3, -2.0, 0.7], [5, 0, 1e-3]])
    zero, *slopes = np.asarray(slopes_of(safe.normalize, derivative)(vectors))
    np.testing.assert_array_equal(zero, 0)
    for slope, vector in zip(slopes, vectors[1:], strict=True):
        length = np.linalg.norm(vector)
        wanted = (np.eye(3) - np.multiply.outer(vector, vector) / length**2) / length
        np.testing.assert_allclose(slope, wanted, rtol=1e-9, atol=1e-15)


def test_angle_is_accurate_from_zero_to_pi():
    x, true = np.asarray([1, 0, 0], np.float32), np.asarray([1e-6, 1e-3, 0.5, np.pi / 2, 3.0])
    other = np.stack([np.cos(true), np.sin(true), 0 * true], axis=-1).astype(np.float32)
    angles = np.asarray(angle(rows(*[x] * 7), rows(*other, x, -3 * x)))
    np.testing.assert_allclose(angles[:5], true, rtol=1e-5)
    np.testing.assert_allclose(np.asarray(angle(rows(x), rows(*-other)))[:5], np.pi - true, rtol=1e-6)
    assert angles[5] == 0
    np.testing.assert_allclose(angles[6], np.pi, rtol=1e-7)


def test_angle_does_not_depend_on_length():
    a, b = np.asarray([1.0, 2, 3]), np.asarray([-2.0, 0.5, 1])
    other, plain, *_ = np.asarray(angle(rows(1e-4 * a, a), rows(1e6 * b, b)))
    np.testing.assert_allclose(other, plain, rtol=1e-6)
    cosine = 2 / np.sqrt(14 * 5.25)
    np.testing.assert_allclose(plain, np.arccos(cosine), rtol=1e-6)


@DERIVATIVES
def test_angle_has_finite_gradients_at_0_at_pi_and_at_the_zero_vector(derivative):
    others = rows([0, 0, 1], [0, 0, -1], [0, 0, 0], [1e-19, 0, 1], [1, 0, 0])
    slopes = np.stack(slopes_of(safe.angle, derivative)(others, rows([0, 0, 1])), axis=1)
    assert np.isfinite(slopes).all()
    np.testing.assert_array_equal(slopes[:3], 0)
    np.testing.assert_allclose(slopes[4], [[0, 0, -1], [-1, 0, 0]], atol=1e-7)


def test_angle_of_a_zero_vector_is_zero():
    assert np.asarray(angle(rows([0, 0, 0]), rows([0, 1, 0])))[0] == 0


@DERIVATIVES
def test_angle_has_the_right_gradient(x64, derivative):
    """It turns a vector in the plane of both, the faster the shorter it is."""
    a, b = np.asarray([0.3, -2.0, 0.7]), np.asarray([1.0, 0.2, 0.1])
    slopes = slopes_of(safe.angle, derivative)(a[None], b[None])
    lengths = np.linalg.norm(a), np.linalg.norm(b)
    cosine = a @ b / np.prod(lengths)
    sine = np.sqrt(1 - cosine**2)
    wanted = (
        (cosine * a / lengths[0] - b / lengths[1]) / (sine * lengths[0]),
        (cosine * b / lengths[1] - a / lengths[0]) / (sine * lengths[1]),
    )
    np.testing.assert_allclose([slope[0] for slope in map(np.asarray, slopes)], wanted, rtol=1e-9)


@pytest.mark.parametrize("size", [1e-19, 1e-25, 1e25])
def test_gradients_of_lengths_do_not_depend_on_size(size):
    vectors = rows(np.full(3, size))
    np.testing.assert_allclose(slopes_of(safe.norm, jax.jacrev)(vectors), np.full((8, 3), 3**-0.5), rtol=1e-6)
    assert np.isfinite(np.asarray(slopes_of(safe.normalize, jax.jacrev)(vectors))).all()


def test_angles_of_long_vectors():
    long = np.asarray(angle(rows([1e25, 0, 0]), rows([1e25, 1e25, 0])))
    np.testing.assert_allclose(long, np.pi / 4, rtol=1e-6)


@jax.jit
def _lengths(vectors):
    slope = jax.grad(lambda v: jnp.sum(safe.norm(v)))(vectors)
    return safe.norm(vectors), safe.normalize(vectors), slope


@pytest.mark.parametrize("n", [1, 2, 3, 4, 5, 9])
def test_vectors_of_any_length(n: int):
    """Short ones are summed component by component, long ones by a reduction."""
    vectors = np.random.default_rng(n).normal(size=(6, n)).astype(np.float32)
    length = np.linalg.norm(vectors, axis=-1)
    norms, unit, slope = _lengths(vectors)
    np.testing.assert_allclose(norms, length, rtol=1e-6)
    np.testing.assert_allclose(unit, vectors / length[:, None], rtol=1e-5)
    np.testing.assert_allclose(slope, vectors / length[:, None], rtol=1e-5)


_VECTORS = rows([0.3, 0.4, 0.5], [0, 0, 0], [1, 2, 3], [0, 1, 0], [3, 0, 4])
_ARGUMENTS = {
    (safe.power, power): (_VECTORS[:, 0], _VECTORS[:, 2]),
    (safe.norm, norm): (_VECTORS,),
    (safe.normalize, normalize): (_VECTORS,),
    (safe.angle, angle): (_VECTORS, _VECTORS[::-1].copy()),
}


@DERIVATIVES
@pytest.mark.parametrize("functions", _ARGUMENTS, ids=lambda functions: functions[0].__name__)
def test_what_is_not_a_number_stays_so_in_its_own_item(functions, derivative):
    """Its value and its gradients, and those of no other row."""
    plain, compiled = functions
    arguments = _ARGUMENTS[functions]

    def of_all(given):
        return jax.tree.leaves((compiled(*given), slopes_of(plain, derivative)(*given)))

    without = of_all(arguments)
    for number in range(len(arguments)):
        given = [argument.copy() for argument in arguments]
        given[number].reshape(8, -1)[2, -1] = np.nan
        for now, before in zip(of_all(given), without, strict=True):
            assert np.isnan(np.asarray(now)[2]).any()
            np.testing.assert_array_equal(np.delete(now, 2, axis=0), np.delete(before, 2, axis=0))


def test_power_of_nothing_by_no_number_is_none():
    assert np.isnan(np.asarray(power(np.asarray([0.0, -1e-30, -1, -1e30], np.float32), np.float32(np.nan)))).all()


@jax.jit
def _clamped(values):
    """Values and slopes of both."""

    def sums(values, other):
        return jnp.sum(safe.clamp(values, 0.0, 2.0)) + jnp.sum(safe.root(other))

    return (safe.clamp(values, 0.0, 2.0), safe.root(values)), *jax.grad(sums, (0, 1))(values, values)


def test_what_is_clamped_has_the_slope_inside_at_both_ends():
    values = np.asarray([-1, 0, 0.5, 2, 3, np.nan], np.float32)
    (clamped, root), slope, root_slope = _clamped(values)
    np.testing.assert_array_equal(clamped, [0, 0, 0.5, 2, 2, np.nan])
    np.testing.assert_array_equal(slope, [0, 1, 1, 1, 0, 1])
    np.testing.assert_allclose(root, [0, 0, 0.5**0.5, 2**0.5, 3**0.5, np.nan], rtol=1e-6)
    np.testing.assert_allclose(root_slope, [0, 0, 0.5 * 2**0.5, 0.5 / 2**0.5, 0.5 / 3**0.5, np.nan], rtol=1e-6)
