"""Extreme light: one sun, no light, maps of a pixel or two."""

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import InputError
from tests.extremes.scenes import ball, by, picture_of, plain

BLACK = jr.environment(np.zeros((2, 4, 3), np.float32))


@by()
def test_no_light_is_black(holds, method, tmp_path):
    image = picture_of(ball(), method, BLACK, tmp_path)
    holds(f"{method}: an all-black environment", np.abs(image).max(), 0.0)


@by()
def test_bad_pixels_are_repaired_and_counted_or_refused(holds, method, tmp_path):
    """The picture is that of a map which is black there."""
    good = np.random.default_rng(0).uniform(0.2, 1, (16, 32, 3)).astype(np.float32)
    bad = good.copy()
    good[3, 5] = good[7, 20] = good[12, 9] = 0
    bad[3, 5], bad[7, 20], bad[12, 9] = np.nan, -np.inf, -2.0
    with pytest.raises(InputError, match="2 NaN or infinite pixels"):
        jr.environment(bad)
    repaired = jr.environment(bad, zero_nonfinite=True)
    assert len(repaired.notes) == 2
    images = [
        picture_of(ball(), method, sky, tmp_path / name)
        for name, sky in (("good", jr.environment(good)), ("repaired", repaired))
    ]
    holds(f"{method}: pixels that are NaN, infinite and negative", np.abs(images[1] - images[0]).max(), 0.0)


@by()
@pytest.mark.parametrize("halves", [(2.0,), (1.0, 3.0)], ids=["1 × 1", "1 × 2"])
def test_maps_of_a_pixel_or_two_are_what_they_say(holds, method, halves, tmp_path):
    """An open plain that faces up gets the mean of both halves: radiance is albedo times that."""
    small = jr.environment(np.repeat(np.array(halves, np.float32)[None, :, None], 3, axis=2))
    image = picture_of(plain(), method, small, tmp_path)
    # A few directions stand for the sky of indirect lighting.
    limit = 0.02 if method == "indirect" else 5e-3
    holds(f"{method}: a map of 1 × {len(halves)} pixels", np.abs(image / (0.5 * np.mean(halves)) - 1).max(), limit)


@by("pixels", "vertices", "prefiltered", "adaptive")
def test_a_sun_of_a_million_on_a_plain_is_its_cosine(holds, method, tmp_path):
    """E = L cosθ Δω on an open plain, and radiance is albedo E / π; the rest of the sky is 1e-3."""
    height, row, column = 256, 60, 300
    pixels = np.full((height, 2 * height, 3), 1e-3, np.float32)
    pixels[row, column] = 1e6
    polar = np.pi * (row + 0.5) / height
    edges = np.cos(np.pi * np.array([row, row + 1]) / height)
    solid_angle = (edges[0] - edges[1]) * np.pi / height
    wanted = 0.5 / np.pi * (1e6 * np.cos(polar) * solid_angle + 1e-3 * np.pi)
    image = picture_of(plain(), method, jr.environment(pixels), tmp_path)
    holds(f"{method}: a sun of 1e6 in one pixel", np.abs(image / wanted - 1).max(), 0.01)
