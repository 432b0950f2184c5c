"""What a user waits for at the start: first pictures, with nothing compiled, second ones, and those of another size."""

import argparse
import dataclasses
import json
import os
import pathlib
import shutil
import statistics
import subprocess
import sys
import tempfile
import time

from tests.benchmarks.measuring import ROOT, Report, shared

# Runs a command of `jaxrelight` and tells what compiling took.
CHILD = """
import atexit, json, resource, sys
import jax.monitoring
spent = {"programs": 0, "compiling": 0.0}
def listen(event, seconds, **_):
    if event == "/jax/core/compile/backend_compile_duration":
        spent["programs"] += 1
        spent["compiling"] += seconds
jax.monitoring.register_event_duration_secs_listener(listen)
def tell():
    used = resource.getrusage(resource.RUSAGE_SELF)
    told = {**spent, "cpu": used.ru_utime + used.ru_stime, "megabytes": used.ru_maxrss / 1e3}
    print(json.dumps(told), file=sys.stderr)
atexit.register(tell)
from jaxrelight.cli import main
main()
"""


@dataclasses.dataclass(frozen=True)
class Run:
    """Of one process: seconds of wall clock and of both cores, those of compiling, programs, and resident memory."""

    wall: float
    cpu: float
    compiling: float
    programs: int
    megabytes: float


class Case:
    """A command, run by the code of a checkout, with folders of its own for what is kept."""

    def __init__(self, tree: pathlib.Path, folder: pathlib.Path, arguments: list[str], has_store: bool):
        self._tree, self._folder, self._arguments, self._has_store = tree, folder, arguments, has_store
        folder.mkdir(parents=True)

    def run(self, *more: str) -> Run:
        """Of the command, in a new process."""
        command = [sys.executable, "-c", CHILD, *self._arguments, *more, "-o", str(self._folder / "picture.png")]
        command += ["--store", str(self._folder / "store")] if self._has_store else []
        # Of the checkout, whatever is installed.
        environment = {**os.environ, "PYTHONPATH": str(self._tree), "XDG_CACHE_HOME": str(self._folder / "cache")}
        started = time.perf_counter()
        done = subprocess.run(command, cwd=self._folder, env=environment, capture_output=True, text=True, check=True)
        wall = time.perf_counter() - started
        told = json.loads(done.stderr.splitlines()[-1])
        return Run(wall, told["cpu"], told["compiling"], told["programs"], told["megabytes"])

    def without_store(self) -> Run:
        """With what is compiled, and nothing precomputed."""
        shutil.rmtree(self._folder / "store")
        return self.run()


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.starts", description=__doc__)
    parser.add_argument("--before", type=pathlib.Path, metavar="CHECKOUT", help="of another version, run in turn")
    parser.add_argument("--label", default="before", help="what that version is called")
    parser.add_argument("--quick", action="store_true", help="64 rows, few points; RESULTS.md is left as it is")
    options = parser.parse_args()
    trees = {"now": ROOT} | ({options.label: options.before.resolve()} if options.before else {})
    rows, runs, samples, resolution = (64, 1, 1024, 8) if options.quick else (256, 3, 16384, 32)
    parameters = (
        f"{rows} rows of pixels; seconds, each of a new process, from its start to its end; folders of compiled "
        f"programs and stores are empty at first; second runs are the median of {runs}, versions in turn"
    )
    with (
        Report("starts", "First pictures", parameters, not options.quick) as report,
        tempfile.TemporaryDirectory() as folder,
    ):
        adaptive(report, trees, pathlib.Path(folder), rows, runs)
        indirect(report, trees, pathlib.Path(folder), rows, runs, samples)
        vertices(report, trees, pathlib.Path(folder), rows, resolution)
        report.speed()


