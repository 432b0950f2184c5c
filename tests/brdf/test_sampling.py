"""Albedo and sampling: densities that integrate to 1, estimates without bias, at any exponent."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.lobe_sampling import LobeSampler
from jaxrelight.brdf.lobes import LobeSum, lambert, lobe, lobe_sum, phong
from jaxrelight.brdf.sampling import CellSampler, directional_albedo, from_disc, to_disc
from tests.brdf.test_lobes import EXPONENTS, PAIRS, albedo, at, hemisphere

OMEGA_O = np.asarray([0.48, -0.36, 0.8], np.float32)
BY_CHANNEL = lobe(np.array([[-0.9, -0.4, 0.7], [-1.1, -1, 0.5], [0.3, 0.2, 0.8]]), [5, 10, 2.5], peak=[0.2, 0.5, 0.3])
BRDFS = {
    "lambert": lambert([0.2, 0.5, 0.9]),
    "phong": phong(0.2, 0.6, 30),
    "turned": lobe_sum(0.1, [lobe([-1, -0.3, 0.8], 8, peak=1), lobe([-1, -1, 1], 3, peak=0.2)], turn=0.7),
    "by channel": lobe_sum([0.1, 0.2, 0.3], [BY_CHANNEL]),
    "no diffuse": lobe_sum(0, [lobe([-1, -1, 0.9], 20, peak=2)]),
}


def sphere(count: int = 400) -> np.ndarray:
    """Directions whose mean is that over the sphere, by the midpoint rule in z and φ."""
    z = (np.arange(count) + 0.5) * (2 / count) - 1
    azimuth = 2 * np.pi * (np.arange(count) + 0.5) / count
    z, azimuth = (grid.ravel() for grid in np.meshgrid(z, azimuth))
    sine = np.sqrt(1 - z * z)
    return np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), z], axis=-1).astype(np.float32)


@functools.partial(jax.jit, static_argnames="kind")
def _sampled(kind, brdf, omega):
    """Densities in directions; and 40,000 samples, their densities, and f cosθ / pdf."""
    sampler = kind(brdf, OMEGA_O)

    def one(key):
        omega_i = sampler.sample(key)
        density = sampler.pdf(omega_i)
        return omega_i, density, brdf.evaluate(omega_i, OMEGA_O) * jnp.maximum(omega_i[2], 0) / density

    return jax.vmap(sampler.pdf)(omega), *jax.vmap(one)(jax.random.split(jax.random.key(0), 40_000))


def _cells(brdf, omega_o):
    """Fewer of them than usual, which take less time to choose among."""
    return CellSampler(brdf, omega_o, 16, 32)


# Cells know nothing of a BRDF but its values: one is enough for a quick suite.
@pytest.mark.parametrize(
    ("kind", "name"),
    [
        *((LobeSampler, name) for name in BRDFS),
        (_cells, "by channel"),
        *(pytest.param(_cells, name, marks=pytest.mark.slow) for name in BRDFS if name != "by channel"),
    ],
)
def test_densities_integrate_to_1_and_estimates_are_without_bias(kind, name):
    """The mean of f cosθ / pdf is the albedo by Gauss's rule, within five standard errors."""
    brdf = BRDFS[name]
    density, _, _, estimates = (np.asarray(part, float) for part in _sampled(kind, brdf, sphere()))
    assert density.mean() * 4 * math.pi == pytest.approx(1, rel=5e-3)
    error = estimates.std(axis=0) / math.sqrt(len(estimates))
    assert np.isfinite(estimates).all()
    assert (np.abs(estimates.mean(axis=0) - _albedo(name)) < 5 * error + 2e-3).all()
    assert (error < 0.02).all()


@functools.cache
def _albedo(name: str) -> np.ndarray:
    with jax.enable_x64(True):
        return albedo(BRDFS[name], OMEGA_O)


@pytest.mark.parametrize("name", BRDFS)
def test_directional_albedo_is_the_integral(name):
    np.testing.assert_allclose(directional_albedo(BRDFS[name], OMEGA_O), _albedo(name), rtol=5e-3)


class _Square(Brdf):
    """A BRDF of no known kind, scale · (1 + x_i x_o + z_i)², whose albedo is known."""

    scale: jax.Array

    def evaluate(self, omega_i, omega_o):
        return self.scale * (1 + omega_i[0] * omega_o[0] + omega_i[2]) ** 2

    @property
    def channels(self) -> int:
        return 2

    @property
    def is_constant(self) -> bool:
        return False


