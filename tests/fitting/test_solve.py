import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from fitting.solve import Fits, Options, Verdict, fit_lobes
from jaxrelight.errors import InputError
from tests.fitting.synthetic import evaluate, hemisphere, texels

ITEMS, SAMPLES = 64, 96


@functools.cache
def made(noise: float = 0.02):
    return texels(ITEMS, SAMPLES, noise, seed=3)


def fit(values, weight=None, data=None, **options) -> Fits:
    """In float32, always of one shape, so that one program is compiled."""
    data = data or made()
    weight = np.ones(values.shape[:2]) if weight is None else weight
    given = [np.asarray(a, np.float32) for a in (data.omega_i, data.omega_o, values, weight)]
    return fit_lobes(*given, options=Options(**options))


def of_truth(data) -> np.ndarray:
    """Relative residual of the parameters that made the samples."""
    items = zip(data.C, data.exponent, data.diffuse, data.peak, data.omega_i, data.omega_o, strict=True)
    fitted = np.stack([evaluate(*item) for item in items])
    return np.linalg.norm(fitted - data.values, axis=(1, 2)) / np.linalg.norm(data.values, axis=(1, 2))


def bits(fits: Fits, items) -> list[bytes]:
    return [np.asarray(leaf)[items].tobytes() for leaf in jax.tree.leaves(fits)]


def test_exact_samples_give_their_lobes_back():
    data = made(noise=0.0)
    fits = fit(data.values)
    assert (np.asarray(fits.residual) < 1e-4).all()
    np.testing.assert_allclose(fits.brdf.exponent[:, 0, 0], data.exponent, rtol=5e-3)
    np.testing.assert_allclose(fits.brdf.C[:, 0, 0], data.C, atol=1e-3)
    np.testing.assert_allclose(fits.brdf.diffuse, data.diffuse, atol=1e-3)
    np.testing.assert_allclose(fits.brdf.scale[:, 0], data.peak, rtol=5e-3)
    assert (np.asarray(fits.verdict) == Verdict.GOOD).all()


def test_noisy_samples_are_fitted_better_than_by_the_truth():
    fits = fit(made().values)
    assert (np.asarray(fits.residual) < of_truth(made())).all()


def test_deviations_are_the_distances_from_the_truth():
    """Under the even noise that they assume."""
    data = made(noise=0.0)
    typical = np.sqrt(np.mean(np.square(data.values), axis=(1, 2)))[:, None, None]
    noise = 0.02 * typical * np.random.default_rng(1).normal(size=data.values.shape)
    fits = fit(data.values + noise)
    exponent, C = np.asarray(fits.brdf.exponent)[:, 0, 0], np.asarray(fits.brdf.C)[:, 0, 0]
    angle, true = (np.arctan2(c[:, 2], -np.sqrt(2) * c[:, 0]) for c in (C, data.C))
    for distance, deviation in (
        (np.log(exponent / data.exponent), fits.exponent_deviation),
        (angle - true, fits.C_deviation),
    ):
        assert 0.75 < np.sqrt(np.mean(np.square(distance / np.asarray(deviation)[:, 0, 0]))) < 1.3


def test_the_residual_is_that_of_the_lobes_returned():
    data, fits = made(), fit(made().values)
    evaluated = jax.vmap(lambda brdf, i, o: jax.vmap(brdf.evaluate)(i, o))(
        fits.brdf, jnp.asarray(data.omega_i, jnp.float32), jnp.asarray(data.omega_o, jnp.float32)
    )
    expected = np.linalg.norm(evaluated - data.values, axis=(1, 2)) / np.linalg.norm(data.values, axis=(1, 2))
    np.testing.assert_allclose(fits.residual, expected, rtol=1e-4)


@pytest.mark.parametrize("factor", [1e-8, 1e8])
def test_units_do_not_matter(factor):
    plain, scaled = fit(made().values), fit(made().values * factor)
    np.testing.assert_allclose(scaled.brdf.exponent, plain.brdf.exponent, rtol=1e-3)
    np.testing.assert_allclose(scaled.brdf.scale, plain.brdf.scale * factor, rtol=1e-3)
    np.testing.assert_array_equal(scaled.verdict, plain.verdict)


