"""Skies of many pixels: memory and seconds of loading, lighting, turning and differentiating them, by method."""

import argparse
import contextlib
import gc
import pathlib
import tempfile
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from tests.benchmarks.measuring import Report, answer, megabytes, peak_memory, resident_memory, run_child

MODULE = "tests.benchmarks.large_skies"
METHODS = "pixels", "vertices", "indirect", "sky", "prefiltered", "adaptive"
STEPS = "file", "light", "turned", "shade", "gradient"


def main():
    parser = argparse.ArgumentParser(prog=f"python -m {MODULE}", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="256 rows, two methods; RESULTS.md is left as it is")
    parser.add_argument("--rows", type=int, help="of the map; RESULTS.md is left as it is")
    parser.add_argument("--only", choices=METHODS, help="one method; RESULTS.md is left as it is")
    parser.add_argument("--child", nargs=2, metavar=("METHOD", "FILE"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        child(arguments.child[0], pathlib.Path(arguments.child[1]))
        return
    rows = arguments.rows or (256 if arguments.quick else 4096)
    methods = [arguments.only] if arguments.only else METHODS[:: 4 if arguments.quick else 1]
    parameters = (
        f"a map of {2 * rows} × {rows} pixels with a sun, {megabytes(24 * rows**2)} in single precision, from a file "
        "of half floats; a ball over a floor; a process for each method"
    )
    with contextlib.ExitStack() as stack:
        folder = pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
        write = not (arguments.quick or arguments.only or arguments.rows)
        report = stack.enter_context(Report("large_skies", "Skies of many pixels", parameters, write))
        write_sky(folder / "sky.exr", rows)
        measure(report, methods, folder / "sky.exr")


def measure(report: Report, methods, file: pathlib.Path):
    """Each method in a process of its own."""
    told = {method: run_child(MODULE, "--child", method, str(file)) for method in methods}
    report.text(
        "Peak memory beyond what the process held before the map was read, over the map's bytes in single precision: "
        "while the file is read, and in each later step. The map itself is 1. The gradient is that of a picture's mean "
        "by all of the map's pixels, which is as large as the map."
    )
    report.table(["method", *STEPS], [[m, *(f"{one['peaks'][s]:.2f}" for s in STEPS)] for m, one in told.items()])
    report.text("Seconds once all is compiled; the first time, which compiles, is in parentheses.")

    def seconds(one: dict, step: str) -> str:
        first, again = one["first"][step], one["again"].get(step)
        return f"{first:.2f}" if again is None else f"{again:.2f} ({first:.2f})"

    report.table(["method", *STEPS], [[m, *(seconds(one, s) for s in STEPS)] for m, one in told.items()])


def sky_pixels(rows: int):
    """A bright horizon, fine noise, and a sun half a degree wide."""
    v, u = (np.arange(rows)[:, None] + 0.5) / rows, (np.arange(2 * rows) + 0.5) / (2 * rows)
    pixels = np.empty((rows, 2 * rows, 3), np.float16)
    noise = np.random.default_rng(0).uniform(0.7, 1.3, (64, 2 * rows)).astype(np.float32)
    x, y, z = (
        np.sin(np.pi * v) * np.cos(2 * np.pi * u),
        np.cos(np.pi * v) + 0 * u,
        np.sin(np.pi * v) * np.sin(2 * np.pi * u),
    )
    sun = x * 0.48 + y * 0.8 + z * 0.36 > np.cos(max(np.radians(0.27), 0.8 * np.pi / rows))
    for channel, colour in enumerate((0.4, 0.6, 1.0)):
        for start in range(0, rows, 64):
            block = slice(start, start + 64)
            smooth = (colour + np.exp(-20 * (v[block] - 0.5) ** 2)).astype(np.float32)
            pixels[block, :, channel] = smooth * noise[: len(smooth)] + 3e4 * sun[block]
    return pixels


def write_sky(path: pathlib.Path, rows: int):
    """`sky_pixels` as half floats."""
    import OpenEXR

    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, {"RGB": sky_pixels(rows)}).write(str(path))


def peak_of(function: Callable[[], Any]) -> tuple[Any, int, float]:
    """What a function gives, the most bytes that the process held meanwhile, and seconds."""
    import jax

    gc.collect()
    # What was the peak before is forgotten; only Linux can.
    pathlib.Path("/proc/self/clear_refs").write_text("5")
    start = time.perf_counter()
    result = jax.block_until_ready(function())
    return result, peak_memory(), time.perf_counter() - start


def child(name: str, file: pathlib.Path):
    """One method in this process."""
    import jax
    import jax.numpy as jnp

    import jaxrelight as jr
    from jaxrelight.lights import prefiltered
    from tests.extremes.scenes import ball

    methods = {
        "pixels": jr.Transport("pixels", resolution=64),
        "vertices": jr.Transport("vertices", resolution=64),
        "indirect": jr.Indirect(gather_samples=256, bounces=1, sky_samples=256),
        "sky": jr.Indirect(gather_samples=256, bounces=1, sky=True),
        "prefiltered": jr.Prefiltered(),
        "adaptive": jr.Adaptive(samples=64),
    }
    with tempfile.TemporaryDirectory() as folder:
        dials = methods[name]
        relighter: Any = jr.prepare(ball(), dials, folder if dials.is_stored else None)
        view = relighter.view()

        def light(sky):
            return jax.block_until_ready(relighter.light(sky))

        def gradient(sky, traced):
            def loss(pixels):
                changed = jr.Environment(pixels, sky.rotate_y, sky.scale)
                return jnp.mean(relighter.shade(relighter.light(changed), view, traced).radiance)

            return jax.grad(loss)(sky.pixels)

        # All that does not depend on the map's size is compiled, and loaded, before.
        small = jr.environment(sky_pixels(64).astype(np.float32))
        lit = light(small)
        relighter.shade(lit, view)
        gradient(small, relighter.trace(lit, view) if name == "adaptive" else None)
        del lit, small
        gc.collect()
        before, size = resident_memory(), 0
        peaks, first, again = {}, {}, {}

        def step(what: str, function):
            result, most, seconds = peak_of(function)
            peaks[what], first[what] = max(most, peaks.get(what, 0)), seconds
            return result

        sky = step("file", lambda: jr.load_environment(file))
        size = sky.pixels.nbytes
        lit = step("light", lambda: light(sky))
        # A plan of samples is made for one light, and serves others; shadow rays are cast for each light.
        traced = relighter.trace(lit, view) if name == "adaptive" else None
        step("shade", lambda: relighter.shade(lit, view, traced).radiance)
        lit = None
        step("turned", lambda: light(sky.with_(rotate_y=20.0)))
        step("gradient", lambda: gradient(sky, traced))
        for what, function in {
            "turned": lambda: light(sky.with_(rotate_y=40.0)),
            "gradient": lambda: gradient(sky.with_(rotate_y=40.0), traced),
        }.items():
            again[what] = peak_of(function)[2]
        # Only a light that is new is filtered.
        prefiltered._REMEMBERED.clear()
        again["light"] = peak_of(lambda: light(sky))[2]
    answer(
        {
            "before": before,
            "peaks": {what: (most - before) / size for what, most in peaks.items()},
            "first": first,
            "again": again,
        }
    )


if __name__ == "__main__":
    main()
