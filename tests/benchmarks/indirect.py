"""Direct-to-indirect transfer: rooms against another renderer's images, by each of its dials (Hašan 2006)."""

import argparse
import contextlib
import dataclasses
import pathlib
import tempfile
from typing import Any

import numpy as np

from jaxrelight.lighting.indirect import IndirectRelighter
from jaxrelight.lighting.prepare import prepare_with_build
from tests.benchmarks.measuring import Report, interleaved, megabytes, percent, shared

# Targets for the whole image.
ROOMS = {"room_point": 0.03, "room_spot": 0.03, "room_glossy": 0.04}
KEPT: dict[str, dict[str, Any]] = {
    "shared, 0.003": {"compression_tolerance": 0.003},
    "shared, 0.01": {"compression_tolerance": 0.01},
    "shared, 0.02": {},
    "shared, 0.02, 8 bits": {"bits": 8},
    "shared, 0.03, 8 bits": {"compression_tolerance": 0.03, "bits": 8},
    **{f"N = {count}": {"coefficients": count} for count in (10, 40, 100, 400)},
}
# The paper's numbers of coefficients, of pixels and between surfaces: of two of these.
PAPER = "N = 100", "N = 40"
FEW = "shared, 0.003", "shared, 0.02", "N = 40", "N = 100"
DIALS: dict[str, dict[str, Any]] = {
    "all coefficients": {"compression_tolerance": 0.0},
    "solid angle 0.3": {"compression_tolerance": 0.003, "solid_angle": 0.3},
    "solid angle 0.1": {"compression_tolerance": 0.003},
    "solid angle 0.03": {"compression_tolerance": 0.003, "solid_angle": 0.03},
    "solid angle 0.01": {"compression_tolerance": 0.003, "solid_angle": 0.01},
    "near: clamp": {"compression_tolerance": 0.003, "near": "clamp"},
    "importance": {"compression_tolerance": 0.003, "importance": True},
    "4,096 samples": {"compression_tolerance": 0.003, "gather_samples": 4096},
    "1,000,000 photons": {"compression_tolerance": 0.003, "photons": 1_000_000},
}
# Those of a trial.
TRIED: dict[str, dict[str, Any]] = {"importance": DIALS["importance"], "1,000,000 photons": {"photons": 10_000}}
PEAKS = 1.0, 0.1, 0.03, 0.01, 0.003
EXPONENTS = 40.0, 1000.0
WHITE = 0.7


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.indirect", description=__doc__)
    parser.add_argument(
        "--quick", action="store_true", help="1,024 gather samples, few dials; RESULTS.md is left as it is"
    )
    parser.add_argument("--folder", type=pathlib.Path, help="keep the stores here and reuse them")
    parser.add_argument("--only", choices=[*ROOMS, "dials", "peaks", "closed"], help="one of the tables")
    arguments = parser.parse_args()
    quick = arguments.quick
    samples, coarser = (1024, 4) if quick else (16384, 1)
    size = 256 // coarser
    parameters = f"{samples:,} gather samples, three bounces, {size}×{size} pixels; errors by `image_error`, trimmed"
    with contextlib.ExitStack() as stack:
        folder = arguments.folder or pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
        write = not (quick or arguments.only)
        report = stack.enter_context(Report("indirect", "Direct-to-indirect transfer", parameters, write))
        for name, target in list(ROOMS.items())[-1 if quick and not arguments.only else 0 :]:
            if arguments.only in (None, name):
                report.text(f"**`{name}`**; targets: whole ≤ {percent(target)}, alone ≤ 6 %, with N = 100, 40 between.")
                kept = KEPT if name == "room_spot" else {label: KEPT[label] for label in FEW}
                room(report, name, kept, samples, folder / name, coarser)
        if arguments.only in (None, "dials"):
            report.text("**Dials, `room_spot`**; target: alone ≤ 3 % with all coefficients.")
            dials = {label: TRIED.get(label, DIALS[label]) for label in (TRIED if quick else DIALS)}
            room(report, "room_spot", dials, samples, folder / "dials", coarser, apart=True)
        if arguments.only in (None, "peaks"):
            peaks(report, samples, folder / "peaks", 1 if quick else None)
        if arguments.only in (None, "closed"):
            closed(report, samples, folder / "closed", 2 if quick else 4)
        report.speed()


