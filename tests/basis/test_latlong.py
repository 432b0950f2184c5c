"""Lat-long maps: conventions, resampling by area, rotation."""

import functools
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxrelight.basis import cubemap, latlong

# Height, width, side of the cube map.
SIZES = [(8, 16, 4), (8, 16, 7), (6, 12, 5), (32, 64, 4), (64, 128, 16)]


apply = jax.jit(latlong.AreaResampling.apply)
_rotate: Any = jax.jit(latlong.rotate)
_look_up = jax.jit(latlong.look_up)


def rotate(pixels, degrees) -> np.ndarray:
    return np.asarray(_rotate(pixels, np.asarray(degrees, np.float32)))


def look_up(pixels, u, v) -> np.ndarray:
    return np.asarray(_look_up(pixels, np.asarray(u, np.float32), np.asarray(v, np.float32)))


def interpolate(pixels, u, v) -> np.ndarray:
    return np.asarray(latlong.interpolate(pixels, np.asarray(u, np.float32), np.asarray(v, np.float32)))


@functools.cache
def shares(height: int, width: int, resolution: int) -> np.ndarray:
    """Weights [texel, pixel] of the resampling, in float64."""
    rows_of = latlong.area_resampling(height, width, resolution).matrix.rows
    parts = []
    for group in rows_of.groups:
        n = group.indices.shape[-1]
        indices, values = (
            np.asarray(part).reshape(-1, n)[: group.row_count] for part in (group.indices, group.values[0])
        )
        rows = np.zeros((group.row_count, height * width))
        np.add.at(rows, (np.arange(group.row_count)[:, None], indices), values)
        parts.append(rows)
    return np.concatenate(parts)[np.asarray(rows_of.order)]


def test_conventions():
    directions = latlong.directions(np.array([0.5, 0.25, 0.75, 0.0, 1.0]), np.full(5, 0.5))
    expected = [[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 0, -1], [0, 0, -1]]
    np.testing.assert_allclose(directions, expected, atol=1e-15)
    np.testing.assert_allclose(
        latlong.directions(np.array([0.3, 0.3]), np.array([0, 1])), [[0, 1, 0], [0, -1, 0]], atol=1e-15
    )


def test_directions_and_coordinates_are_inverse():
    u, v = np.meshgrid((np.arange(37) + 0.5) / 37, (np.arange(19) + 0.5) / 19)
    directions = latlong.directions(u, v)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1, atol=1e-15)
    np.testing.assert_allclose(latlong.coordinates(directions), (u, v), atol=1e-14)
    random = np.random.default_rng(0).normal(size=(4, 50, 3))
    random /= np.linalg.norm(random, axis=-1, keepdims=True)
    u, v = latlong.coordinates(random)
    assert min(u.min(), v.min()) >= 0
    assert max(u.max(), v.max()) <= 1
    np.testing.assert_allclose(latlong.directions(u, v), random, atol=1e-14)


@pytest.mark.parametrize(("height", "width"), [(1, 2), (8, 16), (64, 128)])
def test_solid_angles_are_those_of_the_rows(height, width):
    angles = latlong.solid_angles(height, width)
    assert abs(angles.sum() * width - 4 * np.pi) < 1e-12
    edges = np.pi * np.arange(height + 1) / height
    np.testing.assert_allclose(angles, 2 * np.pi / width * (np.cos(edges[:-1]) - np.cos(edges[1:])), atol=1e-14)


@pytest.mark.parametrize(("height", "width", "resolution"), [*SIZES, (8, 16, 16), (32, 64, 8), (64, 128, 4)])
def test_every_hot_pixel_keeps_its_energy(height, width, resolution):
    """Column by column of the weights: any single pixel, those at the poles and at the seam included."""
    given_out = (cubemap.solid_angles(resolution) @ shares(height, width, resolution)).reshape(height, width)
    own = np.broadcast_to(latlong.solid_angles(height, width)[:, None], (height, width))
    np.testing.assert_allclose(given_out, own, rtol=1e-5)


@pytest.mark.parametrize(("row", "column"), [(0, 0), (0, 9), (3, 8), (7, 15)])
def test_a_hot_pixel_of_a_map_keeps_its_energy_and_place(row, column):
    pixels = np.zeros((8, 16, 3), np.float32)
    pixels[row, column] = [1e5, 1, 0]
    texels = np.asarray(apply(latlong.area_resampling(8, 16, 4), pixels))
    energy = cubemap.solid_angles(4) @ texels.astype(float)
    np.testing.assert_allclose(energy, latlong.solid_angles(8, 16)[row] * pixels[row, column], rtol=1e-5)
    direction = latlong.directions(np.array((column + 0.5) / 16), np.array((row + 0.5) / 8))
    assert texels[cubemap.texel_of(direction, 4), 0] > 0
    assert (cubemap.directions(4)[texels[:, 0] > 0] @ direction).min() > np.cos(0.7)


