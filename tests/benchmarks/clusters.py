"""Clusters against rows: errors, bytes and speed (Sloan et al. 2003; Liu et al. 2004; Wang 2006 §4.1).

Errors are those of light terms, relative L2 over some whole groups of the mesh, against all coefficients.
"""

import argparse
import contextlib
import dataclasses
import functools
import json
import pathlib
import tempfile

import numpy as np
from jaxtyping import Float, Int

from jaxrelight.operators.clustered import Cluster
from tests.benchmarks.measuring import Report, Timing, interleaved, megabytes, shared
from tests.benchmarks.mesh_size import FLOOR, SCENE
from tests.benchmarks.quantised_rows import COLUMNS, RESOLUTION, light_vector

SEED, KEPT, LIGHTS = 0, 128, 64
TOLERANCES = (0.1, 0.05, 0.035, 0.02, 0.01, 0.005)
ENVIRONMENTS = {
    "venice": "pmndrs_venice.exr",
    "sunset": "blender_sunset.exr",
    "city": "blender_city.exr",
    "Grace": "grace_latlong.exr",
    "studio": "blender_studio.exr",
    "lab": "pmndrs_lab.exr",
    "Uffizi": "probulator_uffizi.hdr",
    "Mitsuba": "mitsuba_principled_envmap.hdr",
}
FOUR = ("venice", "sunset", "city", "Grace")
# Towards the sun, and its radiance.
SUN, RADIANCE = (0.3, 0.75, 0.6), 1e5
LAMBERT = 'type = "lambert"\nalbedo = [0.4, 0.1, 0.1]\n'


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.clusters", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a small mesh, few groups; RESULTS.md is left as it is")
    parser.add_argument("--folder", type=pathlib.Path, help="a store to reuse, or to make")
    arguments = parser.parse_args()
    quick, mesh = arguments.quick, shared("data", "mesh")
    path = mesh / ("teapot.obj" if arguments.quick else "dragon_vrip_res2_bin.ply")
    groups, floor = ({1: 2, 4: 1}, 16) if quick else ({1: 24, 4: 4}, FLOOR)
    parameters = (
        f"{path.stem} on a floor of {(floor + 1) ** 2:,} vertices, the mesh's rows, resolution {RESOLUTION}; "
        "K = 1: Lambert; K = 4: the lobe of Phong 50, whose diffuse part is as K = 1; rows of both are grey; errors "
        f"over {groups[1]} and {groups[4]} of its groups, drawn with seed "
        f"{SEED}, means of eight environments; ratios are medians over interleaved runs"
    )
    with contextlib.ExitStack() as stack:
        folder = arguments.folder or pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()), "store")
        report = stack.enter_context(Report("clusters", "Clusters", parameters, not quick))
        lights = {name: light_vector(file, 1) for name, file in ENVIRONMENTS.items()}
        spectrum(report, lights)
        scenes = {terms: _scene(path, terms, floor) for terms in groups}
        samples = {terms: sample(scenes[terms], terms, count, lights, quick) for terms, count in groups.items()}
        weighting(report, samples)
        equal = {terms: errors(report, one, terms) for terms, one in samples.items()}
        eight_bits(report, samples, equal, lights)
        seams(report, scenes[1], lights, 2 if quick else 24)
        for terms, scene in scenes.items():
            speed(report, scene, terms, equal[terms], samples[terms], folder, 3 if quick else 15)
        report.speed()


def _scene(mesh: pathlib.Path, terms: int, floor: int = FLOOR):
    from jaxrelight import load_scene

    sky = shared("data", "env", "pmndrs_venice.exr")
    files = {"mesh": json.dumps(str(mesh.resolve())), "environment": json.dumps(str(sky.resolve()))}
    text = SCENE.format(floor=floor, **files)
    if terms == 1:
        start, end = text.index('type = "phong"'), text.index("[material.floor]")
        text = text[:start] + LAMBERT + text[end:]
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder, "scene.toml")
        path.write_text(text)
        return load_scene(path)


