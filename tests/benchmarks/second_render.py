"""The first and the second `jaxrelight render` of a scene, each in a new process: what is left when all is kept."""

import argparse
import json
import os
import pathlib
import statistics
import subprocess
import sys
import tempfile
import time

from tests.benchmarks.measuring import ROOT, Report, shared

CASES = {
    "bunny_lambert, pixels": ("bunny_lambert", "pixels"),
    "bunny_phong, pixels": ("bunny_phong", "pixels"),
    "bunny_phong, vertices": ("bunny_phong", "vertices"),
}
STAGES = ("load", "geometry", "visibility", "transport", "open", "view", "light", "shade", "write")
TARGET = 3.0


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.second_render", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="resolution 8, few runs; RESULTS.md is left as it is")
    quick = parser.parse_args().quick
    resolution, runs = (8, 1) if quick else (64, 9)
    parameters = (
        f"resolution {resolution}, clusters of tolerance 0.02, K = 4, 256×256 pixels; seconds of wall clock from the "
        f"process's start, the second render as the median of {runs}, in turn; compiled programs are kept in a folder "
        "that is empty at first"
    )
    with (
        Report("second_render", "Rendering a second time", parameters, not quick) as report,
        tempfile.TemporaryDirectory() as folder,
    ):
        measure(report, pathlib.Path(folder), resolution, runs)
        report.speed()


def measure(report: Report, folder: pathlib.Path, resolution: int, runs: int):
    """Every case once from nothing, then all of them in turn."""
    first = {name: render(folder, name, resolution) for name in CASES}
    again: dict[str, list] = {name: [] for name in CASES}
    bare = []
    for _ in range(runs):
        bare.append(imports(folder))
        for name in CASES:
            again[name].append(render(folder, name, resolution))

    def median(name: str, of) -> str:
        return f"{statistics.median(of(run) for run in again[name]):.2f}"

    rows = [
        ["first render", *(f"{first[name][1]:.1f}" for name in CASES)],
        [
            f"second render, until the picture is written (target ≤ {TARGET})",
            *(median(n, lambda r: r[0]) for n in CASES),
        ],
        ["… shortest, longest", *(_range([run[0] for run in again[name]]) for name in CASES)],
        ["… until the process has ended", *(median(name, lambda run: run[1]) for name in CASES)],
        ["… before the command starts, and after it", *(median(n, lambda r: r[1] - r[2]["total"]) for n in CASES)],
        *([f"… {stage}", *(median(name, lambda run, s=stage: run[2][s]) for name in CASES)] for stage in STAGES),
        ["whole process / the imports below", *(_over([run[1] for run in again[name]], bare) for name in CASES)],
        ["importing jax, equinox, trimesh, embreex alone", *([f"{statistics.median(bare):.2f}"] * len(CASES))],
    ]
    report.table(["seconds", *CASES], rows)


def render(folder: pathlib.Path, name: str, resolution: int) -> tuple[float, float, dict[str, float]]:
    """(seconds of a new process until its picture is written, and until it has ended; what it says of its stages)."""
    scene, receivers = CASES[name]
    key = name.replace(", ", "-")
    program = pathlib.Path(sys.executable).parent / "jaxrelight"
    command = [str(program), "render", str(shared("reference", f"{scene}.toml"))]
    picture = folder / f"{key}.exr"
    command += ["-o", str(picture), "--store", str(folder / key), "--receivers", receivers]
    started = time.time()
    done = _run([*command, "--resolution", str(resolution), "--json"], folder)
    return picture.stat().st_mtime - started, time.time() - started, json.loads(done)["seconds"]


def imports(folder: pathlib.Path) -> float:
    """Seconds of a process that only imports what the library is made from, and multiplies two numbers with JAX."""
    code = "import jax, equinox, jaxtyping, trimesh, embreex, OpenEXR, tyro; jax.numpy.ones(2).block_until_ready()"
    started = time.perf_counter()
    _run([sys.executable, "-c", code], folder)
    return time.perf_counter() - started


def _run(command: list[str], folder: pathlib.Path) -> str:
    # Of this checkout, whatever is installed.
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "XDG_CACHE_HOME": str(folder / "cache")}
    return subprocess.run(command, env=environment, stdout=subprocess.PIPE, text=True, check=True).stdout


def _over(seconds: list[float], others: list[float]) -> str:
    """The median of the rounds' ratios: a machine that is slow for a while is slow for both."""
    return f"{statistics.median(a / b for a, b in zip(seconds, others, strict=True)):.2f}"


def _range(values: list[float]) -> str:
    return f"{min(values):.2f}, {max(values):.2f}"


if __name__ == "__main__":
    main()
