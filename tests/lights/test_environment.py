"""Environments: what is mended, what is refused, and where the energy goes."""

import functools
from typing import Any

import jax
import numpy as np
import pytest

from jaxrelight.basis import cubemap, latlong
from jaxrelight.basis.haar import HaarFaces
from jaxrelight.errors import InputError
from jaxrelight.images import write_image
from jaxrelight.lights.environment import coarsened, encode, environment, load_environment

any_environment: Any = environment
any_encode: Any = encode


def sky(height: int = 8, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).uniform(0.1, 1, size=(height, 2 * height, 3)).astype(np.float32)


def energy(pixels) -> np.ndarray:
    """∫ L dω of every channel in float64."""
    return np.einsum("hwc,h->c", np.asarray(pixels, float), latlong.solid_angles(*pixels.shape[:2]))


def test_good_pixels_are_kept_as_they_are():
    pixels = sky()
    made = environment(pixels, 30, 2)
    np.testing.assert_array_equal(made.pixels, pixels)
    assert (made.rotate_y, made.scale, made.notes) == (30.0, 2.0, ())
    black = environment(np.zeros((4, 8, 3)))
    np.testing.assert_array_equal(black.pixels, 0)
    assert black.pixels.dtype == np.float32
    assert black.notes == ()


def test_whole_numbers_are_no_other_kind_of_environment():
    """Nothing is compiled anew for them; arrays stay as they are."""
    whole, real = environment(sky(), 30, 2), environment(sky(), 30.0, float(np.float32(2)))
    assert jax.tree.map(type, whole) == jax.tree.map(type, real)
    turned = real.with_(rotate_y=jax.numpy.asarray(40.0))
    assert isinstance(turned.rotate_y, jax.Array)
    assert type(turned.scale) is type(real.with_(scale=3).scale) is float


def test_negative_pixels_are_clamped_and_counted():
    pixels = sky()
    pixels[2, 3] = [-1, 0.5, 2]
    pixels[4, 5] = -1e-6
    made = environment(pixels, name="sky.exr")
    np.testing.assert_array_equal(made.pixels[2, 3], np.array([0, 0.5, 2], np.float32))
    np.testing.assert_array_equal(made.pixels[4, 5], 0)
    np.testing.assert_array_equal(made.pixels[0], pixels[0])
    assert len(made.notes) == 1
    assert made.notes[0].startswith("sky.exr: 2 pixels had negative")
    assert pixels[2, 3, 0] == -1  # the caller's own


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_pixels_that_are_not_finite_are_refused_or_zeroed_and_counted(bad):
    pixels = sky()
    pixels[2, 3, 1] = bad
    pixels[6, 0] = bad
    with pytest.raises(InputError, match=r"sky\.exr has 2 NaN or infinite pixels, the first in row 2, column 3;"):
        environment(pixels, name="sky.exr")
    made = environment(pixels, name="sky.exr", zero_nonfinite=True)
    assert np.isfinite(made.pixels).all()
    np.testing.assert_array_equal(made.pixels[2, 3], 0)
    np.testing.assert_array_equal(made.pixels[6, 1:], pixels[6, 1:])
    assert len(made.notes) == 1
    assert "2 NaN or infinite pixels were set to 0" in made.notes[0]


def test_a_fourth_channel_is_ignored_whatever_it_is():
    pixels = np.concatenate([sky(), np.full((8, 16, 1), np.nan, np.float32)], axis=-1)
    np.testing.assert_array_equal(environment(pixels).pixels, sky())


@pytest.mark.usefixtures("wrong_types")
@pytest.mark.parametrize("shape", [(8, 16), (8, 16, 1), (8, 16, 2), (8, 16, 5), ()])
def test_other_shapes_are_refused(shape):
    with pytest.raises(InputError, match="h × w pixels of three channels"):
        environment(np.ones(shape))


SIZES = [(1, 1), (1, 2), (3, 5), (7, 1), (1, 16384), (600, 3), (9, 4097)]
SIZES += [pytest.param(*size, marks=pytest.mark.slow) for size in ((5, 3), (16, 31))]
# Every way to encode, as one program for all numbers.
TEXELS, HAAR = cubemap.Texels(4), HaarFaces(4)
find_resampling = functools.cache(latlong.area_resampling)


def encoded(pixels, degrees=0.0, scale=1.0, basis: Any = TEXELS) -> np.ndarray:
    """Texels of a 6×4² cube map, as `TransportRelighter.light` finds them."""
    pixels = coarsened(pixels, 4)
    resampling = find_resampling(*pixels.shape[:2], 4)
    return np.asarray(any_encode(pixels, np.float32(degrees), np.float32(scale), resampling, basis), float)


@jax.jit
def decoded(light):
    return HAAR.decode(light.T).T


