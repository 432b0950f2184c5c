"""An environment's mipmap: means by solid angle, what is looked up, and bandwidth."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight import environment
from jaxrelight.basis import latlong
from jaxrelight.lights import environment_mipmap as environment_mipmap_file
from jaxrelight.lights.environment_mipmap import cells, environment_mipmap, light_bandwidth

_RANDOM = np.random.default_rng(1).normal(size=(200, 3))
DIRECTIONS = (_RANDOM / np.linalg.norm(_RANDOM, axis=1, keepdims=True)).astype(np.float32)


def noise(rows: int) -> np.ndarray:
    return np.random.default_rng(0).random((rows, 2 * rows, 3)).astype(np.float32)


@jax.jit
def _found(light, solid_angle):
    return jax.vmap(lambda one: light.radiance_at(one, solid_angle))(DIRECTIONS)


def radiance(light, solid_angle) -> np.ndarray:
    return np.asarray(_found(light, None if solid_angle is None else np.float32(solid_angle)))


@jax.jit
def _details(light, solid_angle):
    return jax.vmap(lambda one: light.detail_at(one, solid_angle))(DIRECTIONS)


@jax.jit
def _looked_up(of, u, v, solid_angle):
    return jax.vmap(lambda u, v: of.look_up(u, v, solid_angle))(u, v)


@functools.cache
def places() -> tuple[np.ndarray, np.ndarray]:
    """Where the directions lie on the map."""
    u, v = jax.jit(latlong.finite_coordinates)(DIRECTIONS)
    return np.asarray(u), np.asarray(v)


def test_small_cells_are_pixels():
    pixels = noise(16)
    wanted = jax.jit(latlong.look_up)(pixels, *places())
    light = environment_mipmap(environment(pixels))
    np.testing.assert_array_equal(radiance(light, None), wanted)
    np.testing.assert_array_equal(radiance(light, 1e-9), wanted)


@pytest.mark.parametrize("rows", [8, 16, 12])
def test_the_largest_cells_are_means_by_solid_angle(rows: int):
    pixels = noise(rows)
    weight = latlong.solid_angles(rows, 2 * rows)[:, None, None]
    for half, columns in enumerate((slice(None, rows), slice(rows, None))):
        wanted = (weight * pixels[:, columns]).sum(axis=(0, 1)) / (2 * np.pi)
        np.testing.assert_allclose(cells(pixels).values[half - 2, :3], wanted, rtol=1e-5)


@pytest.mark.parametrize("solid_angle", [None, 1e-6, 0.02])
def test_channels_are_looked_up_apart(solid_angle: float | None):
    """However many there are."""
    pixels = np.concatenate([noise(16), 1 + noise(16)], axis=2)
    asked = None if solid_angle is None else np.float32(solid_angle)

    def seen(pixels) -> np.ndarray:
        return np.asarray(_looked_up(cells(pixels), *places(), asked))

    apart = np.concatenate([seen(pixels[..., k : k + 1]) for k in range(6)], axis=1)
    for channels in range(1, 7):
        np.testing.assert_allclose(seen(pixels[..., :channels]), apart[:, :channels], rtol=1e-6)


@pytest.mark.parametrize("rows", [1, 2, 12, 64])
@pytest.mark.parametrize("solid_angle", [1e-6, 1e-2, 0.3, 20])
def test_a_constant_sky_is_constant(rows: int, solid_angle: float):
    light = environment_mipmap(environment(np.full((rows, 2 * rows, 3), 0.7, np.float32)))
    np.testing.assert_allclose(radiance(light, solid_angle), 0.7, rtol=1e-5)
    mean, square, bandwidth = _details(light, np.float32(solid_angle))
    np.testing.assert_allclose(mean, 0.7, rtol=1e-5)
    np.testing.assert_allclose(square, 0.49, rtol=1e-5)
    assert not np.asarray(bandwidth).any()


@pytest.mark.parametrize("solid_angle", [4.3e-4, 6e-4, 8.5e-4, 1.2e-3, 2.4e-3, 3.4e-3])
def test_cells_are_as_wide_as_is_asked(solid_angle: float):
    """A light as small as a texel, looked up all around, looks as large, to √2, as a tent between cells so large."""
    rows = 256
    pixels = np.zeros((rows, 2 * rows, 1), np.float32)
    pixels[rows // 2, rows] = 1
    of, near = cells(pixels), np.linspace(-0.25, 0.25, 4001)
    u, v = 0.5 + near / (2 * np.pi), np.full(len(near), 0.5 + 0.5 / rows)
    seen = _looked_up(of, u.astype(np.float32), v.astype(np.float32), np.float32(solid_angle))
    seen = np.asarray(seen, float)[:, 0]
    seen /= seen.sum()
    variance = np.sum(seen * (near - np.sum(seen * near)) ** 2)
    assert solid_angle / 6 / 1.5 < variance < solid_angle / 6 * 1.5


def test_turning_is_a_turn_of_the_map():
    pixels = noise(16)
    quarter = environment_mipmap(environment(pixels, rotate_y=90))
    turned = np.asarray(jax.jit(latlong.rotate)(pixels, np.float32(90)))
    np.testing.assert_array_equal(radiance(quarter, None), radiance(environment_mipmap(environment(turned)), None))


def test_waves_have_their_bandwidth():
    """A wave of k periods around the equator has k / 2π cycles per radian, within an octave."""
    u = (np.arange(256) + 0.5) / 256
    for k in (4, 16, 64):
        pixels = np.broadcast_to(1 + np.sin(2 * np.pi * k * u)[None, :, None], (128, 256, 3))
        band = light_bandwidth(np.asarray(pixels, np.float32))[48:80]
        assert k / (2 * np.pi) / 2.9 <= np.median(band) <= 2.9 * k / (2 * np.pi)


def test_differentiable_in_pixels():
    def total(pixels):
        of = cells(pixels)
        return jnp.sum(jax.vmap(of.look_up)(*np.asarray([[0.1, 0.6], [0.3, 0.7], [1e-6, 0.2]], np.float32)))

    gradient = np.asarray(jax.jit(jax.grad(total))(noise(8)))
    # Means' weights sum to 1 for each of two look-ups and three channels.
    np.testing.assert_allclose(gradient.sum(), 6, rtol=1e-5)
    assert (gradient >= 0).all()


def test_maps_of_too_many_rows_are_made_coarse_first(monkeypatch):
    monkeypatch.setattr(environment_mipmap_file, "_MAX_ROWS", 16)
    fine = noise(48)
    light = environment_mipmap(environment(fine))
    wanted = environment_mipmap(environment(latlong.resized(fine, 16, 32)))
    assert light.radiance.rows == 16
    np.testing.assert_allclose(light.radiance.values, wanted.radiance.values, rtol=1e-6)
    assert light.detail is not None
    assert wanted.detail is not None
    np.testing.assert_allclose(light.detail.values, wanted.detail.values, rtol=1e-5)


@pytest.mark.parametrize("degrees", [0.0, 70.0])
def test_a_sun_is_split_off_and_turns_with_the_map(degrees: float):
    pixels = noise(128)
    pixels[40, 100] = 1e5
    light = environment_mipmap(environment(pixels, rotate_y=degrees))
    sun = light.sun
    towards = np.asarray(sun.irradiance).sum(axis=1) @ np.asarray(sun.directions)
    towards /= np.linalg.norm(towards)
    # What is left there is no brighter than all else, and is where the sun was.
    assert np.asarray(light.radiance.values).max() < 4
    u, v = jax.jit(latlong.finite_coordinates)(towards)
    place = np.array([(float(u) + degrees / 360) % 1 * 256, float(v) * 128])
    np.testing.assert_allclose(place, [100.5, 40.5], atol=0.05)
    energy = latlong.solid_angles(128, 256)[40] * 1e5
    np.testing.assert_allclose(np.asarray(sun.irradiance).sum(axis=0), energy, rtol=1e-3)
