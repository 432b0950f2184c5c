"""Glossy pictures with two bounces: vertices with filtered lobes and bounced rows against exact pixels."""

import argparse
import dataclasses
import pathlib
import tempfile
import time
from typing import Any

import numpy as np

from tests.benchmarks.measuring import Report, percent, shared

SKIES = {"Grace": "grace_latlong.exr", "Venice": "pmndrs_venice.exr"}
# To be reached, trimmed.
TARGET = 0.05


def main():
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.glossy_bounces",
        description=__doc__,
        epilog="RESULTS.md is written only without options.",
    )
    parser.add_argument("--quick", action="store_true", help="spot in place of the bunny, resolution 8, small pictures")
    quick = parser.parse_args().quick
    side, resolution, bounces = (32, 8, 1) if quick else (128, 64, 2)
    parameters = f"bunny_phong, {side}² pixels, resolution {resolution}, {bounces} bounces"
    with (
        tempfile.TemporaryDirectory() as folder,
        Report("glossy_bounces", "Glossy pictures with bounces", parameters, not quick) as report,
    ):
        measure(report, side, resolution, bounces, pathlib.Path(folder), quick)
        report.speed()


def measure(report: Report, side: int, resolution: int, bounces: int, folder: pathlib.Path, quick: bool):
    """Errors of whole pictures and of the object's pixels alone."""
    import jaxrelight as jr

    text = shared("reference", "bunny_phong.toml").read_text()
    if quick:
        text = text.replace("bunny_mitsuba.ply", "spot.obj").replace("resolution = 176", "resolution = 8")
    path = folder / "scene.toml"
    path.write_text(text.replace("../data", str(shared("data").resolve())))
    scene = jr.load_scene(path)
    scene = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, width=side, height=side))
    dials: dict[str, Any] = {"resolution": resolution, **({"gather_resolution": 4} if quick else {})}
    ways = {
        "reference": jr.Transport("pixels", coefficients="all", bounces=bounces, **dials),
        "without bounces": jr.Transport("pixels", coefficients="all", **dials),
        "filtered lobes, bounces by 4 factors": jr.Transport("vertices", bounces=bounces, **dials),
    }
    truth, rows = [], []
    for way, method in ways.items():
        start = time.perf_counter()
        relighter: Any = jr.prepare(scene, method, folder / method.receivers)
        seconds, view = time.perf_counter() - start, relighter.view()
        pictures = [
            relighter.shade(relighter.light(jr.load_environment(shared("data", "env", file))), view).rgba()
            for file in SKIES.values()
        ]
        if not truth:
            truth = pictures
            continue
        names = [material.name for material in relighter.materials]
        (part,) = (part for part in view.surfaces.parts if names[part.material] == "object")
        shown = np.asarray(part.pixels.pixel)
        shown = shown[shown < side**2]
        cells = []
        for one, other in zip(pictures, truth, strict=True):
            own = [image[..., :3].reshape(-1, 3)[shown][None] for image in (one, other)]
            for error in (jr.image_error(one, other), jr.image_error(*own)):
                cells.append(f"{percent(error.trimmed)} ({percent(error.untrimmed)})")
        rows.append([way, *cells, f"{seconds:.0f} s"])
    report.text(
        "The reference is exact transport of pixels with as many bounces, all coefficients. Errors are trimmed, "
        f"untrimmed ones in brackets; to be reached are {percent(TARGET)}."
    )
    heads = [f"{sky}, {which}" for sky in SKIES for which in ("whole", "object alone")]
    report.table(["way", *heads, "precompute"], rows)


if __name__ == "__main__":
    main()
