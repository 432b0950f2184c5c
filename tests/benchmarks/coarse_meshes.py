"""Coarse meshes at vertices: what receivers where light needs them bring, against exact transport at pixels."""

import argparse
import dataclasses
import pathlib
import tempfile
import time
from typing import Any

import numpy as np

from tests.benchmarks.measuring import Report, percent, shared
from tests.benchmarks.shown_pixels import only, pixels_of

MODULE = "tests.benchmarks.coarse_meshes"
MESHES = {
    "teapot": "teapot.obj",
    "Cornell box": "CornellBox-Original.obj",
    "Sponza": "sponza_crytek_stripped.obj",
}
SKIES = {
    "Grace": "grace_latlong.exr",
    "Venice": "pmndrs_venice.exr",
    "sunset": "blender_sunset.exr",
    "Uffizi": "probulator_uffizi.hdr",
}
LAMP = "a lamp"
TOLERANCES = 0.0, 0.2, 0.1, 0.05


def main():
    parser = argparse.ArgumentParser(prog=f"python -m {MODULE}", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one mesh, resolution 8; RESULTS.md is left as it is")
    quick = parser.parse_args().quick
    resolution, side = (8, 48) if quick else (32, 192)
    parameters = (
        f"resolution {resolution}, all coefficients, {side}×{side}; files as they are, put on a floor and framed"
    )
    with Report("coarse_meshes", "Coarse meshes", parameters, not quick) as report:
        rows = [row for name in list(MESHES)[: 1 if quick else None] for row in _rows(name, resolution, side)]
        report.text(
            "By receiver tolerance, of which 0 leaves meshes as they are: receivers, seconds of the whole "
            "precomputation, and the error of the object's pixels alone against transport at pixels under each sky, "
            "trimmed / untrimmed. Last that of a lamp beside the camera, whose light needs no receivers: what halving "
            "faces in their planes changes of shading normals and of where shadow rays start."
        )
        report.table(["mesh", "tolerance", "receivers", "time", *SKIES, LAMP], rows)


def _rows(name: str, resolution: int, side: int) -> list[list[str]]:
    import jaxrelight as jr

    scene = jr.scene_of_mesh(shared("data", "mesh", MESHES[name]))
    scene = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, width=side, height=side))
    lights: dict[str, Any] = {sky: jr.load_environment(shared("data", "env", of)) for sky, of in SKIES.items()}
    lights[LAMP] = jr.point(_beside(scene.camera), 1.0)
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = pathlib.Path(temporary)
        exact = jr.prepare(scene, jr.Transport("pixels", resolution=resolution, coefficients="all"), folder / "exact")
        view = exact.view()
        objects = ~pixels_of("floor", exact, view)
        pictures = {sky: only(exact.shade(exact.light(light), view).rgba(), objects) for sky, light in lights.items()}
        for tolerance in TOLERANCES:
            method = jr.Transport("vertices", resolution=resolution, coefficients="all", receiver_tolerance=tolerance)
            start = time.perf_counter()
            relighter = jr.prepare(scene, method, folder / str(tolerance))
            seconds, view = time.perf_counter() - start, relighter.view()
            row = [name, f"{tolerance:g}", f"{relighter.transport.receivers.count:,}", f"{seconds:.1f} s"]
            for sky, light in lights.items():
                error = jr.image_error(relighter.shade(relighter.light(light), view).rgba(), pictures[sky])
                row.append(f"{percent(error.trimmed)} / {percent(error.untrimmed)}")
            rows.append(row)
            print(row, flush=True)
    return rows


def _beside(camera) -> np.ndarray:
    """A place above and to the left of the eye, as far from what it looks at."""
    origin, target = np.asarray(camera.origin, float), np.asarray(camera.target, float)
    towards, up = origin - target, np.array([0.0, 1.0, 0.0])
    place = towards + 0.8 * np.linalg.norm(towards) * up + 0.8 * np.cross(towards, up)
    return target + place * np.linalg.norm(towards) / np.linalg.norm(place)


if __name__ == "__main__":
    main()
