"""What commands that light share: they prepare a relighter, make a picture with it, and describe both in a summary."""

import dataclasses
import pathlib
from typing import Any

import jax
import numpy as np

from jaxrelight.command_line import versions
from jaxrelight.errors import InputError
from jaxrelight.geometry.camera import Camera
from jaxrelight.images.false_colour import false_colour
from jaxrelight.images.files import check_writable, write_image, write_layers
from jaxrelight.images.tone import AUTO_PERCENTILE, Exposure, Tone, auto_exposure, displayed, shown_pixels
from jaxrelight.lighting.contract import Image, Relighter
from jaxrelight.lighting.picture_error import PictureError
from jaxrelight.lighting.prepare import prepare_with_build
from jaxrelight.lights.lights import Lights
from jaxrelight.methods import Method, Prefiltered, Transport
from jaxrelight.precomputation.precompute import check_scene
from jaxrelight.progress import Report, notes
from jaxrelight.scene.scene import Scene
from jaxrelight.timing import timed

# Stages that trace rays: all of their time under an environment, with gathering where light is local.
_TRACING = "visibility", "between", "pixels"
# The least share of negative radiance that is told.
_TOLD_NEGATIVE = 0.001
# Displayed values above this are white; pictures are dark if nearly all values are below that. And the least share of
# clipped pixels that is told.
# The least share of backs of faces that is told: a few are seen at edges and through holes.
_TOLD_BEHIND = 0.1
_WHITE, _DARK, _TOLD_CLIPPED = 1 - 0.5 / 255, 0.1, 0.1


def check_output(output: pathlib.Path, layers: bool, error_samples: int = 0, tone: Tone = "linear") -> None:
    """Refuses, before long work, what cannot be written or measured, and layers or a tone curve in the wrong file."""
    if error_samples < 0:
        raise InputError(f"--error-samples must be at least 0, not {error_samples}")
    check_writable(output)
    if layers and output.suffix.lower() != ".exr":
        raise InputError(f"{output}: only an .exr holds layers; name one, or leave --layers out")
    if tone != "linear" and output.suffix.lower() != ".png":
        raise InputError(f"{output}: holds radiance, to which no tone curve applies; name a .png, or leave --tone out")


def scene_to_prepare(scene: Scene, method: Method, lights: Lights) -> Scene:
    """The scene, with the environment that will light it as its own where a resolution is to be chosen for that."""
    if not (isinstance(method, Transport) and method.resolution == "auto" and lights.environment is not None):
        return scene
    return dataclasses.replace(scene, lights=Lights(lights.environment, scene.lights.local))


def prepared(
    scene: Scene, method: Method, store: pathlib.Path | None, report: Report, summary: dict, seconds: dict[str, float]
) -> Relighter:
    """`prepare`; tells its notes, and adds what was precomputed to the summary and to the seconds."""
    if isinstance(method, Prefiltered) or (
        isinstance(method, Transport) and method.receivers == "vertices" and method.reflection != "factors"
    ):
        from fitting.scene_lobes import with_lobes

        if isinstance(method, Transport):
            check_scene(scene, method)
        with timed(fits := {}, "fit"):
            scene, lines = with_lobes(scene, report)
        if lines:
            notes(lines)
            seconds.update(fits)
    with timed(whole := {}, "prepare"):
        relighter, build = prepare_with_build(scene, method, store, report)
    seconds.update(whole if build is None else build.seconds)
    if build is not None:
        notes(build.notes)
        tracing = sum(build.seconds.get(stage, 0) for stage in _TRACING)
        summary |= {
            "store": str(build.folder),
            "receivers": build.receivers,
            "rays": build.rays,
            "rays_per_second": build.rays / max(tracing, 1e-9),
            "bytes": build.nbytes,
        }
        if build.account is not None:
            summary["left_out"] = {"line": build.account.line, **dataclasses.asdict(build.account)}
        if build.seconds.get("bounce 1") is not None:
            traced, above = build.gather_rays
            summary["gather_rays"] = {"traced": traced, "above_horizons": above}
    return relighter


def shaded(
    relighter: Any, lights: Any, view: Any, seconds: dict[str, float], background: bool = True, **how: Any
) -> tuple[Image, np.ndarray]:
    """A view under lights, as `shade` gives it, and its pixels, RGBA, with their background; adds to the seconds.

    `how` is what `shade` takes beside both; or `layers`, for a picture of all its layers.
    """
    with timed(seconds, "light"):
        lit = jax.block_until_ready(relighter.light(lights))
    with timed(seconds, "shade"):
        image = relighter.layers(lights, view) if how.pop("layers", False) else relighter.shade(lit, view, **how)
        return image, image.rgba(relighter.background(lit, view) if background else None)


