"""Ashikhmin–Shirley against its formula as published, its laws, and at the extremes."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxrelight.brdf.ashikhmin_shirley import AshikhminShirley, ashikhmin_shirley
from jaxrelight.errors import InputError
from tests.brdf.test_lobes import PAIRS, albedo, at, hemisphere

EXPONENTS = [(0, 0), (0, 1e4), (10, 100), (1e4, 1e4), (1e4, 0.5)]


def published(omega_i, omega_o, kd, ks, nu, nv):
    """Equations 1, 4 and 5 of the paper of 2000 in float64, for directions well above the surface."""
    h = omega_i + omega_o
    h /= np.linalg.norm(h, axis=-1, keepdims=True)
    cosine, azimuth = h[:, 2], np.arctan2(h[:, 1], h[:, 0])
    power = cosine ** (nu * np.cos(azimuth) ** 2 + nv * np.sin(azimuth) ** 2)
    dot = np.sum(h * omega_i, axis=-1)
    fresnel = ks + (1 - ks) * (1 - dot) ** 5
    i_z, o_z = omega_i[:, 2], omega_o[:, 2]
    specular = np.sqrt((nu + 1) * (nv + 1)) / (8 * np.pi) * power / (dot * np.maximum(i_z, o_z)) * fresnel
    diffuse = 28 * kd / (23 * np.pi) * (1 - ks) * (1 - (1 - i_z / 2) ** 5) * (1 - (1 - o_z / 2) ** 5)
    return specular + diffuse


@pytest.mark.parametrize(("nu", "nv"), EXPONENTS)
def test_it_is_the_published_formula(x64, nu, nv):
    omega_i, omega_o = hemisphere(400), hemisphere(400, 1)
    brdf = ashikhmin_shirley([0.5, 0.3, 0.0], [0.75, 0.05, 1.0], nu, nv, jnp.float64)
    values = at(brdf, omega_i, omega_o, np.float64)
    for c, (kd, ks) in enumerate([(0.5, 0.75), (0.3, 0.05), (0.0, 1.0)]):
        # Exponents of 10,000 multiply rounding.
        np.testing.assert_allclose(
            values[:, c], published(omega_i, omega_o, kd, ks, nu, nv), rtol=1e-10 * (1 + nu + nv), atol=1e-200
        )


@pytest.mark.parametrize("angle", [1e-5, 1e-3, 0.03, 0.035, 0.7, 0.8, 1.2])
def test_float32_is_precise_at_any_angle_of_the_half_vector(angle):
    """Around the normal, where the exponent is 0/0 as it is written, and where one form gives over to another."""
    brdf = ashikhmin_shirley(0.0, 1.0, 10, 100)
    half = np.stack([np.sin(angle) * np.array([1, 0.6, 0]), np.sin(angle) * np.array([0, 0.8, 1])], axis=-1)
    omega = np.concatenate([half, np.full((3, 1), np.cos(angle))], axis=-1)
    expected = published(omega, omega, 0.0, 1.0, 10, 100)
    np.testing.assert_allclose(at(brdf, omega, omega)[:, 0], expected, rtol=3e-5, atol=1e-37)


@pytest.mark.parametrize(("nu", "nv"), EXPONENTS)
def test_reciprocity(nu, nv):
    omega_i, omega_o = np.concatenate([PAIRS[:, 0], hemisphere(300)]), np.concatenate([PAIRS[:, 1], hemisphere(300, 1)])
    brdf = ashikhmin_shirley([0.5, 0.2, 0.9], 0.3, nu, nv)
    there, back = at(brdf, omega_i, omega_o), at(brdf, omega_o, omega_i)
    np.testing.assert_allclose(there, back, rtol=1e-6)
    assert there.min() >= 0


def test_tangent_and_binormal_have_their_own_exponents():
    """Turned by a right angle, with the exponents exchanged, it is the same; equal exponents make it isotropic."""
    omega_i, omega_o = hemisphere(100), hemisphere(100, 1)
    turn = np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]])
    one, other = ashikhmin_shirley(0.5, 0.75, 10, 100), ashikhmin_shirley(0.5, 0.75, 100, 10)
    values = at(one, omega_i, omega_o)
    np.testing.assert_allclose(values, at(other, omega_i @ turn.T, omega_o @ turn.T), rtol=1e-4)
    assert np.abs(values / at(one, omega_i @ turn.T, omega_o @ turn.T) - 1).max() > 0.5
    # The lobe is tighter along y.
    sine = 0.3
    along_x, along_y = np.array([[sine, 0, 0.954]]), np.array([[0, sine, 0.954]])
    assert (at(one, along_x, along_x) > 2 * at(one, along_y, along_y)).all()


@pytest.mark.parametrize(("nu", "nv"), [(0, 0), (1, 1), (10, 100), (200, 5)])
@pytest.mark.parametrize("cosine", [1.0, 0.7, 0.3])
@pytest.mark.parametrize("azimuth", [0.0, 0.9])
def test_no_more_is_reflected_than_comes_in(x64, nu, nv, cosine, azimuth):
    omega = np.array([np.cos(azimuth) * np.sqrt(1 - cosine**2), np.sin(azimuth) * np.sqrt(1 - cosine**2), cosine])
    for kd, ks in ((0.5, 0.75), (1.0, 0.2), (1.0, 1.0)):
        reflectance = albedo(ashikhmin_shirley(kd, ks, nu, nv, jnp.float64), omega)
        assert reflectance.min() > 0
        assert reflectance.max() <= 1.01


def test_the_specular_lobe_of_isotropic_exponents_has_its_albedo_at_the_normal(x64):
    """With ω_o = n, ks = 1, n = nu = nv and u = cosθ_h it is (n + 1) ∫ uⁿ (2u² − 1) du from √½ to 1."""
    for n in (0, 1, 10, 100):
        low = np.sqrt(0.5)
        exact = (n + 1) * (2 * (1 - low ** (n + 3)) / (n + 3) - (1 - low ** (n + 1)) / (n + 1))
        reflectance = albedo(ashikhmin_shirley(0, 1, n, n, jnp.float64), np.array([0.0, 0, 1]))
        np.testing.assert_allclose(reflectance, exact, rtol=1e-5)


@pytest.mark.parametrize("derivative", [jax.jacfwd, jax.jacrev])
def test_values_and_gradients_are_finite_at_every_exponent_and_angle(derivative):
    def values(parameters, omega_i, omega_o):
        return AshikhminShirley(*parameters).evaluate(omega_i, omega_o)

    slope = jax.jit(jax.vmap(derivative(values, argnums=(0, 1, 2)), in_axes=(None, 0, 0)))
    pairs = PAIRS.astype(np.float32)
    for nu, nv in EXPONENTS:
        for ks in (0.0, 0.5, 1.0):
            brdf = ashikhmin_shirley([0, 0.5, 1], ks, nu, nv)
            assert np.isfinite(at(brdf, PAIRS[:, 0], PAIRS[:, 1])).all()
            for gradient in jax.tree.leaves(slope((brdf.kd, brdf.ks, brdf.nu, brdf.nv), pairs[:, 0], pairs[:, 1])):
                assert np.isfinite(np.asarray(gradient)).all()


def test_gradients_are_right(x64):
    def value(kd, ks, nu, nv, omega_i, omega_o):
        return AshikhminShirley(kd, ks, nu, nv).evaluate(omega_i, omega_o)

    parameters = np.asarray([0.5, 0.2, 0.9]), np.asarray([0.7, 0.1, 0.4]), np.asarray(3.0), np.asarray(8.0)
    for omega_o in ([0.36, -0.48, 0.8], [0.48, -0.36, 0.8], [-0.47, 0.35, 0.81]):
        check_grads(
            jax.jit(value), (*parameters, np.asarray([-0.48, 0.36, 0.78]), np.asarray(omega_o)), 1, ["fwd", "rev"]
        )


def test_it_depends_on_direction_even_without_a_lobe():
    brdf = ashikhmin_shirley([0.2, 0.4, 0.6], 0, 1, 1)
    assert not brdf.is_constant
    assert brdf.channels == 3


@pytest.mark.usefixtures("wrong_types")
@pytest.mark.parametrize(
    ("arguments", "fault"),
    [
        ((1.2, 0.5, 1, 1), "'kd' must be from 0 to 1"),
        ((0.5, [0, 0, -0.1], 1, 1), "'ks' must be from 0 to 1"),
        ((float("nan"), 0.5, 1, 1), "'kd' must be"),
        ((0.5, 0.5, -1, 1), "'nu' must be one finite number"),
        ((0.5, 0.5, 1, float("inf")), "'nv' must be one finite number"),
        ((0.5, 0.5, [1, 2, 3], 1), "'nu' must be one finite number"),
    ],
)
def test_parameters_out_of_range_are_refused(arguments, fault):
    with pytest.raises(InputError, match=fault):
        ashikhmin_shirley(*arguments)
