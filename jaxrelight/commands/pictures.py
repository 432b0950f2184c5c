"""The picture that `render` and `relight` make of a relighter, and what they say of it."""

import pathlib
from typing import TYPE_CHECKING, Any

from jaxrelight.commands.options import PictureOptions
from jaxrelight.timing import timed

if TYPE_CHECKING:
    from jaxrelight.geometry.camera import Camera
    from jaxrelight.lighting.contract import Relighter
    from jaxrelight.lights.lights import Lights
    from jaxrelight.precomputation.precompute import StoreBuild


def check_output(output: pathlib.Path, layers: bool) -> None:
    """Finds before long work that a picture cannot be written.

    Raises:
        InputError: for a folder or a kind of file that cannot be, or layers in another file than an EXR.
    """
    from jaxrelight.errors import InputError
    from jaxrelight.images import check_writable

    check_writable(output)
    if layers and output.suffix.lower() != ".exr":
        raise InputError(f"{output}: only an .exr holds layers; name one, or leave --layers out")


def make_picture(
    relighter: "Relighter",
    lights: "Lights",
    camera: "Camera",
    output: pathlib.Path,
    picture: PictureOptions,
    seconds: dict[str, float],
    *,
    layers: bool = False,
    maps: pathlib.Path | None = None,
    report=None,
    **view_options: int,
) -> dict:
    """Lights what a camera sees, writes the picture, and says what it is.

    Args:
        relighter: of the scene.
        lights: on it.
        camera: any that the relighter can view.
        output: the picture's file.
        picture: how it is written.
        seconds: by stage; what is done here is added.
        layers: write the picture's layers, too.
        maps: the folder for pictures of what adaptive lighting planned; None for none.
        report: called with the progress.
        view_options: what the method's `view` takes beside the camera.
    """
    import jax
    import numpy as np

    from jaxrelight.commands.progress import notes
    from jaxrelight.images.files import write_image, write_layers

    left_out = relighter.method.leaves_out(lights.environment is not None, bool(lights.local))
    notes(f"{relighter.method.name} lighting leaves out {line}" for line in left_out)
    with timed(seconds, "view"):
        view = relighter.view(camera, **view_options)
    with timed(seconds, "light"):
        lit = jax.block_until_ready(relighter.light(lights))
    with timed(seconds, "shade"):
        image = jax.block_until_ready(relighter.shade(lit, view, report=report))
        behind = relighter.background(lit, view) if picture.background == "environment" else None
        rgba = image.rgba(behind)
    with timed(seconds, "write"):
        if layers:
            layered: Any = relighter
            write_layers(
                output, rgba, {name: np.asarray(of) for name, of in layered.layers(lights, view).layers.items()}
            )
        else:
            write_image(output, rgba, picture.exposure)
    shown = rgba[..., 3] > 0
    summary = {
        "picture": str(output),
        "width": rgba.shape[1],
        "height": rgba.shape[0],
        "covered": float(rgba[..., 3].mean()),
        "mean_radiance": float(rgba[shown][:, :3].mean()) if shown.any() else 0.0,
        "lights": len(lights.local),
        "leaves_out": list(left_out),
    }
    plan = image.measured.get("plan")
    return summary if plan is None else {**summary, **_describe_plan(plan, view, maps)}


def _describe_plan(plan: Any, view: Any, maps: pathlib.Path | None) -> dict:
    """What adaptive lighting did; with pictures of bandwidth, levels, samples and predicted errors, if asked for."""
    from jaxrelight.images import write_image
    from jaxrelight.images.false_colour import false_colour

    covered = max(view.covered_count(), 1)
    summary: dict[str, Any] = {
        "samples": view.factor**2 * plan.samples / covered,
        "shaded": plan.shaded / max(covered * len(plan.layers), 1),
        "predicted_error": {"between_pixels": float(plan.interpolation), "samples": float(plan.noise)},
    }
    if maps is not None:
        summary["maps"] = {}
        for name, values in plan.maps().items():
            colours, ends = false_colour(values, view.surfaces.covered, octaves=name != "level")
            write_image(maps / f"{name}.png", colours)
            summary["maps"][name] = list(ends)
    return summary


def describe(relighter: "Relighter") -> dict:
    """What a picture was lit with, as a part of a summary."""
    import dataclasses

    from jaxrelight.commands.summary import versions

    summary: dict[str, Any] = {"settings": dataclasses.asdict(relighter.method), "versions": versions()}
    transport = getattr(relighter, "transport", None)
    if transport is None:
        return summary
    return {"operator_bytes": transport.operator.nbytes, "kept_energy": transport.kept, **summary}


# Stages that trace rays: all of their time under an environment, with gathering where light is local.
_TRACING = "visibility", "between", "pixels"


def describe_build(build: "StoreBuild") -> dict:
    """What a precomputation did, as a part of a summary."""
    return {
        "store": str(build.folder),
        "receivers": build.receivers,
        "rays": build.rays,
        "rays_per_second": build.rays / max(sum(build.seconds.get(stage, 0) for stage in _TRACING), 1e-9),
        "bytes": build.nbytes,
    }