def make_picture(
    command: Any,
    relighter: Relighter,
    lights: Lights,
    camera: Camera,
    seconds: dict[str, float],
    report: Report | None = None,
) -> dict:
    """Writes the picture that `render` or `relight` asks for; the summary of it, and of what lit it.

    What is done is added to the seconds.
    """
    with timed(seconds, "view"):
        view: Any = relighter.view(camera, command.view.antialiasing)
    is_png = command.output.suffix.lower() == ".png"
    how = {"background": command.picture.background == "environment", "layers": command.layers, "report": report}
    image, rgba = shaded(relighter, lights, view, seconds, **how)
    exposure, stops = command.picture.exposure, 0.0
    if is_png:
        stops = auto_exposure(rgba) if exposure == "auto" else exposure
    with timed(seconds, "write"):
        if command.layers:
            write_layers(command.output, rgba, {name: np.asarray(layer) for name, layer in image.layers.items()})
        else:
            write_image(command.output, rgba, stops, tone=command.picture.tone)
    with timed(seconds, "error"):
        error = image.measure(command.error_samples)
    left_out = relighter.method.leaves_out(lights.environment is not None, bool(lights.local))
    notes(f"{relighter.method.name} lighting leaves out {line}" for line in left_out)
    notes(relighter.notes_on(lights))
    negative = image.negative_share
    if negative >= _TOLD_NEGATIVE:
        notes(
            [
                f"{negative:.1%} of what is seen has negative radiance, which shows black: factors and coefficients "
                "that are left out leave it; more of them, or another form of factors, leave less"
            ]
        )
    clipped = told_clipped(rgba, exposure, command.picture.tone) if is_png else None
    behind = getattr(view, "surfaces", view).behind_share()
    if behind >= _TOLD_BEHIND:
        notes(
            [
                f"{behind:.0%} of what is seen are backs of faces, which are black; put the camera between the walls "
                "that face inwards (jaxrelight info says where), or give the mesh two_sided = true"
            ]
        )
    shown = rgba[..., 3] > 0
    plan = image.measured.get("plan")
    return {
        "picture": str(command.output),
        "width": rgba.shape[1],
        "height": rgba.shape[0],
        "antialiasing": command.view.antialiasing,
        "covered": float(rgba[..., 3].mean()),
        "mean_radiance": float(rgba[shown][:, :3].mean()) if shown.any() else 0.0,
        **({} if error is None else {"error": _describe_error(error)}),
        "negative": negative,
        "exposure": stops if is_png else None,
        "clipped": clipped,
        "lights": len(lights.local),
        "leaves_out": list(left_out),
        **({} if plan is None else _describe_plan(plan, view, command.maps)),
        **describe(relighter),
    }


def told_clipped(pixels: np.ndarray, exposure: Exposure, tone: Tone) -> float:
    """The share of what a .png shows of surfaces that is clipped to white in a channel; notes where a picture is bad.

    Args:
        pixels: RGBA of the picture.
        exposure: that was asked for.
        tone: its curve.
    """
    automatic = auto_exposure(pixels)
    seen = pixels[shown_pixels(pixels)]
    values = displayed(seen, automatic if exposure == "auto" else exposure, tone)
    clipped = float(np.mean((values > _WHITE).any(axis=-1)))
    hint = "" if exposure == "auto" else f"; --exposure auto takes {automatic:+.1f}"
    if not (seen[..., :3] > 0).any():
        notes(["the picture is black: no light reaches what is seen; look at the lights, and at what hides them"])
    elif np.percentile(values.max(axis=-1), AUTO_PERCENTILE) < _DARK:
        notes([f"the picture is nearly black at an exposure of {exposure}{hint}"])
    elif clipped > _TOLD_CLIPPED:
        notes([f"{clipped:.0%} of what is seen is clipped to white{hint}; --tone agx or filmic clips less"])
    return clipped


def _describe_error(error: PictureError) -> dict:
    """How far a picture is from its reference: `line` says it in words, the rest is for programs."""
    return {
        "line": str(error),
        **{name: dataclasses.asdict(getattr(error, name)) for name in ("trimmed", "untrimmed")},
        "parts": error.parts,
        "reference": error.reference,
        "not_measured": list(error.missing),
        "samples": error.samples,
    }


def _describe_plan(plan: Any, view: Any, maps: pathlib.Path | None) -> dict:
    """What adaptive lighting did; with pictures of bandwidth, levels, samples and predicted errors, if asked for."""
    covered = max(view.covered_count(), 1)
    if not plan.is_met:
        notes(
            [
                f"a tolerance of {float(plan.tolerance):g} cannot be met: {plan.error:.2g} is the least error that is "
                "predicted; ask for a larger one"
            ]
        )
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


def describe(relighter: Relighter) -> dict:
    """What lights, as a part of a summary."""
    transport = getattr(relighter, "transport", None)
    sizes: dict[str, Any] = (
        {} if transport is None else {"operator_bytes": transport.nbytes, "kept_energy": transport.kept}
    )
    method, chosen = relighter.method, None if transport is None else transport.stored.chosen_resolution
    if chosen is not None:
        sizes["chosen_resolution"] = {"line": str(chosen), **chosen.to_record()}
    return {"lighting": method.name, **sizes, "settings": dataclasses.asdict(method), "versions": versions()}
