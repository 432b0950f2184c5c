"""What `render` and `relight` do with local lights: direct light, and what surfaces make of it."""

import pathlib
from collections.abc import Sequence
from typing import TYPE_CHECKING

from jaxrelight.commands.options import LocalOptions, PictureOptions

if TYPE_CHECKING:
    from jaxrelight.lights.environment import Environment
    from jaxrelight.lights.local import Light
    from jaxrelight.transport.model import Transport

LEAVES_OUT = "caustics, and what glossy surfaces show of each other: only diffusely reflected light is passed on"
# What a sky is sampled by, for shadows and for the cloud alike.
SKY_SAMPLES = 256
# Along each side of a pixel.
_SAMPLES = 2


def check_indirect(lights, environment, emits: bool, output: pathlib.Path, dials: LocalOptions):
    """Finds before long work what no picture could be made of.

    Raises:
        InputError: where there is no light, samples are none, or layers are asked for in another file than an EXR.
    """
    from jaxrelight.errors import InputError

    if dials.samples is not None and not 1 <= dials.samples <= 16:
        raise InputError(f"--samples is {dials.samples}; it must be from 1 to 16")
    if dials.layers and output.suffix.lower() != ".exr":
        raise InputError(f"{output}: only an .exr holds layers; name one, or leave --layers out")
    if not (lights or environment or emits):
        raise InputError("there is no light; give the scene a [[light]], or name lights with --lights FILE")


def indirect_picture(
    transport: "Transport",
    lights: "Sequence[Light]",
    environment: "Environment | None",
    output: pathlib.Path,
    picture: PictureOptions,
    dials: LocalOptions,
    seconds: dict[str, float],
) -> dict:
    """Lights a store by local lights and samples of its sky, writes the picture and says what it took."""
    import jax
    import numpy as np

    from jaxrelight.images.files import write_image, write_layers
    from jaxrelight.lighting.indirect import IndirectRelighter
    from jaxrelight.lights.sky import sky_of
    from jaxrelight.precomputation.groups import timed

    sky = environment if transport.settings.sky else None
    every = [*lights, *([sky_of(environment, SKY_SAMPLES)] if environment and not sky else [])]
    with timed(seconds, "view"):
        relighter = IndirectRelighter(transport, dials.samples or _SAMPLES)
        jax.block_until_ready(relighter.view)
    behind = environment if picture.background == "environment" else None
    with timed(seconds, "light"):
        image = relighter.image(every, behind=behind, sky=sky)
    seen = image[..., 3] > 0
    with timed(seconds, "write"):
        if dials.layers:
            write_layers(output, image, relighter.layers(every, sky=sky))
        else:
            write_image(output, image, picture.exposure)
    camera = transport.camera
    return {
        "picture": str(output),
        "width": camera.width,
        "height": camera.height,
        "covered": float(image[..., 3].mean()),
        "mean_radiance": float(np.mean(image[seen][:, :3])) if seen.any() else 0.0,
        "lights": len(lights),
        "leaves_out": LEAVES_OUT,
    }
