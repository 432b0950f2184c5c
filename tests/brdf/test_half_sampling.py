"""Half-vector sampling: densities are those of samples, weights are alike, estimates have no bias."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.brdf.ashikhmin_shirley import ashikhmin_shirley
from jaxrelight.brdf.half_sampling import half_vectors
from jaxrelight.brdf.lobes import lambert, phong
from jaxrelight.brdf.sampling import directional_albedo
from jaxrelight.numerics.random_numbers import vogel_points

BRDFS = {
    "black": lambert(0.0),
    "phong": phong(0.2, 0.5, 60),
    "metal": phong(0, 0.9, 15),
    "anisotropic": ashikhmin_shirley(0.1, 0.5, 20, 200),
}
VIEWS = np.asarray([[0.0, 0, 1], [0.6, 0, 0.8], [0.1, -0.95, 0.29]], np.float32)
# As many numbers in every call, so that one program draws for all BRDFs whose tables have the same size.
COUNT = 400


@functools.cache
def _made(name: str):
    return half_vectors(BRDFS[name])


@jax.jit
def _drawn(vectors, omega_o, u):
    return jax.vmap(lambda one: vectors.towards(omega_o).drawn(*one))(u)


@jax.jit
def _vogel_points():
    return vogel_points(jnp.arange(COUNT**2), jnp.asarray(COUNT**2), jnp.zeros(2, jnp.uint32))


@jax.jit
def _weights(brdf, omega_i, pdf, omega_o):
    """Of samples, f · cosθ_i by their density; 0 below the surface."""
    above = omega_i[:, 2] > 0
    upper = jnp.where(above[:, None], omega_i, jnp.asarray([0.0, 0, 1]))
    value = jax.vmap(lambda one: brdf.evaluate(one, omega_o)[0])(upper)
    return jnp.where(above, value * omega_i[:, 2] / pdf, 0)


def _samples(vectors, omega_o):
    omega_i, pdf = _drawn(vectors, omega_o / np.linalg.norm(omega_o), _vogel_points())
    return np.asarray(omega_i), np.asarray(pdf)


@pytest.mark.parametrize(
    ("name", "view"),
    [
        ("black", 2),
        ("phong", 0),
        pytest.param("phong", 2, marks=pytest.mark.slow),
        pytest.param("anisotropic", 0, marks=pytest.mark.slow),
        pytest.param("anisotropic", 2, marks=pytest.mark.slow),
    ],
)
def test_samples_follow_their_density(name: str, view: int):
    """Means of functions over samples, divided by the density, are their integrals over the sphere."""
    omega_i, pdf = _samples(_made(name), VIEWS[view])
    np.testing.assert_allclose(np.linalg.norm(omega_i, axis=1), 1, atol=1e-5)
    assert (pdf > 0).all()
    weight = np.where(omega_i[:, 2] > 0, 1 / pdf, 0)
    # The cosine's own integral, and of a function of azimuth, too.
    np.testing.assert_allclose((weight * omega_i[:, 2]).mean(), np.pi, rtol=0.05)
    np.testing.assert_allclose((weight * omega_i[:, 2] * omega_i[:, 0] ** 2).mean(), np.pi / 4, rtol=0.1)


@pytest.mark.parametrize(
    ("name", "view"),
    [("metal", 1), pytest.param("metal", 2, marks=pytest.mark.slow), ("anisotropic", 2),
     pytest.param("anisotropic", 1, marks=pytest.mark.slow)],
)  # fmt: skip
def test_albedo_is_estimated_without_bias_and_with_little_noise(name: str, view: int):
    brdf, omega_o = BRDFS[name], VIEWS[view] / np.linalg.norm(VIEWS[view])
    weight = np.asarray(_weights(brdf, *_samples(_made(name), omega_o), omega_o), float)
    wanted = np.asarray(directional_albedo(brdf, omega_o, 256, 512))[0]
    np.testing.assert_allclose(weight.mean(), wanted, rtol=0.01)
    # The sampler knows where it is bright: weights are about the same.
    assert weight.std() <= (0.3 if name == "metal" else 0.6) * weight.mean()


def test_sharp_highlight_is_hit():
    brdf = phong(0.0, 0.5, 1e4)
    weight = np.asarray(_weights(brdf, *_samples(half_vectors(brdf), VIEWS[1]), VIEWS[1]))
    np.testing.assert_allclose(weight.mean(), 0.5 * 0.8 * (1e4 + 2) / (1e4 + 1), rtol=0.02)


def test_small_steps_of_numbers_are_small_steps_of_directions():
    """Even numbers stay even: there are no jumps between the table's cells, but around ±π."""
    vectors, largest = _made("anisotropic"), []
    for count in (COUNT, 4 * COUNT):
        u = np.stack(np.meshgrid(*[np.linspace(0.01, 0.99, count, dtype=np.float32)] * 2, indexing="ij"), axis=-1)
        drawn = [_drawn(vectors, VIEWS[1], part) for part in u.reshape(-1, COUNT**2, 2)]
        omega_i, pdf = (np.concatenate(part).reshape(count, count, -1) for part in zip(*drawn, strict=True))
        largest.append([np.linalg.norm(np.diff(omega_i, axis=axis), axis=-1).max() for axis in (0, 1)])
    # Steps of a quarter the size lead about a quarter as far, and would lead as far over a jump.
    assert max(largest[0]) < 0.5
    np.testing.assert_array_less(largest[1], 0.5 * np.asarray(largest[0]))
    # As dense as the numbers say: a cell of theirs has the solid angle that the density gives it.
    right, down = omega_i[1:, :-1] - omega_i[:-1, :-1], omega_i[:-1, 1:] - omega_i[:-1, :-1]
    area = np.linalg.norm(np.cross(right, down), axis=-1)
    wanted = (0.98 / 1599) ** 2 / pdf[:-1, :-1, 0]
    close = np.abs(area / wanted - 1) < 0.15
    assert close.mean() > 0.97
