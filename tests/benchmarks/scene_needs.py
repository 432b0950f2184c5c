"""What scenes need of a precomputation: bytes of a convex object, receivers of a floor, and a million receivers."""

import argparse
import contextlib
import dataclasses
import json
import pathlib
import sys
import tempfile
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from tests.benchmarks.measuring import Report, answer, blocks, megabytes, peak_memory, percent, run_child, shared
from tests.benchmarks.shown_pixels import only, pixels_of

MODULE = "tests.benchmarks.scene_needs"
SKIES = {
    "Grace": "grace_latlong.exr",
    "Venice": "pmndrs_venice.exr",
    "sunset": "blender_sunset.exr",
    "Uffizi": "probulator_uffizi.hdr",
}
# What is to be reached: shares of the bunny's bytes a receiver and of all rays; shares of the fine floor's receivers,
# and what its error may be exceeded by; bytes of memory, and seconds a receiver over those of the mesh as it is.
BYTES, RAYS = 1 / 4, 0.01
FLOOR, WORSE = 1 / 8, 0.002
MEMORY, SECONDS = 4 * 2**30, 1.2
TOLERANCES = 0.2, 0.1, 0.05, 0.02
# Quads along a side of the floor that has receivers everywhere.
FINE = 128
MILLION = 1_000_000
DRAGON = "dragon_vrip_res2_bin.ply"
# Seconds between the lines that a long precomputation prints.
_LINES_APART = 20


def main():
    parser = argparse.ArgumentParser(prog=f"python -m {MODULE}", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few receivers, resolution 8; RESULTS.md is left as it is")
    parser.add_argument("--only", choices=PARTS, help="one of the parts; only its section is written")
    parser.add_argument("--resolution", type=int, help="of all parts; RESULTS.md is left as it is")
    parser.add_argument("--folder", type=pathlib.Path, help="keep the stores of the dragon here, and go on with them")
    parser.add_argument("--child", type=int, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    resolution = arguments.resolution or (8 if arguments.quick else 64)
    if arguments.child is not None:
        answer(_dragon(arguments.child, resolution, arguments.folder, arguments.quick))
        return
    shared("data", "mesh")
    write = not (arguments.quick or arguments.resolution)
    with contextlib.ExitStack() as stack:
        folder = (arguments.folder or pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))).resolve()
        folder.mkdir(parents=True, exist_ok=True)
        for part in PARTS if arguments.only is None else [arguments.only]:
            title, measure = PARTS[part]
            parameters = f"part `{part}`; Lambert, vertices as receivers, resolution {resolution}"
            with Report("scene_needs", title, parameters, write, part=f"_{part}") as report:
                measure(report, resolution, arguments.quick, folder)


# Bytes


def convex_objects(report: Report, resolution: int, quick: bool, _: pathlib.Path):
    """Bytes and rays of convex objects in the open beside those of the bunny on its floor."""
    rows = {name: Stored(name, make(), resolution) for name, make in _objects(quick).items()}
    first = next(iter(rows.values()))
    heads = ["bytes a receiver", *rows]
    kinds = sorted({kind for one in rows.values() for kind in one.nbytes})
    table = [["receivers", *(f"{one.receivers:,}" for one in rows.values())]]
    table += [
        [f"store: {kind}", *(f"{one.each(one.nbytes.get(kind, 0)):.1f}" for one in rows.values())] for kind in kinds
    ]
    table += [
        ["store: all but the light", *(f"{one.whole:.1f}" for one in rows.values())],
        [f"… of the bunny's (target ≤ {percent(BYTES)})", *(percent(one.whole / first.whole) for one in rows.values())],
        ["operator in memory", *(f"{one.each(one.operator):.1f}" for one in rows.values())],
        [
            f"… of the bunny's (target ≤ {percent(BYTES)})",
            *(percent(one.each(one.operator) / first.each(first.operator)) for one in rows.values()),
        ],
        [f"rays, of all rays (target ≤ {percent(RAYS)})", *(percent(one.rays) for one in rows.values())],
        ["coefficients of a group", *(f"{one.coefficients:.0f}" for one in rows.values())],
        ["shared rows of a group", *(f"{one.shared_rows:.1f}" for one in rows.values())],
        ["seconds of visibility, transport", *(one.seconds for one in rows.values())],
    ]
    report.text(
        "Convex objects in the open and the bunny on its floor, with all other dials at their defaults. Layers are "
        "counted as they lie on disk, that of the scene's own light in none of the sums; all rays are one for each "
        "texel above a receiver's horizon."
    )
    report.table(heads, table)


