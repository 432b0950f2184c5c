"""Factors shared by all texels of a map of lobes."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.brdf import spatial_factors
from jaxrelight.brdf.factors import factor
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.material import Component, Material
from jaxrelight.brdf.pairs import spread_pairs
from jaxrelight.brdf.spatial_factors import factor_spatial, without_diffuse
from jaxrelight.brdf.texture import constant
from tests.brdf.test_spatial import maps

PAIRS = spread_pairs(300)


def smooth(h=2, w=3, lobes=2, seed=0):
    """Lobes that maps of few texels can hold."""
    made = maps(h, w, lobes, seed)
    return dataclasses.replace(made, exponent=1 + made.exponent % 5, diffuse=0 * made.diffuse)


def of_texel(factors, row: int, column: int, shape) -> np.ndarray:
    uv = jnp.asarray([(column + 0.5) / shape[1], 1 - (row + 0.5) / shape[0]])
    return np.asarray(_products(factors, uv))


@jax.jit
def _products(factors, uv):
    light = jax.vmap(factors.light_side)(PAIRS[0])
    view = jax.vmap(lambda omega: factors.view_side_at(omega, uv, 0.0))(PAIRS[1])
    return jnp.sum(light * view, axis=1)


@jax.jit
def _values(lobes, uv):
    return jax.vmap(lobes.at(uv).evaluate)(*PAIRS)


def test_with_many_terms_texels_are_themselves():
    lobes = smooth()
    factors, left = factor_spatial(lobes, 100, 24)
    assert left.shapes <= spatial_factors.TOLERANCE
    assert left.terms < 0.02
    assert factors.channels == 1
    weight = np.asarray(PAIRS[0][:, 2] * PAIRS[1][:, 2])[:, None]
    missed, total = 0.0, 0.0
    for row, column in np.ndindex(2, 3):
        uv = jnp.asarray([(column + 0.5) / 3, 1 - (row + 0.5) / 2])
        wanted = weight * np.asarray(_values(lobes, uv))
        missed += np.sum((weight * of_texel(factors, row, column, (2, 3)) - wanted) ** 2)
        total += np.sum(wanted**2)
    assert missed < 0.04**2 * total


def test_fewer_terms_and_shapes_leave_more():
    lobes = smooth(2, 3, 2)
    errors = [factor_spatial(lobes, terms, 16)[1] for terms in (2, 16)]
    assert errors[0].terms > 2 * errors[1].terms
    assert len({error.shapes for error in errors}) == 1
    assert factor_spatial(lobes, 2, 16, most_shapes=3)[1].shapes > errors[0].shapes + 0.01
    assert errors[0].shapes < factor_spatial(lobes, 2, 16, tolerance=0.3)[1].shapes < 0.4


def test_maps_of_one_lobe_have_the_factors_of_it():
    """One shape, nothing left by it, and what K terms leave is what they leave of the plain BRDF."""
    one = jax.tree.map(lambda leaf: jnp.broadcast_to(leaf[:1, :1], (2, 2, *leaf.shape[2:])), smooth(1, 1, 1))
    factors, left = factor_spatial(one, 3, 24)
    assert factors.view_maps.shape == (3, 1, 24, 24)
    assert left.shapes < 1e-3
    turn = jnp.arctan2(one.axis[0, 0, 1], one.axis[0, 0, 0]) / 2
    plain = factor(
        LobeSum(jnp.zeros(3), one.C[0, 0][:, None], one.exponent[0, 0][:, None], one.scale[0, 0], turn), 3, 24
    )
    light, view = jax.vmap(plain.light_side)(PAIRS[0]), jax.vmap(plain.view_side)(PAIRS[1])
    wanted = np.asarray(jnp.sum(light * view, axis=1))
    np.testing.assert_allclose(of_texel(factors, 0, 1, (2, 2)), wanted, atol=2e-3 * np.abs(wanted).max())


def test_far_away_the_mean_of_all_texels_is_seen():
    factors, _ = factor_spatial(smooth(2, 2), 4, 16)
    omega = jnp.asarray([0.6, 0, 0.8])
    places = [jnp.asarray([x, y]) for x in (0.25, 0.75) for y in (0.25, 0.75)]
    mean = np.mean([factors.view_side_at(omega, uv, 0.0) for uv in places], axis=0)
    np.testing.assert_allclose(factors.view_side(omega), mean, rtol=1e-4, atol=1e-6)


def test_the_diffuse_part_is_a_component_of_its_own():
    lobes, tint = maps(2, 2), constant([1.0, 0.5, 0.2])
    diffuse, glossy = without_diffuse(Material((Component(lobes, (tint,)),))).components
    np.testing.assert_array_equal(diffuse.weight[0].pixels, lobes.diffuse)
    assert diffuse.weight[1] is glossy.weight[0] is tint
    assert not np.asarray(glossy.brdf.diffuse).any()  # pyright: ignore[reportAttributeAccessIssue]
    up = jnp.asarray([0.0, 0, 1])
    np.testing.assert_allclose(diffuse.brdf.evaluate(up, up), 1 / np.pi)  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize("lobes", [0, 1])
def test_black_lobes_are_left_away(lobes):
    black = maps(2, 2, lobes)
    black = dataclasses.replace(black, scale=black.scale * 0)
    assert len(without_diffuse(Material((Component(black),))).components) == 1


def test_extremes_are_finite():
    """Exponents 0 and 1e4, no direction, black texels."""
    lobes = maps(2, 2, 1)
    exponent = jnp.asarray([[0.0, 1e4], [3, 10]])[..., None]
    scale = lobes.scale.at[1, 1].set(0)
    C = lobes.C.at[1, 0].set(0)
    made, left = factor_spatial(dataclasses.replace(lobes, exponent=exponent, scale=scale, C=C), 4, 16)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(made))
    assert 0 <= left.terms <= 1