def spectrum(report: Report, lights: dict[str, Float[np.ndarray, "d c"]]):
    """Root-mean-square coefficients by level, over that of the averages."""
    from jaxrelight.basis.haar import levels
    from jaxrelight.lights.natural_spectrum import natural_spectrum

    level, sigma = levels(RESOLUTION), natural_spectrum(RESOLUTION)
    count = int(level.max()) + 1
    by_level = {
        name: [np.sqrt(np.mean(np.square(light[level == i], dtype=float))) for i in range(count)]
        for name, light in lights.items()
    }
    relative = {name: np.array(rms) / rms[0] for name, rms in by_level.items()}
    mean = np.exp(np.mean([np.log(values) for values in relative.values()], axis=0))
    kept = np.array([sigma[level == i][0] for i in range(count)])
    table = [[name, *(f"{value:.4f}" for value in values)] for name, values in relative.items()]
    table += [[name, *(f"{value:.4f}" for value in values)] for name, values in (("mean", mean), ("table", kept))]
    report.text(
        "**Spectrum of natural light**: root-mean-square Haar coefficient of a level over that of the averages, and "
        "its geometric mean, which is where the table of `natural_spectrum` is from. The table is off by at most "
        f"{100 * np.abs(kept / mean - 1).max():.1f} %."
    )
    report.table(["environment", *(f"level {i}" for i in range(count))], table)


@functools.cache
def sunny() -> dict[str, Float[np.ndarray, "d 3"]]:
    """Light vectors of venice with a sun, of what is left when it is split off, and of what was split off."""
    import jax.numpy as jnp

    from jaxrelight.basis import cubemap
    from jaxrelight.basis.haar import HaarFaces
    from jaxrelight.lights.sun import split_sun

    basis = HaarFaces(RESOLUTION)
    texels = basis.decode(jnp.asarray(light_vector(ENVIRONMENTS["venice"], 1)).T).T
    near = np.argsort(-(cubemap.directions(RESOLUTION) @ np.array(SUN)))[:4]
    split = split_sun(texels.at[near].set(RADIANCE))
    assert np.asarray(split.radiance).any()
    every = {"whole": split.rest + split.sun, "rest": split.rest, "sun": split.sun}
    return {name: np.asarray(basis.encode(light.T).T) for name, light in every.items()}


@dataclasses.dataclass(frozen=True)
class Sample:
    """Some groups of the mesh: g groups of r rows.

    Attributes:
        exact: light terms by all coefficients, by light.
        rows: those of the N largest coefficients of each row.
        clusters: of each group, by tolerance; those where all levels count the same by minus the tolerance.
        indices: of the N largest coefficients of each row.
        values: theirs.
        lights: light vectors.
        sunny: exact light terms of SUN's lights.
    """

    exact: dict[str, Float[np.ndarray, "g r 3"]]
    rows: dict[str, Float[np.ndarray, "g r 3"]]
    clusters: dict[float, list[Cluster]]
    indices: Int[np.ndarray, "gr n"]
    values: Float[np.ndarray, "gr c n"]
    lights: dict[str, Float[np.ndarray, "d 3"]]
    sunny: dict[str, Float[np.ndarray, "g r 3"]]

    @property
    def channels(self) -> int:
        """Of the rows."""
        return self.values.shape[1]

    def off(self, products: dict[str, Float[np.ndarray, "g r 3"]]) -> dict[str, float]:
        """Relative errors by light."""
        return {key: float(np.linalg.norm(y - self.exact[key]) / np.linalg.norm(y)) for key, y in products.items()}

    def off_at(self, tolerance: float) -> dict[str, float]:
        """Those of clusters."""
        clusters = self.clusters[tolerance]
        return self.off({key: np.stack([_terms(one, x) for one in clusters]) for key, x in self.lights.items()})

    def bytes_at(self, tolerance: float, bits: int = 32) -> float:
        """Mean bytes of a group's cluster, with those of its scales."""
        return float(np.mean([_bytes(one, bits) for one in self.clusters[tolerance]]))


def _terms(one: Cluster, light: Float[np.ndarray, "d 3"]) -> Float[np.ndarray, "r 3"]:
    shared_rows = one.basis @ light[one.support]
    return np.stack([one.weights[c % len(one.weights)].T @ shared_rows[:, c] for c in range(3)], axis=-1)


def _bytes(one: Cluster, bits: int) -> float:
    c, q, _ = one.weights.shape
    scales = 0 if bits == 32 else 4 * (len(one.support) + c * q)
    return (one.basis.size + one.weights.size) * bits / 8 + 2 * len(one.support) + scales


def _mean(errors: dict[str, float]) -> float:
    return float(np.mean(list(errors.values())))