def test_an_item_without_finite_samples_is_flagged_and_touches_no_other():
    values = made().values.copy()
    values[17] = np.nan
    good = np.arange(ITEMS) != 17
    fits = fit(values)
    assert bits(fits, good) == bits(fit(made().values), good)
    assert fits.verdict[17] == Verdict.NO_DATA
    assert fits.masked[17] == SAMPLES
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(fits.brdf))


def test_samples_that_are_not_finite_count_as_samples_without_weight():
    values, weight = made().values.copy(), np.ones((ITEMS, SAMPLES))
    values[:, ::7, 1] = np.nan
    values[:, 3] = np.inf
    weight[:, ::7] = 0
    weight[:, 3] = 0
    without = fit(made().values, weight)
    broken = fit(values)
    np.testing.assert_array_equal(broken.brdf.exponent, without.brdf.exponent)
    np.testing.assert_array_equal(broken.brdf.scale, without.brdf.scale)
    np.testing.assert_array_equal(broken.masked, len({*range(0, SAMPLES, 7), 3}))
    np.testing.assert_array_equal(broken.used, without.used)


def test_the_order_of_items_does_not_matter():
    order = np.random.default_rng(0).permutation(ITEMS)
    data = made()
    given = (np.asarray(a[order], np.float32) for a in (data.omega_i, data.omega_o, data.values))
    assert bits(fit_lobes(*given), ...) == bits(fit(data.values), order)


EXTREMES = {
    "black": Verdict.BLACK,
    "constant": Verdict.CONSTANT,
    "one bright sample": Verdict.UNCERTAIN,
    "exponent 0": Verdict.AT_BOUND,
    "exponent 0.001": Verdict.AT_BOUND,
    # Narrower than the samples are apart.
    "exponent 10000": Verdict.CONSTANT,
    "C beyond 1": Verdict.GOOD,
    "negative": Verdict.CONSTANT,
    # Cz moves nothing but the noise, whatever that is.
    **{f"grazing {seed}": Verdict.UNCERTAIN for seed in range(16)},
}


def extreme(name: str):
    data = made()
    values, omega_i, omega_o = data.values[0], data.omega_i[0], data.omega_o[0]
    if name == "black":
        values = np.zeros_like(values)
    elif name == "constant":
        values = np.full_like(values, 0.2)
    elif name == "one bright sample":
        values = np.where(np.arange(SAMPLES)[:, None] == 40, 1e5, 0.1 * np.ones(3))
    elif name.startswith("exponent"):
        values = evaluate(data.C[0], float(name.split()[1]), 0.2 * np.ones(3), np.ones(3), omega_i, omega_o)
    elif name == "C beyond 1":
        # Written with C and no factor: (1.1 · dot)^60.
        values = evaluate(np.array([-1, -1, 0.9]), 60.0, 0.1 * np.ones(3), 1.1**60 * np.ones(3), omega_i, omega_o)
    elif name.startswith("grazing"):
        seed = int(name.split()[1])
        omega_i, omega_o = (hemisphere(np.random.default_rng((seed, side)), SAMPLES, 0.0) for side in (1, 2))
        for omega in (omega_i, omega_o):
            omega[:, 2] *= 1e-3
            omega /= np.linalg.norm(omega, axis=-1, keepdims=True)
        values = evaluate(data.C[0], 5.0, 0.2 * np.ones(3), np.ones(3), omega_i, omega_o)
        values = values * (1 + 0.01 * np.random.default_rng((seed, 3)).normal(size=values.shape))
    elif name == "negative":
        values = -values
    return omega_i, omega_o, values


@functools.cache
def fits_with_extremes() -> Fits:
    """The first items of the batch are extremes."""
    data = made()
    arrays = [a.copy() for a in (data.omega_i, data.omega_o, data.values)]
    for item, name in enumerate(EXTREMES):
        for array, given in zip(arrays, extreme(name), strict=True):
            array[item] = given
    return fit_lobes(*(np.asarray(a, np.float32) for a in arrays))


