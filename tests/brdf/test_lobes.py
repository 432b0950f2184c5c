"""Lambert, Phong and Lafortune against formulas, and at the extremes of published fits."""

import math

import hypothesis
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.lobes import LobeSum, lambert, lobe, lobe_sum, phong
from jaxrelight.errors import InputError

EXPONENTS = [0, 0.5, 50, 1e4, 16600]


def hemisphere(count: int, seed: int = 0) -> np.ndarray:
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    vectors[:, 2] = np.abs(vectors[:, 2])
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


# The normal, grazing directions, and some that are mirrored in each other or at right angles.
SPECIAL = np.array(
    [[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0.6, 0, 0.8], [-0.6, 0, 0.8], [0.8, 0, 0.6], [1, 0, 1e-7]]
)
PAIRS = np.array([(a, b) for a in SPECIAL for b in SPECIAL])


@jax.jit
def evaluate(brdf, omega_i, omega_o):
    return jax.vmap(brdf.evaluate)(omega_i, omega_o)


def at(brdf: Brdf, omega_i, omega_o, dtype=jnp.float32) -> np.ndarray:
    """Of any number of pairs, 512 at a time: one program for each kind of BRDF."""
    sides = [np.asarray(side, dtype) for side in (omega_i, omega_o)]
    sides = [np.pad(side, [(0, -len(side) % 512), (0, 0)], mode="edge") for side in sides]
    parts = [evaluate(brdf, *(side[start : start + 512] for side in sides)) for start in range(0, len(sides[0]), 512)]
    return np.concatenate(parts)[: len(omega_i)].astype(float)


def lafortune(omega_i, omega_o, diffuse, lobes) -> np.ndarray:
    """f with the lobes (C, n, peak), each one peak·max(0, ω_oᵀCω_i / max|C|)ⁿ, in float64."""
    total = np.zeros((len(omega_i), 3)) + np.asarray(diffuse) / np.pi
    for C, n, peak in lobes:
        C, n = np.broadcast_to(C, (3, 3)), np.broadcast_to(n, 3)
        dot = np.einsum("cx,px,px->pc", C / np.abs(C).max(axis=-1, keepdims=True), omega_i, omega_o)
        above = dot > 0
        total += peak * np.where(above, np.exp(n * np.log(np.where(above, dot, 1))), 0)
    return total


def test_lambert():
    omega_i, omega_o = hemisphere(10), hemisphere(10, 1)
    brdf = lambert([0.2, 0.5, 1])
    np.testing.assert_allclose(at(brdf, omega_i, omega_o), np.tile([0.2, 0.5, 1], (10, 1)) / np.pi, rtol=1e-6)
    np.testing.assert_allclose(at(lambert(0.3), omega_i, omega_o), 0.3 / np.pi, rtol=1e-6)
    assert brdf.is_constant
    assert brdf.channels == lambert(0.3).channels == 3


@pytest.mark.parametrize("exponent", [0, 1, 20, 200])
def test_phong(exponent):
    omega_i, omega_o = hemisphere(50), hemisphere(50, 1)
    diffuse, specular = np.array([0.1, 0.2, 0.3]), np.array([0.5, 0.4, 0.0])
    mirrored = omega_i * [-1, -1, 1]
    cosine = np.maximum(0, np.sum(mirrored * omega_o, axis=-1, keepdims=True))
    power = np.where(cosine > 0, cosine**exponent, 0)
    expected = diffuse / np.pi + specular * (exponent + 2) / (2 * np.pi) * power
    brdf = phong(diffuse, specular, exponent)
    np.testing.assert_allclose(at(brdf, omega_i, omega_o), expected, rtol=1e-4, atol=1e-6)
    assert not brdf.is_constant


