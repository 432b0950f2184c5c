"""Fits at the extremes: thousands of lobes, bad texels among them, data in any unit, optima at bounds and beyond."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fitting.solve import Verdict, fit_lobes
from tests.benchmarks.fit_oracle import TEXELS, oracle
from tests.fitting.synthetic import texels
from tests.fitting.test_solve import EXTREMES, ITEMS, bits, fit, fits_with_extremes, made


def test_thousands_of_synthetic_lobes_are_as_near_as_can_be(holds):
    """As near as the best that scipy finds from several starts, the truth among them."""
    data = texels(TEXELS)
    given = (np.asarray(array, np.float32) for array in (data.omega_i, data.omega_o, data.values))
    residual = np.asarray(fit_lobes(*given).residual)
    beyond = np.mean(residual > 1.01 * np.sqrt(oracle("texels")))
    holds(f"{TEXELS:,} lobes: share that is 1 % from the best residual", beyond, 1e-3)


def test_bad_texels_are_flagged_and_leave_others_unchanged(holds):
    """One of 64: without a sample that is finite, or black."""
    for name, bad, verdict in (("NaN", np.nan, Verdict.NO_DATA), ("black", 0.0, Verdict.BLACK)):
        values = made().values.copy()
        values[17] = bad
        fits, others = fit(values), np.arange(ITEMS) != 17
        assert fits.verdict[17] == verdict
        one, other = (np.array(bits(of, others)) for of in (fits, fit(made().values)))
        holds(f"one texel that is {name}: arrays that it changes", np.sum(one != other), 0)


def test_bad_texels_leave_the_gradients_of_others_unchanged(holds):
    """In single precision, with all starts."""
    values = made().values.copy()
    values[3], values[4], values[5] = np.nan, 0, 0.3
    omega_i, omega_o = (np.asarray(array, np.float32) for array in (made().omega_i, made().omega_o))

    @jax.jit
    @jax.grad
    def gradient(values):
        brdf = fit_lobes(omega_i, omega_o, values).brdf
        return jnp.sum(jnp.log(brdf.exponent)) + jnp.sum(brdf.diffuse) + jnp.sum(brdf.scale)

    broken, whole = (np.asarray(gradient(np.asarray(given, np.float32))) for given in (values, made().values))
    assert np.isfinite(broken).all()
    others = np.setdiff1d(np.arange(ITEMS), [3, 4, 5])
    holds("texels that are NaN, black and constant: others' slopes", np.abs(broken - whole)[others].max(), 0)
    assert np.abs(whole).max() > 0


@pytest.mark.parametrize("factor", [1e-8, 1e8])
def test_units_do_not_matter(holds, factor):
    plain, scaled = fit(made().values), fit(made().values * factor)
    for name in ("exponent", "scale"):
        one, other = (np.asarray(getattr(of.brdf, name), float) for of in (plain, scaled))
        off = np.abs(other / (one * (factor if name == "scale" else 1)) - 1).max()
        holds(f"data × {factor:g}: {name}", off, 1e-3)
    np.testing.assert_array_equal(scaled.verdict, plain.verdict)


def test_optima_at_bounds_and_beyond_are_finite_and_flagged(holds):
    fits = fits_with_extremes()
    flagged = [Verdict(int(fits.verdict[item])) == verdict for item, verdict in enumerate(EXTREMES.values())]
    holds("extremes that are flagged otherwise than documented", len(EXTREMES) - sum(flagged), 0)
    largest = max(np.abs(np.asarray(leaf)[: len(EXTREMES)]).max() for leaf in jax.tree.leaves(fits.brdf))
    holds("extremes: largest parameter", largest, 1e6)
