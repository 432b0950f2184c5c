"""Albedo and sampling: densities that integrate to 1, estimates without bias, at any exponent."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxrelight.brdf.ashikhmin_shirley import ashikhmin_shirley
from jaxrelight.brdf.lobe_sampling import LobeSampler
from jaxrelight.brdf.lobes import LobeSum, lambert, lobe, lobe_sum, phong
from jaxrelight.brdf.sampling import CellSampler, directional_albedo, from_disc, to_disc
from tests.brdf.test_lobes import EXPONENTS, PAIRS, albedo, hemisphere

OMEGA_O = jnp.asarray([0.48, -0.36, 0.8])
BY_CHANNEL = lobe(np.array([[-0.9, -0.4, 0.7], [-1.1, -1, 0.5], [0.3, 0.2, 0.8]]), [5, 10, 2.5], peak=[0.2, 0.5, 0.3])
BRDFS = {
    "lambert": lambert([0.2, 0.5, 0.9]),
    "phong": phong(0.2, 0.6, 30),
    "turned": lobe_sum(0.1, [lobe([-1, -0.3, 0.8], 8, peak=1), lobe([-1, -1, 1], 3, peak=0.2)], turn=0.7),
    "by channel": lobe_sum([0.1, 0.2, 0.3], [BY_CHANNEL]),
    "no diffuse": lobe_sum(0, [lobe([-1, -1, 0.9], 20, peak=2)]),
}


def sphere_sum(values, count: int = 400):
    """Integral over the sphere of a function of directions, by the midpoint rule in z and φ."""
    z = (np.arange(count) + 0.5) * (2 / count) - 1
    azimuth = 2 * np.pi * (np.arange(count) + 0.5) / count
    z, azimuth = (grid.ravel() for grid in np.meshgrid(z, azimuth))
    sine = np.sqrt(1 - z * z)
    omega = jnp.asarray(np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), z], axis=-1), jnp.float32)
    return float(jnp.mean(jax.jit(jax.vmap(values))(omega))) * 4 * math.pi


@pytest.mark.parametrize("name", BRDFS)
@pytest.mark.parametrize("kind", [LobeSampler, CellSampler])
def test_densities_integrate_to_1(kind, name):
    assert sphere_sum(kind(BRDFS[name], OMEGA_O).pdf) == pytest.approx(1, rel=5e-3)


# Cells know nothing of a BRDF but its values: one of each kind of lobes is enough for a quick suite.
@pytest.mark.parametrize(
    ("kind", "name"),
    [
        *((LobeSampler, name) for name in BRDFS),
        *((CellSampler, name) for name in ("turned", "by channel")),
        *(pytest.param(CellSampler, name, marks=pytest.mark.slow) for name in ("lambert", "phong", "no diffuse")),
    ],
)
def test_estimates_are_without_bias(x64, kind, name):
    """The mean of f cosθ / pdf is the albedo by Gauss's rule, within five standard errors."""
    brdf = BRDFS[name]

    @jax.jit
    def estimates(keys):
        sampler = kind(brdf, OMEGA_O)

        def one(key):
            omega_i = sampler.sample(key)
            return brdf.evaluate(omega_i, OMEGA_O) * jnp.maximum(omega_i[2], 0) / sampler.pdf(omega_i)

        return jax.vmap(one)(keys)

    found = np.asarray(estimates(jax.random.split(jax.random.key(0), 40_000)), float)
    error = found.std(axis=0) / math.sqrt(len(found))
    assert np.isfinite(found).all()
    assert (np.abs(found.mean(axis=0) - albedo(brdf, np.asarray(OMEGA_O))) < 5 * error + 2e-3).all()
    assert (error < 0.02).all()


@pytest.mark.parametrize("name", BRDFS)
def test_directional_albedo_is_the_integral(x64, name):
    found = directional_albedo(BRDFS[name], OMEGA_O)
    np.testing.assert_allclose(found, albedo(BRDFS[name], np.asarray(OMEGA_O)), rtol=5e-3)


