"""Measured materials from any view: fitted lobes at vertices against their tables, the object alone."""

import argparse
import dataclasses
import pathlib
import tempfile
from typing import Any

import numpy as np

from tests.benchmarks.measuring import Report, percent, shared

SCENE, MATERIAL = "bunny_phong", "object"
# File and the largest trimmed error that is to be reached under the first sky.
MATERIALS = {
    "golden yellow": ("rgl_vch_golden_yellow_rgb.bsdf", None),
    "ibiza sunset": ("rgl_cc_ibiza_sunset_rgb.bsdf", 0.15),
    "garnet": ("cornell_garnet_red.brdf", 0.10),
}
SKIES = {"Grace": "grace_latlong.exr", "Venice": "pmndrs_venice.exr"}


def main():
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.measured_vertices",
        description=__doc__,
        epilog="RESULTS.md is written only without options.",
    )
    parser.add_argument("--quick", action="store_true", help="small pictures, resolution 16, one material")
    arguments = parser.parse_args()
    side, resolution = (32, 16) if arguments.quick else (128, 64)
    materials = dict(list(MATERIALS.items())[: 1 if arguments.quick else None])
    parameters = f"{SCENE} with measured materials, {side}² pixels, resolution {resolution}"
    with (
        tempfile.TemporaryDirectory() as folder,
        Report("measured_vertices", "Measured materials at vertices", parameters, not arguments.quick) as report,
    ):
        report.text(
            "The reference is exact transport of every pixel with the table. The fit is the same with three lobes of "
            "`fitting.with_lobes`; filtered is those lobes at vertices; factors are 4, at vertices, of the table. "
            f"Errors under {' / '.join(SKIES)}, trimmed, untrimmed ones in brackets."
        )
        place = pathlib.Path(folder)
        rows = [row(name, file, target, side, resolution, place) for name, (file, target) in materials.items()]
        report.table(["material", "residual of the fit", "the fit", "filtered", "to be reached", "4 factors"], rows)
        report.speed()


def row(name: str, file: str, target: float | None, side: int, resolution: int, folder: pathlib.Path) -> list[str]:
    """One material by all means."""
    import fitting
    import jaxrelight as jr

    base = jr.load_scene(shared("reference", f"{SCENE}.toml"))
    brdf = jr.load_brdf(shared("data", "brdf", file)).brdf
    camera = dataclasses.replace(base.camera, width=side, height=side)
    measured = dataclasses.replace(base, materials={**base.materials, MATERIAL: brdf}, camera=camera)
    fitted, (account,) = fitting.with_lobes(measured)
    pixels: Any = {"resolution": resolution, "coefficients": "all"}
    exact = _pictures(measured, jr.Transport("pixels", **pixels), folder)
    errors = [
        _errors(_pictures(scene, method, folder), exact)
        for scene, method in (
            (fitted, jr.Transport("pixels", **pixels)),
            (fitted, jr.Transport("vertices", resolution=resolution)),
            (measured, jr.Transport("vertices", resolution=resolution)),
        )
    ]
    residual = account.partition("they are ")[2].partition(" off")[0]
    return [name, residual, errors[0], errors[1], f"≤ {percent(target)}" if target else "", errors[2]]


def _pictures(scene, method, folder: pathlib.Path) -> list[np.ndarray]:
    """The object's pixels under each sky."""
    import jaxrelight as jr

    relighter: Any = jr.prepare(scene, method, folder)
    view = relighter.view()
    names = [material.name for material in relighter.materials]
    (part,) = (part for part in view.surfaces.parts if names[part.material] == MATERIAL)
    shown = np.asarray(part.pixels.pixel)
    shown = shown[shown < np.prod(view.shape)]
    pictures = []
    for file in SKIES.values():
        image = relighter.shade(relighter.light(jr.load_environment(shared("data", "env", file))), view)
        pictures.append(np.asarray(image.radiance).reshape(-1, 3)[shown])
    return pictures


def _errors(actual: list[np.ndarray], wanted: list[np.ndarray]) -> str:
    from jaxrelight import image_error

    errors = [image_error(one[None], other[None]) for one, other in zip(actual, wanted, strict=True)]
    return " / ".join(f"{percent(error.trimmed)} ({percent(error.untrimmed)})" for error in errors)


if __name__ == "__main__":
    main()