@pytest.mark.parametrize(("height", "width"), SIZES)
def test_maps_of_any_size_keep_constants_and_the_energy_of_a_hot_pixel(height, width):
    np.testing.assert_allclose(encoded(environment(np.ones((height, width, 3))).pixels, 33), 1, rtol=2e-6)
    hot = np.zeros((height, width, 3), np.float32)
    row, column = height // 3, (2 * width) // 3
    hot[row, column] = [1e5, 1, 0]
    expected = latlong.solid_angles(height, width)[row] * hot[row, column]
    for degrees in (0, 77.7):
        texels = encoded(environment(hot).pixels, degrees)
        np.testing.assert_allclose(cubemap.solid_angles(4) @ texels, expected, rtol=1e-5)
    if min(height, width) > 2:
        centre = (cubemap.solid_angles(4) * encoded(hot)[:, 0]) @ cubemap.directions(4)
        direction = latlong.directions(np.array((column + 0.5) / width), np.array((row + 0.5) / height))
        assert centre @ direction > 0


def test_a_map_of_other_sides_is_told_and_of_a_given_layout_is_not():
    assert environment(np.ones((3, 6, 3))).notes == ()
    assert environment(np.ones((3, 7, 3)), layout="latlong").notes == ()
    (note,) = environment(np.ones((3, 7, 3)), name="sky.exr").notes
    assert note.startswith("sky.exr: 7 × 3 pixels are not 2:1")


def test_a_smaller_map_in_other_cells_is_the_same_light():
    """Every pixel of 3 × 5 as 4 × 2 of its own: the cells are the same, so is their light."""
    pixels = np.random.default_rng(0).uniform(size=(3, 5, 3)).astype(np.float32)
    fine = pixels.repeat(4, axis=0).repeat(2, axis=1)
    np.testing.assert_allclose(encoded(pixels), encoded(fine), atol=2e-4)
    np.testing.assert_allclose(latlong.resized(fine, 3, 5), pixels, rtol=1e-6)


@pytest.mark.parametrize("name", ["sky.png", "sky.jpg"])
def test_eight_bit_pictures_are_decoded_from_srgb(tmp_path, name):
    from PIL import Image

    Image.fromarray(np.full((8, 16, 3), 188, np.uint8)).save(tmp_path / name)
    np.testing.assert_allclose(load_environment(tmp_path / name).pixels, 0.5029, rtol=0.01)


@pytest.mark.parametrize("name", ["sky.exr", "sky.hdr"])
def test_bad_pixels_from_file_to_light(tmp_path, name):
    """NaN, infinite and negative pixels of a file: refused, or repaired and counted, so that the light is finite."""
    pixels = sky(16)
    pixels[1, 2], pixels[3, 4], pixels[5, 6] = np.nan, np.inf, -1
    write_image(tmp_path / name, pixels)
    if name == "sky.hdr":  # which can hold none of them: NaN and negative are written as 0, infinity as the largest
        made = load_environment(tmp_path / name)
        assert made.notes == ()
        np.testing.assert_array_equal(made.pixels[[1, 5], [2, 6]], 0)
        assert made.pixels.max() > 1e38
        return
    with pytest.raises(InputError, match=r"sky\.exr has 2 NaN or infinite pixels, the first in row 1, column 2;"):
        load_environment(tmp_path / name)
    made = load_environment(tmp_path / name, zero_nonfinite=True)
    assert [note.split(" ", 2)[1] for note in made.notes] == ["2", "1"]
    np.testing.assert_array_equal(made.pixels[[1, 3, 5], [2, 4, 6]], 0)
    assert np.isfinite(encoded(made.pixels)).all()


@pytest.mark.parametrize("placement", [(np.nan, 1), (np.inf, 1), (0, -1), (0, np.nan), (0, np.inf)])
def test_bad_placement_is_refused(placement):
    with pytest.raises(InputError, match="rotate_y must be finite and scale finite and not negative"):
        any_environment(sky(), *placement)


def test_an_environment_turned_or_scaled_has_the_same_pixels_and_notes():
    made = environment(np.where(sky() < 0.2, -1, sky()), 30, 2, name="sky.exr")
    turned = made.with_(rotate_y=40.0)
    assert turned.pixels is made.pixels
    assert (turned.rotate_y, turned.scale, turned.notes) == (40.0, 2, made.notes)
    assert (made.with_(scale=3.0).rotate_y, made.with_(1.0, 1.0).scale) == (30, 1.0)
    with pytest.raises(InputError, match="rotate_y must be finite"):
        made.with_(scale=-1.0)


def test_load_reads_an_image_and_names_it(tmp_path):
    pixels = sky()
    pixels[0, 0, 0] = -1
    write_image(tmp_path / "sky.exr", pixels)
    made = load_environment(tmp_path / "sky.exr", 90, 0.5)
    np.testing.assert_array_equal(made.pixels, np.maximum(pixels, 0))
    assert (made.rotate_y, made.scale) == (90.0, 0.5)
    assert made.notes[0].startswith("sky.exr: 1 pixels")
    with pytest.raises(InputError, match="missing"):
        load_environment(tmp_path / "missing.exr")