def room(
    report: Report,
    name: str,
    every: dict[str, dict[str, Any]],
    samples: int,
    folder: pathlib.Path,
    coarser: int,
    apart: bool = False,
):
    """One room by some dials, each in a store of its own where they are `apart`: nothing is there already."""
    import jaxrelight as jr

    scene = jr.load_scene(shared("reference", f"{name}.toml"))
    width, height = scene.camera.width // coarser, scene.camera.height // coarser
    scene = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, width=width, height=height))
    every_pixel = (jr.read_image(shared("reference", f"{name}_b{bounces}.exr")) for bounces in (0, 3))
    none, three = (image[::coarser, ::coarser] for image in every_pixel)
    alone = np.concatenate([three[..., :3] - none[..., :3], three[..., 3:]], axis=-1)
    rows, opened = [], {}

    def told(relighter: IndirectRelighter) -> tuple[list[str], list[str]]:
        """Errors and energy; milliseconds."""
        view, lit = relighter.view(), relighter.light(scene.lights)
        whole = relighter.shade(lit, view).rgba()
        indirect = np.array(whole)
        indirect[..., :3] = np.asarray(relighter.final_gather(lit.cloud, view))
        errors = [jr.image_error(whole, three).trimmed, jr.image_error(indirect, alone).trimmed]
        energy = indirect[..., :3].sum() / alone[..., :3].sum()
        light = relighter.direct_light_at_cloud(scene.lights.local)
        calls = {
            "bounces": lambda: relighter.add_bounces(light),
            "pixels": lambda: relighter.final_gather(light, view),
        }
        times = interleaved(calls, 5)
        return [*map(percent, errors), percent(energy)], [f"{times[call].median * 1e3:.1f}" for call in calls]

    for label, dials in every.items():
        method = jr.Indirect(bounces=3, **{"gather_samples": samples, **dials})
        opened[label], made = _prepared(scene, method, folder / label if apart else folder)
        errors, milliseconds = told(opened[label])
        seconds = [f"{made.seconds[stage]:.0f}" for stage in ("between", "pixels")]
        size = sum(made.nbytes.get(kind, 0) for kind in ("between", "indirect"))
        rays = f"{made.rays / 1e6:.0f}"
        rows.append([label, *errors, rays, *seconds, megabytes(size), *milliseconds])
    if opened.keys() >= set(PAPER):
        pixels, fewer = (opened[label].precomputed for label in PAPER)
        cloud = dataclasses.replace(pixels.cloud, between=fewer.cloud.between)
        errors, milliseconds = told(IndirectRelighter(dataclasses.replace(pixels, cloud=cloud)))
        rows.append(["N = 100, 40 between", *errors, "", "", "", "", *milliseconds])
    stages = "between / s", "pixels / s", "store", "bounces / ms", "pixels / ms"
    report.table(["dials", "whole", "indirect alone", "energy", "rays / M", *stages], rows)


def _prepared(scene, method, folder: pathlib.Path):
    """A relighter, and what its precomputation did."""
    relighter, made = prepare_with_build(scene, method, folder)
    assert isinstance(relighter, IndirectRelighter)
    assert made is not None
    return relighter, made


def peaks(report: Report, samples: int, folder: pathlib.Path, few: int | None):
    """Sharp lobes by how far nodes are split in them."""
    import jaxrelight as jr

    read = jr.load_scene(shared("reference", "room_glossy.toml"))
    camera, rows = dataclasses.replace(read.camera, width=96, height=96), []
    for exponent in EXPONENTS[:few]:
        materials = {**read.materials, "object": jr.phong(0.05, 0.8, exponent)}
        scene = dataclasses.replace(read, camera=camera, materials=materials)
        wanted = None
        for solid_angle, peak in ((0.002, 1e-4), *((0.1, peak) for peak in PEAKS[:few])):
            dials: dict[str, Any] = {"solid_angle": solid_angle, "peak": peak, "compression_tolerance": 0.0}
            method = jr.Indirect(gather_samples=samples, bounces=1, **dials)
            relighter, made = _prepared(scene, method, folder / f"{exponent}-{solid_angle}-{peak}")
            light = relighter.direct_light_at_cloud(scene.lights.local)
            image = np.asarray(relighter.final_gather(light, relighter.view(), "glossy"))
            wanted = image if wanted is None else wanted
            error = float(np.linalg.norm(image - wanted) / np.linalg.norm(wanted))
            rays, seconds = f"{made.rays / 1e6:.0f}", f"{made.seconds['pixels']:.1f}"
            rows.append([f"{exponent:g}", f"{solid_angle:g}", f"{peak:g}", percent(error), rays, seconds])
    report.text(
        "**Glossy peaks**: `room_glossy` at 96×96 pixels with another exponent, one bounce, what is reflected "
        "glossily; against the first line of each."
    )
    report.table(["exponent", "solid angle", "peak", "differs by", "rays / M", "pixels / s"], rows)


def closed(report: Report, samples: int, folder: pathlib.Path, most: int):
    """A closed white room that emits: sums of rows, and the series."""
    import jax.numpy as jnp

    import jaxrelight as jr
    from jaxrelight.brdf.material import Component, Material
    from tests.scenes import inside_out

    made = jr.box((1, 1, 1), 16)
    walls = inside_out(made)
    white = Material((Component(jr.lambert(WHITE)),), emission=np.ones(3, np.float32))
    camera = jr.Camera((0, 0.05, 0.4), (0.1, -0.1, -1), fov_y=70.0, width=64, height=64)
    scene, rows = jr.Scene([jr.Part(walls, "white")], {"white": white}, camera), []
    for near in ("disc", "clamp"):
        for bounces in range(1, most + 1):
            dials: dict[str, Any] = {"near": near, "bounces": bounces, "compression_tolerance": 0.0}
            relighter, _ = _prepared(scene, jr.Indirect(gather_samples=samples, **dials), folder / near)
            image = np.asarray(relighter.final_gather(relighter.light(None).cloud, relighter.view()))[..., 0]
            wanted = sum(WHITE**n for n in range(bounces + 1))
            cells = ["", ""]
            if bounces > 1:
                ones = jnp.ones((samples, 3))
                sums = np.asarray(relighter.add_bounces(ones, 2) - ones)[:, 0]
                cells = [f"{sums.mean():.4f}", f"{sums.max():.4f}"]
            off = percent(float(np.sqrt(np.mean((image / wanted - 1) ** 2)))), percent(float(image.mean() / wanted - 1))
            rows.append([f"{near}, {bounces}", *cells, f"{wanted:.4f}", f"{image.mean():.4f}", *off])
    report.text(
        f"**A closed white room** of albedo {WHITE} that emits 1 (targets: sums of rows never above the albedo; the "
        "picture within 2 % of the series)."
    )
    heads = ["mean sum of rows", "largest", "series", "picture", "rms off", "mean off"]
    report.table(["near, bounces", *heads], rows)


if __name__ == "__main__":
    main()
