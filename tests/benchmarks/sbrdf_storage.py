"""SBRDF maps in compact storage: bytes, seconds, and what rounding does to pictures."""

import argparse
import dataclasses
import pathlib
import tempfile
import time
from collections.abc import Callable

import numpy as np

from jaxrelight.brdf.files.sbrdf import SbrdfLevel
from tests.benchmarks.measuring import Report, megabytes, percent, shared

EXPONENTS = 1, 5, 20, 80, 200


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.sbrdf_storage", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small maps and pictures; RESULTS.md is left as it is")
    quick = parser.parse_args().quick
    shared("data", "mesh", "spot.obj")
    side, size = (32, 64) if quick else (512, 400)
    parameters = (
        f"spot with {side}² texels of two lobes, {size}² pixels under Grace Cathedral and three lights; relative L2 "
        "against the same maps in float32"
    )
    with Report("sbrdf_storage", "Compact SBRDF maps", parameters, not quick) as report:
        measure(report, side, size)


def maps(side: int, exponents: tuple[float, float], seed: int = 0) -> SbrdfLevel:
    """Lobes that reflect a tenth to a half each, anisotropic by up to a fifth, forwards and off-specular."""
    from fitting import uniform
    from jaxrelight.brdf.lobes import lambert

    chance, shape = np.random.default_rng(seed), (side, side, 2)
    level = uniform(lambert(0.1), (side, side))
    low, high = np.log(exponents)
    x = -chance.uniform(0.8, 1, shape)
    C = np.stack([x, -chance.uniform(0.8, 1, shape), chance.uniform(0.8, 1, shape)], axis=-1)
    n = np.exp(chance.uniform(low, high, shape))
    angle = chance.uniform(0, np.pi, shape[:2])
    arrays = {
        "diffuse": chance.uniform(0, 0.5, (*shape[:2], 3)),
        "C": C / np.abs(C).max(axis=-1, keepdims=True),
        "exponent": n,
        "scale": chance.uniform(0.1, 0.5, (*shape, 3)) * (n[..., None] + 2) / (2 * np.pi),
        "axis": np.stack([np.cos(2 * angle), np.sin(2 * angle)], axis=-1),
    }
    lobes = dataclasses.replace(level.lobes, **{name: np.asarray(a, np.float32) for name, a in arrays.items()})
    return dataclasses.replace(level, lobes=lobes)


def measure(report: Report, side: int, size: int):
    """Rows: ways to store. Columns: exponents."""
    from jaxrelight import load_environment
    from jaxrelight.brdf.files.sbrdf import read_sbrdf, write_sbrdf
    from jaxrelight.lights.prefiltered import prefilter

    sky = prefilter(load_environment(shared("data", "env", "grace_latlong.exr")).pixels)
    columns = [*((n, n) for n in EXPONENTS), (1, 200)]
    heads = [f"n = {n:g}" for n in EXPONENTS] + ["n = 1 … 200"]
    errors: dict[str, list[str]] = {}
    sizes = {}
    with tempfile.TemporaryDirectory() as folder:
        for exponents in columns:
            level = maps(side, exponents)
            truth = pictures(level, size, sky)
            for storage in ("half", "8bit"):
                path = pathlib.Path(folder, f"{storage}.exr")
                start = time.perf_counter()
                write_sbrdf(path, [level], storage)
                wrote = time.perf_counter()
                (decoded,) = read_sbrdf(path)
                seconds = f"{wrote - start:.1f} s", f"{time.perf_counter() - wrote:.2f} s"
                sizes[storage] = [megabytes(path.stat().st_size), *seconds]
                errors.setdefault(storage, []).append(apart(pictures(decoded, size, sky), truth))
            for name, change in CHANGES.items():
                changed = dataclasses.replace(level, lobes=change(level.lobes))
                errors.setdefault(name, []).append(apart(pictures(changed, size, sky), truth))
        write_sbrdf(pathlib.Path(folder, "float.exr"), [level])
        report.text(f"In float32 the last file takes {megabytes(pathlib.Path(folder, 'float.exr').stat().st_size)}.")
    rows = [[name, *row, *sizes.get(name, ["", "", ""])] for name, row in errors.items()]
    report.text("Under the environment / under the lights; targets: half 0.3 %, 8 bits 2 %. Below: single parts alone.")
    report.table(["storage", *heads, "file", "write", "read"], rows)


