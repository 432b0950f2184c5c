"""Direct-to-indirect transfer: rooms against another renderer's images, by each of its dials (Hašan 2006)."""

import argparse
import contextlib
import dataclasses
import functools
import pathlib
import tempfile
from typing import Any

import numpy as np

from jaxrelight.precomputation.load import load
from jaxrelight.precomputation.precompute import precompute
from tests.benchmarks.measuring import Report, interleaved, megabytes, percent, shared

# Targets for the whole image.
ROOMS = {"room_point": 0.03, "room_spot": 0.03, "room_glossy": 0.04}
KEPT: dict[str, dict[str, Any]] = {
    "shared, 0.003": {"tolerance": 0.003},
    "shared, 0.01": {"tolerance": 0.01},
    "shared, 0.02": {},
    "shared, 0.02, 8 bits": {"bits": 8},
    "shared, 0.03, 8 bits": {"tolerance": 0.03, "bits": 8},
    **{f"N = {count}": {"coefficients": count} for count in (10, 40, 100, 400)},
}
# The paper's numbers of coefficients, of pixels and between surfaces: of two of these.
PAPER = "N = 100", "N = 40"
FEW = "shared, 0.003", "shared, 0.02", "N = 40", "N = 100"
DIALS: dict[str, dict[str, Any]] = {
    "all coefficients": {"tolerance": 0.0},
    "solid angle 0.3": {"tolerance": 0.003, "solid_angle": 0.3},
    "solid angle 0.1": {"tolerance": 0.003},
    "solid angle 0.03": {"tolerance": 0.003, "solid_angle": 0.03},
    "solid angle 0.01": {"tolerance": 0.003, "solid_angle": 0.01},
    "near: clamp": {"tolerance": 0.003, "near": "clamp"},
    "importance": {"tolerance": 0.003, "importance": True},
    "4,096 samples": {"tolerance": 0.003, "gather_samples": 4096},
    "1,000,000 photons": {"tolerance": 0.003, "photons": 1_000_000},
}
PEAKS = 1.0, 0.1, 0.03, 0.01, 0.003
EXPONENTS = 40.0, 1000.0
WHITE = 0.7


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.indirect", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="1,024 gather samples; RESULTS.md is left as it is")
    parser.add_argument("--folder", type=pathlib.Path, help="keep the stores here and reuse them")
    parser.add_argument("--only", choices=[*ROOMS, "dials", "peaks", "closed"], help="one of the tables")
    arguments = parser.parse_args()
    samples = 1024 if arguments.quick else 16384
    parameters = f"{samples:,} gather samples, three bounces, 256×256 pixels; errors by `image_error`, trimmed"
    with contextlib.ExitStack() as stack:
        folder = arguments.folder or pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
        write = not (arguments.quick or arguments.only)
        report = stack.enter_context(Report("indirect", "Direct-to-indirect transfer", parameters, write))
        for name, target in ROOMS.items():
            if arguments.only in (None, name):
                report.text(f"**`{name}`**; targets: whole ≤ {percent(target)}, alone ≤ 6 %, with N = 100, 40 between.")
                kept = KEPT if name == "room_spot" else {label: KEPT[label] for label in FEW}
                room(report, name, kept, samples, folder / name)
        if arguments.only in (None, "dials"):
            report.text("**Dials, `room_spot`**; target: alone ≤ 3 % with all coefficients.")
            room(report, "room_spot", DIALS, samples, folder / "dials", apart=True)
        if arguments.only in (None, "peaks"):
            peaks(report, samples, folder / "peaks")
        if arguments.only in (None, "closed"):
            closed(report, samples, folder / "closed")
        report.speed()


def room(
    report: Report, name: str, every: dict[str, dict[str, Any]], samples: int, folder: pathlib.Path, apart: bool = False
):
    """One room by some dials, each in a store of its own where they are `apart`: nothing is there already."""
    import jaxrelight as jr
    from jaxrelight.lighting.indirect import IndirectRelighter

    scene = jr.load_scene(shared("reference", f"{name}.toml"))
    none, three = (jr.read_image(shared("reference", f"{name}_b{bounces}.exr")) for bounces in (0, 3))
    alone = np.concatenate([three[..., :3] - none[..., :3], three[..., 3:]], axis=-1)
    rows, opened = [], {}

    def told(relighter: IndirectRelighter) -> tuple[list[str], list[str]]:
        """Errors and energy; milliseconds."""
        whole = relighter.image(scene.lights)
        indirect = np.array(whole)
        indirect[..., :3] = np.asarray(relighter.indirect(scene.lights))
        errors = [jr.image_error(whole, three).trimmed, jr.image_error(indirect, alone).trimmed]
        energy = indirect[..., :3].sum() / alone[..., :3].sum()
        light = relighter.cloud_light(scene.lights)
        calls = {"spread": relighter.spread, "pixels": relighter.gathered}
        times = interleaved({name: functools.partial(call, light) for name, call in calls.items()}, 5)
        return [*map(percent, errors), percent(energy)], [f"{times[call].median * 1e3:.1f}" for call in calls]

    for label, dials in every.items():
        settings = jr.Indirect(bounces=3, **{"gather_samples": samples, **dials})
        made = precompute(scene, settings, folder / label if apart else folder)
        opened[label] = load(made.folder, made.header, made.geometry)
        errors, milliseconds = told(IndirectRelighter(opened[label]))
        seconds = [f"{made.seconds[stage]:.0f}" for stage in ("between", "pixels")]
        size = sum(made.nbytes.get(kind, 0) for kind in ("between", "indirect"))
        rays = f"{made.rays / 1e6:.0f}"
        rows.append([label, *errors, rays, *seconds, megabytes(size), *milliseconds])
    if opened.keys() >= set(PAPER):
        pixels, fewer = (opened[label] for label in PAPER)
        cloud = dataclasses.replace(pixels.cloud, between=fewer.cloud.between)
        errors, milliseconds = told(IndirectRelighter(dataclasses.replace(pixels, cloud=cloud)))
        rows.append(["N = 100, 40 between", *errors, "", "", "", "", *milliseconds])
    stages = "between / s", "pixels / s", "store", "spread / ms", "pixels / ms"
    report.table(["dials", "whole", "indirect alone", "energy", "rays / M", *stages], rows)


