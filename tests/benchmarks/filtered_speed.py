"""What filtered light times filtered visibility costs: lights, views, bytes, and its precomputation."""

import argparse
import dataclasses
import itertools
import pathlib
import tempfile
from collections.abc import Iterator
from typing import Any

import numpy as np

from tests.benchmarks.measuring import Report, Timing, interleaved, megabytes, shared

SKY = "grace_latlong.exr"
EXPONENT = 50
SIDE = 512
RUNS = 9


def main():
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.filtered_speed",
        description=__doc__,
        epilog="RESULTS.md is written only without options.",
    )
    parser.add_argument("--quick", action="store_true", help="the bunny in place of the dragon, resolution 8")
    arguments = parser.parse_args()
    path = shared("data", "mesh", "bunny_mitsuba.ply" if arguments.quick else "dragon_vrip_res2_bin.ply")
    resolution, side = (8, 64) if arguments.quick else (64, SIDE)
    parameters = f"Phong {EXPONENT} on a mesh over a floor, vertices, resolution {resolution}, {side}² pixels, {SKY}"
    with (
        tempfile.TemporaryDirectory() as folder,
        Report("filtered_speed", "Filtered lobes: speed", parameters, not arguments.quick) as report,
    ):
        measure(report, path, resolution, side, pathlib.Path(folder))
        diffuse(report, resolution, min(side, 256), pathlib.Path(folder, "diffuse"))
        report.speed()


def measure(report: Report, path: pathlib.Path, resolution: int, side: int, folder: pathlib.Path):
    """One scene, by filtered lobes that are shaded by themselves and as narrower ones, and by factors."""
    import jax

    import jaxrelight as jr

    def done(tree: Any) -> Any:
        return jax.block_until_ready(jax.tree.leaves(tree))

    scene = jr.scene_of_mesh(path)
    scene = dataclasses.replace(
        scene,
        camera=dataclasses.replace(scene.camera, width=side, height=side),
        materials={**scene.materials, "plaster": jr.phong([0.4, 0.1, 0.1], 0.4, EXPONENT)},
    )
    sky = jr.load_environment(shared("data", "env", SKY))
    dials = {
        "filtered, the lobe itself": {"reflection_tolerance": 0.5},
        "filtered, 7 narrower lobes": {"reflection_tolerance": 0.01},
        "filtered, 19 narrower lobes": {"reflection_tolerance": 0.005},
        "4 factors, shared rows": {"reflection": "factors"},
    }
    relighters, builds = {}, {}
    from jaxrelight.lighting.prepare import prepare_with_build

    for name, given in dials.items():
        method = jr.Transport("vertices", resolution=resolution, split_sun=False, **given)
        relighters[name], builds[name] = prepare_with_build(scene, method, folder)
    lit = {name: relighter.light(sky) for name, relighter in relighters.items()}
    views = {name: relighter.view() for name, relighter in relighters.items()}
    others = _others(sky)
    lights = interleaved({n: lambda r=r: done(r.light(next(others))) for n, r in relighters.items()}, RUNS)
    turns = interleaved({n: lambda r=r: done(r.light(_turned(sky))) for n, r in relighters.items()}, RUNS)
    traced = interleaved({n: lambda r=r: done(r.view()) for n, r in relighters.items()}, 5)
    shades = interleaved({n: lambda n=n, r=r: done(r.shade(lit[n], views[n])) for n, r in relighters.items()}, RUNS)
    rows = []
    for name, relighter in relighters.items():
        lobes = relighter.transport.lobes
        held = sum(part.visibility.nbytes for part in lobes) if lobes else relighter.transport.operator.nbytes
        rows.append([name, megabytes(held), *(_ms(of[name]) for of in (lights, turns, traced, shades))])
    report.table(["reflection", "bytes", "a light", "a turned light", "a view: rays", "a view: shading"], rows)
    first = builds["filtered, the lobe itself"]
    rays, filtering = (first.seconds[stage] for stage in ("visibility", "filtered visibility"))
    report.text(
        f"{first.receivers:,} vertices. A light is an environment that was not seen before, a turned one the same by "
        "another angle each time. Times have the diffuse part in them; bytes are of the glossy part, but of "
        f"all rows for factors. Visibility took {rays:.1f} s of rays, and filtering it {filtering:.1f} s: "
        f"{filtering / rays:.2f} of that."
    )


def diffuse(report: Report, resolution: int, side: int, folder: pathlib.Path):
    """A diffuse mesh, a change of light and the picture, with and without a sun."""
    import jax

    import jaxrelight as jr

    def done(tree: Any) -> Any:
        return jax.block_until_ready(jax.tree.leaves(tree))

    scene = jr.load_scene(shared("reference", "bunny_lambert.toml"))
    scene = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, width=side, height=side))
    relighter = jr.prepare(scene, jr.Transport("vertices", resolution=resolution), folder)
    view, rows = relighter.view(), []
    for file in SKY, "blender_sunset.exr":
        sky = jr.load_environment(shared("data", "env", file))
        others = _others(sky)
        times = interleaved(
            {
                "light": lambda others=others: done(relighter.light(next(others))),
                "picture": lambda others=others: done(relighter.shade(relighter.light(next(others)), view)),
                "turned": lambda sky=sky: done(relighter.light(_turned(sky))),
                "again": lambda sky=sky: done(relighter.light(sky.with_(rotate_y=30.0))),
            },
            2 * RUNS + 1,
        )
        rows.append([file, *(_ms(timing) for timing in times.values())])
    report.text(
        f"**Diffuse**: bunny_lambert, clusters, {side}² pixels. Rays to a sun are remembered by its direction, of "
        "the cube map's: a turned light casts them where it was not yet, and turned to an angle again it does not."
    )
    report.table(["sky", "a light", "a light and the picture", "a turned light", "at an angle again"], rows)


_COUNT = itertools.count()


def _others(sky: Any) -> Iterator[Any]:
    """Environments in turn, more of them than maps are remembered of."""
    import jaxrelight as jr

    return itertools.cycle([jr.Environment(np.array(sky.pixels)) for _ in range(6)])


def _turned(sky: Any) -> Any:
    """The environment at an angle that did not come before."""
    return sky.with_(rotate_y=(37.3 * next(_COUNT)) % 360)


def _ms(timing: Timing) -> str:
    return str(timing)


if __name__ == "__main__":
    main()