def test_albedo_of_any_brdf_and_its_gradient(x64):
    """∫ cosθ is π, ∫ z cosθ is 2π/3, and ∫ x² cosθ and ∫ z² cosθ are π/4 and π/2."""
    scale, omega_o = np.asarray([0.2, 0.1]), OMEGA_O.astype(float)
    wanted = scale * np.pi * (1 + 4 / 3 + 1 / 2 + omega_o[0] ** 2 / 4)
    np.testing.assert_allclose(directional_albedo(_Square(jnp.asarray(scale)), omega_o), wanted, rtol=1e-3)
    small = jax.jit(lambda scale, omega_o: directional_albedo(_Square(scale), omega_o, 8, 16))
    check_grads(small, (scale, omega_o), 1, ["fwd", "rev"])


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_a_lobe_of_any_exponent_is_sampled_about_its_peak(exponent):
    """cosⁿ⁺¹ of the angle to the peak is uniform: its mean is ½."""
    brdf = lobe_sum(0, [lobe([-1, -1, 1], exponent, peak=1)])
    _, drawn, density, _ = map(np.asarray, _sampled(LobeSampler, brdf, sphere()))
    assert np.isfinite(drawn).all()
    np.testing.assert_allclose(np.linalg.norm(drawn, axis=1), 1, rtol=1e-5)
    assert np.isfinite(density).all()
    assert density.min() > 0
    if 1 < exponent < 1e4:
        cosine = drawn.astype(float) @ (OMEGA_O * [-1, -1, 1])
        share = np.mean(np.maximum(cosine, 0) ** (exponent + 1))
        assert share == pytest.approx(0.5 * 0.95, abs=0.05)


def test_a_black_brdf_is_sampled_by_the_cosine():
    for kind in (LobeSampler, CellSampler):
        sampler = kind(lambert(0.0), jnp.asarray(OMEGA_O))
        np.testing.assert_allclose(sampler.pdf(np.asarray([0.6, 0, 0.8], np.float32)), 0.8 / np.pi, rtol=1e-5)


def test_the_disc_and_back():
    omega = hemisphere(100).astype(np.float32)
    back = jax.jit(jax.vmap(lambda w: from_disc(*to_disc(w))))(omega)
    np.testing.assert_allclose(back, omega, atol=1e-3)


# ---- the direction of anisotropy and the peak ------------------------------------------------------------------------


def turned(omega, angle):
    cosine, sine = np.cos(angle), np.sin(angle)
    return np.asarray(omega) @ np.array([[cosine, sine, 0], [-sine, cosine, 0], [0, 0, 1]])


def test_turning_the_lobes_is_turning_the_surface():
    parts = [lobe([-1, -0.3, 0.8], 8, peak=1)]
    plain, other = lobe_sum(0.1, parts), lobe_sum(0.1, parts, turn=0.7)
    i, o = hemisphere(50), hemisphere(50, 1)
    np.testing.assert_allclose(at(other, turned(i, 0.7), turned(o, 0.7)), at(plain, i, o), rtol=1e-4)
    assert np.abs(at(other, i, o) - at(plain, i, o)).max() > 0.05


@pytest.mark.parametrize("name", ["turned", "by channel"])
def test_a_lobe_is_largest_at_its_peak(name):
    brdf = jax.tree.map(np.asarray, BRDFS[name])
    peaks, lengths = map(np.asarray, brdf.peak(OMEGA_O))
    np.testing.assert_allclose(np.linalg.norm(peaks, axis=-1), 1, rtol=1e-5)
    for number, channel in np.ndindex(*lengths.shape):
        parts = (x[number : number + 1] for x in (brdf.C, brdf.exponent, brdf.scale))
        alone = LobeSum(0 * brdf.diffuse, *parts, turn=brdf.turn)
        omega = np.concatenate([peaks[number, channel][None], hemisphere(4000)])
        at_peak, *others = at(alone, omega, np.broadcast_to(OMEGA_O, omega.shape))[:, channel]
        assert max(others) <= at_peak * (1 + 1e-5)
        wanted = alone.scale[0, channel] * lengths[number, channel] ** alone.exponent[0, channel]
        np.testing.assert_allclose(at_peak, wanted, rtol=1e-4)


def test_gradients_in_the_turn_are_right_and_finite(x64):
    brdf = jax.tree.map(np.asarray, lobe_sum(0.1, [lobe([-1, -0.3, 0.8], 8, peak=1)], jnp.float64, turn=0.7))

    def value(turn, omega_i, omega_o):
        return LobeSum(brdf.diffuse, brdf.C, brdf.exponent, brdf.scale, turn).evaluate(omega_i, omega_o)

    parameters = brdf.turn, np.asarray([-0.48, 0.36, 0.8]), OMEGA_O.astype(float)
    check_grads(jax.jit(value), parameters, 1, ["fwd", "rev"])
    slopes = jax.jit(jax.vmap(jax.jacrev(value, argnums=(0, 1, 2)), in_axes=(None, 0, 0)))
    assert all(np.isfinite(slope).all() for slope in map(np.asarray, slopes(brdf.turn, *PAIRS.swapaxes(0, 1))))