@pytest.mark.parametrize(("height", "width", "resolution"), SIZES)
def test_every_texel_is_a_mean_so_a_constant_map_stays_constant(height, width, resolution):
    weights = shares(height, width, resolution)
    assert weights.min() >= 0
    np.testing.assert_allclose(weights.sum(axis=1), 1, atol=1e-6)


@pytest.mark.parametrize(("height", "width", "resolution"), SIZES)
def test_resampling_is_the_mean_over_each_texel(height, width, resolution):
    """Against brute force: the mean of many look-ups in every texel, weighted by solid angle."""
    pixels = np.random.default_rng(0).uniform(size=(height, width)).astype(np.float32)
    fine = 512 // resolution
    n = resolution * fine
    u, v = latlong.coordinates(cubemap.directions(n))
    row, column = np.minimum((v * height).astype(int), height - 1), np.minimum((u * width).astype(int), width - 1)
    weight = cubemap.solid_angles(n)

    def total(samples):
        return samples.reshape(6, resolution, fine, resolution, fine).sum(axis=(2, 4)).ravel()

    expected = total(weight * pixels[row, column]) / total(weight)
    np.testing.assert_allclose(shares(height, width, resolution) @ pixels.ravel(), expected, atol=0.02)


@pytest.mark.parametrize(("height", "width", "resolution"), [(8, 16, 7), (64, 128, 16)])
def test_applying_is_the_product_with_the_shares(height, width, resolution):
    pixels = np.random.default_rng(0).uniform(size=(height, width, 2)).astype(np.float32)
    pixels[..., 1] = 1
    texels = np.asarray(apply(latlong.area_resampling(height, width, resolution), pixels))
    np.testing.assert_allclose(texels, shares(height, width, resolution) @ pixels.reshape(-1, 2), rtol=1e-5)
    np.testing.assert_allclose(texels[:, 1], 1, atol=1e-6)


def test_resampling_does_not_retrace_for_other_pixels():
    traces = []

    @jax.jit
    def apply(resampling, pixels):
        traces.append(1)
        return resampling.apply(pixels)

    resampling = latlong.area_resampling(8, 16, 4)
    for value in (1.0, 2.0):
        np.testing.assert_allclose(apply(resampling, np.full((8, 16, 3), value, np.float32)), value, rtol=1e-6)
    assert len(traces) == 1
    assert latlong.area_resampling(8, 16, 4) is resampling


def test_look_up_finds_the_constant_cell():
    height, width = 4, 8
    pixels = np.arange(32, dtype=np.float32).reshape(height, width, 1)
    for offset in (0.01, 0.5, 0.99):
        u, v = np.meshgrid((np.arange(width) + offset) / width, (np.arange(height) + offset) / height)
        np.testing.assert_array_equal(look_up(pixels, u, v), pixels)
        np.testing.assert_array_equal(look_up(pixels, u + 1, v), pixels)
    corners = look_up(pixels, [0.0, 1.0], [0.0, 1.0])
    np.testing.assert_array_equal(corners[:, 0], [0, 24])


def test_interpolation_meets_the_cells_in_their_centres_and_is_linear_between():
    height, width = 4, 8
    pixels = np.random.default_rng(1).random((height, width, 2)).astype(np.float32)
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    np.testing.assert_allclose(interpolate(pixels, u, v), pixels, atol=1e-6)
    # Half-way to the right, also across the seam, and half-way down.
    np.testing.assert_allclose(
        interpolate(pixels, u + 0.5 / width, v), (pixels + np.roll(pixels, -1, axis=1)) / 2, atol=1e-6
    )
    np.testing.assert_allclose(interpolate(pixels, u - 3, v), pixels, atol=1e-5)
    between = interpolate(pixels, u[:-1], v[:-1] + 0.5 / height)
    np.testing.assert_allclose(between, (pixels[:-1] + pixels[1:]) / 2, atol=1e-6)


def test_interpolation_has_no_step_at_seam_and_poles():
    pixels = np.random.default_rng(2).random((4, 8, 3)).astype(np.float32)
    v = np.linspace(0, 1, 50)
    seam = [interpolate(pixels, np.full(50, u), v) for u in (0.0, 1e-6, 1 - 1e-6, 1.0)]
    for side in seam[1:]:
        np.testing.assert_allclose(side, seam[0], atol=1e-4)
    u = np.linspace(0, 1, 33)
    for pole, row in ((0.0, 0), (1.0, -1)):
        np.testing.assert_allclose(
            interpolate(pixels, u, np.full(33, pole)), np.tile(pixels[row].mean(axis=0), (33, 1)), atol=1e-6
        )


