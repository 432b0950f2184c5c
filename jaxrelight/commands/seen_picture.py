"""The end of rendering what a camera sees without a store: local lights, what is behind, the file, and what it is."""

import pathlib
from typing import TYPE_CHECKING

from jaxrelight.commands.options import PictureOptions

if TYPE_CHECKING:
    import numpy as np

    from jaxrelight.lighting.prefiltered import Seen
    from jaxrelight.lights.environment import Environment
    from jaxrelight.scene.scene import Scene


def written(
    scene: "Scene",
    seen: "Seen",
    image: "np.ndarray",
    environment: "Environment | None",
    output: pathlib.Path,
    picture: PictureOptions,
    seconds: dict[str, float],
    factor: int = 1,
) -> dict:
    """Puts the environment behind a picture, writes it, and says what it is.

    Args:
        scene: with the camera.
        seen: what it sees, with `factor` times its rows and columns.
        image: radiance of that.
        environment: behind it; None for none.
        output: the picture's file.
        picture: how it is written.
        seconds: by stage; what is done here is added.
        factor: of samples of the surface along each side of a pixel.
    """
    import jax.numpy as jnp
    import numpy as np

    from jaxrelight.commands.relight import timed
    from jaxrelight.commands.summary import versions
    from jaxrelight.images import write_image
    from jaxrelight.lighting.antialiasing import averaged

    if environment is not None and picture.background == "environment":
        image = np.where(seen.covered[..., None], image, np.asarray(seen.background(environment)))
    image = np.concatenate([image, seen.covered[..., None]], axis=-1, dtype=np.float32)
    if factor > 1:
        image = np.asarray(averaged(jnp.asarray(image), factor))
    shown = image[..., 3] > 0
    with timed(seconds, "write"):
        write_image(output, image, picture.exposure)
    return {
        "picture": str(output),
        "width": scene.camera.width,
        "height": scene.camera.height,
        "covered": float(seen.covered.mean()),
        "mean_radiance": float(image[shown][:, :3].mean()) if shown.any() else 0.0,
        "lights": len(scene.lights),
        "versions": versions(),
    }
