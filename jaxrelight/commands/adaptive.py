"""What `render --lighting adaptive` does: a picture without a store, shaded where bandwidth asks."""

import dataclasses
import math
import pathlib
from collections.abc import Callable
from typing import TYPE_CHECKING

from jaxrelight.commands.options import LightOptions, PictureOptions

if TYPE_CHECKING:
    import numpy as np

    from jaxrelight.brdf.spatial import Minification
    from jaxrelight.lighting.adaptive.planning import Plan
    from jaxrelight.scene.scene import Scene

# Root-mean-square error of displayed values, unless something else is asked for.
_TOLERANCE = 0.01


def adaptive_picture(
    scene: "Scene",
    light: LightOptions,
    output: pathlib.Path,
    picture: PictureOptions,
    *,
    samples: float | None,
    tolerance: float | None,
    maps: pathlib.Path | None,
    shadows: bool,
    minification: "Minification",
    antialiasing: int,
    seed: int,
    seconds: dict[str, float],
    report: Callable[[str, int, int], None],
) -> dict:
    """Lights a scene by samples of its environment and by its local lights, writes the picture and says what it took.

    Args:
        scene: with the camera.
        light: changes the scene's environment.
        output: the picture's file.
        picture: how it is written.
        samples: of a pixel, on average.
        tolerance: root-mean-square error of displayed values, in its place.
        maps: the folder for pictures of what was planned; None for none.
        shadows: whether surfaces hide lights from each other.
        minification: what is seen of texels smaller than pixels, see `look_at`.
        antialiasing: samples of the surface in a pixel: 1, 4 or 16.
        seed: of samples.
        seconds: by stage; what is done here is added.
        report: hears of progress.

    Raises:
        InputError: for a scene without any light, both dials, or what `look_at` refuses.
    """
    import jax
    import numpy as np

    from jaxrelight.commands.progress import notes
    from jaxrelight.commands.relight import timed
    from jaxrelight.commands.seen_picture import written
    from jaxrelight.errors import InputError
    from jaxrelight.lighting.adaptive.shader import AdaptiveShader
    from jaxrelight.lighting.prefiltered import look_at
    from jaxrelight.lights.pyramid import light_pyramid

    if samples is not None and tolerance is not None:
        raise InputError("--samples is a budget and --tolerance a quality; give one of both")
    for name, given in (("samples", samples), ("tolerance", tolerance)):
        if given is not None and not 0 < given < np.inf:
            raise InputError(f"--{name} is {given}; it must be above 0")
    asked = light != LightOptions()
    environment = light.environment(scene.environment) if scene.environment or asked or not scene.lights else None
    notes(dict.fromkeys((*scene.notes, *(environment.notes if environment else ()))))
    if maps is not None and environment is None:
        raise InputError("--maps shows how an environment is sampled, and there is none; leave it out, or give --env")
    if maps is not None:
        # Found now rather than after the work.
        try:
            maps.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise InputError(f"--maps {maps}: {error.strerror}") from None
    factor = math.isqrt(antialiasing)
    camera = scene.camera
    fine = dataclasses.replace(camera, width=factor * camera.width, height=factor * camera.height)
    with timed(seconds, "view"):
        seen = look_at(dataclasses.replace(scene, camera=fine), minification)
    image, told = np.zeros((*seen.covered.shape, 3), np.float32), {}
    if environment is not None:
        notes(["adaptive: surfaces do not light each other"])
        with timed(seconds, "light"):
            pyramid = light_pyramid(environment)
        with timed(seconds, "materials"):
            shader = AdaptiveShader(seen, fine, report=report, factor=factor)
        white = 2.0**-picture.exposure / max(environment.scale, 1e-30)
        if samples is None and tolerance is None:
            tolerance = _TOLERANCE
        with timed(seconds, "plan"):
            plan = shader.plan(pyramid, samples=samples, tolerance=tolerance, white=white, shadows=shadows)
        with timed(seconds, "shade"):
            radiance = jax.block_until_ready(shader.shade(plan, pyramid, seed, report=report))
        image = image + environment.scale * np.asarray(radiance)
        told = {
            "samples": factor**2 * plan.samples / max(int(seen.covered.sum()), 1),
            "shaded": plan.shaded / max(int(seen.covered.sum()) * len(plan.layers), 1),
            "predicted_error": {"between_pixels": plan.interpolation, "samples": plan.noise},
        }
        if maps is not None:
            told["maps"] = _write_maps(maps, plan, seen.covered)
    with timed(seconds, "lights"):
        image = image + np.asarray(seen.lit_by(scene.lights, shadows))
    return {**written(scene, seen, image, environment, output, picture, seconds, factor), **told}


def _write_maps(folder: pathlib.Path, plan: "Plan", covered: "np.ndarray") -> dict[str, list[float]]:
    """Pictures of bandwidth, levels, samples and predicted error; and what their ends stand for."""
    from jaxrelight.images import write_image
    from jaxrelight.images.false_colour import false_colour

    ends = {}
    for name, values in plan.maps().items():
        colours, ends[name] = false_colour(values, covered, octaves=name != "level")
        write_image(folder / f"{name}.png", colours)
    return {name: list(pair) for name, pair in ends.items()}