def c_in_half(lobes):
    """C itself in half floats: what its power makes of their rounding."""
    return dataclasses.replace(lobes, C=np.asarray(lobes.C).astype(np.float16).astype(np.float32))


def c_fixed_point(lobes):
    """C in steps of 1/127, not rescaled."""
    return dataclasses.replace(lobes, C=np.rint(np.asarray(lobes.C) * 127) / 127)


def c_rescaled(lobes):
    """The same, of the length that keeps ratios best where the lobe is bright; the scale takes up the rest."""
    C, n = np.asarray(lobes.C), np.asarray(lobes.exponent)
    best, change, least = C, np.zeros_like(n), np.full(n.shape, np.inf)
    for length in np.linspace(64, 127, 253):
        tried = np.rint(C * length)
        tried /= np.abs(tried).max(axis=-1, keepdims=True)
        off, weight = np.log(np.abs(tried / C)), np.abs(C) ** n[..., None] + 0.05
        mean = (weight * off).sum(axis=-1, keepdims=True) / weight.sum(axis=-1, keepdims=True)
        error = (weight * (off - mean) ** 2).sum(axis=-1)
        better = error < least
        best = np.where(better[..., None], tried, best)
        change, least = np.where(better, mean[..., 0], change), np.minimum(error, least)
    return dataclasses.replace(lobes, C=best, scale=lobes.scale * np.exp(-n * change)[..., None])


def paper_exponent(lobes):
    """The paper's 255·√(n/255) in 8 bits; lobes reflect what they did."""
    n = np.asarray(lobes.exponent)
    return with_exponent(lobes, 255 * (np.rint(255 * np.sqrt(n / 255)) / 255) ** 2)


def our_exponent(lobes):
    """Even steps of log(n + 1) up to 100,000."""
    step = np.log1p(1e5) / 255
    return with_exponent(lobes, np.expm1(np.rint(np.log1p(np.asarray(lobes.exponent)) / step) * step))


def with_exponent(lobes, n):
    """Other exponents; |C|ⁿ and what a lobe reflects stay."""
    C, old = np.asarray(lobes.C), np.asarray(lobes.exponent)
    powers = np.sign(C) * np.abs(C) ** (old / n)[..., None]
    return dataclasses.replace(lobes, C=powers, exponent=n, scale=lobes.scale * ((n + 2) / (old + 2))[..., None])


CHANGES: dict[str, Callable] = {
    "half: C as it is": c_in_half,
    "8 bit: C fixed point": c_fixed_point,
    "8 bit: C rescaled, as in the paper": c_rescaled,
    "8 bit: n as in the paper": paper_exponent,
    "8 bit: n by its logarithm": our_exponent,
}


def pictures(level: SbrdfLevel, size: int, sky) -> list[np.ndarray]:
    """Under the environment, and under the lights."""
    from jaxrelight import Prefiltered, prepare
    from jaxrelight.lighting.prefiltered import PrefilteredRelighter, shade_environment
    from tests.benchmarks.composed_cow import cow

    scene = cow([level], size)
    relighter = prepare(dataclasses.replace(scene, parts=scene.parts[:1]), Prefiltered(occlusion_resolution=0))
    assert isinstance(relighter, PrefilteredRelighter)
    view = relighter.view()
    lit = relighter.shade(relighter.light(scene.lights), view).radiance
    return [np.asarray(shade_environment(relighter.materials, view, sky)), np.asarray(lit)]


def apart(images: list[np.ndarray], truth: list[np.ndarray]) -> str:
    """Relative L2 of both."""
    both = zip(images, truth, strict=True)
    return " / ".join(percent(float(np.linalg.norm(a - b) / np.linalg.norm(b))) for a, b in both)


if __name__ == "__main__":
    main()
