"""Precomputation, change of light and change of view over mesh size (Wang 2006, Tables I and II, Figure 12)."""

import argparse
import contextlib
import json
import pathlib
import tempfile

from tests.benchmarks.measuring import Report, Timing, megabytes, percent, shared
from tests.benchmarks.precompute import precompute_apart, relight_apart

# Meshes, and those of the paper's tables that are nearest in size.
MESHES = {
    "teapot": "teapot.obj",
    "dragon, 5k": "dragon_vrip_res4.ply",
    "dragon, 23k": "dragon_vrip_res3.ply",
    "bunny": "bunny_mitsuba.ply",
    "dragon, 100k": "dragon_vrip_res2_bin.ply",
}
# Vertices, minutes and MB of direct light with 1 and 4 terms (Table I); fps on GPU/CPU of view and light (Table II).
PAPER = (
    ("Bird", "25 K", "5.3 / 11 min", "35 / 82 MB", "230/79, 123/67", "31/13, -/5.8"),
    ("Bunny", "36 K", "5.6 / 14 min", "36 / 100 MB", "226/79, 97/62", "31/12, -/4.8"),
    ("Lucy", "102 K", "20 / 44 min", "83 / 273 MB", "173/35, 101/26", "-/5.9, -/1.8"),
)
# Quads along each side of the floor.
FLOOR = 176
SCENE = """
[camera]
origin = [0.3, 0.9, 2.3]
target = [0, 0.3, 0]
fov_y = 38.0
width = 256
height = 256
[environment]
file = {environment}
[[mesh]]
file = {mesh}
normalize = 1.0
material = "object"
[[mesh]]
primitive = "plane"
size = [2.4, 2.4]
resolution = {floor}
material = "floor"
[material.object]
type = "phong"
diffuse = [0.4, 0.1, 0.1]
specular = [0.4, 0.4, 0.4]
exponent = 50.0
[material.floor]
type = "lambert"
albedo = [0.5, 0.5, 0.5]
"""


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.mesh_size", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="resolution 8, a small mesh; RESULTS.md is left as it is")
    arguments = parser.parse_args()
    shared("data", "mesh")
    resolution, floor = (8, 16) if arguments.quick else (64, FLOOR)
    parameters = (
        f"each mesh, Phong 50 with a red diffuse colour, on a floor of {(floor + 1) ** 2:,} vertices, under Venice; "
        f"vertices as receivers, N = 128, resolution {resolution}; every store fresh, every process too; medians"
    )
    with contextlib.ExitStack() as stack:
        folder = pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
        report = stack.enter_context(Report("mesh_size", "Mesh size", parameters, not arguments.quick))
        measure(report, folder, resolution, dict(list(MESHES.items())[: 1 if arguments.quick else None]), floor)
        report.speed()


def measure(report: Report, folder: pathlib.Path, resolution: int, meshes: dict[str, str], floor: int):
    """Every mesh with 1 and with 4 terms."""
    rows = []
    for name, file in meshes.items():
        mesh, sky = shared("data", "mesh", file), shared("data", "env", "pmndrs_venice.exr")
        scene = folder / f"{mesh.stem}.toml"
        # JSON writes strings as TOML does.
        files = {"mesh": json.dumps(str(mesh.resolve())), "environment": json.dumps(str(sky.resolve()))}
        scene.write_text(SCENE.format(floor=floor, **files))
        for terms in (1, 4):
            store = folder / f"{mesh.stem}-{terms}"
            made = precompute_apart(scene, terms, resolution, store)
            lit = relight_apart(scene, store, resolution < 64)
            light, operator, view = (Timing(tuple(lit["seconds"][key])) for key in ("light", "terms", "view 256×256"))
            rows.append(
                [
                    name,
                    f"{made['receivers']:,}",
                    terms,
                    f"{made['rays'] / 1e6:.0f}",
                    *(f"{made['seconds'][stage]:.1f}" for stage in ("visibility", "transport")),
                    f"{made['wall']:.1f}",
                    megabytes(made["peak_memory"]),
                    megabytes(made["bytes"]["transport"]),
                    percent(lit["kept"]),
                    *(f"{timing.median * 1e3:.1f}" for timing in (light, operator, view)),
                ]
            )
    heads = ["mesh", "receivers", "K", "rays / M", "visibility / s", "transport / s", "whole / s", "peak memory"]
    heads += ["transport", "energy kept", "light / ms", "… operator / ms", "view / ms"]
    report.table(heads, rows)
    report.text(
        "The paper's, on a P4 of 2.4 GHz with a GeForce 6800; frames per second with a GPU / without, for 1, 4 terms:"
    )
    report.table(["model", "vertices", "direct light, 1 / 4 terms", "stored, 8 bit", "view", "light"], PAPER)


if __name__ == "__main__":
    main()
