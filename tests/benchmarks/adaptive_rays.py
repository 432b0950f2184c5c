"""Visibility by rays where it changes against all rays: how many they are, what they miss, and how long they take."""

import argparse
import functools
import pathlib
import tempfile
import time
from collections.abc import Callable

import numpy as np

from tests.benchmarks.measuring import Report, answer, percent, run_child, shared

MODULE = "tests.benchmarks.adaptive_rays"
SKIES = {
    "Grace": "grace_latlong.exr",
    "Venice": "pmndrs_venice.exr",
    "sunset": "blender_sunset.exr",
    "Uffizi": "probulator_uffizi.hdr",
}
# What is to be reached: shares of the rays, of the irradiance that may be lost, and of receivers that may lose a fifth
# of what thin things hide.
OPEN, CLOSED, LOST, UNDER_GRACE = 0.32, 0.15, 0.001, 0.003
# Texels along an edge of the cube map that bounces look around with, and of that by which vertices are lit.
GATHERED, LIT = 32, 8


def main():
    parser = argparse.ArgumentParser(prog=f"python -m {MODULE}", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few groups, resolution 32; RESULTS.md is left as it is")
    parser.add_argument("--only", choices=("visibility", "hits"), help="one of the two sections of RESULTS.md")
    parser.add_argument("--child", choices=("all", "adaptive"), help=argparse.SUPPRESS)
    parser.add_argument("--folder", type=pathlib.Path, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    quick = arguments.quick
    resolution, groups = (32, 4) if quick else (64, 64)
    if arguments.child:
        answer(_precomputed(arguments.child, resolution, arguments.folder))
        return
    if arguments.only != "hits":
        parameters = f"resolution {resolution}; groups of 128 receivers, {groups} of each scene by chance"
        with Report("adaptive_rays", "Rays where visibility changes", parameters, not quick) as report:
            _scenes(report, resolution, groups)
            _thin_things(report, resolution)
            _precomputations(report, quick)
            report.speed()
    if arguments.only != "visibility":
        groups //= 4
        parameters = f"resolution {resolution}, gather resolution {GATHERED}; {groups} groups of each scene by chance"
        with Report("adaptive_rays", "Hits of bounces", parameters, not quick, "_hits") as report:
            _hits_of_bounces(report, resolution, groups)
            report.speed()


@functools.cache
def _meshes() -> dict[str, Callable]:
    """Surfaces of scenes, and the share of the rays that they are to need."""
    import jaxrelight as jr
    from jaxrelight.geometry.surfaces import join

    def on_a_floor(file: str):
        return join([part.mesh for part in jr.scene_of_mesh(shared("data", "mesh", file)).parts])

    def alone(file: str):
        return join(jr.load_mesh(shared("data", "mesh", file)).parts)

    return {
        "bunny on a floor": functools.partial(on_a_floor, "bunny_mitsuba.ply"),
        "dragon on a floor": functools.partial(on_a_floor, "dragon_vrip_res2_bin.ply"),
        "staircase": functools.partial(on_a_floor, "staircase/staircase_by_material.glb"),
        "Sponza": functools.partial(on_a_floor, "sponza_crytek_stripped.obj"),
        "a sphere in the open": lambda: join([jr.sphere(1, 64)]),
        "Cornell box": functools.partial(on_a_floor, "CornellBox-Original.obj"),
    }


class Sides:
    """All rays and adaptive ones of groups of receivers.

    Attributes:
        rays: of both.
        seconds: in one thread, in turns.
        different: texels above horizons that differ.
        hidden: of each receiver, the texels that are, by all rays.
        lost: those of them that adaptive rays take for open.
        irradiance: by both, under every sky, [2, receivers, skies, 3].
    """

    def __init__(self, surfaces, resolution: int, groups: int):
        from jaxrelight.basis import cubemap
        from jaxrelight.geometry.occluders import Occluders
        from jaxrelight.geometry.receivers import vertex_receivers
        from jaxrelight.geometry.tracer import Tracer
        from jaxrelight.transport.adaptive_visibility import trace_adaptively
        from jaxrelight.transport.visibility import trace_visibility

        receivers = vertex_receivers(surfaces, np.arange(len(surfaces.two_sided)))
        count = len(receivers.filled)
        chosen = np.sort(np.random.default_rng(0).choice(count, min(groups, count), replace=False))
        tracer, occluders = Tracer(surfaces), Occluders(surfaces)
        directions, skies = cubemap.directions(resolution), _skies(resolution)
        ways = (
            lambda origins, normals: trace_visibility(tracer, origins, normals, directions),
            lambda origins, normals: trace_adaptively(tracer, occluders, origins, normals, resolution),
        )
        self.rays, self.seconds, self.different = np.zeros(2, int), np.zeros(2), 0
        hidden, lost, irradiance = [], [], []
        for group in chosen:
            filled, seen = receivers.filled[group], []
            for way, trace in enumerate(ways):
                start = time.perf_counter()
                packed, rays = trace(receivers.origins[group], receivers.normals[group])
                self.seconds[way] += time.perf_counter() - start
                self.rays[way] += rays
                seen.append(np.unpackbits(packed, axis=1, bitorder="little")[:filled].astype(bool))
            cosines = np.maximum(receivers.normals[group][:filled] @ directions.T, 0)
            # On the horizon itself rounding decides.
            clear = cosines > 1e-6
            self.different += np.count_nonzero((seen[0] != seen[1]) & clear)
            hidden.append((~seen[0] & clear).sum(axis=1))
            lost.append((~seen[0] & seen[1] & clear).sum(axis=1))
            irradiance.append([(of * cosines @ skies).reshape(filled, -1, 3) for of in seen])
        self.hidden, self.lost = np.concatenate(hidden), np.concatenate(lost)
        self.irradiance = np.concatenate(irradiance, axis=1)

    @property
    def errors(self) -> list[float]:
        """Of irradiance under every sky, relative L2 over receivers and channels."""
        exact, found = (np.moveaxis(of, 1, 0).reshape(len(SKIES), -1) for of in self.irradiance)
        return [float(np.linalg.norm(b - a) / np.linalg.norm(a)) for a, b in zip(exact, found, strict=True)]


@functools.cache
def _skies(resolution: int) -> np.ndarray:
    """Radiance times solid angle of texels, skies and their channels side by side."""
    import jax.numpy as jnp

    import jaxrelight as jr
    from jaxrelight.basis import cubemap, latlong
    from jaxrelight.basis.cubemap import Texels
    from jaxrelight.lights.environment import coarsened, encode

    skies = []
    for file in SKIES.values():
        pixels = coarsened(jr.load_environment(shared("data", "env", file)).pixels, resolution)
        resampling = latlong.area_resampling(*pixels.shape[:2], resolution)
        skies.append(np.asarray(encode(jnp.asarray(pixels), 0.0, 1.0, resampling, Texels(resolution))))
    return np.concatenate(skies, axis=1) * cubemap.solid_angles(resolution)[:, None]


def _scenes(report: Report, resolution: int, groups: int):
    rows = []
    for name in ("bunny on a floor", "dragon on a floor", "staircase", "Sponza", "a sphere in the open"):
        surfaces = _meshes()[name]
        sides = Sides(surfaces(), resolution, groups)
        share, seconds = sides.rays[1] / sides.rays[0], sides.seconds[1] / sides.seconds[0]
        rows.append([name, percent(share), percent(seconds), percent(sides.different / sides.rays[0])])
        rows[-1] += [percent(error) for error in sides.errors]
    report.text(
        "Rays and time are shares of those of all rays, the time in one thread and in turns; to be reached are "
        f"{OPEN:.0%} of the rays of the bunny and the dragon, and {CLOSED:.0%} of those of the staircase and Sponza. "
        "Texels are those above horizons that differ. Then follows the error of irradiance under each sky, to be "
        f"{LOST:.1%} at most, and {UNDER_GRACE:.1%} under Grace."
    )
    report.table(["scene", "rays", "time", "texels", *SKIES], rows)


class HitSides:
    """All rays that bounces gather along and those that visibility leaves, of groups of receivers.

    Attributes:
        rays: of both.
        seconds: of the processor, in turns.
        hits: by both.
        in_cells: hits between four directions, four texels apart, that all hit the same face.
        by_plane: seconds to compute all hits from the planes of their faces.
        by_ray: seconds of embree for the same.
        irradiance: of light that is reflected once, by both, under every sky, [2, receivers, skies, 3].
    """

    def __init__(self, surfaces, resolution: int, groups: int):
        from jaxrelight.basis import cubemap
        from jaxrelight.geometry.occluders import Occluders
        from jaxrelight.geometry.receivers import vertex_receivers
        from jaxrelight.geometry.tracer import Tracer
        from jaxrelight.transport.adaptive_visibility import trace_adaptively
        from jaxrelight.transport.hits import trace_hits

        receivers = vertex_receivers(surfaces, np.arange(len(surfaces.two_sided)))
        count = len(receivers.filled)
        chosen = np.sort(np.random.default_rng(0).choice(count, min(groups, count), replace=False))
        tracer, occluders = Tracer(surfaces), Occluders(surfaces)
        directions, solid_angles = cubemap.directions(GATHERED), cubemap.solid_angles(GATHERED)
        lit = _lit(receivers, tracer)
        self.rays, self.seconds, self.hits = np.zeros(2, int), np.zeros(2), np.zeros(2, int)
        self.in_cells, self.by_plane, self.by_ray = 0, 0.0, 0.0
        irradiance = []
        for group in chosen:
            filled, given = receivers.filled[group], (receivers.origins[group], receivers.normals[group])
            bits, _ = trace_adaptively(tracer, occluders, *given, resolution)
            sums = []
            for way, visibility in enumerate((None, bits)):
                start = time.thread_time()
                hits = trace_hits(surfaces, tracer, *given, GATHERED, visibility)
                self.seconds[way] += time.thread_time() - start
                self.rays[way] += hits.rays.traced
                self.hits[way] += len(hits.texel)
                back = hits.points.back[:, None]
                corners = np.where(back, surfaces.back[hits.points.corners], hits.points.corners)
                light = np.einsum("hv,hvx->hx", hits.points.barycentric, lit[receivers.slot_of[corners]])
                cosines = np.sum(given[1][hits.receiver] * directions[hits.texel], axis=1)
                sums.append(np.zeros((len(given[0]), lit.shape[1])))
                np.add.at(sums[way], hits.receiver, light * (cosines * solid_angles[hits.texel])[:, None])
                if not way:
                    self._time_planes(surfaces, tracer, given[0], hits)
            irradiance.append([of[:filled].reshape(filled, -1, 3) for of in sums])
        self.irradiance = np.concatenate(irradiance, axis=1)

    def _time_planes(self, surfaces, tracer, origins: np.ndarray, hits) -> None:
        """Counts hits in cells of one face, and times where all hits' directions meet the planes of their faces."""
        faces = np.full((len(origins), 6 * GATHERED**2), -1)
        faces[hits.receiver, hits.texel] = hits.points.face
        faces = faces.reshape(-1, 6, GATHERED, GATHERED)
        first, last = slice(0, GATHERED - 4, 4), slice(4, GATHERED, 4)
        corners = [faces[:, :, rows, columns] for rows in (first, last) for columns in (first, last)]
        same = (corners[0] >= 0) & np.all([corners[0] == other for other in corners[1:]], axis=0)
        self.in_cells += 15 * np.count_nonzero(same)
        start = time.thread_time()
        corner, along, across = np.moveaxis(surfaces.vertices[hits.points.corners], 1, 0)
        along, across, off = along - corner, across - corner, origins[hits.receiver] - corner
        upright, other = np.cross(-hits.points.omega_o, across), np.cross(off, along)
        size = np.einsum("hx,hx->h", along, upright)
        shares = np.einsum("hx,hx->h", off, upright) / size, -np.einsum("hx,hx->h", hits.points.omega_o, other) / size
        planes = np.stack([1 - shares[0] - shares[1], *shares], axis=1)
        middle = time.thread_time()
        tracer.first_hits(origins[hits.receiver], -hits.points.omega_o)
        self.by_plane, self.by_ray = self.by_plane + middle - start, self.by_ray + time.thread_time() - middle
        assert not len(planes) or np.median(np.abs(planes - hits.points.barycentric)) < 1e-4

    @property
    def errors(self) -> list[float]:
        """Of irradiance under every sky, relative L2 over receivers and channels; 0 where there is none."""
        exact, found = (np.moveaxis(of, 1, 0).reshape(len(SKIES), -1) for of in self.irradiance)
        return [float(np.linalg.norm(b - a) / (np.linalg.norm(a) or 1)) for a, b in zip(exact, found, strict=True)]


def _lit(receivers, tracer) -> np.ndarray:
    """What vertices reflect of every sky, at an albedo of π/2, in the order of the groups; skies side by side."""
    from jaxrelight.basis import cubemap
    from jaxrelight.transport.visibility import trace_visibility

    directions, skies, lit = cubemap.directions(LIT), _skies(LIT), []
    for origins, normals in zip(receivers.origins, receivers.normals, strict=True):
        bits, _ = trace_visibility(tracer, origins, normals, directions)
        lit.append(np.unpackbits(bits, axis=1, bitorder="little") * np.maximum(normals @ directions.T, 0) @ skies / 2)
    return np.concatenate(lit)


def _hits_of_bounces(report: Report, resolution: int, groups: int):
    rows = []
    for name in ("bunny on a floor", "staircase", "Sponza", "Cornell box", "a sphere in the open"):
        sides = HitSides(_meshes()[name](), resolution, groups)
        hits = max(int(sides.hits[0]), 1)
        rows.append([name, percent(hits / sides.rays[0] if hits > 1 else 0.0), percent(sides.rays[1] / sides.rays[0])])
        rows[-1] += [percent(sides.seconds[1] / sides.seconds[0]), percent(1 - sides.hits[1] / hits if hits > 1 else 0)]
        rows[-1] += [percent(error) for error in sides.errors]
        rows[-1] += [percent(sides.in_cells / hits)]
        rows[-1] += [f"{sides.by_plane / sides.by_ray:.2f}" if hits > 1 else "–"]
    report.text(
        "Rays that bounces gather along, counted apart from those of visibility, which is adaptive. Hits, rays and "
        "time are shares of those of all rays; the time is the processor's, with all that is computed of hits, in "
        "turns. Lost are shares of the hits. Then follows the error of irradiance by light that is reflected once, to "
        f"be {LOST:.1%} at most, and {UNDER_GRACE:.1%} under Grace. The last two columns tell what more could be "
        "spared: the share of the hits that lie between four directions, four texels apart, that hit one face, and the "
        "time it takes to compute hits from the planes of their faces over that of their rays."
    )
    report.table(["scene", "hits", "rays", "time", "lost", *SKIES, "same face", "plane / ray"], rows)


def _thin_things(report: Report, resolution: int):
    """Wires, a fence and leaves over a floor."""
    import jaxrelight as jr
    from jaxrelight.geometry.surfaces import join

    def placed(mesh, *by: float):
        matrix = np.eye(4)
        matrix[:3, 3] = by
        return jr.transformed(mesh, matrix)

    texel, random = 2 / resolution, np.random.default_rng(0)
    floor = jr.plane([2, 2], 24)
    wires = [placed(jr.box([4, texel, texel]), 0, 1, z) for z in np.linspace(-1, 1, 7)]
    fence = [placed(jr.box([texel / 2, 0.6, texel / 2]), x, 0.31, 0.3) for x in np.linspace(-1, 1, 21)]
    leaves = []
    for _ in range(300):
        turned, _ = np.linalg.qr(random.normal(size=(3, 3)))
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = turned * np.linalg.det(turned), random.uniform((-1, 0.7, -1), (1, 1.2, 1))
        leaves.append(jr.transformed(jr.plane([1.5 * texel, 3 * texel]), matrix))
    rows = []
    for name, things in {"seven wires": wires, "a fence of 21 bars": fence, "300 leaves": leaves}.items():
        sides = Sides(join([floor, *things]), resolution, -(-(25**2) // 128))
        lost = sides.lost / np.maximum(sides.hidden, 1)
        rows.append(
            [
                name,
                percent(sides.rays[1] / sides.rays[0]),
                percent(float(lost.mean())),
                percent(float(np.mean(lost > 0.2))),
            ]
        )
        rows[-1] += [percent(error) for error in sides.errors]
    report.text(
        "**Thin things**, about a texel wide, over a floor: of what each receiver has hidden, the share that is lost "
        "in the mean, and the share of receivers that lose more than a fifth, to be 1 % at most. Irradiance is to be "
        "0.5 % off at most."
    )
    report.table(["over a floor", "rays", "lost", "over a fifth", *SKIES], rows)


def _precomputations(report: Report, quick: bool):
    made: dict[str, list[dict]] = {"all": [], "adaptive": []}
    with tempfile.TemporaryDirectory() as folder:
        for turn in range(1 if quick else 2):
            for way, runs in made.items():
                more = ["--quick"] if quick else []
                runs.append(run_child(MODULE, "--child", way, "--folder", f"{folder}/{way}{turn}", *more))
    best = {way: min(runs, key=lambda run: run["wall"]) for way, runs in made.items()}
    rows = []
    for what in ("wall", "visibility", "transport"):
        every, some = (best[way][what] for way in ("all", "adaptive"))
        rows.append([what if what != "wall" else "whole", f"{every:.1f} s", f"{some:.1f} s", f"{some / every:.2f}"])
    every, some = (best[way]["rays"] for way in ("all", "adaptive"))
    rows.append(["rays", f"{every / 1e6:.0f} M", f"{some / 1e6:.0f} M", f"{some / every:.2f}"])
    report.text(
        "**Precomputation** of the bunny on its floor, Lambert, vertices, in new processes and stores, in turns, the "
        "better of two: to be reached are 0.58 of the whole with all rays."
    )
    report.table(["stage", "all rays", "adaptive", "ratio"], rows)


def _precomputed(way: str, resolution: int, folder: pathlib.Path) -> dict:
    import jaxrelight as jr
    from jaxrelight.precomputation.precompute import precompute

    scene = jr.load_scene(shared("reference", "bunny_lambert.toml"))
    start = time.perf_counter()
    made = precompute(scene, jr.Transport("vertices", resolution=resolution, rays=way), folder)
    wall = time.perf_counter() - start
    return {"wall": wall, "rays": made.rays, **{name: made.seconds[name] for name in ("visibility", "transport")}}


if __name__ == "__main__":
    main()
