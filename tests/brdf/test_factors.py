"""Separable factors: exact where they can be, optimal elsewhere."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.brdf.factors import Factored, factor
from jaxrelight.brdf.lobes import lambert, lobe, lobe_sum, phong
from jaxrelight.errors import InputError

SIDE = 8


@functools.cache
def disc(side: int) -> tuple[np.ndarray, np.ndarray]:
    """Directions through the texel centres inside the unit disc, and which texels those are."""
    centre = (np.arange(side) + 0.5) * 2 / side - 1
    x, y = (grid.ravel() for grid in np.meshgrid(centre, centre))
    inside = x * x + y * y < 1
    z = np.sqrt(np.maximum(0, 1 - x * x - y * y))
    return np.stack([x, y, z], axis=-1)[inside], inside


@jax.jit
def evaluate(brdf, omega_i, omega_o):
    """All pairs [i, o, c]."""
    over_o = jax.vmap(brdf.evaluate, in_axes=(None, 0))
    return jax.vmap(over_o, in_axes=(0, None))(omega_i, omega_o)


@jax.jit
def look_up(factors, omega):
    return jax.vmap(factors.light_side)(omega), jax.vmap(factors.view_side)(omega)


def sampled(brdf, side: int) -> np.ndarray:
    """The BRDF between all directions of the disc: [i, o, c]."""
    omega = jnp.asarray(disc(side)[0], jnp.float32)
    return np.asarray(evaluate(brdf, omega, omega), float)


def sides(factors: Factored, omega) -> tuple[np.ndarray, np.ndarray]:
    """Light and view side [direction, k, c] by look-up."""
    light, view = look_up(factors, jnp.asarray(omega, jnp.float32))
    return np.asarray(light, float), np.asarray(view, float)


def product(factors: Factored, omega) -> np.ndarray:
    """Σ_k light_side · view_side between all given directions: [i, o, c]."""
    return np.einsum("ikc,okc->ioc", *sides(factors, omega))


GLOSSY = phong([0.2, 0.1, 0.3], [0.5, 0.4, 0.6], 8)


def test_a_constant_brdf_is_one_texel_and_exact():
    factors = factor(lambert([0.2, 0.5, 0.9]), terms=4, resolution=48)
    assert factors.light_maps.shape == (1, 1, 1, 1)
    assert factors.view_maps.shape == (1, 3, 1, 1)
    assert (factors.terms, factors.channels) == (1, 1)
    omega = np.concatenate([disc(4)[0], [[1, 0, 0], [0, -1, 0]]])
    light, view = sides(factors, omega)
    expected = np.broadcast_to(np.array([0.2, 0.5, 0.9], np.float32) / np.float32(np.pi), (len(omega), 1, 3))
    np.testing.assert_allclose(light * view, expected, rtol=2e-7)


def test_the_error_is_that_of_the_best_approximation():
    """By Eckart and Young: the sum of the squared singular values that are left out."""
    matrix = sampled(GLOSSY, SIDE)
    sigma = np.stack([np.linalg.svd(matrix[..., c], compute_uv=False) for c in range(3)])
    errors = []
    for terms in (1, 2, 4, 9):
        factors = factor(GLOSSY, terms, SIDE)
        assert factors.terms == terms
        assert factors.channels == 3
        error = np.sum((product(factors, disc(SIDE)[0]) - matrix) ** 2, axis=(0, 1))
        np.testing.assert_allclose(error, np.sum(sigma[:, terms:] ** 2, axis=-1), rtol=1e-3)
        errors.append(error)
    assert (np.diff(errors, axis=0) < 0).all()


def test_all_terms_give_the_sampled_matrix_back():
    omega, _ = disc(SIDE)
    matrix = sampled(GLOSSY, SIDE)
    found = product(factor(GLOSSY, len(omega), SIDE), omega)
    np.testing.assert_allclose(found, matrix, atol=1e-5 * matrix.max())


def test_a_brdf_of_rank_two_needs_two_terms_everywhere():
    """diffuse/π + z_i z_o, also beyond the disc's edge, where maps are continued."""
    brdf = lobe_sum([0.3, 0.6, 0.9], [lobe([0, 0, 1], 1, peak=[1, 2, 3])])
    factors = factor(brdf, 2, 32)
    z = np.array([0.95, 0.8, 0.6])
    omega = np.stack([np.sqrt(1 - z * z), 0 * z, z], axis=-1)
    expected = np.array([0.3, 0.6, 0.9]) / np.pi + np.multiply.outer(np.multiply.outer(z, z), [1, 2, 3])
    np.testing.assert_allclose(product(factors, omega), expected, rtol=0.01)
    horizon = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0.6, 0.8, 0], [-0.8, 0.6, 0]])
    at_horizon = product(factors, horizon)
    assert np.isfinite(at_horizon).all()
    # Between the last texel inside and the edge, where z has its root, a bilinear look-up is off by some of a texel.
    np.testing.assert_allclose(at_horizon, np.broadcast_to(np.array([0.3, 0.6, 0.9]) / np.pi, (6, 6, 3)), atol=0.2)


