"""Every operator on the same scenes: seconds, bytes, error, time of a light and of a view (Wang 2006, Tables I, II).

Where JAX runs on a GPU, its own section of the results, with the share of the GPU's bandwidth that a light reaches.
"""

import argparse
import contextlib
import pathlib
import tempfile
import time
from typing import Any

import numpy as np

from jaxrelight.lighting.prepare import prepare_with_build
from jaxrelight.lighting.transport import TransportRelighter
from tests.benchmarks.clusters import _scene
from tests.benchmarks.measuring import Report, Timing, interleaved, megabytes, percent, shared
from tests.benchmarks.mesh_size import FLOOR, PAPER

MESHES = {"bunny": "bunny_mitsuba.ply", "dragon": "dragon_vrip_res2_bin.ply"}
LIGHTS = ("pmndrs_venice.exr", "grace_latlong.exr", "blender_sunset.exr")
DIRECT: dict[str, dict[str, Any]] = {
    "rows, N = 128": {"coefficients": 128},
    "rows, N = 128, 8 bits": {"coefficients": 128, "bits": 8},
    "clusters, 0.03": {"compression_tolerance": 0.03},
    "clusters, 0.02": {"compression_tolerance": 0.02},
    "clusters, 0.02, 8 bits": {"compression_tolerance": 0.02, "bits": 8},
}
ONE_BOUNCE = ("clusters, 0.02", "clusters, 0.02, 8 bits")
CHAIN = 64  # lights one after the other in one call, so that what a call costs is not counted


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.operators", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="resolution 8, a small mesh; RESULTS.md is left as it is")
    parser.add_argument("--folder", type=pathlib.Path, help="keep the stores here and reuse them")
    parser.add_argument("--only", choices=[*MESHES], help="this mesh alone; RESULTS.md is left as it is")
    arguments = parser.parse_args()
    resolution, look, runs, floor = (8, 4, 3, 16) if arguments.quick else (64, 32, 15, FLOOR)
    meshes = {"teapot": "teapot.obj"} if arguments.quick else MESHES
    if arguments.only:
        meshes = {arguments.only: MESHES[arguments.only]}
    parameters = (
        f"meshes on a floor of {(floor + 1) ** 2:,} vertices, vertices, resolution {resolution}; K = 1: Lambert; "
        "K = 4: Phong 50 as its diffuse part and 4 factors of its lobe; errors of the picture against all "
        "coefficients, relative L2 without the worst 5 % of pixels, mean over venice, Grace and sunset; times are "
        "medians of interleaved runs"
    )
    with contextlib.ExitStack() as stack:
        folder = arguments.folder or pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
        write = not (arguments.quick or arguments.only)
        title, part = ("Operators", "") if backend() == "cpu" else ("Operators on a GPU", "_gpu")
        report = stack.enter_context(Report("operators", title, parameters, write, part))
        report.text(
            "For comparison, Wang 2006 (P4 2.4 GHz, GeForce 6800), direct light with 1 / 4 terms: bunny of 36 K "
            f"vertices {PAPER[1][2]}, {PAPER[1][3]}; Lucy of 102 K {PAPER[2][2]}, {PAPER[2][3]}; a light on the CPU "
            "83 / 208 and 169 / 556 ms. One bounce took 25 to 32 minutes more on the bunny."
        )
        for name, file in meshes.items():
            for terms in (1, 4):
                scene = _scene(shared("data", "mesh", file), terms, floor)
                compare(report, name, scene, terms, resolution, look, folder / name, runs)
        if backend() == "gpu":
            report.text(f"The GPU: {gpu()}.")
        report.speed()