@pytest.mark.parametrize(("height", "resolution", "wanted"), [(64, 4, 32), (256, 4, 32), (64, 8, 64), (8, 16, 8)])
def test_coarsened_keeps_energy_and_stops_in_time(height, resolution, wanted):
    pixels = sky(height)
    pixels[height // 3, height // 2] = 1e5
    pixels[0, 0] = 1e5
    coarse = coarsened(pixels, resolution)
    assert coarse.shape == (wanted, 2 * wanted, 3)
    assert coarse.dtype == np.float32
    np.testing.assert_allclose(energy(coarse), energy(pixels), rtol=1e-6)
    if wanted == height:
        np.testing.assert_array_equal(coarse, pixels)


def test_coarsened_keeps_constants_and_the_energy_of_odd_sizes():
    np.testing.assert_allclose(coarsened(np.ones((128, 256, 3), np.float32), 4), 1, rtol=1e-6)
    odd = np.random.default_rng(0).uniform(size=(75, 351, 3)).astype(np.float32)
    odd[31, 200] = 1e5
    coarse = coarsened(odd, 4)
    assert coarse.shape == (38, 88, 3)
    np.testing.assert_allclose(energy(coarse), energy(odd), rtol=1e-6)
    np.testing.assert_allclose(coarsened(np.ones_like(odd), 4), 1, rtol=1e-6)
    even = sky(64)
    np.testing.assert_allclose(
        coarsened(even, 4).mean(axis=1), latlong.resized(even, 32, 1)[:, 0], rtol=1e-6
    )  # pairs of rows and columns


def test_a_sun_over_a_dim_sky_keeps_both():
    """Everywhere but at the sun the texels are those of the sky alone, and the sums are those of float64."""
    dim = 1e-3 * sky(16)
    sunny = dim.copy()
    sunny[4, 20] = 1e5
    texels = {name: encoded(pixels) for name, pixels in (("dim", dim), ("sunny", sunny))}
    for name, pixels in (("dim", dim), ("sunny", sunny)):
        np.testing.assert_allclose(cubemap.solid_angles(4) @ texels[name], energy(pixels), rtol=1e-5)
    lit = texels["sunny"][:, 0] > 1
    assert 0 < lit.sum() <= 4
    np.testing.assert_allclose(texels["sunny"][~lit], texels["dim"][~lit], rtol=1e-6)
    # In Haar coefficients the sky survives to the rounding of float32 beside the sun.
    back = np.asarray(decoded(encoded(sunny, basis=HAAR).astype(np.float32)), float)
    np.testing.assert_allclose(back, texels["sunny"], atol=1e-6 * texels["sunny"].max())


def test_encode_is_scaled_rotated_and_linear():
    one, other = sky(16, 0), sky(16, 1)
    whole = encoded(one + 2 * other, 90, 3, HAAR)
    assert whole.shape == (96, 3)
    turned = [encoded(np.roll(pixels, -8, axis=1), basis=HAAR) for pixels in (one, other)]
    np.testing.assert_allclose(whole, 3 * (turned[0] + 2 * turned[1]), atol=1e-5 * np.abs(whole).max())
    texels = encoded(3 * np.roll(one + 2 * other, -8, axis=1))
    np.testing.assert_allclose(decoded(whole.astype(np.float32)), texels, rtol=1e-4)


def test_encode_has_gradients_in_pixels_rotation_and_scale(x64):
    """Forwards as central differences have it, and backwards as forwards."""
    resampling, random = find_resampling(16, 32, 4), np.random.default_rng(0)
    given = sky(16).astype(float), np.asarray(33.0), np.asarray(1.5)
    way = random.normal(size=(16, 32, 3)), np.asarray(2.0), np.asarray(0.3)
    back = random.normal(size=(96, 3))

    @jax.jit
    def value(pixels, degrees, scale):
        return encode(pixels, degrees, scale, resampling, HAAR)

    @jax.jit
    def slopes(given, way, back):
        return jax.jvp(value, given, way)[1], jax.vjp(value, *given)[1](back)

    forwards, backwards = slopes(given, way, back)
    ends = [value(*(x + step * w for x, w in zip(given, way, strict=True))) for step in (1e-6, -1e-6)]
    difference = (np.asarray(ends[0]) - np.asarray(ends[1])) / 2e-6
    np.testing.assert_allclose(forwards, difference, atol=1e-6 * np.abs(difference).max())
    along = sum(np.vdot(x, np.asarray(y)) for x, y in zip(way, backwards, strict=True))
    np.testing.assert_allclose(along, np.vdot(back, np.asarray(forwards)), rtol=1e-9)


def test_a_map_without_pixels_is_refused():
    with pytest.raises(InputError, match="shape"):
        environment(np.zeros((0, 0, 3)))


def test_what_float32_cannot_hold_is_refused_as_infinite():
    with pytest.raises(InputError, match="infinite"):
        environment(np.full((2, 4, 3), 1e39))
