"""Textures: where their pixels lie, that they repeat, and their gradients."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from scipy import ndimage

from jaxrelight.brdf.texture import Texture, VertexColours, constant, look_up
from jaxrelight.errors import InputError
from jaxrelight.numerics.arrays import as_array
from tests.compilations import compilations

PIXELS = np.random.default_rng(3).random((5, 7, 3)).astype(np.float32)


def _at(pixels, uv) -> np.ndarray:
    """Of up to 500 places: the same program for all."""
    padded = np.pad(np.asarray(uv, np.float32), [(0, 500 - len(uv)), (0, 0)], mode="edge")
    return np.asarray(_look_up(Texture(pixels), padded, np.zeros(500, np.float32)))[: len(uv)]


@jax.jit
def _look_up(texture, uv, covered):
    return jax.vmap(texture.look_up)(uv, covered)


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
    uv = np.asarray([0.3, 0.4], np.float32)
    np.testing.assert_array_equal(constant([1, 2, 3]).look_up(uv), [1, 2, 3])
    np.testing.assert_array_equal(constant(0.5).look_up(uv), [0.5])
    assert constant(1).is_constant
    assert not Texture(jnp.asarray(PIXELS)).is_constant
    np.testing.assert_array_equal(look_up((), uv), [1])
    np.testing.assert_allclose(look_up((constant([1, 2, 3]), constant(0.5)), uv), [0.5, 1, 1.5])


def test_gradients(x64):
    uv = np.random.default_rng(5).uniform(-1, 2, (20, 2))

    def total(pixels, weight):
        weights = (Texture(pixels), Texture(weight))
        return jnp.sum(jax.vmap(look_up, in_axes=(None, 0))(weights, uv) ** 2)

    arguments = PIXELS.astype(float), PIXELS[:2, :3, :1].astype(float)
    check_grads(jax.jit(total), arguments, order=1, modes=("fwd", "rev"))


def test_a_texel_that_is_no_number_spoils_no_gradient_elsewhere():
    uv = np.asarray([[0.5 / 7, 1 - 0.5 / 5], [4.5 / 7, 1 - 2.5 / 5]], np.float32)
    slope = jax.jit(jax.grad(lambda pixels: jnp.sum(jax.vmap(Texture(pixels).look_up)(uv) ** 2)))

    def spoilt_by(value) -> np.ndarray:
        pixels = PIXELS.copy()
        pixels[0, 0] = value
        return np.asarray(slope(pixels))

    clean, spoilt = spoilt_by(0.5), spoilt_by(np.nan)
    np.testing.assert_array_equal(spoilt[2:4, 3:6], clean[2:4, 3:6])
    assert np.abs(clean[2:4, 3:6]).max() > 0


# Levels of detail.


def _levels(pixels) -> list[np.ndarray]:
    """Means of 2×2, of those there are at an odd border, pixel by pixel."""
    levels = [np.asarray(pixels, float)]
    while levels[-1].shape[:2] != (1, 1):
        h, w, c = levels[-1].shape
        level = np.empty((-(-h // 2), -(-w // 2), c))
        for row, column in np.ndindex(level.shape[:2]):
            corner = [(min(2 * row + i, h - 1), min(2 * column + j, w - 1)) for i in (0, 1) for j in (0, 1)]
            level[row, column] = np.mean([levels[-1][place] for place in corner], axis=0)
        levels.append(level)
    return levels


def test_coarser_levels_are_means_of_2_by_2():
    levels = _levels(PIXELS)
    assert [level.shape[:2] for level in levels] == [(5, 7), (3, 4), (2, 2), (1, 1)]
    texture = Texture(jnp.asarray(PIXELS)).minified()
    assert texture.coarser is not None
    np.testing.assert_allclose(texture.coarser, np.concatenate([x.reshape(-1, 3) for x in levels[1:]]), atol=1e-6)


@pytest.mark.parametrize("level", [0, 0.25, 1, 1.5, 2, 2.75, 3])
def test_larger_footprints_see_coarser_levels(level):
    """Scipy's bilinear look-up of the two levels at hand, at places that no border repeats."""
    texture, levels = Texture(jnp.asarray(PIXELS)).minified(), _levels(PIXELS)
    uv = np.random.default_rng(4).uniform(0.4, 0.6, (50, 2)).astype(np.float32)
    lower = min(int(level), 2)
    wanted = np.zeros((50, 3))
    for number, share in ((lower, 1 - (level - lower)), (lower + 1, level - lower)):
        place = [(1 - uv[:, 1]) * 5 / 2**number - 0.5, uv[:, 0] * 7 / 2**number - 0.5]
        pixels = levels[number]
        channels = [ndimage.map_coordinates(pixels[..., c], place, order=1, mode="grid-wrap") for c in range(3)]
        wanted += share * np.stack(channels, axis=-1)
    colours = _look_up(texture, uv, np.full(50, 4.0**level / 35, np.float32))
    np.testing.assert_allclose(colours, wanted, atol=3e-5)