def test_texels_beyond_the_edge_are_those_of_the_edge():
    """At the corner texel the product with any direction is the BRDF with the direction at the edge before it."""
    omega, inside = disc(SIDE)
    factors = factor(GLOSSY, len(omega), SIDE)
    edge = (1 - 1e-6) * np.array([-1, -1]) / np.sqrt(2)
    corner = np.array([*edge, np.sqrt(1 - edge @ edge)])
    assert not inside[0]
    light = np.asarray(factors.light_maps, float)[:, :, 0, 0]
    view = np.asarray(factors.view_maps, float)[:, :, 0, 0]
    light_sides, view_sides = sides(factors, omega)
    expected = np.asarray(evaluate(GLOSSY, jnp.asarray([corner], jnp.float32), jnp.asarray(omega, jnp.float32)), float)[
        0
    ]
    np.testing.assert_allclose(np.einsum("kc,okc->oc", light, view_sides), expected, atol=2e-4)
    np.testing.assert_allclose(np.einsum("ikc,kc->ic", light_sides, view), expected, atol=2e-4)


def test_light_and_view_maps_of_a_reciprocal_brdf_agree_up_to_sign():
    factors = factor(GLOSSY, 4, SIDE)
    light, view = np.asarray(factors.light_maps, float), np.asarray(factors.view_maps, float)
    for k, c in np.ndindex(4, 3):
        size = np.abs(light[k, c]).max()
        difference = min(np.abs(light[k, c] - sign * view[k, c]).max() for sign in (1, -1))
        assert difference < 1e-3 * size
    # The first one is positive by choice of sign.
    assert light[0].min() > 0
    assert view[0].min() > 0


def test_channels_alike_have_maps_alike():
    factors = factor(phong(0.2, 0.5, 8), 3, SIDE)
    np.testing.assert_array_equal(factors.light_maps[:, 0], factors.light_maps[:, 1])
    np.testing.assert_array_equal(factors.view_maps[:, 0], factors.view_maps[:, 2])


def test_look_up_is_bilinear():
    """Exact at texel centres, in the order y, x; the mean half-way between them."""
    side = 4
    maps = jnp.arange(2.0 * 3 * side * side).reshape(2, 3, side, side)
    factors = Factored(maps, -maps)
    centre = (np.arange(side) + 0.5) * 2 / side - 1
    omega = np.array([[x, y, 0.1] for y in centre for x in centre])
    light, view = sides(factors, omega)
    np.testing.assert_allclose(light, np.asarray(maps).reshape(2, 3, -1).transpose(2, 0, 1), atol=1e-5)
    np.testing.assert_allclose(view, -light, atol=1e-5)
    light, _ = sides(
        factors, [[(centre[1] + centre[2]) / 2, centre[3], 0], [centre[0], (centre[0] + centre[1]) / 2, 0]]
    )
    expected = [(maps[:, :, 3, 1] + maps[:, :, 3, 2]) / 2, (maps[:, :, 0, 0] + maps[:, :, 1, 0]) / 2]
    np.testing.assert_allclose(light, expected, atol=1e-5)


def test_look_up_at_the_horizon_stays_inside_the_map():
    maps = jnp.arange(1.0, 17).reshape(1, 1, 4, 4)
    light, _ = sides(Factored(maps, maps), [[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [1, 1, 0], [-1, -1, 0]])
    np.testing.assert_allclose(light[:, 0, 0], [10, 7, 14.5, 2.5, 16, 1], atol=1e-5)


def test_look_up_has_gradients_in_maps_and_direction():
    maps = jnp.asarray(np.random.default_rng(0).normal(size=(2, 3, 5, 5)), jnp.float32)

    def total(maps, omega):
        return jnp.sum(Factored(maps, maps).light_side(omega))

    slopes = jax.jit(jax.grad(total, argnums=(0, 1)))
    for omega in ([0.13, -0.44, 0.5], [1.0, 0, 0], [0, 0, 1.0]):
        for slope in slopes(maps, jnp.asarray(omega)):
            assert np.isfinite(slope).all()
            assert np.abs(slope).max() > 0


@pytest.mark.parametrize("terms", [0, -1, 10**6])
def test_an_impossible_number_of_terms_is_refused(terms):
    with pytest.raises(InputError, match=f"{terms} terms cannot be had"):
        factor(GLOSSY, terms, SIDE)


def test_factors_are_shared_by_all_receivers():
    assert jax.tree.leaves(Factored(jnp.ones((1, 1, 1, 1)), jnp.ones((1, 1, 1, 1))).per_receiver) == [False, False]
