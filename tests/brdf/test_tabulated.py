"""Tables over half and difference vector: reciprocal, isotropic, and differentiable wherever two directions point."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.test_util import check_grads

from jaxrelight.brdf.tabulated import Tabulated
from tests.brdf.test_lobes import PAIRS, at, hemisphere

TABLE = np.random.default_rng(0).random((6, 5, 8, 3)) + 0.5


def test_reciprocity_and_isotropy():
    brdf = Tabulated(jnp.asarray(TABLE, jnp.float32))
    i, o = hemisphere(200), hemisphere(200, 1)
    found = at(brdf, i, o)
    turn = np.array([[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1]])
    np.testing.assert_allclose(at(brdf, o, i), found, rtol=1e-4)
    np.testing.assert_allclose(at(brdf, i @ turn, o @ turn), found, rtol=1e-4)
    assert found.std() > 0.05


def test_gradients_are_right_and_finite(x64):
    brdf = Tabulated(jnp.asarray(TABLE))
    omega_i, omega_o = jnp.asarray([-0.48, 0.33, 0.8]), jnp.asarray([0.3, -0.5, 0.8])
    value = jax.jit(lambda v, i, o: Tabulated(v).evaluate(i, o))
    check_grads(jax.jit(value), (brdf.values, omega_i, omega_o), 1, ["rev"], eps=1e-6)
    pairs = jnp.asarray([*PAIRS, [[0, 0, 1], [0, 0, -1]], [[0.6, 0, 0.8], [-0.6, 0, -0.8]]])
    slopes = jax.jit(jax.vmap(jax.jacrev(brdf.evaluate, argnums=(0, 1))))(pairs[:, 0], pairs[:, 1])
    assert all(np.isfinite(slope).all() for slope in slopes)
