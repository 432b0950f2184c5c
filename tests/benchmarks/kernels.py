"""The kernels against what they are made of: bare embree calls, memory copies, PyWavelets, scipy; and `--help`."""

import argparse
import os
import pathlib
import statistics
import subprocess
import sys
import time
from collections.abc import Callable

import numpy as np

from tests.benchmarks.measuring import (
    THREADS,
    Report,
    Timing,
    answer,
    blocks,
    fire,
    in_threads,
    interleaved,
    prepare_rays,
    run_child,
    shared,
)

FACES, SIDE = 3600, 64
ROWS, KEPT, COLUMNS = 131_072, 128, 6 * 64**2


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.kernels", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a small trial; RESULTS.md is left as it is")
    parser.add_argument("--store", type=pathlib.Path, help="a bunny_phong store, K = 4, vertices: its indices are used")
    parser.add_argument("--only", choices=("visibility", "haar", "rows", "help"), help="one of the kernels")
    parser.add_argument("--pinned", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.pinned is not None:
        _pinned_rows(arguments.pinned == "real", arguments.store, 5 if arguments.quick else 15)
        return
    shared("reference")
    quick = arguments.quick
    parts = {
        "visibility": lambda report: visibility(report, groups=4 if quick else 16, runs=3 if quick else 9),
        "haar": lambda report: haar(report, runs=7 if quick else 31),
        "rows": lambda report: rows(report, arguments.store, 7 if quick else 31),
        "help": help_seconds,
    }
    write = not (quick or arguments.only)
    parameters = "ratios are medians over interleaved runs; times are medians"
    with Report("kernels", "Kernels", parameters, write) as report:
        for name, part in parts.items():
            if arguments.only in (None, name):
                part(report)


def visibility(report: Report, groups: int, runs: int):
    """The visibility stage without its disk, against bare calls on the same rays prepared beforehand."""
    import jaxrelight
    from jaxrelight.basis import cubemap
    from jaxrelight.geometry.receivers import vertex_receivers
    from jaxrelight.geometry.surfaces import join
    from jaxrelight.geometry.tracer import Tracer
    from jaxrelight.transport.visibility import trace_visibility

    scene = jaxrelight.load_scene(shared("reference", "bunny_lambert.toml"))
    surfaces = join([part.mesh for part in scene.parts])
    tracer, receivers = Tracer(surfaces), vertex_receivers(surfaces, np.arange(len(scene.parts)))
    directions = cubemap.directions(64)
    chosen = np.linspace(0, len(receivers.filled) - 1, groups).astype(int)
    arrays = [values[chosen] for values in (receivers.origins, receivers.normals)]
    rays = prepare_rays(tracer, [values.reshape(-1, 3) for values in arrays], 64)
    counted = []

    def trace(i: int):
        origins, normals = (values[i] for values in arrays)
        counted.append(trace_visibility(tracer, origins, normals, directions)[1])

    size = rays.count / len(rays.receiver_ends)
    ways = {
        f"calls of {size:,.0f} rays (a receiver's)": rays.by_receiver(),
        f"calls of {size * 32:,.0f} rays (32 receivers')": rays.by_receivers(32),
        f"{THREADS} calls of {rays.count / THREADS:,.0f} rays": rays.by_thread(),
    }
    sides = {"stage": lambda: in_threads(trace, groups)}
    sides |= {name: lambda calls=calls: fire(rays.scene, calls) for name, calls in ways.items()}
    times = interleaved(sides, runs, 1)
    assert sum(counted[:groups]) == rays.count, "the stage traced other rays than were prepared"

    report.text(
        f"**Visibility stage**, {THREADS} threads, bunny with floor, resolution 64: {groups} groups of 128 vertices, "
        f"{rays.count / 1e6:.1f} M rays, {runs} runs. Target: at least 0.8 of the best bare calls."
    )
    stage = times["stage"]
    table = [["visibility stage (ours)", stage, f"{rays.count / stage.median / 1e6:.2f}", ""]]
    for name in ways:
        bare = times[name]
        row = [f"bare embree, {name}", bare, f"{rays.count / bare.median / 1e6:.2f}", f"{1 / stage.over(bare):.3f}"]
        table.append(row)
    report.table(["what", "time", "Mrays/s", "stage's rate / this"], table)
    report.speed(rays)


def haar(report: Report, runs: int):
    """The Haar transform against reading and writing its bytes, and against PyWavelets."""
    import jax
    import jax.numpy as jnp
    import pywt

    from jaxrelight.basis import haar as ours

    faces = np.random.default_rng(0).standard_normal((FACES, SIDE, SIDE)).astype(np.float32)
    on_device, target = jnp.asarray(faces), np.empty_like(faces)
    forward = jax.jit(ours.forward)
    scaled = jax.jit(lambda x: x * 1.0001)
    halves = list(blocks(FACES, FACES // THREADS))

    def by_wavelets(x):
        return pywt.wavedec2(x, "haar", mode="periodization", axes=(-2, -1))

    laid_out = pywt.coeffs_to_array(by_wavelets(faces), axes=(-2, -1))[0]
    exact = pywt.coeffs_to_array(by_wavelets(faces.astype(float)), axes=(-2, -1))[0]
    result = np.asarray(forward(on_device))
    largest = np.abs(exact).max()

    def apart(a, b):
        difference = np.abs(a - b).max()
        return f"{difference:.1e} ({difference / largest:.1e} of the largest coefficient)"

    report.text(
        f"**Haar forward**, {FACES:,} faces of {SIDE}×{SIDE}, float32, {faces.nbytes / 1e6:.0f} MB, {runs} runs. "
        "Targets: at most 4 times reading and writing the same bytes once; at least 6 times faster than "
        f"PyWavelets, and equal to 1e-6. Largest difference to PyWavelets {apart(result, laid_out)}; to PyWavelets in "
        f"float64 ours {apart(result, exact)}, theirs in float32 {apart(laid_out, exact)}."
    )
    heads = ["what", "time", "GB/s", "page faults", "forward / this"]
    table = []
    for size in (FACES, 900):
        cuts = list(blocks(FACES, size))
        pieces = [on_device[cut] for cut in cuts]

        def each(function, of=pieces):
            for piece in of:
                jax.block_until_ready(function(piece))

        sides = {
            "haar.forward, jitted (ours)": lambda each=each: each(forward),
            "np.copyto, 1 thread": lambda cuts=cuts: [np.copyto(target[cut], faces[cut]) for cut in cuts],
            f"np.copyto, {THREADS} threads": lambda: in_threads(
                lambda i: np.copyto(target[halves[i]], faces[halves[i]]), len(halves)
            ),
            "x * 1.0001, jitted": lambda each=each: each(scaled),
            "pywt.wavedec2": lambda cuts=cuts: [by_wavelets(faces[cut]) for cut in cuts],
        }
        times = interleaved(sides, runs)
        forward_time = times["haar.forward, jitted (ours)"]
        label = "at once" if size == FACES else f"in blocks of {size}"
        for name, timing in times.items():
            ratio = forward_time.over(timing)
            shown = f"{ratio:.2f}" if ratio > 0.5 else f"1/{1 / ratio:.1f}"
            rate = f"{2 * faces.nbytes / timing.median / 1e9:.1f}"
            shown = "" if timing is forward_time else shown
            table.append([f"{label}: {name}", timing, rate, f"{page_faults(sides[name]):,}", shown])
    report.table(heads, table)
    report.speed()


def page_faults(function: Callable[[], object]) -> int:
    """Pages that one call touches for the first time: fresh memory, which the system clears first."""
    import resource

    import jax

    before = resource.getrusage(resource.RUSAGE_SELF).ru_minflt
    jax.block_until_ready(function())
    return resource.getrusage(resource.RUSAGE_SELF).ru_minflt - before


def rows(report: Report, store: pathlib.Path | None, runs: int):
    """The row-sparse product against scipy's."""
    report.text(
        f"**Row-sparse apply**, {ROWS:,} rows × {KEPT} of {COLUMNS:,} coefficients, three channels, float32, {runs} "
        "runs. scipy: three CSR matrices with int32 indices, one product after the other; it uses one thread by "
        "itself, so it is also given half of the rows in each of two threads. Target: at least 2 times faster."
    )
    table, notes = [], []
    for real in (False, True) if store else (False,):
        operator, matrices, light = _product_inputs(real, store)
        label = "real indices" if real else "random indices"
        times, difference = _time_rows(operator, matrices, light, runs)
        ours = times["SparseRows.apply (ours)"]
        for name, timing in times.items():
            factor = "" if timing is ours else f"{1 / ours.over(timing):.2f}"
            table.append([f"{label}: {name}", timing, factor])
        notes.append(f"with {label} ours differs from scipy's by {difference:.0e} of the largest value")
        arguments = ["--pinned", "real" if real else "random", *(["--store", str(store.resolve())] if store else [])]
        pinned = run_child("tests.benchmarks.kernels", *arguments, *(["--quick"] if runs < 10 else []))
        ours, theirs = Timing(tuple(pinned["ours"])), Timing(tuple(pinned["scipy"]))
        table.append([f"{label}: ours, process pinned to one core", ours, ""])
        table.append([f"{label}: scipy, the same", theirs, f"{1 / ours.over(theirs):.2f}"])
    report.table(["what", "time", "ours is faster by"], table)
    if store is None:
        notes.append("real indices were not measured, since no --store was given")
    text = "; ".join(notes)
    report.text(f"{text[0].upper()}{text[1:]}.")
    report.speed()


def _product_inputs(real: bool, store: pathlib.Path | None):
    """The operator, the same as three CSR matrices, and light [d, 3]."""
    import jax.numpy as jnp
    import scipy.sparse

    from jaxrelight.operators.sparse_rows import sparse_rows

    generator = np.random.default_rng(0)
    light = generator.standard_normal((COLUMNS, 3)).astype(np.float32)
    if real:
        indices, values = _stored_rows(store)
    else:
        indices = generator.integers(0, COLUMNS, (ROWS, KEPT))
        values = generator.standard_normal((ROWS, 3, KEPT)).astype(np.float32)
    starts = np.arange(len(indices) + 1, dtype=np.int32) * KEPT
    matrices = [
        scipy.sparse.csr_matrix(
            (np.ascontiguousarray(values[:, c]).ravel(), indices.ravel().astype(np.int32), starts),
            shape=(len(indices), COLUMNS),
        )
        for c in range(3)
    ]
    operator = sparse_rows(jnp.asarray(indices.astype(np.uint16)), jnp.asarray(values), COLUMNS)
    return operator, matrices, light


def _stored_rows(store: pathlib.Path | None):
    """Indices and values of the first rows of the store's operator of three channels."""
    from jaxrelight import open_store
    from jaxrelight.operators.sparse_rows import SparseRows

    assert store is not None
    for operator in open_store(store).transport.operator.operators:
        if isinstance(operator, SparseRows) and operator.shape[2] == 3 and operator.indices.shape[-1] == KEPT:
            indices = np.asarray(operator.indices).reshape(-1, KEPT)[: operator.row_count]
            values = np.stack([np.asarray(v).reshape(-1, KEPT) for v in operator.values], 1)[: operator.row_count]
            if len(indices) >= ROWS:
                return indices[:ROWS], values[:ROWS]
    sys.exit(f"the store has no operator of three channels with {ROWS:,} rows of {KEPT}; give a bunny_phong store")


def _time_rows(operator, matrices, light, runs: int):
    import jax
    import jax.numpy as jnp

    apply = jax.jit(lambda operator, light: operator.apply(light))
    on_device = jnp.asarray(light)
    by_channel = [np.ascontiguousarray(light[:, c]) for c in range(3)]
    cut = matrices[0].shape[0] // THREADS
    parts = [[matrix[i * cut : (i + 1) * cut] for matrix in matrices] for i in range(THREADS)]

    def scipy_products(of=matrices):
        return [matrix @ x for matrix, x in zip(of, by_channel, strict=True)]

    expected = np.stack(scipy_products(), axis=-1)
    difference = np.abs(np.asarray(apply(operator, on_device)) - expected).max() / np.abs(expected).max()
    sides = {
        "SparseRows.apply (ours)": lambda: apply(operator, on_device),
        "scipy CSR, 1 thread": scipy_products,
        f"scipy CSR, rows shared by {THREADS} threads": lambda: in_threads(lambda i: scipy_products(parts[i]), THREADS),
    }
    return interleaved(sides, runs), difference


def _pinned_rows(real: bool, store: pathlib.Path | None, runs: int):
    """The same in a process with one core; set before JAX starts its threads."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    times, _ = _time_rows(*_product_inputs(real, store), runs)
    names = list(times)
    answer({"ours": times[names[0]].seconds, "scipy": times[names[1]].seconds})


def help_seconds(report: Report, runs: int = 5):
    """The time that `jaxrelight --help` takes, if the command is there."""
    command = pathlib.Path(sys.executable).parent / "jaxrelight"
    if not command.exists():
        report.text("**`jaxrelight --help`** was not measured: the command is not installed.")
        return
    seconds = []
    for _ in range(runs):
        start = time.perf_counter()
        done = subprocess.run([str(command), "--help"], capture_output=True, check=False)
        seconds.append(time.perf_counter() - start)
        if done.returncode:
            report.text(f"**`jaxrelight --help`** was not measured: it ended with {done.returncode}.")
            return
    report.text(
        f"**`jaxrelight --help`** took {statistics.median(seconds):.2f} s (median of {runs}, {min(seconds):.2f} to "
        f"{max(seconds):.2f}). Target: below 1 s."
    )
    report.speed()


if __name__ == "__main__":
    main()
