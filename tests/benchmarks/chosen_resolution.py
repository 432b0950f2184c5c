"""Resolution by need: what is chosen, and the error that was predicted against that of pictures."""

import argparse
import dataclasses
import pathlib
import tempfile
from typing import Any

from tests.benchmarks.measuring import Report, percent, shared

MODULE = "tests.benchmarks.chosen_resolution"
SKIES = {"Grace": "grace_latlong.exr", "sunset": "blender_sunset.exr", "Uffizi": "probulator_uffizi.hdr"}
SCENES = {
    "bunny": (("bunny_mitsuba.ply",), None),
    "bunny, Phong 30": (("bunny_mitsuba.ply",), 30),
    "staircase": (("staircase", "staircase_by_material.glb"), None),
}


def main():
    parser = argparse.ArgumentParser(prog=f"python -m {MODULE}", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one mesh, 12×12 pixels; RESULTS.md is left as it is")
    quick = parser.parse_args().quick
    side = 12 if quick else 36
    parameters = f"pixels, all coefficients, {side}×{side}; a tolerance of 2 %"
    with Report("chosen_resolution", "Resolution by need", parameters, not quick) as report:
        rows = [row for name in list(SCENES)[: 1 if quick else None] for row in _rows(name, side)]
        report.text(
            "By scene and sky: the resolution that is chosen, and the error against 256 of every resolution, predicted "
            "on 256 points and measured of the picture, both trimmed. The time is that of the choice in a new store; "
            "it is less than 0.1 s more than that of the geometry where the store has it."
        )
        report.table(["scene", "sky", "chosen", *(str(n) for n in _resolutions()[:-1]), "time"], rows)


def _resolutions() -> tuple[int, ...]:
    from jaxrelight.methods import RESOLUTIONS_BY_NEED

    return RESOLUTIONS_BY_NEED


def _rows(name: str, side: int) -> list[list[str]]:
    import jaxrelight as jr

    path, exponent = SCENES[name]
    scene = jr.scene_of_mesh(shared("data", "mesh", *path))
    materials: dict[str, Any] = dict(scene.materials)
    if exponent is not None:
        materials[scene.parts[0].material] = jr.phong(0.3, 0.5, exponent)
    camera = dataclasses.replace(scene.camera, width=side, height=side)
    scene = dataclasses.replace(scene, camera=camera, materials=materials)
    lights = {sky: jr.load_environment(shared("data", "env", of)) for sky, of in SKIES.items()}
    pictures: dict[int, dict[str, Any]] = {}
    rows = []
    with tempfile.TemporaryDirectory() as temporary:
        folder = pathlib.Path(temporary)
        for resolution in _resolutions():
            method = jr.Transport(resolution=resolution, coefficients="all")
            relighter = jr.prepare(scene, method, folder / "store")
            view = relighter.view()
            pictures[resolution] = {
                sky: relighter.shade(relighter.light(light), view).rgba() for sky, light in lights.items()
            }
        for sky, light in lights.items():
            chosen, seconds = _chosen(dataclasses.replace(scene, lights=light), folder / f"new {sky}")
            row = [name, sky, str(chosen.resolution)]
            for resolution, expected in chosen.errors.items():
                error = jr.image_error(pictures[resolution][sky], pictures[chosen.finest][sky])
                row.append(f"{percent(expected)}, {percent(error.trimmed)}")
            rows.append([*row, f"{seconds:.1f} s"])
            print(rows[-1], flush=True)
    return rows


def _chosen(scene: Any, folder: pathlib.Path) -> tuple[Any, float]:
    """The choice, and its seconds."""
    import jaxrelight as jr
    from jaxrelight.precomputation.chosen_resolution import with_resolution

    seconds: dict[str, float] = {}
    resolved = with_resolution(scene, jr.Transport(resolution="auto"), folder, lambda *progress: None, seconds)
    return resolved.chosen, seconds["resolution"]


if __name__ == "__main__":
    main()