def _objects(quick: bool) -> dict[str, Callable]:
    import jaxrelight as jr

    def alone(mesh):
        camera = jr.Camera((0.8, 1.2, 2.0), (0, 0, 0), width=64, height=64)
        return jr.Scene([jr.Part(mesh, "plain")], {"plain": jr.lambert(0.6)}, camera)

    n = 12 if quick else 76
    return {
        "bunny on its floor": lambda: _bunny(quick),
        "a sphere": lambda: alone(jr.sphere(0.5, n)),
        "a box": lambda: alone(jr.box((1, 1, 1), n - 1)),
    }


def _bunny(quick: bool):
    """The bunny on its floor; something smaller for a trial."""
    import jaxrelight as jr

    return jr.scene_of_mesh(shared("data", "mesh", "spot.obj" if quick else "bunny_mitsuba.ply"))


class Stored:
    """What the store of a scene holds.

    Attributes:
        receivers: how many.
        nbytes: on disk, by kind of layer.
        operator: bytes in memory.
        rays: share of all rays.
        coefficients: of a group, in the mean.
        shared_rows: of a group, in the mean.
        seconds: of visibility and transport.
    """

    def __init__(self, name: str, scene, resolution: int):
        import jaxrelight as jr
        from jaxrelight.lighting.prepare import prepare_with_build
        from jaxrelight.lighting.transport import TransportRelighter
        from jaxrelight.operators.clustered import Clustered

        method = jr.Transport("vertices", resolution=resolution)
        with tempfile.TemporaryDirectory() as folder:
            relighter, build = prepare_with_build(scene, method, pathlib.Path(folder) / "store")
        assert build is not None
        assert isinstance(relighter, TransportRelighter)
        clusters = [
            one
            for operator in _operators(relighter.transport.operator)
            if isinstance(operator, Clustered)
            for one in operator.clusters()
        ]
        filled = [one for one in clusters if len(one.support)]
        self.receivers, self.nbytes = build.receivers, build.nbytes
        self.operator = relighter.transport.operator.nbytes
        self.rays = build.rays / _all_rays(build.geometry.receivers, resolution)
        self.coefficients = float(np.mean([len(one.support) for one in filled]))
        self.shared_rows = float(np.mean([len(one.basis) for one in filled]))
        self.seconds = ", ".join(f"{build.seconds[stage]:.1f}" for stage in ("visibility", "transport"))
        print(name, self.nbytes, self.operator, f"{self.receivers:,}", self.seconds, flush=True)

    def each(self, count: float) -> float:
        """Bytes a receiver."""
        return count / self.receivers

    @property
    def whole(self) -> float:
        """Bytes on disk a receiver, without those of the light."""
        return self.each(sum(self.nbytes.values()) - self.nbytes.get("environment", 0))


def _operators(operator) -> list:
    """The parts of a stacked operator, or the operator itself."""
    return list(getattr(operator, "operators", [operator]))


def _all_rays(receivers, resolution: int) -> int:
    """One for each texel above a receiver's horizon."""
    from jaxrelight.basis import cubemap

    directions = cubemap.directions(resolution).astype(np.float32).T
    normals = receivers.normals.reshape(-1, 3)[receivers.slot_of].astype(np.float32)
    return sum(int(np.count_nonzero(normals[part] @ directions > 0)) for part in blocks(len(normals), 4096))


# Floors


