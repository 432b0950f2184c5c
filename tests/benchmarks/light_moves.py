"""What a light move costs in two buildings, in the rows of Hašan 2006, Table 2; and millions of triangles."""

import argparse
import contextlib
import dataclasses
import json
import pathlib
import shutil
import tempfile
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from tests.benchmarks.large_scenes import CASES, scene_text
from tests.benchmarks.measuring import Report, answer, interleaved, megabytes, percent, run_child, shared

MODULE = "tests.benchmarks.light_moves"
# Of a lamp in each scene: place, place of a spot, what it looks at, and an intensity.
LAMPS = {
    "sponza": ([-300, 400, 60], [-500, 900, 0], [-200, 0, 40], 3e5),
    "staircase": ([0.4, 2.6, 1.2], [1.0, 2.9, 2.6], [-1.2, 0.8, -0.6], 12.0),
}
# Rows of Table 2 for its scene of the same kind, Sponza and the still life: spot light, then omni light.
PAPER_SCENE = {"sponza": "paper: Sponza", "staircase": "paper: still life"}
PAPER = {
    "sponza": ["66k", "1.2 h", "4164", "72 MB", "23 MB", "100, 40"],
    "staircase": ["107k", "1.3 h", "3863", "80 MB", "19 MB", "100, 40"],
}
PAPER_LIGHT = {
    ("sponza", "spot"): ["13.1-15.5", "21.3-24.9", "1.4 ms", "3.6 ms", "62.8 ms", "32.9 ms", "4.7 ms"],
    ("sponza", "point"): ["11.3-12.2", "13.7-18.2", "7.3 ms", "10 ms", "62.7 ms", "44.8 ms", "4.7 ms"],
    ("staircase", "spot"): ["10.9-13.0", "13.7-18.7", "2.7 ms", "3.5 ms", "76.4 ms", "46.1 ms", "4.6 ms"],
    ("staircase", "point"): ["9.7-10.5", "11.4-13.5", "11 ms", "8.3 ms", "75.8 ms", "58.2 ms", "4.8 ms"],
}
CULLING = 3e-4, 1e-3, 3e-3, 1e-2
# The longest edge that makes about two million triangles of a scene.
FINE = "sponza", 14.0
COARSER = "sponza", 400.0
ROUNDS = 9
# Of shared rows; and by how much pictures of rows may differ from theirs to be as good.
TOLERANCE = 0.03
# Coefficients of rows, of pixels and between surfaces: the paper's, and more, until they are as good as clusters.
ROWS = (100, 40), (400, 160), (1600, 640)