@pytest.mark.parametrize("shape", [(1, 1), (1, 5), (3, 1), (4, 8)])
def test_interpolation_of_a_constant_map_is_constant(shape):
    u, v = np.random.default_rng(3).random((2, 50))
    np.testing.assert_allclose(interpolate(np.full((*shape, 3), 0.7, np.float32), u, v), 0.7, rtol=1e-6)


@pytest.fixture
def image():
    return np.random.default_rng(0).uniform(size=(8, 16, 3)).astype(np.float32)


@pytest.mark.parametrize("turns", [0, 1, 3, 16, -5, 37])
def test_rotation_by_whole_pixels_is_a_roll(image, turns):
    np.testing.assert_array_equal(rotate(image, turns * 22.5), np.roll(image, -turns, axis=1))


@pytest.mark.parametrize("degrees", [0.0, 1.0, 22.0, 100.3, -7.7, 1234.5])
def test_rotation_keeps_every_rows_energy(image, degrees):
    turned = rotate(image, degrees)
    np.testing.assert_allclose(np.sum(turned, axis=1), np.sum(image, axis=1), rtol=1e-5)
    assert float(turned.min()) >= 0


def test_rotation_by_part_of_a_pixel_shares_it_by_area(image):
    expected = 0.75 * image + 0.25 * np.roll(image, -1, axis=1)
    np.testing.assert_allclose(rotate(image, 0.25 * 22.5), expected, rtol=1e-6)


def test_rotations_add_up(image):
    twice = rotate(rotate(image, 4 * 22.5), 7 * 22.5)
    np.testing.assert_allclose(twice, rotate(image, 11 * 22.5), rtol=1e-6)
    np.testing.assert_allclose(rotate(rotate(image, 4 * 22.5), 30.0), rotate(image, 120.0), rtol=1e-5)
    np.testing.assert_allclose(rotate(image, 360.0), image, rtol=1e-6)


def test_rotation_is_counter_clockwise_seen_from_above():
    """What was at +z is at +x after 90 degrees, and then at −z."""
    height, width = 8, 16

    def centre(pixels):
        u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
        total = np.einsum("hw,hwx->x", np.asarray(pixels[..., 0]), latlong.directions(u, v))
        return total / np.linalg.norm(total)

    bright = np.zeros((height, width, 3), np.float32)
    bright[3:5, 7:9] = 1
    np.testing.assert_allclose(centre(bright), [0, 0, 1], atol=1e-6)
    np.testing.assert_allclose(centre(rotate(bright, 90.0)), [1, 0, 0], atol=1e-6)
    np.testing.assert_allclose(centre(rotate(bright, 180.0)), [0, 0, -1], atol=1e-6)


def test_gradient_in_the_angle_is_the_finite_difference(x64):
    image = np.random.default_rng(0).uniform(size=(4, 8, 3))
    weight = np.random.default_rng(1).normal(size=(4, 8, 3))

    def value(degrees):
        return jnp.sum(weight * latlong.rotate(image, degrees))

    values, backwards, forwards = (jax.jit(f) for f in (value, jax.grad(value), jax.jacfwd(value)))
    for degrees in (10.0, 100.0, -33.0):
        difference = (float(values(degrees + 1e-3)) - float(values(degrees - 1e-3))) / 2e-3
        np.testing.assert_allclose(backwards(degrees), difference, rtol=1e-8)
        np.testing.assert_allclose(forwards(degrees), difference, rtol=1e-8)
    # At a whole pixel it is that of turning on.
    difference = (float(values(45.0 + 1e-3)) - float(values(45.0))) / 1e-3
    np.testing.assert_allclose(backwards(45.0), difference, rtol=1e-8)


def test_cells_left_of_the_seam_are_found():
    cells = np.arange(16, dtype=np.float32).reshape(1, 16, 1)
    values = look_up(cells, [-0.1, -0.01, 1.01], np.full(3, 0.5))
    np.testing.assert_array_equal(values.ravel(), [14, 15, 0])


def test_a_resampling_first_made_under_jit_can_be_used_afterwards():
    latlong.area_resampling.cache_clear()
    pixels = np.ones((6, 12, 3), np.float32)
    jax.jit(lambda pixels: latlong.area_resampling(6, 12, 4).apply(pixels))(pixels)
    np.testing.assert_allclose(apply(latlong.area_resampling(6, 12, 4), pixels), 1, rtol=1e-6)


@pytest.mark.parametrize("shape", [(3, 5), (12, 24), (2, 4), (5, 3)])
def test_resizing_arrays_of_jax_is_the_same_and_differentiable(x64, shape):
    pixels = np.random.default_rng(0).uniform(size=(6, 12, 2))
    resized = latlong.resized(jnp.asarray(pixels), *shape)
    assert isinstance(resized, jax.Array)
    np.testing.assert_allclose(resized, latlong.resized(pixels, *shape), rtol=1e-12)
    check_grads(jax.jit(lambda p: latlong.resized(p, *shape)), (jnp.asarray(pixels),), order=1, modes=["rev"])