def peaks(report: Report, samples: int, folder: pathlib.Path):
    """Sharp lobes by how far nodes are split in them."""
    import jaxrelight as jr
    from jaxrelight.lighting.indirect import IndirectRelighter

    read = jr.load_scene(shared("reference", "room_glossy.toml"))
    camera, rows = dataclasses.replace(read.camera, width=96, height=96), []
    for exponent in EXPONENTS:
        materials = {**read.materials, "object": jr.phong(0.05, 0.8, exponent)}
        scene = dataclasses.replace(read, camera=camera, materials=materials)
        wanted = None
        for solid_angle, peak in ((0.002, 1e-4), *((0.1, peak) for peak in PEAKS)):
            dials = {"solid_angle": solid_angle, "peak": peak, "tolerance": 0.0, "bounces": 1}
            settings = jr.Indirect(gather_samples=samples, **dials)
            made = precompute(scene, settings, folder / f"{exponent}-{solid_angle}-{peak}")
            relighter = IndirectRelighter(load(made.folder, made.header, made.geometry))
            found = np.asarray(relighter.gathered(relighter.cloud_light(scene.lights), "glossy"))
            wanted = found if wanted is None else wanted
            error = float(np.linalg.norm(found - wanted) / np.linalg.norm(wanted))
            rays, seconds = f"{made.rays / 1e6:.0f}", f"{made.seconds['pixels']:.1f}"
            rows.append([f"{exponent:g}", f"{solid_angle:g}", f"{peak:g}", percent(error), rays, seconds])
    report.text(
        "**Glossy peaks**: `room_glossy` at 96×96 pixels with another exponent, one bounce, what is reflected "
        "glossily; against the first line of each."
    )
    report.table(["exponent", "solid angle", "peak", "differs by", "rays / M", "pixels / s"], rows)


def closed(report: Report, samples: int, folder: pathlib.Path):
    """A closed white room that emits: sums of rows, and the series."""
    import jax.numpy as jnp

    import jaxrelight as jr
    from jaxrelight.brdf.material import Component, Material
    from jaxrelight.lighting.indirect import IndirectRelighter

    made = jr.box((1, 1, 1), 16)
    walls = dataclasses.replace(made, faces=made.faces[:, ::-1], normals=-made.normals)
    white = Material((Component(jr.lambert(WHITE)),), emission=np.ones(3, np.float32))
    camera = jr.Camera((0, 0.05, 0.4), (0.1, -0.1, -1), fov_y=70.0, width=64, height=64)
    scene, rows = jr.Scene([jr.Part(walls, "white")], {"white": white}, camera), []
    for near in ("disc", "clamp"):
        for bounces in (1, 2, 3, 4):
            dials: dict[str, Any] = {"near": near, "bounces": bounces, "tolerance": 0.0}
            done = precompute(scene, jr.Indirect(gather_samples=samples, **dials), folder / near)
            relighter = IndirectRelighter(load(done.folder, done.header, done.placed))
            found = np.asarray(relighter.indirect([]))[..., 0]
            wanted = sum(WHITE**n for n in range(bounces + 1))
            cells = ["", ""]
            if bounces > 1:
                ones = jnp.ones((samples, 3))
                sums = np.asarray(relighter.spread(ones, 2) - ones)[:, 0]
                cells = [f"{sums.mean():.4f}", f"{sums.max():.4f}"]
            off = percent(float(np.sqrt(np.mean((found / wanted - 1) ** 2)))), percent(float(found.mean() / wanted - 1))
            rows.append([f"{near}, {bounces}", *cells, f"{wanted:.4f}", f"{found.mean():.4f}", *off])
    report.text(
        f"**A closed white room** of albedo {WHITE} that emits 1 (targets: sums of rows never above the albedo; the "
        "picture within 2 % of the series)."
    )
    heads = ["mean sum of rows", "largest", "series", "picture", "rms off", "mean off"]
    report.table(["near, bounces", *heads], rows)


if __name__ == "__main__":
    main()