def adaptive(report: Report, trees, folder: pathlib.Path, rows: int, runs: int):
    """A mesh without anything precomputed."""
    mesh, sky = shared("data", "mesh", "teapot.obj"), shared("data", "env", "pmndrs_venice.exr")
    arguments = ["render", str(mesh), "--env", str(sky), "--lighting", "adaptive", "--height", str(rows)]
    cases = {name: Case(tree, folder / f"adaptive {name}", arguments, False) for name, tree in trees.items()}
    wide, narrow = (("--width", str(width)) for width in (rows, rows - 6))
    first = {name: case.run(*wide) for name, case in cases.items()}
    again = [{name: case.run(*wide) for name, case in cases.items()} for _ in range(runs)]
    other = {name: case.run(*narrow) for name, case in cases.items()}
    report.text("**`render teapot.obj --lighting adaptive`**, under Venice.")
    lines = [
        ("first run (reach: 40 s)", lambda name: f"{first[name].wall:.1f}"),
        ("… of it compiling; programs", lambda name: f"{first[name].compiling:.1f}; {first[name].programs}"),
        ("second run (reach: 8 s)", lambda name: f"{median(again, name, 'wall'):.2f}"),
        ("… CPU seconds", lambda name: f"{median(again, name, 'cpu'):.2f}"),
        ("… resident megabytes", lambda name: f"{median(again, name, 'megabytes'):.0f}"),
        (f"{rows - 6} columns instead of {rows} (reach: 9 s)", lambda name: f"{other[name].wall:.2f}"),
    ]
    table(report, trees, lines)


def indirect(report: Report, trees, folder: pathlib.Path, rows: int, runs: int, samples: int):
    """A closed room; tracing and gathering are what emptying the store alone costs."""
    scene = shared("reference", "room_point.toml")
    size = "--width", str(rows), "--height", str(rows)
    arguments = ["render", str(scene), "--lighting", "indirect", "--gather-samples", str(samples), *size]
    cases = {name: Case(tree, folder / f"indirect {name}", arguments, True) for name, tree in trees.items()}
    first = {name: case.run() for name, case in cases.items()}
    again = [{name: case.run() for name, case in cases.items()} for _ in range(runs)]
    gathered = {name: case.without_store() for name, case in cases.items()}
    report.text(f"**`render room_point.toml --lighting indirect`**, {samples:,} gather samples.")

    def beyond(name: str) -> float:
        return first[name].cpu - (gathered[name].cpu - median(again, name, "cpu"))

    lines = [
        ("first run", lambda name: f"{first[name].wall:.1f}"),
        ("… of it compiling; programs", lambda name: f"{first[name].compiling:.1f}; {first[name].programs}"),
        ("… CPU seconds beyond tracing and gathering (reach: 30 s)", lambda name: f"{beyond(name):.1f}"),
        ("second run", lambda name: f"{median(again, name, 'wall'):.2f}"),
        ("… CPU seconds (reach: 5 s)", lambda name: f"{median(again, name, 'cpu'):.2f}"),
    ]
    table(report, trees, lines)


def vertices(report: Report, trees, folder: pathlib.Path, rows: int, resolution: int):
    """Glossy transport at vertices, precomputed."""
    scene = shared("reference", "bunny_phong.toml")
    size = "--width", str(rows), "--height", str(rows)
    arguments = ["render", str(scene), "--receivers", "vertices", "--resolution", str(resolution), *size]
    cases = {name: Case(tree, folder / f"vertices {name}", arguments, True) for name, tree in trees.items()}
    first = {name: case.run() for name, case in cases.items()}
    report.text(f"**`render bunny_phong.toml --receivers vertices`**, resolution {resolution}.")
    lines = [
        ("first run", lambda name: f"{first[name].wall:.1f}"),
        ("… of it compiling (reach: half)", lambda name: f"{first[name].compiling:.2f}"),
        ("… programs", lambda name: f"{first[name].programs}"),
    ]
    table(report, trees, lines)


def median(runs: list[dict[str, Run]], name: str, of: str) -> float:
    """Of several runs."""
    return statistics.median(getattr(run[name], of) for run in runs)


def table(report: Report, trees, lines):
    """A column for each version."""
    report.table(["seconds", *trees], [[label, *map(value, trees)] for label, value in lines])


if __name__ == "__main__":
    main()
