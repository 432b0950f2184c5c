"""Tables over half and difference vector: reciprocal, isotropic, and differentiable wherever two directions point."""

import jax
import jax.numpy as jnp
import numpy as np

from jaxrelight.brdf.tabulated import Tabulated
from tests.brdf.test_lobes import PAIRS, at, hemisphere

TABLE = np.random.default_rng(0).random((6, 5, 8, 3)) + 0.5


def test_reciprocity_and_isotropy():
    brdf = Tabulated(jnp.asarray(TABLE, jnp.float32))
    i, o = hemisphere(200), hemisphere(200, 1)
    values = at(brdf, i, o)
    turn = np.array([[0.6, 0.8, 0], [-0.8, 0.6, 0], [0, 0, 1]])
    np.testing.assert_allclose(at(brdf, o, i), values, rtol=1e-4)
    np.testing.assert_allclose(at(brdf, i @ turn, o @ turn), values, rtol=1e-4)
    assert values.std() > 0.05


def test_gradients_are_right_and_finite(x64):
    """Right by central differences along random ways."""

    def value(table, omega_i, omega_o):
        return Tabulated(table).evaluate(omega_i, omega_o)

    place = np.asarray([[-0.48, 0.33, 0.8], [0.3, -0.5, 0.8]])
    pairs = np.asarray([place, *PAIRS, [[0, 0, 1], [0, 0, -1]], [[0.6, 0, 0.8], [-0.6, 0, -0.8]]])
    backwards = jax.jit(jax.vmap(jax.jacrev(value, argnums=(0, 1, 2)), in_axes=(None, 0, 0)))
    slopes = [np.asarray(slope) for slope in backwards(TABLE, pairs[:, 0], pairs[:, 1])]
    assert all(np.isfinite(slope).all() for slope in slopes)
    random = np.random.default_rng(1)
    for _ in range(3):
        way = [random.normal(size=part.shape) for part in (TABLE, *place)]
        ends = []
        for step in (1e-6, -1e-6):
            table, omega_i, omega_o = (part + step * w for part, w in zip((TABLE, *place), way, strict=True))
            ends.append(at(Tabulated(jnp.asarray(table)), omega_i[None], omega_o[None], np.float64))
        along = sum(slope[0].reshape(3, -1) @ w.ravel() for slope, w in zip(slopes, way, strict=True))
        np.testing.assert_allclose(along, (ends[0] - ends[1])[0] / 2e-6, rtol=1e-6)
