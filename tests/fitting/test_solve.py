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
    """In float32, always of one shape, so that one program is compiled; as NumPy arrays, whose parts cost none."""
    data = data or made()
    weight = np.ones(values.shape[:2]) if weight is None else weight
    given = [np.asarray(a, np.float32) for a in (data.omega_i, data.omega_o, values, weight)]
    return jax.tree.map(np.asarray, fit_lobes(*given, options=Options(**options)))


def residual_of(data, *parameters) -> np.ndarray:
    """Relative residual of each item's C, exponent, diffuse albedo and peak, over its samples."""
    fitted = np.stack([evaluate(*item) for item in zip(*parameters, data.omega_i, data.omega_o, strict=True)])
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
    data, fits = made(), fit(made().values)
    assert (fits.residual < residual_of(data, data.C, data.exponent, data.diffuse, data.peak)).all()


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
    brdf, fits = fit(made().values).brdf, fit(made().values)
    parameters = brdf.C[:, 0, 0], brdf.exponent[:, 0, 0], brdf.diffuse, brdf.scale[:, 0]
    np.testing.assert_allclose(fits.residual, residual_of(made(), *parameters), rtol=1e-4)


def test_an_item_without_finite_samples_is_flagged_and_touches_no_other():
    values = made().values.copy()
    values[17] = np.nan
    good = np.arange(ITEMS) != 17
    fits = fit(values)
    assert bits(fits, good) == bits(fit(made().values), good)
    assert fits.verdict[17] == Verdict.NO_DATA
    assert fits.masked[17] == SAMPLES
    np.testing.assert_array_equal(np.isnan(fits.residual), ~good)
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
    np.testing.assert_array_equal(broken.below, 0)


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


FEW = 5, 40


def optimum(omega_i, omega_o, values):
    brdf = fit_lobes(omega_i, omega_o, values, options=Options(starts=1, rtol=1e-20)).brdf
    return jnp.log(brdf.exponent), brdf.C, brdf.diffuse, brdf.scale


@jax.jit
def pulled_back(omega_i, omega_o, values, cotangents):
    """The optimum, and what its differentials say of the values."""
    solution, pull = jax.vjp(lambda values: optimum(omega_i, omega_o, values), values)
    return solution, pull(cotangents)[0]


@pytest.mark.slow
def test_the_optimum_moves_with_the_samples_as_its_gradient_says(x64):
    """Each of its parts, in every item; and gradients stay what they are, or finite, where other items are bad."""
    data, random = texels(*FEW, 0.02, seed=5), np.random.default_rng(0)
    pull = functools.partial(pulled_back, data.omega_i, data.omega_o)
    along = random.normal(size=data.values.shape)
    step = 1e-5
    parts = tuple(random.normal(size=(FEW[0], *shape)) for shape in ((1, 1), (1, 1, 3), (3,), (1, 3)))
    after, before = (pull(data.values + h * along, parts)[0] for h in (step, -step))
    values = data.values.copy()
    values[0], values[1], values[2] = np.nan, 0, 0.3
    for i, (a, b, weights) in enumerate(zip(after, before, parts, strict=True)):
        alone = tuple(weights * (i == k) for k, weights in enumerate(parts))
        gradient, broken = (np.asarray(pull(given, alone)[1]) for given in (data.values, values))
        moved = weights * (np.asarray(a) - np.asarray(b)) / (2 * step)
        expected = np.sum(gradient * along, axis=(1, 2))
        np.testing.assert_allclose(moved.reshape(FEW[0], -1).sum(axis=1), expected, rtol=1e-4, atol=1e-4)
        assert np.isfinite(broken).all()
        np.testing.assert_array_equal(broken[3:], gradient[3:])


@pytest.mark.slow
def test_the_optimum_is_differentiable_in_both_modes(x64):
    data = texels(2, 40, 0.02, seed=5)
    of_values = jax.jit(functools.partial(optimum, data.omega_i, data.omega_o))
    check_grads(of_values, (data.values,), order=1, modes=["fwd", "rev"], atol=2e-4, rtol=2e-4, eps=1e-5)


@pytest.mark.usefixtures("wrong_types")
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
