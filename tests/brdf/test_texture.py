"""Textures: where their pixels lie, that they repeat, and their gradients."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy import ndimage

from jaxrelight.brdf.texture import Texture, constant, look_up

PIXELS = np.random.default_rng(3).random((5, 7, 3)).astype(np.float32)


def _at(pixels, uv) -> np.ndarray:
    return np.asarray(jax.vmap(Texture(jnp.asarray(pixels)).look_up)(jnp.asarray(uv, jnp.float32)))


def test_pixel_centres_are_the_pixels_with_the_top_row_at_v_1():
    row, column = np.mgrid[:5, :7]
    uv = np.stack([(column + 0.5) / 7, 1 - (row + 0.5) / 5], axis=-1).reshape(-1, 2)
    np.testing.assert_allclose(_at(PIXELS, uv), PIXELS.reshape(-1, 3), atol=1e-5)


def test_look_up_is_scipys_bilinear_one_that_repeats():
    uv = np.random.default_rng(4).uniform(-3, 4, (500, 2))
    place = [(1 - uv[:, 1]) * 5 - 0.5, uv[:, 0] * 7 - 0.5]
    wanted = [ndimage.map_coordinates(PIXELS[..., c], place, order=1, mode="grid-wrap") for c in range(3)]
    np.testing.assert_allclose(_at(PIXELS, uv), np.stack(wanted, axis=-1), atol=2e-5)


@pytest.mark.parametrize("shift", [1, -1, 64])
def test_repeats_exactly(shift):
    uv = np.array([[0.25, 0.5], [0.125, 0.875], [0, 0], [0, 0.5]])
    np.testing.assert_array_equal(_at(PIXELS, uv), _at(PIXELS, uv + shift))


def test_one_pixel_is_a_constant_and_weights_multiply():
    uv = jnp.asarray([0.3, 0.4])
    np.testing.assert_array_equal(constant([1, 2, 3]).look_up(uv), [1, 2, 3])
    np.testing.assert_array_equal(constant(0.5).look_up(uv), [0.5])
    assert constant(1).is_constant
    assert not Texture(jnp.asarray(PIXELS)).is_constant
    np.testing.assert_array_equal(look_up((), uv), [1])
    np.testing.assert_allclose(look_up((constant([1, 2, 3]), constant(0.5)), uv), [0.5, 1, 1.5])


def test_gradients(x64):
    uv = jnp.asarray(np.random.default_rng(5).uniform(-1, 2, (20, 2)))

    def total(pixels, weight):
        weights = (Texture(pixels), Texture(weight))
        return jnp.sum(jax.vmap(look_up, in_axes=(None, 0))(weights, uv) ** 2)

    arguments = jnp.asarray(PIXELS, jnp.float64), jnp.asarray(PIXELS[:2, :3, :1], jnp.float64)
    check_grads(jax.jit(total), arguments, order=1, modes=("fwd", "rev"))


def test_a_texel_that_is_no_number_spoils_no_gradient_elsewhere():
    uv = jnp.asarray([[0.5 / 7, 1 - 0.5 / 5], [4.5 / 7, 1 - 2.5 / 5]])

    def total(pixels):
        return jnp.sum(jax.vmap(Texture(pixels).look_up)(uv) ** 2)

    clean, spoilt = (jax.grad(total)(jnp.asarray(PIXELS).at[0, 0].set(value)) for value in (0.5, jnp.nan))
    np.testing.assert_array_equal(spoilt[2:4, 3:6], clean[2:4, 3:6])
    assert np.abs(clean[2:4, 3:6]).max() > 0
