"""Precomputation and relighting of the bunny with its floor, beside Tables I and II of Wang 2006."""

import argparse
import contextlib
import dataclasses
import pathlib
import tempfile
import time

import numpy as np

from tests.benchmarks.measuring import (
    Report,
    Timing,
    answer,
    copy_rate,
    interleaved,
    machine_speed,
    megabytes,
    run_child,
    scene_rays,
    shared,
)

MODULE = "tests.benchmarks.precompute"
CASES = ("bunny_lambert", 1), ("bunny_phong", 1), ("bunny_phong", 4)
# The Bunny columns: 36 K vertices and a floor of 31 K; minutes and MB (8-bit coefficients), frames per second GPU/CPU.
TABLE_1 = {1: ("5.6 min", "36 MB"), 4: ("14 min", "100 MB")}
TABLE_2 = {1: ("226/79", "31/12"), 4: ("97/62", "-/4.8")}
PAPER = "Wang 2006 (P4 2.4 GHz, GeForce 6800)"


def main():
    parser = argparse.ArgumentParser(prog=f"python -m {MODULE}", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="resolution 8, one case; RESULTS.md is left as it is")
    parser.add_argument("--folder", type=pathlib.Path, help="where new stores go, and stay")
    parser.add_argument("--case", type=int, choices=range(len(CASES)), help="one of the cases")
    parser.add_argument("--child", choices=("precompute", "relight"), help=argparse.SUPPRESS)
    parser.add_argument("--scene", type=pathlib.Path, help=argparse.SUPPRESS)
    parser.add_argument("--terms", type=int, help=argparse.SUPPRESS)
    parser.add_argument("--resolution", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child == "precompute":
        precompute_child(arguments.scene, arguments.terms, arguments.resolution, arguments.folder)
    elif arguments.child == "relight":
        relight_child(arguments.scene, arguments.folder, 3 if arguments.quick else 21)
    else:
        shared("reference")
        resolution = 8 if arguments.quick else 64
        parameters = (
            f"bunny with floor, vertices as receivers, N = 128, resolution {resolution}, 1 ray a texel; every "
            "precomputation in a fresh process and a fresh store"
        )
        write = not (arguments.quick or arguments.case is not None)
        case = len(CASES) - 1 if arguments.quick and arguments.case is None else arguments.case
        chosen = CASES if case is None else CASES[case : case + 1]
        with contextlib.ExitStack() as stack:
            folder = arguments.folder or pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
            report = stack.enter_context(Report("precompute", "Precomputation and relighting", parameters, write))
            measure(report, chosen, resolution, folder)


@dataclasses.dataclass(frozen=True)
class Case:
    """One precomputation and its relighting, as the children told."""

    scene: str
    terms: int
    made: dict
    lit: dict
    rates: tuple[float, float]
    copies: tuple[float, float]

    @property
    def ray_seconds(self) -> float:
        """Rays over the better of the two bare rates, taken before and after."""
        return self.made["rays"] / max(self.rates)

    @property
    def name(self) -> str:
        """Scene and terms."""
        return f"{self.scene}, K = {self.terms}"


def measure(report: Report, chosen, resolution: int, folder: pathlib.Path):
    """Runs the cases and reports them."""
    rays = scene_rays(shared("reference", "bunny_phong.toml"), resolution, receivers=max(256, 256 * 16 // resolution))
    cases = []
    for scene, terms in chosen:
        store = folder / f"{scene}-{terms}"
        if store.exists():
            raise SystemExit(f"{store} exists already; this measures fresh stores, so remove it or give another folder")
        path = shared("reference", f"{scene}.toml")
        before, copy_before = rays.rate(), copy_rate(2)
        made = precompute_apart(path, terms, resolution, store)
        after, copy_after = rays.rate(), copy_rate(2)
        lit = relight_apart(path, store, resolution < 64)
        cases.append(Case(scene, terms, made, lit, (before, after), (copy_before, copy_after)))

    report.text(
        "**Precomputation.** Pure ray time is the number of rays over the rate of bare embree calls of the same run, "
        "the faster of before and after, on a sample of the same rays. Targets for K = 1: at most 1.5 times the "
        "pure ray time, and at most 2147.5 MB (2 GiB) of memory at the peak."
    )
    heads = ["what", *(case.name for case in cases), f"{PAPER}: K = 1, 4"]
    stages = list(dict.fromkeys(stage for case in cases for stage in case.made["seconds"]))

    minutes, sizes = zip(*TABLE_1.values(), strict=True)

    def row(name: str, value, paper: str = ""):
        return [name, *(value(case) for case in cases), paper]

    table = [row("receivers", lambda c: f"{c.made['receivers']:,}", "67 K")]
    table += [row(f"{stage} / s", lambda c, s=stage: f"{c.made['seconds'].get(s, 0):.2f}") for stage in stages]
    table += [
        row("whole call / s", lambda c: f"{c.made['wall']:.2f}", " / ".join(minutes)),
        row("rays / M", lambda c: f"{c.made['rays'] / 1e6:.1f}"),
        row("bare embree before, after / (Mrays/s)", lambda c: ", ".join(f"{rate / 1e6:.2f}" for rate in c.rates)),
        row("memory copy before, after / (GB/s)", lambda c: ", ".join(f"{rate / 1e9:.1f}" for rate in c.copies)),
        row("pure ray time / s", lambda c: f"{c.ray_seconds:.2f}"),
        row("visibility stage / pure ray time", lambda c: f"{c.made['seconds']['visibility'] / c.ray_seconds:.2f}"),
        row("whole call / pure ray time", lambda c: f"{c.made['wall'] / c.ray_seconds:.2f}"),
        row("peak memory", lambda c: megabytes(c.made["peak_memory"])),
        row("store: visibility", lambda c: megabytes(c.made["bytes"]["visibility"])),
        row("store: transport", lambda c: megabytes(c.made["bytes"]["transport"]), " / ".join(sizes)),
        row("store: all", lambda c: megabytes(sum(c.made["bytes"].values()))),
        row("operator in memory", lambda c: megabytes(c.lit["operator_bytes"])),
        row("energy kept", lambda c: f"{100 * c.lit['kept']:.3f} %"),
    ]  # fmt: skip
    report.table(heads, table)

    views = next(iter(cases)).lit["views"]
    report.text(
        "**Relighting**, medians of interleaved runs, shortest in brackets. A change of light is another rotation of "
        "the map: resampling, wavelets and the operator. A change of view is G-buffer and shading. First calls compile."
    )

    def timed(key: str):
        return lambda case: str(Timing(tuple(case.lit["seconds"][key])))

    table = [
        row("opening the store / s", lambda c: f"{c.lit['load']:.2f}"),
        row("first light, first view / s", lambda c: f"{c.lit['first_light']:.2f}, {c.lit['first_view']:.2f}"),
        row("light change", timed("light"), " / ".join(f"{_ms(light)}" for _, light in TABLE_2.values())),
        row("… map to light vector", timed("vector")),
        row("… operator alone", timed("terms")),
    ]
    for size in views:
        paper = " / ".join(f"{_ms(view)}" for view, _ in TABLE_2.values()) if size == views[0] else ""
        table.append(row(f"view change, {size}", timed(f"view {size}"), paper))
        table.append(row(f"… shading alone, {size}", timed(f"shade {size}")))
    table.append(row("peak memory", lambda c: megabytes(c.lit["peak_memory"])))
    report.table([*heads[:-1], f"{PAPER}, ms GPU, CPU: K = 1 / 4"], table)
    report.text(f"The machine at this moment: {machine_speed(rays)}.")


def _ms(rates: str) -> str:
    """Milliseconds of a pair of frame rates."""
    return ", ".join(f"{1000 / float(rate):.1f}" if rate != "-" else "-" for rate in rates.split("/"))


def precompute_apart(scene: pathlib.Path, terms: int, resolution: int, store: pathlib.Path) -> dict:
    """What `precompute_child` tells, from a process of its own."""
    dials = "--terms", str(terms), "--resolution", str(resolution)
    return run_child(MODULE, "--child", "precompute", *dials, "--scene", str(scene), "--folder", str(store.resolve()))


def relight_apart(scene: pathlib.Path, store: pathlib.Path, quick: bool) -> dict:
    """What `relight_child` tells, from a process of its own."""
    where = "--scene", str(scene), "--folder", str(store.resolve())
    return run_child(MODULE, "--child", "relight", *where, *(["--quick"] if quick else []))


def precompute_child(path: pathlib.Path, terms: int, resolution: int, folder: pathlib.Path):
    """Precomputes in this process, and tells what it took."""
    from jaxrelight import Transport, load_scene
    from jaxrelight.precomputation.precompute import precompute

    scene = load_scene(path)
    start = time.perf_counter()
    done = precompute(
        scene, Transport("vertices", reflection="factors", terms=terms, resolution=resolution, coefficients=128), folder
    )
    wall = time.perf_counter() - start
    answer(
        {"seconds": done.seconds, "wall": wall, "rays": done.rays, "receivers": done.receivers, "bytes": done.nbytes}
    )


def relight_child(path: pathlib.Path, folder: pathlib.Path, runs: int):
    """Lights and views in this process, and tells what it took."""
    import jax
    import jax.numpy as jnp

    from jaxrelight import load_scene, open_store
    from jaxrelight.lighting.transport import TransportRelighter

    environment = load_scene(path).lights.environment
    assert environment is not None
    start = time.perf_counter()
    relighter = open_store(folder)
    assert isinstance(relighter, TransportRelighter)
    load = time.perf_counter() - start

    turns = iter(np.random.default_rng(0).uniform(0, 360, 10_000))

    def turned():
        return environment.with_(rotate_y=float(next(turns)))

    own = relighter.camera
    cameras = {f"{size}×{size}": dataclasses.replace(own, width=size, height=size) for size in (own.width, 512)}

    def moved(camera):
        """The camera turned about the vertical axis through its target."""
        angle = np.radians(next(turns))
        x, y, z = np.subtract(camera.origin, camera.target)
        turn = np.array([np.cos(angle) * x + np.sin(angle) * z, y, np.cos(angle) * z - np.sin(angle) * x])
        return dataclasses.replace(camera, origin=tuple((turn + camera.target).tolist()))

    start = time.perf_counter()
    lit = jax.block_until_ready(relighter.light(environment))
    first_light = time.perf_counter() - start
    start = time.perf_counter()
    jax.block_until_ready(relighter.shade(lit, relighter.view()))
    first_view = time.perf_counter() - start

    from jaxrelight.lights.environment import coarsened

    pixels = jnp.asarray(coarsened(environment.pixels, relighter.method.resolution))
    vector = relighter.light_vector(pixels)
    sides = {
        "light": lambda: relighter.light(turned()),
        "vector": lambda: relighter.light_vector(pixels, float(next(turns))),
        "terms": lambda: relighter.terms(vector),
    }
    times = interleaved(sides, runs)
    for size, camera in cameras.items():
        view = relighter.view(camera)

        def changed(camera=camera):
            return relighter.shade(lit, relighter.view(moved(camera)))

        shaded = {f"view {size}": changed, f"shade {size}": lambda view=view: relighter.shade(lit, view)}
        times |= interleaved(shaded, runs)
    answer(
        {
            "load": load,
            "first_light": first_light,
            "first_view": first_view,
            "seconds": {key: timing.seconds for key, timing in times.items()},
            "views": list(cameras),
            "operator_bytes": relighter.transport.operator.nbytes,
            "kept": relighter.transport.kept,
        }
    )


if __name__ == "__main__":
    main()