def floors(report: Report, resolution: int, quick: bool, _: pathlib.Path):
    """A floor of two triangles whose edges are halved where light needs it, against one of many squares."""
    import jaxrelight as jr

    side, squares = (48, 16) if quick else (192, FINE)
    fine, coarse = (_on_floor(_bunny(quick), count, side) for count in (squares, 1))
    tolerances = TOLERANCES[2:3] if quick else TOLERANCES
    cases = [("squares", fine, 0.0), *(("two triangles", coarse, tolerance) for tolerance in (0.0, *tolerances))]
    lights = {sky: jr.load_environment(shared("data", "env", file)) for sky, file in SKIES.items()}
    rows, first = [], None
    with tempfile.TemporaryDirectory() as temporary:
        folder = pathlib.Path(temporary)
        exact = jr.prepare(coarse, jr.Transport(resolution=resolution, coefficients="all"), folder / "exact")
        view = exact.view()
        pictures = {sky: exact.shade(exact.light(light), view).rgba() for sky, light in lights.items()}
        shown = pixels_of("floor", exact, view)
        for number, (name, scene, tolerance) in enumerate(cases):
            dials: dict[str, Any] = {"resolution": resolution, "coefficients": "all", "receiver_tolerance": tolerance}
            relighter = jr.prepare(scene, jr.Transport("vertices", **dials), folder / str(number))
            errors = _errors(relighter, lights, pictures, shown)
            count = _receivers_of_floor(relighter)
            first = first or (count, errors)
            worse = max(errors[sky][0].trimmed - first[1][sky][0].trimmed for sky in lights)
            receivers = f"{relighter.transport.receivers.count:,}", f"{count:,}"
            row = [name, f"{tolerance:g}", *receivers, percent(count / first[0]), f"{100 * worse:+.2f}"]
            rows.append([*row, *_told(errors)])
            print(rows[-1], flush=True)
        filtered = []
        for name, scene, tolerance in (*cases[:2], (*cases[1][:2], jr.Prefiltered().receiver_tolerance)):
            start = time.perf_counter()
            relighter = jr.prepare(scene, jr.Prefiltered(receiver_tolerance=tolerance))
            seconds = time.perf_counter() - start
            vertices = len(relighter.geometry.surfaces.vertices)
            row = [name, f"{tolerance:g}", f"{vertices:,}", f"{seconds:.1f} s"]
            filtered.append([*row, *_told(_errors(relighter, lights, pictures, shown))])
            print(filtered[-1], flush=True)
    report.text(
        f"The bunny on a floor of {squares}² squares with a receiver at each corner, and on one of two triangles by "
        f"receiver tolerance, which halves edges of the bunny, too; all coefficients, {side}×{side} pixels, against "
        "exact transport at pixels: trimmed / untrimmed of all that is covered, and trimmed of the floor alone. "
        f"Targets: at most {percent(FLOOR)} of the squares' receivers on the floor, and no trimmed error of all that "
        f"is covered more than {100 * WORSE:g} points above that of the squares."
    )
    heads = ["floor", "tolerance", "receivers", "of the floor", "of the squares'", "worse by points"]
    report.table([*heads, *SKIES], rows)
    report.text(
        "The same by prefiltered lighting, whose own approximations are in all rows; the time is its preparation's."
    )
    report.table(["floor", "tolerance", "vertices", "time", *SKIES], filtered)


def _errors(relighter, lights, pictures, shown) -> dict[str, tuple]:
    """Of pictures under every sky: of all pixels, and of some."""
    import jaxrelight as jr

    view, errors = relighter.view(), {}
    for sky, light in lights.items():
        ours = relighter.shade(relighter.light(light), view).rgba()
        errors[sky] = jr.image_error(ours, pictures[sky]), jr.image_error(ours, only(pictures[sky], shown))
    return errors


def _told(errors: dict[str, tuple]) -> list[str]:
    return [
        f"{percent(every.trimmed)} / {percent(every.untrimmed)}; {percent(some.trimmed)}"
        for every, some in errors.values()
    ]


def _on_floor(scene, squares: int, side: int):
    """The scene with so many squares along each side of its floor, and pixels along each side of its picture."""
    import jaxrelight as jr

    *others, floor = scene.parts
    low, high = floor.mesh.vertices.min(axis=0), floor.mesh.vertices.max(axis=0)
    down = np.eye(4)
    down[1, 3] = low[1]
    plane = jr.transformed(jr.plane((high - low)[[0, 2]], squares), down)
    camera = dataclasses.replace(scene.camera, width=side, height=side)
    return dataclasses.replace(scene, parts=(*others, dataclasses.replace(floor, mesh=plane)), camera=camera)


def _receivers_of_floor(relighter) -> int:
    receivers = relighter.transport.receivers
    floors = [number for number, one in enumerate(relighter.materials) if one.name == "floor"]
    return int(receivers.filled[np.isin(receivers.material_of_group, floors)].sum())


# A million receivers