def _whole_rows(scene, terms: int, chosen):
    """The receivers, which groups are the mesh's, and a generator of the whole rows of those chosen of them."""
    import jax.numpy as jnp

    from jaxrelight import factor
    from jaxrelight.basis import cubemap
    from jaxrelight.basis.haar import HaarFaces
    from jaxrelight.brdf.material import as_material, split_tint
    from jaxrelight.geometry.receivers import GROUP, vertex_receivers
    from jaxrelight.geometry.tracer import Tracer
    from jaxrelight.transport import bake
    from jaxrelight.transport.model import frames_of
    from jaxrelight.transport.visibility import trace_visibility

    surfaces = scene.surfaces()
    receivers = vertex_receivers(surfaces, np.array([part.material == "object" for part in scene.parts], int))
    mine = receivers.groups_of(1)
    groups = chosen(mine[receivers.filled[mine] == GROUP])
    reflection = factor(split_tint(as_material(scene.materials["object"])).components[-1].brdf, terms, 48)
    basis, directions, tracer = HaarFaces(RESOLUTION), bake.directions_for(RESOLUTION), Tracer(surfaces)

    def rows():
        for group, frames in zip(groups, frames_of(receivers, groups), strict=True):
            points = receivers.origins[group], receivers.normals[group]
            bits = jnp.asarray(trace_visibility(tracer, *points, cubemap.directions(RESOLUTION))[0])
            baked = np.asarray(bake.bake_rows(bits, frames, reflection, directions, basis))
            yield baked.reshape(-1, *baked.shape[2:])

    return surfaces, receivers, groups, rows()


def _lit(rows: Float[np.ndarray, "r c d"], light: Float[np.ndarray, "d 3"]) -> Float[np.ndarray, "r 3"]:
    return np.stack([rows[:, c % rows.shape[1]] @ light[:, c] for c in range(3)], axis=-1)


def sample(scene, terms: int, count: int, lights, quick: bool) -> Sample:
    """Bakes some groups, and compresses them in all ways."""
    from jaxrelight.lights.natural_spectrum import natural_spectrum
    from jaxrelight.operators.clustering import cluster

    rng, sigma, same = np.random.default_rng(SEED), natural_spectrum(RESOLUTION), np.ones(COLUMNS, np.float32)
    _, _, _, baked = _whole_rows(scene, terms, lambda every: np.sort(rng.choice(every, count, replace=False)))
    exact, kept = ({key: [] for key in lights} for _ in range(2))
    in_sun: dict[str, list[np.ndarray]] = {key: [] for key in sunny()}
    tolerances = TOLERANCES[:2] if quick else TOLERANCES
    clusters: dict[float, list[Cluster]] = {tolerance: [] for tolerance in tolerances}
    # Unweighted ones, for about as many bytes.
    clusters |= {-tolerance: [] for tolerance in ((0.5, 0.15) if quick else (0.5, 0.35, 0.25, 0.15, 0.1))}
    indices, values = [], []
    for rows in baked:
        energy = np.einsum("rcd,rcd->rd", rows, rows)
        largest = np.sort(np.argpartition(energy, -KEPT, axis=-1)[:, -KEPT:], axis=-1)
        kept_values = np.take_along_axis(rows, largest[:, None], axis=-1)
        indices.append(largest)
        values.append(kept_values)
        for key, light in sunny().items():
            in_sun[key].append(_lit(rows, light))
        for key, light in lights.items():
            exact[key].append(_lit(rows, light))
            by_row = [np.sum(kept_values[:, c % rows.shape[1]] * light[largest, c], axis=-1) for c in range(3)]
            kept[key].append(np.stack(by_row, axis=-1))
        for tolerance, of in clusters.items():
            of.append(cluster(rows, sigma if tolerance > 0 else same, abs(tolerance))[0])
    joined = [{key: np.stack(parts) for key, parts in of.items()} for of in (exact, kept, in_sun)]
    indices, values = np.concatenate(indices), np.concatenate(values)
    return Sample(joined[0], joined[1], clusters, indices, values, lights, joined[2])


