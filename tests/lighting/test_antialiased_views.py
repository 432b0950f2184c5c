"""Several samples in a pixel under every lighting method: the mean of what they show, with smooth edges."""

import functools
import pathlib
import tempfile
from typing import Any

import equinox as eqx
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import InputError

SKY = jr.environment(np.random.default_rng(3).gamma(0.5, size=(8, 16, 3)).astype(np.float32))
ONES = jr.environment(np.ones((8, 16, 3), np.float32))
LAMP = jr.point([1.0, 2.0, 1.5], 4.0)
CAMERA = jr.Camera((0.3, 0.4, 3.0), (0, 0, 0), fov_y=45.0, width=14, height=12)
METHODS: dict[str, Any] = {
    "vertices": jr.Transport("vertices", receiver_tolerance=0, resolution=8),
    "pixels": jr.Transport("pixels", resolution=8),
    "prefiltered": jr.Prefiltered(map_rows=32, occlusion_resolution=0),
    "indirect": jr.Indirect(gather_samples=64, bounces=1, sky_samples=16),
    "adaptive": jr.Adaptive(samples=32, exposure=0.0),
}
SAMPLED = "vertices", "prefiltered"
# What adaptive lighting compiles takes a while.
EVERY = [*(name for name in METHODS if name != "adaptive"), pytest.param("adaptive", marks=pytest.mark.slow)]


@functools.cache
def relighter(name: str, albedo: float = 0.6) -> jr.Relighter:
    parts = [jr.Part(jr.sphere(0.8, 16), "ball")]
    scene = jr.Scene(parts, {"ball": jr.lambert(albedo)}, CAMERA, [SKY])
    folder = pathlib.Path(tempfile.mkdtemp()) if name in ("vertices", "pixels", "indirect") else None
    return jr.prepare(scene, METHODS[name], folder)


@functools.cache
def view(name: str, antialiasing: int):
    return relighter(name).view(antialiasing=antialiasing)


def shaded(name: str, antialiasing: int, lights=SKY):
    lit = relighter(name).light(lights)
    return relighter(name).shade(lit, view(name, antialiasing)), lit


def blocks(picture, factor: int = 2) -> np.ndarray:
    """Means over so many pixels along each side."""
    h, w = picture.shape[0] // factor, picture.shape[1] // factor
    return np.asarray(picture).reshape(h, factor, w, factor, -1).mean(axis=(1, 3)).reshape(h, w, *picture.shape[2:])


@pytest.mark.parametrize("name", SAMPLED)
def test_pictures_are_means_of_pictures_with_more_pixels(name: str):
    lights = [SKY, LAMP]
    image, lit = shaded(name, 4, lights)
    fine = relighter(name).view(jr.Camera(CAMERA.origin, CAMERA.target, fov_y=45.0, width=28, height=24))
    wanted = relighter(name).shade(lit, fine)
    assert image.radiance.shape == (12, 14, 3)
    np.testing.assert_allclose(image.radiance, blocks(wanted.radiance), rtol=1e-4, atol=1e-6)
    np.testing.assert_allclose(image.alpha, blocks(wanted.alpha), atol=1e-6)
    behind = relighter(name).background(lit, view(name, 4))
    np.testing.assert_allclose(behind, blocks(relighter(name).background(lit, fine)), rtol=1e-4, atol=1e-6)


@pytest.mark.parametrize("name", EVERY)
def test_coverage_is_the_share_of_samples(name: str):
    alpha = np.asarray(shaded(name, 4)[0].alpha)
    hard = np.asarray(shaded(name, 1)[0].alpha)
    assert set(np.unique(hard)) == {0, 1}
    assert ((alpha > 0) & (alpha < 1)).sum() >= 8
    np.testing.assert_array_equal(4 * alpha % 1, 0)
    assert np.abs(alpha - hard).max() < 1
    assert alpha.mean() == pytest.approx(hard.mean(), abs=0.03)


@pytest.mark.parametrize("name", ["vertices", "pixels", "prefiltered"])
def test_edges_are_as_bright_as_what_meets_there(name: str):
    """A white ball under a white sky cannot be seen: no sample is black, and none counts twice."""
    white = relighter(name, 1.0)
    lit, seen = white.light(ONES), white.view(antialiasing=16)
    picture = white.shade(lit, seen).rgba(white.background(lit, seen))
    np.testing.assert_allclose(picture[..., :3], 1, atol=0.03)


def test_samples_of_receivers_take_the_radiance_of_their_pixels_and_local_lights_of_their_own():
    soft, hard = (np.asarray(shaded("pixels", n)[0].radiance) for n in (4, 1))
    whole = np.asarray(shaded("pixels", 4)[0].alpha) == 1
    inner = np.zeros_like(whole)
    inner[1:-1, 1:-1] = whole[1:-1, 1:-1]
    assert inner.sum() > 20
    assert np.median(np.abs(soft - hard)[inner]) < 1e-6
    # Under a lamp alone there is nothing else: all of it is that of samples, as between vertices.
    pixels, vertices = (np.asarray(shaded(name, 4, LAMP)[0].radiance) for name in ("pixels", "vertices"))
    np.testing.assert_allclose(pixels[inner], vertices[inner], rtol=1e-4)
    assert pixels[inner].max() > 0.1


@pytest.mark.parametrize("name", EVERY)
def test_errors_are_measured_of_them_and_they_can_be_arguments_of_compiled_functions(name: str):
    image, lit = shaded(name, 4)
    assert image.error is not None
    assert 0 <= image.error.trimmed.value < 0.5
    if name == "adaptive":
        return
    of, seen = relighter(name), view(name, 4)
    traced = of.trace(lit, seen)
    compiled = eqx.filter_jit(lambda lit, seen, traced: of.shade(lit, seen, traced).radiance)(lit, seen, traced)
    np.testing.assert_allclose(compiled, image.radiance, rtol=1e-4, atol=1e-5)
    assert of.picture(SKY, antialiasing=4).shape == (12, 14, 4)


@pytest.mark.parametrize("name", METHODS)
def test_other_numbers_of_samples_are_refused(name: str):
    with pytest.raises(InputError, match="antialiasing is 2; it must be 1, 4 or 16"):
        relighter(name).view(antialiasing=2)


def test_what_no_pixel_sees_is_no_dark_spot(tmp_path):
    """A strip between the centres of pixels, which are the receivers: its samples are like none, and do not count."""
    upright, aside = np.array([[1.0, 0, 0, 0], [0, 0, -1, 0], [0, 1, 0, 0], [0, 0, 0, 1]]), np.eye(4)
    aside[0, 3] = 0.9
    strip = jr.transformed(jr.plane((0.08, 4), 1), upright)
    ball = jr.transformed(jr.sphere(0.3, 8), aside)
    camera = jr.Camera((0, 0, 3.0), (0, 0, 0), fov_y=45.0, width=14, height=12)
    parts = [jr.Part(strip, "grey"), jr.Part(ball, "grey")]
    scene = jr.Scene(parts, {"grey": jr.lambert(0.5)}, camera, [ONES])
    one = jr.prepare(scene, METHODS["pixels"], tmp_path)
    assert not np.asarray(one.view().surfaces.covered)[:, 6:8].any()
    image = one.shade(one.light(scene.lights), one.view(antialiasing=16))
    alpha = np.asarray(image.alpha)
    assert not alpha[:, 6:8].any()
    seen = alpha > 0
    assert np.asarray(image.radiance)[seen].min() > 0.3 * alpha[seen].min()