def million(report: Report, resolution: int, quick: bool, folder: pathlib.Path):
    """The dragon as it is and with edges halved until it has a million receivers, each in a process of its own."""
    counts = (0, 20_000) if quick else (0, MILLION)
    dials = "--resolution", str(resolution), "--folder", str(folder), *(["--quick"] if quick else [])
    told = [run_child(MODULE, "--child", str(count), *dials) for count in counts]
    each = [one["seconds"] / one["receivers"] for one in told]
    rows = [
        ["triangles", *(f"{one['triangles']:,}" for one in told)],
        ["receivers", *(f"{one['receivers']:,}" for one in told)],
        *(
            [f"{stage} / s", *(f"{one['stages'].get(stage, 0):.1f}" for one in told)]
            for stage in ("geometry", "visibility", "transport")
        ),
        ["whole call / s", *(f"{one['seconds']:.1f}" for one in told)],
        [f"milliseconds a receiver, over the first (target ≤ {SECONDS:g})"]
        + [f"{1e3 * one:.3f}, {one / each[0]:.2f}" for one in each],
        ["rays / M", *(f"{one['rays'] / 1e6:.0f}" for one in told)],
        ["store", *(megabytes(one["bytes"]) for one in told)],
        [f"peak memory (target ≤ {megabytes(MEMORY)})", *(megabytes(one["peak"]) for one in told)],
    ]
    report.text(
        "The dragon on its floor as its file has it, and with all edges halved, then the longest, until a million "
        "vertices are receivers; each is precomputed in a new process into a new store, rays adaptive, which ends "
        "before the store is opened. A run that was stopped goes on: its seconds are those of all its processes."
    )
    report.table(["what", "as it is", "finer"], rows)
    report.speed()


def _dragon(count: int, resolution: int, folder: pathlib.Path, quick: bool) -> dict:
    """Precomputes the dragon with so many receivers, or with as many as it has; from where another process stopped."""
    import jaxrelight as jr
    from jaxrelight.precomputation.precompute import precompute

    scene = jr.scene_of_mesh(shared("data", "mesh", "dragon_vrip_res4.ply" if quick else DRAGON))
    if count:
        parts = list(scene.parts)
        others = sum(len(part.mesh.vertices) for part in parts[1:])
        parts[0] = dataclasses.replace(parts[0], mesh=_with_vertices(parts[0].mesh, count - others))
        scene = dataclasses.replace(scene, parts=tuple(parts))
    name = folder / f"dragon_{count}_{resolution}"
    progress = Progress(name.with_suffix(".json"))
    made = precompute(scene, jr.Transport("vertices", resolution=resolution), name, progress)
    told = progress.finished(made.seconds, made.rays)
    return told | {
        "triangles": sum(len(part.mesh.faces) for part in scene.parts),
        "receivers": made.receivers,
        "bytes": sum(made.nbytes.values()),
    }


def _with_vertices(mesh, count: int):
    """The same surface with so many vertices: all edges are halved while that is not too many, then the longest."""
    from jaxrelight.geometry.subdivision import edges_of, halved

    while len(mesh.vertices) < count:
        edges = edges_of(mesh)
        lengths = np.linalg.norm(np.diff(mesh.vertices[edges.ends], axis=1)[:, 0], axis=1)
        chosen = np.zeros(len(lengths), bool)
        chosen[np.argsort(lengths)[::-1][: count - len(mesh.vertices)]] = True
        mesh = halved(mesh, edges, chosen)
    return mesh


class Progress:
    """Prints how far a precomputation is, and keeps beside the store what its processes have taken so far.

    It is called as a `Report`.
    """

    def __init__(self, path: pathlib.Path):
        self._path, self._start, self._line = path, time.perf_counter(), 0.0
        self._before = json.loads(path.read_text()) if path.exists() else {"seconds": 0.0, "peak": 0}

    def __call__(self, stage: str, done: int, total: int):
        now = time.perf_counter() - self._start
        if now - self._line >= _LINES_APART:
            self._line = now
            print(f"{self._path.stem}: {stage} {done:,} of {total:,}, {now:.0f} s", file=sys.stderr, flush=True)
            self._path.write_text(json.dumps(self._so_far()))

    def _so_far(self) -> dict:
        seconds = self._before["seconds"] + time.perf_counter() - self._start
        return {"seconds": seconds, "peak": max(self._before["peak"], peak_memory())}

    def finished(self, stages: dict[str, float], rays: int) -> dict:
        """Seconds, those of the stages of the last process, its rays, and the peak; as before where all was done."""
        if "stages" not in self._before:
            self._before = self._so_far() | {"stages": stages, "rays": rays}
            self._path.write_text(json.dumps(self._before))
        return self._before


PARTS = {
    "bytes": ("What convex objects in the open need", convex_objects),
    "floor": ("Receivers of a floor", floors),
    "million": ("A million receivers", million),
}


if __name__ == "__main__":
    main()
