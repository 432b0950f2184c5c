"""Factors shared by all texels of a map of lobes."""

import dataclasses
import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.brdf import spatial_factors
from jaxrelight.brdf.factors import factor
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.material import Component, Material, split_diffuse
from jaxrelight.brdf.pairs import spread_pairs
from jaxrelight.brdf.spatial_factors import factor_spatial
from jaxrelight.brdf.texture import Texture, constant
from tests.brdf.test_spatial import maps

# All maps are of this size, and the numbers of shapes are but three, so that programs are the same.
SHAPE, SIDE = (4, 2), 16
PAIRS = tuple(np.asarray(side) for side in spread_pairs(300))


def smooth(lobes=2):
    """Lobes that maps of few texels can hold."""
    made = maps(*SHAPE, lobes, seed=5)
    exponent = 1 + np.asarray(made.exponent) % 5
    return dataclasses.replace(made, exponent=jnp.asarray(exponent), diffuse=jnp.asarray(np.zeros((*SHAPE, 3), "f4")))


@functools.cache
def factored(terms: int):
    return factor_spatial(smooth(), terms, SIDE)


def place(row: int, column: int) -> np.ndarray:
    """Texture coordinates of a texel's centre."""
    return np.asarray([(column + 0.5) / SHAPE[1], 1 - (row + 0.5) / SHAPE[0]], np.float32)


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
    factors, left = factored(100)
    assert left.shapes <= spatial_factors.TOLERANCE
    assert left.terms < 0.02
    assert factors.channels == 1
    weight = (PAIRS[0][:, 2] * PAIRS[1][:, 2])[:, None]
    missed, total = 0.0, 0.0
    for row, column in np.ndindex(*SHAPE):
        wanted = weight * np.asarray(_values(lobes, place(row, column)))
        missed += np.sum((weight * np.asarray(_products(factors, place(row, column))) - wanted) ** 2)
        total += np.sum(wanted**2)
    assert missed < 0.04**2 * total


def test_fewer_terms_and_shapes_leave_more():
    errors = [factored(terms)[1] for terms in (2, 16)]
    assert errors[0].terms > 2 * errors[1].terms
    assert len({error.shapes for error in errors}) == 1
    assert factor_spatial(smooth(), 2, SIDE, most_shapes=3)[1].shapes > errors[0].shapes + 0.01
    assert errors[0].shapes < factor_spatial(smooth(), 2, SIDE, tolerance=0.16)[1].shapes < 0.2


def test_maps_of_one_lobe_have_the_factors_of_it():
    """One shape, nothing left by it, and what K terms leave is what they leave of the plain BRDF."""
    one = jax.tree.map(lambda leaf: np.broadcast_to(np.asarray(leaf)[:1, :1], leaf.shape), smooth(1))
    factors, left = factor_spatial(one, 3, SIDE)
    assert factors.view_maps.shape == (3, 1, SIDE, SIDE)
    assert left.shapes < 1e-3
    turn = np.arctan2(one.axis[0, 0, 1], one.axis[0, 0, 0]) / 2
    grey = np.zeros(1, np.float32), one.C[0, 0][:, None], one.exponent[0, 0][:, None], np.ones((1, 1), np.float32), turn
    plain = factor(LobeSum(*(jnp.asarray(part) for part in grey)), 3, SIDE)
    wanted = np.asarray(_plain_products(plain)) * one.scale[0, 0]
    products = np.asarray(_products(factors, place(0, 1)))
    np.testing.assert_allclose(products, wanted, atol=2e-3 * np.abs(wanted).max())


@jax.jit
def _plain_products(factors):
    return jnp.sum(jax.vmap(factors.light_side)(PAIRS[0]) * jax.vmap(factors.view_side)(PAIRS[1]), axis=1)


@jax.jit
def _views(factors, omega, places):
    return factors.view_side(omega), jax.vmap(lambda uv: factors.view_side_at(omega, uv, 0.0))(places)


def test_far_away_the_mean_of_all_texels_is_seen():
    places = np.stack([place(*texel) for texel in np.ndindex(*SHAPE)])
    far, near = _views(factored(16)[0], np.asarray([0.6, 0, 0.8], np.float32), places)
    np.testing.assert_allclose(far, np.mean(near, axis=0), rtol=1e-4, atol=1e-6)


def test_the_diffuse_part_is_a_component_of_its_own():
    lobes, tint = maps(*SHAPE), constant([1.0, 0.5, 0.2])
    diffuse, glossy = split_diffuse(Material((Component(lobes, (tint,)),))).components
    assert isinstance(diffuse.weight[0], Texture)
    np.testing.assert_array_equal(diffuse.weight[0].pixels, lobes.diffuse)
    assert diffuse.weight[1] is glossy.weight[0] is tint
    assert not np.asarray(glossy.brdf.diffuse).any()  # pyright: ignore[reportAttributeAccessIssue]
    up = jnp.asarray(np.asarray([0, 0, 1], np.float32))
    np.testing.assert_allclose(diffuse.brdf.evaluate(up, up), 1 / np.pi)  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize("lobes", [0, 1])
def test_black_lobes_are_left_away(lobes):
    black = maps(*SHAPE, lobes)
    black = dataclasses.replace(black, scale=jnp.asarray(np.zeros_like(black.scale)))
    assert len(split_diffuse(Material((Component(black),))).components) == 1


def test_extremes_are_finite():
    """Exponents 0 and 1e4, no direction, black texels."""
    lobes = jax.tree.map(np.array, maps(*SHAPE, seed=5))
    lobes.exponent[0, :2, 0], lobes.C[1, 0], lobes.scale[1, 1] = (0, 1e4), 0, 0
    made, left = factor_spatial(jax.tree.map(jnp.asarray, lobes), 16, SIDE)
    assert all(np.isfinite(leaf).all() for leaf in map(np.asarray, jax.tree.leaves(made)))
    assert 0 <= left.terms <= 1
