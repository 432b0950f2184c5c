"""Direct-to-indirect transfer: rooms against reference images, and what a move of a light costs (Hašan 2006)."""

import argparse
import contextlib
import pathlib
import tempfile
from typing import Any

import numpy as np

from tests.benchmarks.measuring import Report, interleaved, megabytes, percent, shared

ROOMS = {"room_point": 0.03, "room_spot": 0.03, "room_glossy": 0.04}
KEPT: dict[str, dict[str, Any]] = {
    "all": {"tolerance": 0.0},
    "shared, 0.01": {"tolerance": 0.01},
    "shared, 0.02": {"tolerance": 0.02},
    "shared, 0.05": {"tolerance": 0.05},
    "shared, 0.02, 8 bits": {"tolerance": 0.02, "bits": 8},
    **{f"N = {count}": {"coefficients": count} for count in (10, 40, 100, 400)},
}


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.indirect", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="1,024 gather samples; RESULTS.md is left as it is")
    parser.add_argument("--folder", type=pathlib.Path, help="keep the stores here and reuse them")
    parser.add_argument("--only", choices=ROOMS, help="one of the rooms")
    arguments = parser.parse_args()
    samples = 1024 if arguments.quick else 16384
    parameters = f"{samples:,} gather samples, three bounces, errors by `image_error`, trimmed"
    with contextlib.ExitStack() as stack:
        folder = arguments.folder or pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
        write = not (arguments.quick or arguments.only)
        report = stack.enter_context(Report("indirect", "Direct-to-indirect transfer", parameters, write))
        for name, target in ROOMS.items():
            if arguments.only in (None, name):
                room(report, name, target, samples, folder / name)
        report.speed()


def room(report: Report, name: str, target: float, samples: int, folder: pathlib.Path):
    """One room by everything that may be kept."""
    import jax

    import jaxrelight as jr
    from jaxrelight.lighting.indirect import IndirectRelighter

    scene = jr.load_scene(shared("reference", f"{name}.toml"))
    none, three = (jr.read_image(shared("reference", f"{name}_b{bounces}.exr")) for bounces in (0, 3))
    alone = np.concatenate([three[..., :3] - none[..., :3], three[..., 3:]], axis=-1)
    rows = []
    for label, dials in KEPT.items():
        settings = jr.Settings("pixels", gather_samples=samples, bounces=3, **dials)
        made = jr.precompute(scene, settings, folder)
        relighter = IndirectRelighter(jr.load(made.folder, made.header, made.placed))
        whole = relighter.image(scene.lights)
        indirect = np.array(whole)
        indirect[..., :3] = np.asarray(relighter.indirect(scene.lights))
        errors = [jr.image_error(whole, three).trimmed, jr.image_error(indirect, alone).trimmed]
        energy = indirect[..., :3].sum() / alone[..., :3].sum()
        light = relighter.cloud_light(scene.lights)
        calls = {
            "between": lambda one=relighter, light=light: one.spread(light),
            "pixels": lambda one=relighter, light=light: one.gathered(light),
        }
        times = interleaved({call: lambda f=f: jax.block_until_ready(f()) for call, f in calls.items()}, 5)
        seconds = [f"{made.seconds[stage]:.0f}" for stage in ("between", "pixels")]
        size = sum(made.nbytes.get(kind, 0) for kind in ("between", "indirect"))
        milliseconds = [f"{times[call].median * 1e3:.1f}" for call in calls]
        rows.append([label, *map(percent, errors), percent(energy), *seconds, megabytes(size), *milliseconds])
    report.text(f"**`{name}`**; target for the whole image {percent(target)}, with N = 100; alone with all 3 %.")
    heads = [
        "kept",
        "whole",
        "indirect alone",
        "energy",
        "between / s",
        "pixels / s",
        "store",
        "spread / ms",
        "pixels / ms",
    ]
    report.table(heads, rows)


if __name__ == "__main__":
    main()