def weighting(report: Report, samples: dict[int, Sample]):
    """Energy weighted with natural light's, against energy as it is, at equal bytes."""
    report.text(
        "**Weighted with the spectrum of natural light, or not**, at equal bytes: error in percent. Of unweighted "
        "clusters, interpolated between tolerances."
    )
    table = []
    for terms, one in samples.items():
        others = sorted((one.bytes_at(t), one.off_at(t)) for t in one.clusters if t < 0)
        sizes = np.log([size for size, _ in others])
        for tolerance in (t for t in one.clusters if t in (0.05, 0.02)):
            size, off = one.bytes_at(tolerance), one.off_at(tolerance)
            if not sizes[0] <= np.log(size) <= sizes[-1]:
                continue
            plain = {
                key: float(np.exp(np.interp(np.log(size), sizes, [np.log(errors[key]) for _, errors in others])))
                for key in off
            }
            for name, errors in (("weighted", off), ("unweighted", plain)):
                cells = [f"{100 * value:.2f}" for value in (_mean(errors), *errors.values())]
                table.append([f"K = {terms}, tolerance {tolerance}, {name}", f"{size / 1e3:.1f}", *cells])
    report.table(["clusters", "kB a group", "mean", *ENVIRONMENTS], table)


def errors(report: Report, one: Sample, terms: int) -> float:
    """Errors by tolerance. Returns the one that leaves as much as rows do."""
    report.text(
        f"**Error, bytes and size by tolerance**, K = {terms}; float32, uint16 coefficient numbers. Medians (ranges)."
    )
    of_rows, rows = one.off(one.rows), one.exact["venice"].shape[1]
    size = rows * KEPT * (2 + 4 * one.channels)
    table = [[f"rows, N = {KEPT}", *_errors(of_rows), f"{size / 1e3:.1f}", "", "", ""]]
    means = {}
    for tolerance in (t for t in one.clusters if t > 0):
        off, held = one.off_at(tolerance), one.bytes_at(tolerance)
        means[tolerance] = _mean(off)
        sizes = np.array([(len(cluster.basis), len(cluster.support)) for cluster in one.clusters[tolerance]])
        shown = [f"{np.median(x):.0f} ({x.min()} to {x.max()})" for x in sizes.T]
        table.append([f"tolerance {tolerance}", *_errors(off), f"{held / 1e3:.1f}", f"1/{size / held:.1f}", *shown])
    ordered = sorted(means)
    equal = np.exp(np.interp(np.log(_mean(of_rows)), np.log([means[t] for t in ordered]), np.log(ordered)))
    equal = float(f"{equal:.2g}")
    report.table(["kept as", "mean error", "least, largest", "kB a group", "of rows", "shared rows", "support"], table)
    report.text(f"At tolerance {equal} clusters are as near as rows of N = {KEPT}.")
    return equal


def _errors(off: dict[str, float]) -> list[str]:
    return [f"{100 * _mean(off):.2f} %", f"{100 * min(off.values()):.2f}, {100 * max(off.values()):.2f}"]


def _nearest(one: Sample, tolerance: float) -> float:
    """Of the sample's tolerances, the largest that is no larger; else the least."""
    every = sorted(t for t in one.clusters if t > 0)
    return max((t for t in every if t <= tolerance), default=every[0])


def eight_bits(report: Report, samples: dict[int, Sample], equal: dict[int, float], lights):
    """Bytes, and what rounding adds."""
    import jax

    from jaxrelight.operators.clustered import clustered, quantised_clusters

    apply = jax.jit(lambda operator, light: operator.apply(light))
    report.text(
        "**8 bits**: a scale for each coefficient of a group, and for each shared row's weights. Increase of the error "
        "against all coefficients, in percentage points, at a tolerance that leaves no more than rows of N = "
        f"{KEPT}; bytes, with scales and coefficient numbers, over those of such rows in 8 bits with 16-bit numbers, "
        "as in the paper. Targets: increase at most 1, bytes at most 0.5. The last columns are of venice with a sun of "
        "1e5 in four texels: error and increase with it in the light, and with it split off (target 0.1)."
    )
    table = []
    for terms, one in samples.items():
        tolerance = _nearest(one, equal[terms])
        whole = clustered(one.clusters[tolerance], COLUMNS)
        rows = one.exact["venice"].shape[1]
        paper = rows * KEPT * (2 + one.channels)
        for bits in (8, 16):
            coded, shape = quantised_clusters(whole, bits), (-1, rows, 3)
            rounded, plain = (
                {key: np.asarray(apply(operator, lights[key])).reshape(shape) for key in FOUR}
                for operator in (coded, whole)
            )
            off, before = one.off(rounded), one.off(plain)
            held = one.bytes_at(tolerance, bits)
            cells = [f"{100 * before[key]:.2f} {100 * (off[key] - before[key]):+.3f}" for key in FOUR]
            cells += _under_a_sun(one, apply, whole, coded)
            name = f"K = {terms}, tolerance {tolerance}, {bits} bits"
            table.append([name, f"{held / 1e3:.1f}", f"{held / paper:.2f}", *cells])
    report.table(["clusters", "kB a group", "of rows in 8 bits", *FOUR, "with a sun", "split off"], table)


