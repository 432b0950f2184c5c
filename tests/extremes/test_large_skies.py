"""A sky of 8192 × 4096 pixels in every method: what the process holds, and the slope of a picture in all pixels."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrelight as jr
from tests.benchmarks import large_skies
from tests.benchmarks.measuring import run_child
from tests.extremes.scenes import METHODS, ball, picture_of, plain

ROWS = 4096


@pytest.fixture(scope="module")
def sky_file(tmp_path_factory):
    file = tmp_path_factory.mktemp("skies") / "sky.exr"
    large_skies.write_sky(file, ROWS)
    return file


@pytest.mark.slow
@pytest.mark.parametrize("method", large_skies.METHODS)
def test_memory_is_a_few_maps(holds, sky_file, method):
    """From the file to a gradient by all pixels, the map counted in."""
    told = run_child(large_skies.MODULE, "--child", method, str(sky_file))
    for step, peak in told["peaks"].items():
        holds(f"{method}: memory over a map's of 8192 × 4096 pixels, {step}", peak, 3.0)


@pytest.mark.slow
@pytest.mark.parametrize("method", METHODS)
def test_slopes_in_pixels_times_the_map_are_the_picture(holds, method, tmp_path):
    """A picture is linear in a map without a sun. Its own map is made coarse on the host, that of slopes by JAX."""
    sky = jr.environment(np.random.default_rng(0).uniform(0.2, 1, (512, 1024, 3)).astype(np.float32))
    dials = METHODS[method]
    relighter = jr.prepare(ball(), dials, tmp_path if dials.is_stored else None)
    view, lit = relighter.view(), relighter.light(sky)
    traced = relighter.trace(lit, view) if method == "adaptive" else None

    def mean(pixels):
        return jnp.mean(relighter.shade(relighter.light(jr.Environment(pixels)), view, traced).radiance)

    slopes = np.asarray(jax.grad(mean)(sky.pixels), float)
    whole = float(np.mean(np.asarray(relighter.shade(lit, view, traced).radiance), dtype=float))
    holds(f"{method}: slopes in pixels against the picture", abs((slopes * sky.pixels).sum() / whole - 1), 1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("method", ["pixels", "vertices", "prefiltered", "adaptive"])
def test_a_sun_of_one_pixel_in_a_large_sky_keeps_its_energy(holds, method, tmp_path):
    """E = L cosθ Δω on an open plain, and radiance is albedo E / π."""
    row = 968
    pixels = np.full((ROWS, 2 * ROWS, 3), 1e-3, np.float32)
    pixels[row, 4808] = 2e8
    edges = np.cos(np.pi * np.array([row, row + 1]) / ROWS)
    solid_angle = (edges[0] - edges[1]) * np.pi / ROWS
    wanted = 0.5 / np.pi * (2e8 * np.cos(np.pi * (row + 0.5) / ROWS) * solid_angle + 1e-3 * np.pi)
    image = picture_of(plain(), method, jr.environment(pixels), tmp_path)
    holds(f"{method}: a sun in a pixel of 8192 × 4096", np.abs(image / wanted - 1).max(), 0.01)
