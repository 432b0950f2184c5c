"""Six lamps to twelve targets of illuminance in a staircase, made by lamps that the solver does not know."""

import argparse
import contextlib
import json
import pathlib
import tempfile
import time

import numpy as np

from tests.benchmarks.large_scenes import CASES, scene_text
from tests.benchmarks.measuring import Report, answer, percent, run_child, shared

MODULE = "tests.benchmarks.inverse_lamps"
# Places of sensors, which look up, 0.85 m above the floor; the first row is before the stairs.
ACROSS, ALONG, HEIGHT = (-3.0, -1.5, 0.0, 1.5), (0.0, 1.8, 3.4), 0.85
# Hidden lamps: place, intensity, and of spots what they look at and their cutoff.
HIDDEN = [
    ([-2.8, 2.4, 0.1], 14.0, None, None),
    ([-0.4, 2.6, 0.7], 18.0, None, None),
    ([1.3, 2.2, 0.0], 12.0, None, None),
    ([-2.7, 2.6, 3.2], 40.0, [-2.9, 0.0, 2.2], 45.0),
    ([-1.0, 2.3, 2.3], 30.0, [-0.9, 0.0, 3.0], 50.0),
    ([0.7, 2.5, 3.3], 35.0, [0.3, 0.0, 2.6], 45.0),
]
# Where the solver starts from: two rows, all alike, spots that look down; and how far lamps may move from there. They
# stay away from walls, where the few points of a cloud that are near a lamp would count for too much.
BEGUN = [[x, 2.3, z] for z in (0.3, 2.8) for x in (-2.5, -0.75, 1.0)]
MOVES = [0.6, 0.4, 0.8]
TARGET, LIMIT = 0.03, 120.0


