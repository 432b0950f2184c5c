"""Pictures of what was found of the light: data, fit and residual, the environment, and what pictures tell of it."""

import pathlib

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxrelight.images import write_image
from jaxrelight.images.false_colour import false_colour
from jaxrelight.images.figures import log_bars, side_by_side
from jaxrelight.images.tone import auto_exposure
from jaxrelight.inverse.light_grid import LightGrid
from jaxrelight.inverse.observations import Picture
from jaxrelight.inverse.solve_light import InverseLight


def write_light_report(folder: pathlib.Path, found: InverseLight, pictures: list[Picture]) -> dict[str, str]:
    """Writes the pictures of a report, and says what each of them shows.

    Args:
        folder: that exists.
        found: the light.
        pictures: that it was found from.
    """
    shown: dict[str, str] = {}
    for number, (given, made) in enumerate(zip(pictures, found.pictures, strict=True), 1):
        data = np.asarray(given, np.float32)[..., :3]
        missed = np.abs(made - data).mean(axis=2)
        colours, (low, high) = false_colour(missed, np.ones(missed.shape, bool))
        name, stops = f"picture{number}.png", auto_exposure(data)
        write_image(folder / name, side_by_side([data * 2.0**stops, made * 2.0**stops, colours]))
        shown[name] = f"what is given, what the light makes, and the difference from {low:.3g} to {high:.3g}"
    certainty = found.certainty
    sky = np.asarray(found.environment.pixels)
    write_image(folder / "environment.exr", sky)
    write_image(folder / "environment.png", sky, auto_exposure(sky))
    shown |= {"environment.exr": "radiance of the environment", "environment.png": "the same, exposed"}
    maps = {
        "told.png": (certainty.texel_shares().mean(axis=1), "share of each direction's variance that pictures tell"),
        "detail.png": (certainty.details(), "degrees of the finest detail that pictures tell"),
        "deviation.png": (certainty.texel_deviations().mean(axis=1), "standard deviation of the radiance"),
    }
    for name, (values, what) in maps.items():
        on_map = _as_map(certainty.grid, values)
        colours, (low, high) = false_colour(on_map, np.ones(on_map.shape, bool))
        write_image(folder / name, colours)
        shown[name] = f"{what}, from {low:.3g} to {high:.3g}"
    values = found.singular_values.max(axis=1)
    write_image(folder / "singular_values.png", log_bars(values, found.strength))
    shown["singular_values.png"] = (
        f"singular values from {values.max(initial=0):.3g} down, by logarithm over six decades; the line is the ridge"
    )
    return shown


def _as_map(grid: LightGrid, values: Float[np.ndarray, " d"]) -> Float[np.ndarray, "h w"]:
    """Numbers of texels as a lat-long map of at least 128 rows."""
    pixels = np.asarray(grid.pixels(jnp.asarray(values, jnp.float32)[:, None]))[..., 0]
    repeat = max(1, 128 // len(pixels))
    return np.repeat(np.repeat(pixels, repeat, axis=0), repeat, axis=1)
