"""From an environment's file to the picture: bad pixels, other sizes, cube maps."""

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.basis import cubemap, latlong
from jaxrelight.lights.environment import load_environment
from jaxrelight.precomputation.precompute import precompute


@pytest.fixture(scope="module")
def relighter(tmp_path_factory) -> jr.Relighter:
    parts = [jr.Part(jr.plane((4, 4), 4), "paper"), jr.Part(jr.sphere(0.5, 8), "paper")]
    camera = jr.Camera(origin=(0, 1.5, 3), target=(0, 0, 0), width=16, height=16)
    scene = jr.Scene(parts, {"paper": jr.lambert(0.5)}, camera)
    folder = tmp_path_factory.mktemp("store") / "store"
    precompute(scene, jr.Transport("vertices", receiver_tolerance=0, resolution=8, coefficients=64), folder)
    return jr.open_store(folder)


@pytest.fixture(scope="module")
def picture(relighter):
    return relighter.picture


def _sky(height: int = 16) -> np.ndarray:
    return np.random.default_rng(0).uniform(0.2, 1, (height, 2 * height, 3)).astype(np.float32)


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf, -7.0])
def test_bad_pixels_of_a_file_are_black_in_the_light_and_no_others_change(tmp_path, picture, bad):
    spoilt, mended = _sky(), _sky()
    spoilt[3, 5], mended[3, 5] = bad, 0
    spoilt[2, 20, 1] = bad
    mended[2, 20] = [mended[2, 20, 0], 0, mended[2, 20, 2]] if np.isfinite(bad) else 0
    jr.write_image(tmp_path / "sky.exr", spoilt)
    made = load_environment(tmp_path / "sky.exr", 40, 2, zero_nonfinite=True)
    assert len(made.notes) == 1
    assert "2 " in made.notes[0]
    image = picture(made)
    assert np.isfinite(image).all()
    assert image.min() >= -1e-6
    np.testing.assert_array_equal(image, picture(jr.environment(mended, 40, 2)))
    jr.write_image(tmp_path / "picture.exr", image)
    np.testing.assert_array_equal(jr.read_image(tmp_path / "picture.exr"), image)
    if not np.isfinite(bad):
        with pytest.raises(jr.InputError, match=r"sky\.exr has 2 NaN or infinite pixels"):
            load_environment(tmp_path / "sky.exr")


@pytest.mark.slow
def test_the_same_light_in_files_of_other_sizes_and_kinds_is_the_same_picture(tmp_path, picture):
    """Constant cells split in other ways, and a cube map of the same smooth radiance."""
    sky = _sky(4)
    wanted = picture(jr.environment(sky))
    # Behind surfaces there is what is between the pixels, which their split changes.
    surface = wanted[..., 3] == 1
    for rows, columns in ((1, 3), (3, 2)):
        name = tmp_path / f"{rows}x{columns}.exr"
        jr.write_image(name, sky.repeat(rows, axis=0).repeat(columns, axis=1))
        image = picture(load_environment(name, layout="latlong"))
        np.testing.assert_allclose(image[surface], wanted[surface], rtol=2e-3)

    def smooth(direction):
        return (1.5 + direction @ [[1.0, 0, 0.2], [0, 1, 0.3], [0.1, 0, 1]]).astype(np.float32)

    u, v = np.meshgrid((np.arange(128) + 0.5) / 128, (np.arange(64) + 0.5) / 64)
    jr.write_image(tmp_path / "map.exr", smooth(latlong.directions(u, v)))
    jr.write_image(tmp_path / "strip.exr", np.concatenate(smooth(cubemap.directions(32)).reshape(6, 32, 32, 3), axis=1))
    maps = [picture(load_environment(tmp_path / name, 30)) for name in ("map.exr", "strip.exr")]
    np.testing.assert_allclose(maps[1], maps[0], atol=0.1)
    covered = maps[0][..., 3] == 1
    np.testing.assert_allclose(maps[1][covered], maps[0][covered], rtol=1e-3)


def test_a_map_of_one_pixel_lights_as_a_constant_one(picture):
    np.testing.assert_allclose(
        picture(jr.environment(np.full((1, 1, 3), 0.7))), picture(jr.environment(np.full((16, 32, 3), 0.7))), rtol=1e-5
    )


def test_a_strip_comes_back_from_a_store_as_the_map_it_was_made_to(tmp_path):
    environment = jr.environment(np.ones((6, 1, 3)) * np.arange(1, 7)[:, None, None], 20, 3)
    assert environment.pixels.shape == (8, 16, 3)
    flat = jr.environment(np.random.default_rng(0).random((4, 24, 3)), layout="latlong")
    for sky in (environment, flat):
        part = jr.Part(jr.plane((1, 1), 1), "paper")
        scene = jr.Scene([part], {"paper": jr.lambert(0.5)}, jr.Camera((0, 2, 1), (0, 0, 0)), sky)
        folder = tmp_path / str(sky.pixels.shape[0])
        precompute(scene, jr.Transport("vertices", receiver_tolerance=0, resolution=4, coefficients=8), folder)
        stored = jr.open_store(folder).scene_lights().environment
        assert stored is not None
        np.testing.assert_array_equal(stored.pixels, sky.pixels)
        assert (stored.rotate_y, stored.scale, stored.notes) == (sky.rotate_y, sky.scale, ())