def main():
    parser = argparse.ArgumentParser(prog=f"python -m {MODULE}", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few points of the cloud; RESULTS.md is left as it is")
    parser.add_argument("--samples", type=int, default=16384, help="points of the clouds")
    parser.add_argument("--child", type=json.loads, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        child(**arguments.child)
        return
    shared("data", "mesh")
    samples, starts = (256, 2) if arguments.quick else (arguments.samples, 4)
    parameters = (
        f"the staircase, {samples:,} gather samples, three bounces; targets by hidden lamps; six lamps whose place and "
        f"intensity are free, and the aim of three spots, from {starts} starts; the check has a cloud of another seed, "
        "precomputed afresh in a process of its own"
    )
    with contextlib.ExitStack() as stack:
        folder = pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
        report = stack.enter_context(
            Report("inverse_lamps", "Lamps to targets of illuminance", parameters, not arguments.quick)
        )
        given = {"folder": str(folder.resolve()), "samples": samples, "starts": starts}
        told = run_child(MODULE, "--child", json.dumps(given))
        checked = run_child(MODULE, "--child", json.dumps(given | {"lamps": told["lamps"]}))
        tables(report, told, checked)
        report.speed()


def tables(report: Report, told: dict, checked: dict):
    """What was reached, and what each sensor has."""
    targets, found, fresh = (np.array(x) for x in (told["targets"], told["found"], checked["found"]))
    by_own, by_fresh = found / targets - 1, fresh / targets - 1
    hidden = np.array(checked["hidden"]) / targets - 1
    rows = [
        ["unknowns, of which the targets determine", f"{told['unknowns']}, {told['determined']}"],
        ["largest error by the solver's own precomputation", percent(np.abs(by_own).max())],
        [f"by a fresh one (target ≤ {TARGET:.0%})", percent(np.abs(by_fresh).max())],
        ["of the hidden lamps by the fresh one: what two precomputations differ by", percent(np.abs(hidden).max())],
        ["root mean square of relative errors, by start", ", ".join(percent(x) for x in told["by_start"])],
        [
            f"seconds, of which compiling and setting up (target ≤ {LIMIT:.0f})",
            f"{told['total']:.0f}, {told['set_up']:.0f}",
        ],
        ["processor seconds of that, on all cores", f"{told['processor']:.0f}"],
        ["again, with all compiled", f"{told['again']:.1f} s, of processors {told['processor_again']:.1f} s"],
        ["precomputation, not counted above", f"{told['precompute']:.0f} s"],
        ["bounced light at sensors, of all", percent(told["bounced"])],
    ]
    report.table(["what", "measured"], rows)
    lines = [
        [f"{x:g}, {z:g}", f"{lux:.0f}", f"{own:.0f}", f"{other:.0f}", percent(abs(error))]
        for (x, z), lux, own, other, error in zip(places(), targets, found, fresh, by_fresh, strict=True)
    ]
    report.table(["sensor at x, z / m", "target / lux", "found", "found, fresh", "off"], lines)


def places() -> list[tuple[float, float]]:
    """Of the sensors."""
    return [(x, z) for z in ALONG for x in ACROSS]


def child(folder: str, samples: int, starts: int, lamps: list | None = None):
    """Precomputes and solves; or, of lamps that were found, precomputes another cloud and measures."""
    import jaxrelight as jr
    from jaxrelight.inverse.lamp_targets import LuxTarget
    from jaxrelight.inverse.solve_lamps import lamps as solve

    mesh, materials, origin, target, fov_y, _ = CASES["staircase"]
    camera, _, others = scene_text(mesh, materials, origin, target, fov_y, 1e30).partition("[environment]")
    text = camera + "[[mesh]]" + others.partition("[[mesh]]")[2].replace("max_edge = 1e+30\n", "")
    sensors = "".join(
        f'\n[[sensor]]\nname = "{number}"\npoints = [[{x}, {HEIGHT}, {z}]]' for number, (x, z) in enumerate(places(), 1)
    )
    path = pathlib.Path(folder, "staircase.toml")
    path.write_text(text + sensors)
    scene, seed = jr.load_scene(path), 0 if lamps is None else 1
    start = time.perf_counter()
    method = jr.Indirect(gather_samples=samples, bounces=3, seed=seed)
    relighter = jr.prepare(scene.at_sensors(), method, pathlib.Path(folder, f"store{seed}"))
    precompute = time.perf_counter() - start
    hidden = [_lamp(*one) for one in HIDDEN]

    def lux(lights) -> list[float]:
        return np.asarray(jr.measure(relighter, lights).illuminance, float).tolist()

    if lamps is not None:
        answer({"found": lux([_lamp(*one) for one in lamps]), "hidden": lux(hidden), "precompute": precompute})
        return
    targets = lux(hidden)
    spots = [one[2] is not None for one in HIDDEN]
    begun = [
        _lamp(at, 20.0, [at[0], 0.0, at[2]] if spot else None, 45.0 if spot else None)
        for at, spot in zip(BEGUN, spots, strict=True)
    ]
    free = {number: ["intensity", "position"] + ["aim"] * spot for number, spot in enumerate(spots)}
    box = {number: np.stack([np.subtract(at, MOVES), np.add(at, MOVES)]) for number, at in enumerate(BEGUN)}
    asked = {str(number): LuxTarget(values=[value]) for number, value in enumerate(targets, 1)}
    begin, busy = time.perf_counter(), time.process_time()
    found = solve(relighter, asked, free=free, lights=begun, box=box, starts=starts)
    total, processor = time.perf_counter() - begin, time.process_time() - busy
    begin, busy = time.perf_counter(), time.process_time()
    solve(relighter, asked, free=free, lights=begun, box=box, starts=starts)
    again, processor_again = time.perf_counter() - begin, time.process_time() - busy
    lit, view = relighter.light(found.lights, bounces=0), relighter.view()
    direct = 179 * np.pi * np.asarray(relighter.shade(lit, view).radiance)[0] @ [0.2126, 0.7152, 0.0722]
    told = {
        "targets": targets,
        "found": [fit.found for fit in found.targets],
        "lamps": [_told(lamp) for lamp in found.lamps],
        "unknowns": len(found.unknowns),
        "determined": len(found.unknowns) - len(found.undetermined),
        "by_start": list(found.starts),
        "total": total,
        "set_up": found.seconds["set up"],
        "again": again,
        "processor": processor,
        "processor_again": processor_again,
        "precompute": precompute,
        "bounced": float(1 - direct.sum() / sum(lux(found.lights))),
    }
    answer(told)


def _lamp(place, intensity, aim, cutoff):
    """A point light, or a spot where there is an aim."""
    import jaxrelight as jr

    return jr.point(place, intensity) if aim is None else jr.spot(place, aim, intensity, cutoff)


def _told(lamp) -> list:
    """What `_lamp` makes it of."""
    is_spot = hasattr(lamp, "target")
    place, intensity = np.asarray(lamp.position).tolist(), np.asarray(lamp.intensity).tolist()
    return [
        place,
        intensity,
        np.asarray(lamp.target).tolist() if is_spot else None,
        float(lamp.cutoff) if is_spot else None,
    ]


if __name__ == "__main__":
    main()