def test_lafortune_with_parameters_of_their_own_in_every_channel():
    omega_i, omega_o = hemisphere(50), hemisphere(50, 1)
    C = np.array([[-0.9, -0.9, 0.7], [-1.1, -1.0, 0.5], [0.3, 0.2, 0.8]])
    n = np.array([5.0, 10, 2.5])
    specular = np.array([0.3, 0.6, 0.2])
    brdf = lobe_sum([0.1, 0.2, 0.3], [lobe(C, n, specular=specular), lobe([-1, -1, 1], 7, peak=0.5)])
    peaks = specular * np.abs(C).max(axis=-1) ** n
    expected = lafortune(omega_i, omega_o, [0.1, 0.2, 0.3], [(C, n, peaks), (np.array([-1, -1, 1]), 7, 0.5)])
    np.testing.assert_allclose(at(brdf, omega_i, omega_o), expected, rtol=1e-5)
    assert (brdf.C.shape, brdf.exponent.shape, brdf.scale.shape) == ((2, 3, 3), (2, 3), (2, 3))
    shared = lobe_sum(0.1, [lobe([-1, -1, 0.5], 4, peak=[1, 2, 3])])
    assert (shared.C.shape, shared.exponent.shape, shared.scale.shape) == ((1, 1, 3), (1, 1), (1, 3))
    expected = lafortune(omega_i, omega_o, 0.1, [(np.array([-1, -1, 0.5]), 4, np.array([1, 2, 3]))])
    np.testing.assert_allclose(at(shared, omega_i, omega_o), expected, rtol=1e-5)


def test_specular_and_peak_are_two_ways_to_write_one_lobe():
    """specular·max|C|ⁿ is the largest value, for C below and above 1."""
    for C in ([-0.8, -0.8, 0.9], [-1.2, -1.2, 1.0]):
        by_specular, by_peak = lobe(C, 10, specular=0.3), lobe(C, 10, peak=0.3 * np.abs(C).max() ** 10)
        for one, other in zip(by_specular, by_peak, strict=True):
            np.testing.assert_allclose(one, other, rtol=1e-12)
        assert np.abs(by_specular[0]).max() == 1


PARAMETERS = {
    "C": st.lists(st.floats(-1.5, 1.5), min_size=3, max_size=3).filter(lambda C: np.abs(C).max() > 0.1),
    "exponent": st.floats(0, 100),
    "peak": st.floats(0, 10),
    "diffuse": st.floats(0, 1),
    "seed": st.integers(0, 2**20),
}


@hypothesis.given(**PARAMETERS)
def test_any_lobe_is_its_formula_and_reciprocal(C, exponent, peak, diffuse, seed):
    omega_i, omega_o = hemisphere(16, seed), hemisphere(16, seed + 1)
    with jax.enable_x64(True):
        brdf = lobe_sum(diffuse, [lobe(C, exponent, peak=peak)], jnp.float64)
        values, swapped = (at(brdf, *pair, np.float64) for pair in ((omega_i, omega_o), (omega_o, omega_i)))
    np.testing.assert_allclose(
        values, lafortune(omega_i, omega_o, diffuse, [(np.array(C), exponent, peak)]), rtol=1e-9, atol=1e-300
    )
    np.testing.assert_allclose(values, swapped, rtol=1e-9)


@pytest.mark.parametrize("exponent", EXPONENTS)
def test_a_tight_published_lobe_reaches_its_peak(exponent):
    """C = 0.577, the peak form: 0.577ⁿ alone would underflow."""
    brdf = lobe_sum(0, [lobe([-0.577, -0.577, 0.577], exponent, peak=3)])
    omega = hemisphere(20)
    mirrored = omega * [-1, -1, 1]
    np.testing.assert_allclose(at(brdf, omega, mirrored), 3, rtol=2e-7 * max(exponent, 5))
    values = at(brdf, PAIRS[:, 0], PAIRS[:, 1])
    assert np.isfinite(values).all()
    assert values.min() >= 0
    assert values.max() <= 3 * (1 + 2e-7 * max(exponent, 5))


def test_gradients_are_right(x64):
    brdf = lobe_sum(
        [0.1, 0.2, 0.3], [lobe([-0.9, -0.9, 0.7], 5, specular=0.4), lobe([-1.1, -1, 1.2], 2.5, peak=1)], jnp.float64
    )
    omega_i, omega_o = np.asarray([-0.48, 0.36, 0.8]), np.asarray([0.36, -0.48, 0.8])

    def value(parameters, omega_i, omega_o):
        return LobeSum(*parameters).evaluate(omega_i, omega_o)

    check_grads(
        jax.jit(value), ((brdf.diffuse, brdf.C, brdf.exponent, brdf.scale), omega_i, omega_o), 1, ["fwd", "rev"]
    )


@pytest.mark.parametrize("factors", [{}, {"specular": 1, "peak": 1}])
def test_a_lobe_needs_exactly_one_factor(factors):
    with pytest.raises(InputError, match="exactly one of 'specular' and 'peak'"):
        lobe([-1, -1, 1], 10, **factors)