@pytest.mark.parametrize("name", EXTREMES)
def test_extremes_are_sane_and_flagged(name):
    item, fits = list(EXTREMES).index(name), fits_with_extremes()
    leaves = [np.asarray(leaf)[item] for leaf in jax.tree.leaves(fits.brdf)]
    assert all(np.isfinite(leaf).all() for leaf in leaves)
    assert (np.asarray(fits.brdf.scale)[item] >= 0).all()
    assert (np.asarray(fits.brdf.diffuse)[item] >= 0).all()
    assert 0 <= fits.residual[item] <= 1.001
    assert Verdict(int(fits.verdict[item])) == EXTREMES[name]


def test_extremes_touch_no_other_items():
    others = np.arange(ITEMS) >= len(EXTREMES)
    assert bits(fits_with_extremes(), others) == bits(fit(made().values), others)


def test_gradients_are_finite_with_bad_items_in_the_batch():
    data = made()
    values = data.values.copy()
    values[3], values[4], values[5] = np.nan, 0, 0.3
    omega_i, omega_o = (jnp.asarray(a, jnp.float32) for a in (data.omega_i, data.omega_o))

    def total(values):
        brdf = fit_lobes(omega_i, omega_o, values).brdf
        return jnp.sum(jnp.log(brdf.exponent)) + jnp.sum(brdf.diffuse) + jnp.sum(brdf.scale)

    broken = jax.grad(total)(jnp.asarray(values, jnp.float32))
    whole = jax.grad(total)(jnp.asarray(data.values, jnp.float32))
    assert np.isfinite(broken).all()
    np.testing.assert_array_equal(broken[6:], whole[6:])
    np.testing.assert_array_equal(broken[:3], whole[:3])
    assert np.abs(whole).max() > 0


def optimum_of(data):
    omega_i, omega_o = (jnp.asarray(a) for a in (data.omega_i, data.omega_o))

    def optimum(values):
        brdf = fit_lobes(omega_i, omega_o, values, options=Options(starts=1, rtol=1e-20)).brdf
        return jnp.log(brdf.exponent), brdf.C, brdf.diffuse, brdf.scale

    return optimum


def test_the_optimum_moves_with_the_samples_as_its_derivative_says(x64):
    data = texels(2, 40, 0.02, seed=5)
    values = jnp.asarray(data.values)
    push = jax.jit(lambda at, along: jax.jvp(optimum_of(data), (at,), (along,)))
    along = jnp.asarray(np.random.default_rng(0).normal(size=values.shape))
    step = 1e-5
    (after, _), (before, _), (_, derivative) = (push(values + h * along, along) for h in (step, -step, 0))
    for a, b, expected in zip(after, before, derivative, strict=True):
        np.testing.assert_allclose((a - b) / (2 * step), expected, rtol=1e-4, atol=1e-4)


@pytest.mark.slow
def test_the_optimum_is_differentiable_in_both_modes(x64):
    data = texels(2, 40, 0.02, seed=5)
    values = (jnp.asarray(data.values),)
    check_grads(optimum_of(data), values, order=1, modes=["fwd", "rev"], atol=2e-4, rtol=2e-4, eps=1e-5)


def test_options_and_shapes_are_checked():
    data = made()
    with pytest.raises(InputError, match="lobes must be 1, 2 or 3"):
        Options(lobes=4)
    with pytest.raises(InputError, match="starts must be"):
        Options(starts=0)
    with pytest.raises(InputError, match="shape"):
        fit_lobes(data.omega_i, data.omega_o, data.values[0])
    with pytest.raises(InputError, match="omega_o must have the shape"):
        fit_lobes(data.omega_i, data.omega_o[:, :5], data.values)
    with pytest.raises(InputError, match="weight must have the shape"):
        fit_lobes(data.omega_i, data.omega_o, data.values, np.ones((3, 4)))