def test_albedo_of_any_brdf_and_its_gradient(x64):
    brdf = ashikhmin_shirley(0.4, 0.2, 20, 5, jnp.float64)
    omega_o = OMEGA_O.astype(jnp.float64)
    np.testing.assert_allclose(directional_albedo(brdf, omega_o), albedo(brdf, np.asarray(OMEGA_O)), rtol=5e-3)
    check_grads(jax.jit(lambda o: directional_albedo(brdf, o, 8, 16)), (omega_o,), 1, ["fwd", "rev"])


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_a_lobe_of_any_exponent_is_sampled_about_its_peak(exponent):
    """cosⁿ⁺¹ of the angle to the peak is uniform: its mean is ½."""
    brdf = lobe_sum(0, [lobe([-1, -1, 1], exponent, peak=1)])
    sampler = LobeSampler(brdf, OMEGA_O)
    drawn = jax.vmap(sampler.sample)(jax.random.split(jax.random.key(1), 4000))
    assert np.isfinite(drawn).all()
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1, rtol=1e-5)
    density = np.asarray(jax.vmap(sampler.pdf)(drawn))
    assert np.isfinite(density).all()
    assert density.min() > 0
    if 1 < exponent < 1e4:
        cosine = np.asarray(drawn @ (OMEGA_O * jnp.asarray([-1, -1, 1])), float)
        share = np.mean(np.maximum(cosine, 0) ** (exponent + 1))
        assert share == pytest.approx(0.5 * 0.95, abs=0.05)


def test_a_black_brdf_is_sampled_by_the_cosine():
    for kind in (LobeSampler, CellSampler):
        sampler = kind(lambert(0.0), OMEGA_O)
        np.testing.assert_allclose(sampler.pdf(jnp.asarray([0.6, 0, 0.8])), 0.8 / np.pi, rtol=1e-5)


def test_the_disc_and_back():
    omega = jnp.asarray(hemisphere(100), jnp.float32)
    back = jax.vmap(lambda w: from_disc(*to_disc(w)))(omega)
    np.testing.assert_allclose(back, omega, atol=1e-3)


# ---- the direction of anisotropy and the peak ------------------------------------------------------------------------


def turned(omega, angle):
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.asarray(omega) @ np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])


def test_turning_the_lobes_is_turning_the_surface():
    parts = [lobe([-1, -0.3, 0.8], 8, peak=1)]
    plain, other = lobe_sum(0.1, parts), lobe_sum(0.1, parts, turn=0.7)
    i, o = hemisphere(50), hemisphere(50, 1)

    def values(brdf, i, o):
        return np.asarray(jax.vmap(brdf.evaluate)(jnp.asarray(i, jnp.float32), jnp.asarray(o, jnp.float32)))

    np.testing.assert_allclose(values(other, turned(i, 0.7), turned(o, 0.7)), values(plain, i, o), rtol=1e-4)
    assert np.abs(values(other, i, o) - values(plain, i, o)).max() > 0.05


@pytest.mark.parametrize("name", ["turned", "by channel"])
def test_a_lobe_is_largest_at_its_peak(name):
    brdf = BRDFS[name]
    peaks, lengths = brdf.peak(OMEGA_O)
    np.testing.assert_allclose(jnp.linalg.norm(peaks, axis=-1), 1, rtol=1e-5)
    omega = jnp.asarray(hemisphere(4000), jnp.float32)
    for number in range(len(peaks)):
        parts = (x[number : number + 1] for x in (brdf.C, brdf.exponent, brdf.scale))
        alone = LobeSum(0 * brdf.diffuse, *parts, turn=brdf.turn)
        for channel in range(peaks.shape[1]):
            at_peak = alone.evaluate(peaks[number, channel], OMEGA_O)[channel]
            others = jax.vmap(alone.evaluate, in_axes=(0, None))(omega, OMEGA_O)[:, channel]
            assert float(others.max()) <= float(at_peak) * (1 + 1e-5)
            wanted = alone.scale[0, channel] * lengths[number, channel] ** alone.exponent[0, channel]
            np.testing.assert_allclose(at_peak, wanted, rtol=1e-4)


def test_gradients_in_the_turn_are_right_and_finite(x64):
    brdf = lobe_sum(0.1, [lobe([-1, -0.3, 0.8], 8, peak=1)], jnp.float64, turn=0.7)

    def value(turn, omega_i, omega_o):
        return LobeSum(brdf.diffuse, brdf.C, brdf.exponent, brdf.scale, turn).evaluate(omega_i, omega_o)

    check_grads(jax.jit(value), (brdf.turn, jnp.asarray([-0.48, 0.36, 0.8]), OMEGA_O.astype(float)), 1, ["fwd", "rev"])
    slopes = jax.vmap(jax.jacrev(value, argnums=(0, 1, 2)), in_axes=(None, 0, 0))(
        brdf.turn, *jnp.asarray(PAIRS.swapaxes(0, 1))
    )
    assert all(np.isfinite(slope).all() for slope in slopes)
