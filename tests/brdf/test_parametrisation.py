"""Maps over the hemisphere: texels, their measure, and look-ups."""

import jax
import numpy as np
import pytest

from jaxrelight.brdf.parametrisation import DISC, POLAR, look_up


@jax.jit
def _look_up(parametrisation, maps, omega):
    return jax.vmap(lambda one: look_up(parametrisation, maps, one))(omega)


BOTH = pytest.mark.parametrize("parametrisation", [DISC, POLAR], ids=["disc", "polar"])


@BOTH
def test_texels_are_unit_directions_above_the_surface(parametrisation):
    omega, inside = parametrisation.directions(16)
    np.testing.assert_allclose(np.linalg.norm(omega, axis=-1), 1, rtol=1e-12)
    assert omega[:, 2].min() > 0
    assert inside.sum() == (16**2 if parametrisation is POLAR else np.sum(inside))
    assert len(omega) == len(inside) == 16**2


@BOTH
def test_the_measure_is_that_of_the_projected_hemisphere(parametrisation):
    """Sums over texels converge to integrals of cosθ dω: of z and of x² they are 2π/3 and π/4, of all π."""
    omega, inside = parametrisation.directions(200)
    weight = parametrisation.measure(200)[inside]
    weight = weight / weight.sum()
    omega = omega[inside]
    assert weight @ omega[:, 2] == pytest.approx(2 / 3, abs=1e-3)
    assert weight @ omega[:, 0] ** 2 == pytest.approx(1 / 4, abs=1e-3)
    assert weight @ omega[:, 1] ** 2 == pytest.approx(1 / 4, abs=1e-3)


@BOTH
def test_look_up_is_exact_at_texel_centres(parametrisation):
    side = 9
    omega, inside = parametrisation.directions(side)
    maps = np.random.default_rng(0).normal(size=(2, 3, side, side)).astype(np.float32)
    values = _look_up(parametrisation, maps, omega[inside].astype(np.float32))
    expected = maps.reshape(2, 3, -1)[:, :, inside]
    np.testing.assert_allclose(values, expected.transpose(2, 0, 1), atol=2e-4)


@BOTH
def test_weights_are_a_mean_of_four_texels_in_every_direction(parametrisation):
    vectors = np.random.default_rng(0).normal(size=(500, 3))
    vectors[:, 2] = np.abs(vectors[:, 2])
    vectors = np.concatenate([vectors, [[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [-1e-9, -1, 0]]])
    omega = (vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)).astype(np.float32)
    texels, weights = jax.jit(jax.vmap(lambda one: parametrisation.corners(one, 7)))(omega)
    assert np.asarray(texels).min() >= 0
    assert np.asarray(texels).max() < 49
    assert np.asarray(weights).min() >= 0
    np.testing.assert_allclose(np.asarray(weights).sum(axis=-1), 1, rtol=1e-6)


def test_polar_look_ups_go_around_the_circle():
    """A map linear in the azimuth's sine has no seam where the azimuth starts again."""
    side = 64
    omega, _ = POLAR.directions(side)
    maps = omega[:, 0].reshape(1, 1, side, side).astype(np.float32)
    azimuth = np.linspace(-0.2, 0.2, 41)
    around = np.stack([0.8 * np.sin(azimuth), 0.8 * np.cos(azimuth), np.full(41, 0.6)], axis=-1)
    values = np.asarray(_look_up(POLAR, maps, around.astype(np.float32)))[:, 0, 0]
    np.testing.assert_allclose(values, around[:, 0], atol=2e-3)


@BOTH
def test_gradients_are_finite_at_the_pole_and_at_the_horizon(parametrisation):
    maps = np.random.default_rng(0).normal(size=(1, 1, 5, 5)).astype(np.float32)
    omega = np.asarray([[0.0, 0, 1], [1.0, 0, 0], [0, -1.0, 0], [0.3, -0.4, 0.86]], np.float32)
    slopes = jax.vmap(jax.grad(lambda one, maps: look_up(parametrisation, maps, one)[0, 0]), (0, None))
    assert np.isfinite(np.asarray(jax.jit(slopes)(omega, maps))).all()