def test_footprints_beyond_all_levels_see_the_last():
    texture = Texture(jnp.asarray(PIXELS)).minified()
    covered = np.resize(np.asarray([2, 1e9, np.inf], np.float32), 50)
    colours = np.asarray(_look_up(texture, np.tile(np.asarray([[0.3, 0.4]], np.float32), (50, 1)), covered))
    np.testing.assert_allclose(colours, np.broadcast_to(_levels(PIXELS)[-1][0, 0], (50, 3)), 1e-6)


def test_gradients_reach_the_finest_pixels_through_all_levels():
    uv, covered = np.asarray([[0.3, 0.4]] * 3, np.float32), np.asarray([0, 0.1, 1], np.float32)

    def total(pixels, covered):
        return jnp.sum(jax.vmap(Texture(pixels).minified().look_up)(uv, covered))

    by_pixels, by_footprint = map(np.asarray, jax.jit(jax.grad(total, argnums=(0, 1)))(PIXELS, covered))
    np.testing.assert_allclose(by_pixels.sum(axis=(0, 1)), 3, rtol=1e-5)
    assert (by_pixels > 0).all()
    assert np.isfinite(by_footprint).all()


def test_images_of_any_size_get_coarser_levels_without_a_program():
    with compilations() as programs:
        for size in (31, 32, 37):
            Texture(as_array(np.ones((size, size + 3, 3), np.float32))).minified()
    assert programs == []


@pytest.mark.parametrize(("wrap", "mode"), [("clamp", "nearest"), ("mirror", "reflect")])
def test_beyond_the_edges_an_image_is_clamped_or_mirrored(wrap, mode):
    uv = np.random.default_rng(4).uniform(-3, 4, (500, 2)).astype(np.float32)
    place = [(1 - uv[:, 1]) * 5 - 0.5, uv[:, 0] * 7 - 0.5]
    wanted = [ndimage.map_coordinates(PIXELS[..., c], place, order=1, mode=mode) for c in range(3)]
    got = _look_up(Texture(jnp.asarray(PIXELS), wrap=(wrap, wrap)), uv, np.zeros(500, np.float32))
    np.testing.assert_allclose(got, np.stack(wanted, axis=-1), atol=2e-5)


def test_each_axis_is_wrapped_its_own_way():
    texture = Texture(jnp.asarray(PIXELS), wrap=("mirror", "clamp"))
    clamped = Texture(jnp.asarray(PIXELS), wrap=("clamp", "clamp")).look_up(jnp.array([0.25, 3]))
    np.testing.assert_allclose(texture.look_up(jnp.array([1.75, 1.75])), clamped, atol=1e-6)


def test_a_placement_moves_the_image_and_its_footprint():
    """Half the size and a quarter turn: the same as coordinates that are placed already."""
    placement = jnp.asarray([[0.0, -2, 0.3], [2, 0, 0.1]], jnp.float32)
    plain = Texture(jnp.asarray(PIXELS)).minified()
    uv = np.random.default_rng(7).uniform(-1, 1, (50, 2)).astype(np.float32)
    placed = np.stack([-2 * uv[:, 1] + 0.3, 2 * uv[:, 0] + 0.1], axis=1)
    covered = np.full(50, 0.02, np.float32)
    got = _look_up(dataclasses.replace(plain, placement=placement), uv, covered)
    np.testing.assert_allclose(got, _look_up(plain, placed, 4 * covered), atol=2e-5)


def test_a_further_set_has_coordinates_and_a_footprint_of_its_own():
    plain = Texture(jnp.asarray(PIXELS)).minified()
    rows = np.random.default_rng(8).random((50, 8)).astype(np.float32)
    covered = np.full(50, 0.05, np.float32)
    for uv_set, columns in ((0, [0, 1]), (1, [2, 3]), (2, [5, 6])):
        own = covered * (rows[:, 3 * uv_set + 1] if uv_set else 1)
        got = _look_up(dataclasses.replace(plain, uv_set=uv_set), rows, covered)
        np.testing.assert_allclose(got, _look_up(plain, rows[:, columns], own), atol=2e-5)
    with pytest.raises(InputError, match="set 1 of texture coordinates"):
        dataclasses.replace(plain, uv_set=1).look_up(jnp.asarray(rows[0, :2]))


def test_vertex_colours_are_the_last_three_coordinates():
    uv = np.array([0.1, 0.2, 0.5, 0.25, 1], np.float32)
    np.testing.assert_array_equal(look_up((constant(2.0), VertexColours()), uv), [1, 0.5, 2])
    np.testing.assert_array_equal(VertexColours().look_up(jnp.asarray(uv[:2])), [1, 1, 1])


def test_gradients_of_a_placement(x64):
    placement = jnp.asarray([[1.0, 0.2, 0.3], [-0.1, 1.1, 0.45]])
    uv = np.random.default_rng(5).uniform(-1, 2, (20, 2))

    def total(placement):
        texture = Texture(jnp.asarray(PIXELS, float), placement=placement, wrap=("mirror", "repeat"))
        return jnp.sum(jax.vmap(texture.look_up)(uv) ** 2)

    check_grads(total, (placement,), order=1, modes=("rev",), eps=1e-5)