def compare(report: Report, name: str, scene, terms: int, resolution: int, look: int, folder: pathlib.Path, runs: int):
    """One scene by all operators."""
    import jaxrelight as jr

    environments = [jr.load_environment(shared("data", "env", file)) for file in LIGHTS]
    made, relighters = {}, {}

    def prepare(label: str, **dials):
        # A sun, where a light has one, is compressed like all else.
        method = jr.Transport(
            "vertices", reflection="factors", resolution=resolution, terms=terms, split_sun=False, **dials
        )
        relighters[label], made[label] = prepare_with_build(scene, method, folder)

    for label, dials in DIRECT.items():
        prepare(label, **dials)
    first = next(iter(relighters.values()))
    assert isinstance(first, TransportRelighter)
    view, exact = first.view(), first.exact()
    wanted = [_surface(exact, one, view) for one in environments]
    clock = time.perf_counter()
    exact.light(environments[0])
    exact_seconds = time.perf_counter() - clock
    for label in ONE_BOUNCE:
        prepare(f"{label}, one bounce", bounces=1, gather_resolution=look, **DIRECT[label])
    lights, views = _times(relighters, environments[0], view, runs)
    shares = gpu_shares(relighters, environments[0], runs) if backend() == "gpu" else {}
    rows = []
    for label, relighter in relighters.items():
        bounced = label not in DIRECT
        error = "" if bounced else percent(_error(relighter, environments, view, wanted))
        stage, layers = ("bounce 1", "bounced") if bounced else ("transport", "transport")
        seconds, on_disk = made[label].seconds[stage], made[label].nbytes[layers]
        numbers = [f"{seconds:.0f}", megabytes(on_disk), megabytes(relighter.transport.operator.nbytes), error]
        clocks = [_milliseconds(lights[label]), _milliseconds(views[label]), *shares.get(label, ())]
        rows.append([label, *numbers, *clocks])
    start = made[next(iter(DIRECT))]
    report.text(
        f"**{name}, K = {terms}**, {start.receivers:,} receivers; visibility took {start.seconds['visibility']:.0f} s, "
        "for all, or was there already. Of a bounce, seconds and the store are those of what it adds. A light is the "
        "operator alone, with all coefficients "
        f"{exact_seconds:.1f} s, since their rows are baked at every light."
    )
    heads = ["operator", "made in / s", "in the store", "in memory", "error", "a light / ms", "a view / ms"]
    if shares:
        heads += ["in a chain / ms", "GB/s", "of reading"]
    report.table(heads, rows)


def _times(relighters, environment, view, runs: int) -> tuple[dict[str, Timing], dict[str, Timing]]:
    import jax

    vector = next(iter(relighters.values())).light_vector(_pixels(environment, relighters))
    terms = {label: jax.block_until_ready(relighter.terms(vector)) for label, relighter in relighters.items()}
    lights = {label: lambda one=one: one.terms(vector) for label, one in relighters.items()}
    views = {
        label: lambda label=label, one=one: one.shade_terms(terms[label], view) for label, one in relighters.items()
    }
    return interleaved(lights, runs), interleaved(views, runs)


def backend() -> str:
    """Where JAX runs: "cpu" or "gpu"."""
    import jax

    return jax.default_backend()


def gpu() -> str:
    """The GPU's name."""
    import jax

    return jax.devices()[0].device_kind


def gpu_shares(relighters, environment, runs: int) -> dict[str, list[str]]:
    """Milliseconds of a light among many in one call; bytes of the operator over them; share of the rate of reading."""
    import jax
    import jax.numpy as jnp

    vector = next(iter(relighters.values())).light_vector(_pixels(environment, relighters))
    vectors = vector * jnp.linspace(0.5, 1.5, CHAIN)[:, None, None]

    @jax.jit
    def chain(operators, vectors):
        start = tuple(jnp.zeros((operator.shape[0], vectors.shape[-1])) for operator in operators)

        def add(sums, vector):
            return tuple(total + one.apply(vector) for total, one in zip(sums, operators, strict=True)), None

        return jax.lax.scan(add, start, vectors)[0]

    large = jnp.ones(2**28)
    operators = {label: one.transport.operator.operators for label, one in relighters.items()}
    sides = {label: lambda one=one: chain(one, vectors) for label, one in operators.items()}
    read = jax.jit(jnp.sum)
    times = interleaved({"reading": lambda: read(large), **sides}, runs)
    rate = large.nbytes / times["reading"].least
    shares = {}
    for label in relighters:
        seconds = times[label].median / CHAIN
        speed = relighters[label].transport.operator.nbytes / seconds
        shares[label] = [f"{seconds * 1e3:.3f}", f"{speed / 1e9:.0f}", f"{speed / rate:.2f}"]
    return shares


def _pixels(environment, relighters):
    import jax.numpy as jnp

    from jaxrelight.lights.environment import coarsened

    resolution = next(iter(relighters.values())).method.resolution
    return jnp.asarray(coarsened(environment.pixels, resolution))


def _surface(relighter, environment, view) -> np.ndarray:
    """The picture of an environment's light, without background."""
    return relighter.shade(relighter.light(environment), view).rgba()


def _error(relighter, environments, view, wanted) -> float:
    import jaxrelight as jr

    pairs = zip(environments, wanted, strict=True)
    errors = [jr.image_error(_surface(relighter, one, view), picture).trimmed for one, picture in pairs]
    return float(np.mean(errors))


def _milliseconds(timing: Timing) -> str:
    return f"{timing.median * 1e3:.1f}"


if __name__ == "__main__":
    main()