def test_a_lobe_that_overflows_is_refused_and_its_peak_form_is_not():
    with pytest.raises(InputError, match="too large; give 'peak'"):
        lobe([-1.1, -1.1, 1.1], 935, specular=1)
    with pytest.raises(InputError, match="too large"):
        lobe([[-1, -1, 1], [-1, -1, 1], [-1.01, -1, 1]], 16600, specular=1)
    with pytest.raises(InputError, match="at least 0"):
        lobe([-1, -1, 1], -0.5, peak=1)
    tame = lobe_sum(0, [lobe([-1.1, -1.1, 1.1], 16600, peak=2)])
    up = np.array([[0, 0, 1]])
    np.testing.assert_allclose(at(tame, up, up), 2, rtol=1e-6)
    largest = lobe([-1.1, -1.1, 1.1], 900, specular=1)
    np.testing.assert_allclose(largest[2], math.exp(900 * math.log(1.1)), rtol=1e-9)


def test_a_lobe_of_nothing_reflects_nothing():
    brdf = lobe_sum(0, [lobe([0, 0, 0], 3, specular=1), lobe([-1, -1, 1], 3, peak=0)])
    np.testing.assert_array_equal(at(brdf, PAIRS[:, 0], PAIRS[:, 1]), 0)


def albedo(brdf: Brdf, omega_o: np.ndarray, lowest: float = 0.0) -> np.ndarray:
    """∫ f cosθ dω over the hemisphere above cosθ = lowest by Gauss's rule, in float64."""
    node, weight = np.polynomial.legendre.leggauss(128)
    z, weight = lowest + (node + 1) / 2 * (1 - lowest), weight / 2 * (1 - lowest)
    azimuth = 2 * np.pi * (np.arange(256) + 0.5) / 256
    z, azimuth = (grid.ravel() for grid in np.meshgrid(z, azimuth))
    sine = np.sqrt(1 - z * z)
    omega_i = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), z], axis=-1)
    values = at(brdf, omega_i, np.broadcast_to(omega_o, omega_i.shape), np.float64)
    return values.T @ (z * np.tile(weight, 256) * 2 * np.pi / 256)


@pytest.mark.parametrize("exponent", [0, 1, 20, 200])
def test_phongs_albedo_at_normal_incidence_is_its_specular(x64, exponent):
    brdf = phong(0.25, [0.7, 0.5, 0.1], exponent)
    np.testing.assert_allclose(albedo(brdf, np.array([0.0, 0, 1])), [0.95, 0.75, 0.35], rtol=1e-4)


def test_a_tight_phong_has_its_albedo_too(x64):
    np.testing.assert_allclose(albedo(phong(0, 0.6, 1e4), np.array([0.0, 0, 1]), lowest=0.99), 0.6, rtol=1e-4)


@pytest.mark.parametrize("cosine", [0.9, 0.5, 0.1])
def test_phong_never_reflects_more_than_it_gets(x64, cosine):
    omega_o = np.array([math.sqrt(1 - cosine**2), 0, cosine])
    assert albedo(phong(0.3, 0.7, 10), omega_o).max() <= 1.0 + 1e-6


@pytest.mark.parametrize(
    "arguments",
    [
        {"C": [-1, -1, 1], "exponent": float("nan"), "peak": 1},
        {"C": [float("nan"), -1, 1], "exponent": 2, "peak": 1},
        {"C": [-1, -1, 1], "exponent": 2, "peak": float("inf")},
        {"C": [-1, 1], "exponent": 2, "peak": 1},
    ],
)
def test_numbers_that_are_none_are_refused(arguments):
    with pytest.raises(InputError, match=r"finite|three numbers"):
        lobe(**arguments)


@pytest.mark.parametrize("exponent", [0, 1, 7.5, 300])
def test_normal_albedo_is_the_integral(exponent: float):
    brdf = lobe_sum([0.1, 0.2, 0.3], [lobe([-1, -0.5, 0.8], exponent, peak=[1, 2, 3]), lobe([1, 1, -1], 2, peak=5)])
    # Midpoints in the cosine; around the normal, nothing changes.
    cosine = (np.arange(20000) + 0.5) / 20000
    omega_i = np.stack([np.sqrt(1 - cosine**2), 0 * cosine, cosine], axis=-1)
    values = at(brdf, omega_i, np.broadcast_to([0.0, 0.0, 1.0], omega_i.shape))
    np.testing.assert_allclose(brdf.normal_albedo, 2 * np.pi * np.mean(values * cosine[:, None], axis=0), rtol=1e-4)
