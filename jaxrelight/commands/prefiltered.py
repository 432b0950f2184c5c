"""What `render --lighting prefiltered` does: a picture without a store."""

import pathlib
from typing import TYPE_CHECKING

from jaxrelight.commands.options import LightOptions, PictureOptions

if TYPE_CHECKING:
    from jaxrelight.brdf.spatial import Minification
    from jaxrelight.lighting.prefiltered import Texels
    from jaxrelight.scene.scene import Scene


def prefiltered_picture(
    scene: "Scene",
    light: LightOptions,
    output: pathlib.Path,
    picture: PictureOptions,
    *,
    shadows: bool,
    texels: "Texels",
    minification: "Minification",
    seconds: dict[str, float],
) -> dict:
    """Lights a scene by its prefiltered environment and its local lights, writes the picture and says what it took.

    Args:
        scene: with the camera.
        light: changes the scene's environment.
        output: the picture's file.
        picture: how it is written.
        shadows: whether local lights cast them.
        texels: what is interpolated between those of an SBRDF.
        minification: what is seen of texels smaller than pixels, see `look_at`.
        seconds: by stage; what is done here is added.

    Raises:
        InputError: for a scene without any light, or as `Seen.under` does.
    """
    import jax
    import numpy as np

    from jaxrelight.commands.progress import notes
    from jaxrelight.commands.relight import timed
    from jaxrelight.commands.seen_picture import written
    from jaxrelight.lighting.prefiltered import look_at
    from jaxrelight.lights.prefiltered import prefilter

    # Lights are enough.
    asked = light != LightOptions()
    environment = light.environment(scene.environment) if scene.environment or asked or not scene.lights else None
    with timed(seconds, "view"):
        seen = look_at(scene, minification)
    if environment is not None:
        notes(dict.fromkeys(environment.notes))
        notes(["prefiltered: the environment casts no shadows, and surfaces do not light each other"])
    image = np.zeros((*seen.covered.shape, 3), np.float32)
    maps_bytes = 0
    if environment is not None:
        with timed(seconds, "prefilter"):
            maps = jax.block_until_ready(prefilter(environment.pixels))
            maps_bytes = maps.texels.nbytes
        with timed(seconds, "environment"):
            image = image + np.asarray(seen.under(maps, environment.rotate_y, environment.scale, texels=texels))
    with timed(seconds, "lights"):
        image = image + np.asarray(seen.lit_by(scene.lights, shadows, texels))
    return {**written(scene, seen, image, environment, output, picture, seconds), "maps_bytes": maps_bytes}