def _under_a_sun(one: Sample, apply, whole, coded) -> list[str]:
    """The error of two operators under a sun: of the first, and what the second adds; also with the sun split off."""
    wanted, cells = one.sunny["whole"], []
    for light, more in (("whole", 0.0), ("rest", one.sunny["sun"])):
        before, after = (
            float(np.linalg.norm(np.reshape(apply(operator, sunny()[light]), wanted.shape) + more - wanted))
            / float(np.linalg.norm(wanted))
            for operator in (whole, coded)
        )
        cells.append(f"{100 * before:.3f} {100 * (after - before):+.4f}")
    return cells


def seams(report: Report, scene, lights, count: int):
    """Jumps of the error along edges, between groups and within them."""
    from jaxrelight.geometry.receivers import GROUP
    from jaxrelight.lights.natural_spectrum import natural_spectrum
    from jaxrelight.operators.clustering import cluster

    def neighbours(every):
        start = int(np.random.default_rng(SEED).integers(len(every) - count + 1))
        return every[start : start + count]

    surfaces, receivers, groups, baked = _whole_rows(scene, 1, neighbours)
    rows = list(baked)
    faces = receivers.slot_of[surfaces.faces]
    edges = np.unique(np.sort(np.concatenate([faces[:, [0, 1]], faces[:, [1, 2]], faces[:, [2, 0]]]), axis=1), axis=0)
    place = np.full(len(receivers.filled), -1)
    place[groups] = np.arange(len(groups))
    edges = edges[(place[edges // GROUP] >= 0).all(axis=1)]
    across = edges[:, 0] // GROUP != edges[:, 1] // GROUP
    ends = place[edges // GROUP] * GROUP + edges % GROUP
    report.text(
        f"**Seams**, K = 1, {count} neighbouring groups, {across.sum():,} edges between groups and {(~across).sum():,} "
        "within: mean jump of the error along an edge, in percent of the mean radiance; between groups, within, ratio."
    )
    table = []
    for tolerance in (0.02, 0.05):
        clusters = [cluster(one, natural_spectrum(RESOLUTION), tolerance)[0] for one in rows]
        cells = []
        for key in FOUR:
            exact = np.concatenate([_lit(one, lights[key]) for one in rows])
            off = np.concatenate([_terms(one, lights[key]) for one in clusters]) - exact
            jump = np.abs(off[ends[:, 0]] - off[ends[:, 1]]).mean(axis=1) / exact.mean()
            between, within = (float(jump[which].mean()) for which in (across, ~across))
            cells.append(f"{100 * between:.2f}, {100 * within:.2f}, {between / within:.1f}")
        table.append([f"tolerance {tolerance}", *cells])
    report.table(["clusters", *FOUR], table)


def speed(report: Report, scene, terms: int, tolerance: float, one: Sample, folder: pathlib.Path, runs: int):
    """Products of all groups of the mesh, against scipy's with rows that are as near."""
    import jax
    import jax.numpy as jnp

    from jaxrelight import Transport, prepare
    from jaxrelight.lighting.transport import TransportRelighter
    from jaxrelight.operators.clustered import Clustered, quantised_clusters

    method = Transport(
        "vertices", reflection="factors", terms=terms, resolution=RESOLUTION, compression_tolerance=tolerance
    )
    relighter = prepare(scene, method, folder)
    assert isinstance(relighter, TransportRelighter)
    operator = [block.operator for block in relighter.transport.blocks if block.material == "object"][-1]
    assert isinstance(operator, Clustered)
    coded = quantised_clusters(operator, 8)
    rng = np.random.default_rng(SEED)
    light = jnp.asarray(one.lights["venice"])
    radiance = jnp.asarray(rng.normal(size=(operator.shape[0], 3)), jnp.float32)

    apply = jax.jit(lambda operator, light: operator.apply(light))
    transpose = jax.jit(lambda operator, radiance: operator.transpose(radiance))
    read = jax.jit(lambda operator: [jnp.sum(x) for part in operator.buckets for x in (part.basis, part.weights)])
    sides = {
        "its bytes read once": lambda: read(operator),
        "apply": lambda: apply(operator, light),
        "transpose": lambda: transpose(operator, radiance),
        "apply, 8 bits": lambda: apply(coded, light),
        "transpose, 8 bits": lambda: transpose(coded, radiance),
    }
    times = interleaved(sides, runs)
    times |= _scipy(one, operator.shape[0], np.asarray(light), max(runs // 3, 1), sides["apply"])
    beside = times.pop("apply, beside scipy")
    names = [name for name in times if name.startswith("scipy")]
    best = min(names, key=lambda name: times[name].median)
    held = {"its bytes read once": operator, "apply": operator, "apply, 8 bits": coded}
    table = []
    for name, timing in times.items():
        size = megabytes(held[name].nbytes) if name in held else ""
        ours = timing in (times[other] for other in sides)
        against = [f"{timing.over(times[other]):.2f}" if ours else "" for other in ("its bytes read once", "apply")]
        factor = f"{times[best].over(beside):.1f}" if name == "apply" else ""
        table.append([name, size, timing, *against, factor])
    report.text(
        f"**Speed**, K = {terms}, tolerance {tolerance}: {operator.shape[0]:,} rows of the mesh in "
        f"{len(operator.buckets)} buckets, three channels; scipy: rows of N = {KEPT} that are as near, float32, int32 "
        f"indices. Targets: at least {10 if terms == 1 else 6} times as fast as scipy, at most 2.5 times the reading; "
        "the adjoint at most 1.5 times as long."
    )
    report.table(["what", "held", "time", "over reading", "over apply", f"{best} / this"], table)
    many(report, operator, runs)


def _scipy(one: Sample, rows: int, light, runs: int, ours) -> dict[str, Timing]:
    """CSR of the sample's rows, repeated; and apply, between its runs."""
    import scipy.sparse

    again = -(-rows // len(one.indices))
    indices = np.tile(one.indices, (again, 1))[:rows].astype(np.int32).ravel()
    starts = np.arange(rows + 1, dtype=np.int32) * KEPT
    matrices = [
        scipy.sparse.csr_matrix(
            (np.tile(one.values[:, c], (again, 1))[:rows].ravel(), indices, starts), shape=(rows, COLUMNS)
        )
        for c in range(one.channels)
    ]
    by_channel = [np.ascontiguousarray(light[:, c]) for c in range(3)]
    sides = {
        "scipy CSR, 3 vectors": lambda: [matrices[c % len(matrices)] @ by_channel[c] for c in range(3)],
        "apply, beside scipy": ours,
    }
    if len(matrices) == 1:
        sides["scipy CSR, a matrix of 3 columns"] = lambda: matrices[0] @ light
    return interleaved(sides, runs, 1)


def many(report: Report, operator, runs: int):
    """Many lights at once, against dense products of the same shapes."""
    import jax
    import jax.numpy as jnp

    lights = jnp.asarray(np.random.default_rng(SEED).normal(size=(LIGHTS, COLUMNS, 3)), jnp.float32)
    product = functools.partial(jnp.einsum, precision="highest")
    c = operator.channels

    @jax.jit
    def dense(operator, gathered, shared_rows):
        return [
            (product("bqs,bsl->bql", part.basis, x), product("bcqr,bcql->bcrl", part.weights, y))
            for part, x, y in zip(operator.buckets, gathered, shared_rows, strict=True)
        ]

    gathered = [jnp.ones((*part.support.shape, 3 * LIGHTS)) for part in operator.buckets]
    shared_rows = [jnp.ones((*part.weights.shape[:3], 3 * LIGHTS // c)) for part in operator.buckets]
    batched = jax.jit(jax.vmap(lambda operator, light: operator.apply(light), in_axes=(None, 0)))
    at_once = jax.jit(lambda operator, lights: operator.apply_many(lights))
    sides = {
        "dense products of the same shapes": lambda: dense(operator, gathered, shared_rows),
        "vmap of apply": lambda: batched(operator, lights),
        "apply_many": lambda: at_once(operator, lights),
    }
    times = interleaved(sides, max(runs // 4, 1), 1)
    first = times["dense products of the same shapes"]
    table = [
        [name, timing, f"{timing.median / LIGHTS * 1e3:.2f}", f"{first.over(timing):.2f}"]
        for name, timing in times.items()
    ]
    report.text(f"{LIGHTS} lights of three channels at once; target: at least 0.5 of the dense products' rate.")
    report.table(["what", "time", "ms a light", "of the dense rate"], table)


if __name__ == "__main__":
    main()