def main():
    parser = argparse.ArgumentParser(prog=f"python -m {MODULE}", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few pixels and points of one scene; RESULTS.md is left")
    parser.add_argument("--only", choices=CASES, help="one of the scenes")
    parser.add_argument("--pictures", type=pathlib.Path, help="write the pictures here")
    parser.add_argument("--folder", type=pathlib.Path, help="keep stores and figures here, and go on from them")
    parser.add_argument("--child", type=json.loads, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        child(**arguments.child)
        return
    shared("data", "mesh")
    width, samples = (64, 1024) if arguments.quick else (640, 65536)
    parameters = (
        f"{width}×{width * 3 // 4} pixels of 2×2 samples, {samples:,} gather samples, three bounces, tolerance 0.03, 8 "
        "bits; a fresh process for each scene"
    )
    chosen = [arguments.only] if arguments.only else list(CASES)[: 1 if arguments.quick else None]
    write = not (arguments.quick or arguments.only)
    with contextlib.ExitStack() as stack:
        folder = arguments.folder or pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder.mkdir(parents=True, exist_ok=True)
        report = stack.enter_context(Report("light_moves", "Moving lights in buildings", parameters, write))
        told = {name: measured(folder, name, width, samples, arguments.pictures) for name in chosen}
        buildings(report, told)
        row_form(report, told)
        for name, one in told.items():
            culling(report, name, one)
        finer(report, folder, *((64, 1024, COARSER) if arguments.quick else (320, 16384, FINE)))
        report.speed()


def measured(folder: pathlib.Path, name: str, width: int, samples: int, pictures: pathlib.Path | None = None, **more):
    """What fresh processes tell of a scene: one that precomputes, and one that moves lights."""
    given = {"name": name, "width": width, "samples": samples, "folder": str(folder.resolve()), **more}
    stem = f"{name}_{width}_{more.get('max_edge')}"
    if not (folder / f"{stem}.json").exists():
        # What another run has made of it is not timed.
        shutil.rmtree(folder / stem, ignore_errors=True)
    told = _kept(folder / f"{stem}.json", given | {"only_precompute": True})
    if not more.get("only_precompute"):
        if pictures:
            pictures.mkdir(parents=True, exist_ok=True)
            given["picture"] = str((pictures / f"{name}.png").resolve())
        told |= {"precomputed": told["peak_memory"]} | _kept(folder / f"{name}_{width}_moves.json", given)
    return told


def _kept(file: pathlib.Path, given: dict) -> dict:
    """What a process tells, once."""
    if not file.exists():
        file.write_text(json.dumps(run_child(MODULE, "--child", json.dumps(given))))
    return json.loads(file.read_text())


def buildings(report: Report, told: dict[str, dict]):
    """Table 2."""
    rows = []

    def row(what: str, show: Callable[[dict], str], paper: int | None = None):
        cells = []
        for name, one in told.items():
            cells += [show(one), "" if paper is None else PAPER[name][paper]]
        rows.append([what, *cells])

    row("triangles", lambda t: f"{t['triangles']:,}", 0)
    row("final gather", lambda t: f"{t['seconds']['pixels']:.0f} s", 1)
    row("light between surfaces", lambda t: f"{t['seconds']['between']:.0f} s")
    row("all of precomputation (target ≤ 1,200 s)", lambda t: f"{t['precompute']:.0f} s")
    row("its peak memory (target ≤ 4.29 GB)", lambda t: megabytes(t["precomputed"]))
    row("visibility rays of a receiver", lambda t: f"{t['rays'] / t['receivers']:,.0f}", 2)
    row("final gather, size", lambda t: megabytes(t["bytes"]["indirect"]), 3)
    row("multi-bounce, size", lambda t: megabytes(t["bytes"]["between"]), 4)
    row("both (target ≤ 100 MB)", lambda t: megabytes(t["bytes"]["indirect"] + t["bytes"]["between"]))
    row("both in memory", lambda t: megabytes(t["memory"]["clusters"]))
    row("coefficients of a group, shared rows", lambda t: f"{t['support']:.0f}, {t['shared']:.1f}", 5)
    row("opening, first light", lambda t: f"{t['first']:.1f} s")
    for light in ("spot", "point"):

        def of(what: str, show: Callable[[dict], str], paper: int | None = None, light=light):
            cells = []
            for name, one in told.items():
                theirs = "" if paper is None else PAPER_LIGHT[name, light][paper]
                cells += [show(one["lights"][light]), theirs]
            rows.append([f"{light}: {what}", *cells])

        of("whole moves a second (target ≥ 4)", lambda t: f"{1 / t['move']:.1f}", 0)
        of("the same, culled, in the paper", lambda t: "", 1)
        of("shadow rays", lambda t: f"{t['shadows'] * 1e3:.1f} ms", 2)
        of("shading view and cloud", lambda t: f"{t['shading'] * 1e3:.1f} ms", 3)
        of("transform, clusters (target ≤ 40 ms)", lambda t: f"{t['clusters'] * 1e3:.1f} ms", 4)
        of("of that, pixels", lambda t: f"{t['gather'] * 1e3:.1f} ms")
        of("transform, column blocks", lambda t: f"{t['culling'][0][0] * 1e3:.1f} ms")
        of("joining", lambda t: f"{t['joining'] * 1e3:.1f} ms", 6)
    row("colours and strengths of four lights a second (target ≥ 60)", lambda t: f"{1 / t['colours']:.0f}")
    row("column blocks in memory", lambda t: megabytes(t["memory"]["blocks"]))
    heads = []
    for name in told:
        heads += [name, PAPER_SCENE[name]]
    report.table(["what", *heads], rows)


def row_form(report: Report, told: dict[str, dict]):
    """Clusters against rows of their own coefficients."""
    rows = []
    for name, one in told.items():
        for light, each in one["lights"].items():
            for count, (seconds, over, differ) in each["rows"].items():
                size = megabytes(one["memory"]["rows"][count])
                cells = f"{each['clusters'] * 1e3:.1f} ms", f"{seconds * 1e3:.1f} ms", f"{over:.2f}×", percent(differ)
                rows.append([f"{name}, {light}", f"{count}, {dict(ROWS)[int(count)]}", size, *cells])
    report.text(
        "**Clusters and rows**: the same transport as rows that each keep N coefficients of their own, those that "
        "matter most under lamps, of pixels and between surfaces. Rows are as good where their picture differs from "
        f"that of clusters by no more than {TOLERANCE:.0%}, the tolerance that those have (target ≥ 2.5×)."
    )
    report.table(["scene, light", "N", "in memory", "clusters", "rows", "rows over clusters", "differ by"], rows)


def culling(report: Report, name: str, told: dict):
    """Time and error of column blocks."""
    for light in ("spot", "point"):
        (whole, *_), *each = told["lights"][light]["culling"]
        rows = [
            [f"{culling:g}", f"{seconds * 1e3:.1f} ms", f"{whole / seconds:.2f}×", percent(kept), percent(error)]
            for culling, (seconds, kept, error) in zip(CULLING, each, strict=True)
        ]
        report.text(
            f"**Column blocks of {name}, {light}**: blocks are left out that add less than ε times their "
            f"root-mean-square; without, {whole * 1e3:.1f} ms (target ≥ 1.5× faster at ≤ 0.5 % added error, of a spot)."
        )
        report.table(["ε", "transform", "faster", "blocks kept", "added error"], rows)


def finer(report: Report, folder: pathlib.Path, width: int, samples: int, fine: tuple[str, float]):
    """The same view and budgets, of many more triangles."""
    name, edge = fine
    every = [measured(folder, name, width, samples, only_precompute=True, max_edge=longest) for longest in (None, edge)]
    rows = [
        [
            f"{one['triangles']:,}",
            f"{one['precompute']:.0f} s",
            f"{one['precompute'] / every[0]['precompute']:.2f}×",
            f"{one['rays'] / 1e6:.0f} M",
            megabytes(one["peak_memory"]),
        ]
        for one in every
    ]
    report.text(
        f"**Finer meshes**: faces of {name} split until no edge is longer than {edge:g}, {width}×{width * 3 // 4} "
        f"pixels, {samples:,} gather samples (target ≤ 1.5×)."
    )
    report.table(["triangles", "precompute", "ratio", "rays", "peak memory"], rows)


def child(
    name: str,
    width: int,
    samples: int,
    folder: str,
    max_edge: float | None = None,
    only_precompute: bool = False,
    picture: str | None = None,
):
    """One scene in this process."""
    from jaxrelight.command_line import _share_freed_memory

    _share_freed_memory()
    import jaxrelight as jr
    from jaxrelight.precomputation.precompute import precompute

    mesh, materials, origin, target, fov_y, _ = CASES[name]
    text = scene_text(mesh, materials, origin, target, fov_y, max_edge or 1e30)
    text = text.replace("width = 480\nheight = 360", f"width = {width}\nheight = {width * 3 // 4}")
    path = pathlib.Path(folder, f"{name}_{width}_{max_edge}.toml")
    path.write_text("\n".join(line for line in text.splitlines() if not line.endswith("= 1e+30")))
    if not only_precompute:
        answer(moves(name, path.with_suffix(""), picture))
        return
    scene = jr.load_scene(path)
    start = time.perf_counter()
    method = jr.Indirect(gather_samples=samples, bounces=3, bits=8, compression_tolerance=TOLERANCE)
    made = precompute(scene, method, path.with_suffix(""))
    told = {
        "triangles": sum(len(part.mesh.faces) for part in scene.parts),
        "precompute": time.perf_counter() - start,
        "seconds": made.seconds,
        "rays": made.rays,
        "receivers": made.receivers + samples,
        "bytes": made.nbytes,
    }
    answer(told)


def moves(name: str, folder: pathlib.Path, picture: str | None) -> dict:
    """What moving lights costs in a store."""
    import jax
    import jax.numpy as jnp

    import jaxrelight as jr
    from jaxrelight.gather.cloud_spectrum import cloud_spectrum
    from jaxrelight.lighting.antialiasing import joined
    from jaxrelight.lighting.direct_light import shade_lights
    from jaxrelight.lighting.indirect import IndirectRelighter
    from jaxrelight.lighting.shadows import all_visible, group_lights, trace_visibility
    from jaxrelight.lights.local import point, spot
    from jaxrelight.operators.clustered import Clustered

    place, above, target, intensity = LAMPS[name]
    scale = np.linalg.norm(np.subtract(target, above))
    kinds = {
        "point": lambda by: point(np.add(place, by), [intensity, 0.9 * intensity, 0.8 * intensity]),
        "spot": lambda by: spot(np.add(above, by), target, [2 * intensity, 2 * intensity, 1.6 * intensity], 25.0, 18.0),
    }
    start = time.perf_counter()
    relighter = jr.open_store(folder)
    assert isinstance(relighter, IndirectRelighter)
    view = relighter.view()
    first = relighter.shade(relighter.light(kinds["point"](np.zeros(3))), view).rgba()
    opened = time.perf_counter() - start
    precomputed = relighter.precomputed
    every = [precomputed.cloud.between, *precomputed.transport.operator.operators]
    clusters = [one.clusters() for one in every if isinstance(one, Clustered)]
    both = list(zip(clusters, every, strict=True))
    geometry = precomputed.stored.geometry
    spectrum = cloud_spectrum(precomputed.points, geometry.surfaces, geometry.tracer, relighter.method.seed)
    by_rows = {}
    for counts in (counts for counts in ROWS if counts[0] <= len(spectrum)):
        rows = [as_rows(some, spectrum, counts[0 if i else 1]) for i, some in enumerate(clusters)]
        by_rows[counts[0]] = IndirectRelighter(with_operators(precomputed, *rows))
    blocks = [as_blocks(some, one.columns) for some, one in both]
    filled = [one for some in clusters[1:] for one in some if len(one.support)]
    told = {
        "first": opened,
        "memory": {
            "clusters": sum(one.nbytes for one in every),
            "rows": {
                count: some.precomputed.cloud.between.nbytes + some.transport.operator.nbytes
                for count, some in by_rows.items()
            },
            "blocks": sum(one.nbytes for one in blocks),
        },
        "support": float(np.mean([len(one.support) for one in filled])),
        "shared": float(np.mean([len(one.basis) for one in filled])),
        "lights": {},
    }

    def lit(lamp, shadows: bool = True):
        """Light of the cloud that a lamp gives it, and samples of direct light."""
        groups, points = group_lights([lamp], geometry.surfaces.centre), view.samples.points
        visibility = trace_visibility(points, groups) if shadows else all_visible(points, groups)
        direct = shade_lights(relighter.materials, view.samples, groups, visibility)
        return relighter.direct_light_at_cloud(groups, shadows=shadows), direct

    def transform(some: IndirectRelighter, g):
        """All bounces, as pixels see them."""
        return some.final_gather(some.add_bounces(g), view)

    steps = iter(0.02 * scale * np.sin(np.arange(3, 10_000))[:, None] * [1.0, 0.3, 0.5])
    for kind, make in kinds.items():
        lamp = make(np.zeros(3))
        g, direct = lit(lamp)
        indirect = transform(relighter, g)
        calls = {
            "move": lambda make=make: relighter.shade(relighter.light(make(next(steps))), view).radiance,
            "lit": lambda make=make: lit(make(next(steps))),
            "shading": lambda make=make: lit(make(next(steps)), shadows=False),
            "clusters": lambda g=g: transform(relighter, g),
            **{f"rows {count}": lambda g=g, some=some: transform(some, g) for count, some in by_rows.items()},
            "gather": lambda g=g: relighter.final_gather(g, view),
            "joining": lambda direct=direct, indirect=indirect: joined(direct, indirect, view.nearest),
        }
        times = interleaved(calls, ROUNDS)
        one: dict[str, Any] = {what: time.median for what, time in times.items()}
        one["shadows"] = one["lit"] - one["shading"]
        wanted, one["rows"] = np.asarray(indirect), {}
        for count, some in by_rows.items():
            differ = np.linalg.norm(np.asarray(transform(some, g)) - wanted) / np.linalg.norm(wanted)
            time_of = times[f"rows {count}"]
            one["rows"][count] = time_of.median, time_of.over(times["clusters"]), float(differ)
        told["lights"][kind] = one | {"culling": culled(relighter, blocks, g)}
    layers = jr.LightLayers(relighter, [make(next(steps)) for make in kinds.values() for _ in range(2)])
    gains = iter(np.random.default_rng(0).random((10_000, 4, 3)))
    told["colours"] = interleaved({"": lambda: layers.picture(jnp.asarray(next(gains)))}, 3 * ROUNDS)[""].median
    if picture:
        bright = np.concatenate([np.asarray(layers.picture()), first[..., 3:]], axis=-1)
        bright[..., :3] *= 0.6 / np.quantile(bright[..., :3].mean(axis=-1), 0.95)
        jr.write_image(picture, bright)
    jax.block_until_ready(layers.pictures)
    return told


def with_operators(precomputed, between, *pixels):
    """What a store holds, with other operators between surfaces and of pixels."""
    transport = precomputed.transport
    pairs = zip(transport.blocks, pixels, strict=True)
    blocks = tuple(dataclasses.replace(block, operator=operator) for block, operator in pairs)
    cloud = dataclasses.replace(precomputed.cloud, between=between)
    return dataclasses.replace(precomputed, transport=dataclasses.replace(transport, blocks=blocks), cloud=cloud)


def as_rows(clusters, spectrum: np.ndarray, count: int):
    """The same rows, each with the coefficients of its own that matter most under lamps, in codes of 8 bits."""
    from jaxrelight.operators.quantised import Quantised
    from jaxrelight.operators.sparse_rows import sparse_rows
    from jaxrelight.transport.compression import Rows

    kept = Rows(count, 8, spectrum)
    rows = []
    for one in clusters:
        written = np.einsum("cqr,qs->rcs", one.weights, one.basis, optimize=True).astype(np.float32)
        rows.append(kept.compress(written[:, None], one.support))
    indices, codes, scales = (np.stack([a[k] for a in rows]) for k in ("indices", "values", "values_scale"))
    c, n = codes.shape[-2:]
    coded = Quantised(codes.reshape(-1, c, n), scales.reshape(-1, c, scales.shape[-1]), min(16, n))
    return sparse_rows(indices.reshape(-1, n), coded, len(spectrum))


def as_blocks(clusters, columns: int):
    """The same rows, in blocks of columns."""
    from jaxrelight.operators.column_blocks import ColumnBlocks

    return ColumnBlocks(clusters, columns)


def culled(relighter, blocks, g) -> list[tuple[float, float, float]]:
    """Seconds, share of blocks and error of both bounces between surfaces and of pixels, without culling and with."""
    import jax
    import jax.numpy as jnp

    cloud = relighter.precomputed.cloud

    def transform(culling: float):
        total, taken = g, 0
        for _ in range(relighter.method.bounces - 1):
            radiance, count = blocks[0].apply(relighter._encoded(total), culling)
            total, taken = g + cloud.albedo * radiance[cloud.slot_of], taken + count
        light = relighter._encoded(total)
        pixels = []
        for part in blocks[1:]:
            radiance, count = part.apply(light, culling)
            pixels.append(radiance)
            taken += count
        return pixels, taken

    all_of_them = 2 * blocks[0].count + sum(part.count for part in blocks[1:])
    whole = jnp.concatenate(transform(0.0)[0])
    times = interleaved({str(c): lambda c=c: transform(c)[0] for c in (0.0, *CULLING)}, 3, 1)
    told = []
    for culling in (0.0, *CULLING):
        by_part, taken = transform(culling)
        error = float(jnp.linalg.norm(jnp.concatenate(by_part) - whole) / jnp.linalg.norm(whole))
        told.append((times[str(culling)].median, taken / all_of_them, error))
    jax.clear_caches()
    return told


if __name__ == "__main__":
    main()
