"""What baking and viewing need of a material."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrelight.brdf.factored import Factored
from jaxrelight.brdf.lobes import lobe, lobe_sum, phong
from jaxrelight.brdf.reflection import FixedView, of_group

BRDF = phong([0.1, 0.2, 0.3], 0.5, 7)
OMEGA_I, OMEGA_O = (jnp.asarray(np.asarray(omega, np.float32)) for omega in ([0.6, 0, 0.8], [-0.48, 0.36, 0.8]))


@jax.jit
def light_sides(own, shared):
    """Of every receiver, towards `OMEGA_I`."""
    return jax.vmap(lambda one: eqx.combine(one, shared).light_side(OMEGA_I))(own)


@jax.jit
def _reflected(omega_o):
    return FixedView(BRDF, omega_o).light_side(OMEGA_I)


_slope = jax.jit(jax.grad(lambda omega_o: jnp.sum(_reflected(omega_o))))


def test_fixed_view_is_the_brdf_itself():
    omega_i, omega_o = OMEGA_I, OMEGA_O
    reflection = FixedView(BRDF, omega_o)
    assert (reflection.terms, reflection.channels) == (1, 3)
    product = np.sum(np.asarray(reflection.light_side(omega_i)) * np.asarray(reflection.view_side(omega_o)), axis=0)
    np.testing.assert_allclose(product, BRDF.evaluate(omega_i, omega_o), rtol=1e-6)
    assert reflection.light_side(omega_i).shape == (1, 3)
    np.testing.assert_array_equal(reflection.view_side(omega_i), [[1]])


def test_fixed_view_reflects_nothing_to_an_eye_below_the_surface():
    for z in (-0.8, 0.0):
        omega_o = np.asarray([0.6, 0, z], np.float32)
        np.testing.assert_array_equal(_reflected(omega_o), 0)
        np.testing.assert_array_equal(_slope(omega_o), 0)


def test_only_the_view_is_each_receivers_own():
    reflection = FixedView(BRDF, jnp.asarray(np.zeros((4, 5, 3), np.float32)))
    own, shared = eqx.partition(reflection, reflection.per_receiver)
    assert [x.shape for x in jax.tree.leaves(own)] == [(4, 5, 3)]
    assert len(jax.tree.leaves(shared)) == len(jax.tree.leaves(BRDF))


def test_of_group_picks_one_groups_views_and_all_of_what_is_shared():
    omega_o = jnp.asarray(np.arange(24, dtype=np.float32).reshape(2, 4, 3))
    picked = of_group(FixedView(BRDF, omega_o), 1)
    assert isinstance(picked, FixedView)
    np.testing.assert_array_equal(picked.omega_o, np.asarray(omega_o)[1])
    assert eqx.tree_equal(picked.brdf, BRDF)
    factors = Factored(jnp.ones((2, 3, 4, 4)), jnp.ones((2, 3, 4, 4)))
    assert eqx.tree_equal(of_group(factors, 1), factors)


def test_parameters_of_the_brdf_may_be_each_receivers_own():
    """As `of_group` and a loop over receivers part them: every receiver has its exponent and shares the rest."""
    exponents = jnp.asarray(np.arange(1, 7, dtype=np.float32).reshape(2, 3, 1, 1))
    omega_o = jnp.asarray(np.broadcast_to(np.asarray(OMEGA_O), (2, 3, 3)))
    varying = eqx.tree_at(lambda b: b.exponent, BRDF, exponents)
    only_exponent = eqx.tree_at(lambda b: b.exponent, jax.tree.map(lambda _: False, BRDF), True)
    own, shared = eqx.partition(varying, only_exponent)
    group = of_group(FixedView(shared, omega_o, own), 1)
    own, shared = eqx.partition(group, group.per_receiver)
    assert (group.terms, group.channels) == (1, 3)
    sides = np.asarray(light_sides(own, shared))
    for value, n in zip(sides, (4, 5, 6), strict=True):
        brdf = eqx.tree_at(lambda b: b.exponent, BRDF, jnp.asarray(np.full((1, 1), n, np.float32)))
        np.testing.assert_allclose(value[0], brdf.evaluate(OMEGA_I, OMEGA_O), rtol=1e-6)


def test_a_brdf_may_lead_with_receivers_as_a_whole():
    brdfs = [phong([0.1, 0.2, 0.3], 0.5, 7), phong(0.2, [0.1, 0.2, 0.4], 20)]
    leading = jax.tree.map(lambda *x: jnp.asarray(np.stack(x)), *brdfs)
    omega_o = jnp.asarray(np.asarray([[-0.48, 0.36, 0.8], [0, 0, 1]], np.float32))
    nothing = jax.tree.map(lambda _: None, leading)
    reflection = FixedView(nothing, omega_o, leading)
    assert reflection.channels == 3
    own, shared = eqx.partition(reflection, reflection.per_receiver)
    sides = np.asarray(light_sides(own, shared))
    for value, brdf, view in zip(sides, brdfs, np.asarray(omega_o), strict=True):
        np.testing.assert_allclose(value[0], brdf.evaluate(OMEGA_I, view), rtol=1e-6)


def test_the_direction_of_anisotropy_may_be_each_receivers_own():
    """One that the shared BRDF does not have at all."""
    parts = [lobe([-1, -0.3, 0.8], 8, peak=1)]
    brdf = lobe_sum(0.1, parts)
    turns = jnp.asarray(np.asarray([0, 0.5, 2], np.float32))
    own = eqx.tree_at(lambda b: b.turn, jax.tree.map(lambda _: None, brdf), turns, is_leaf=lambda x: x is None)
    omega_o = jnp.asarray(np.tile(np.asarray(OMEGA_O), (3, 1)))
    reflection = FixedView(brdf, omega_o, own)
    mine, shared = eqx.partition(reflection, reflection.per_receiver)
    sides = np.asarray(light_sides(mine, shared))
    for value, turn in zip(sides, np.asarray(turns), strict=True):
        wanted = lobe_sum(0.1, parts, turn=turn).evaluate(OMEGA_I, OMEGA_O)
        np.testing.assert_allclose(value[0], wanted, rtol=1e-5)
    assert abs(float(sides[0, 0, 0] - sides[1, 0, 0])) > 1e-3
