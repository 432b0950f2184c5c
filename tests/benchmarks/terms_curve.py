"""How many terms a glossy BRDF needs: factored transport at pixels and at vertices, against the exact one."""

import argparse
import dataclasses
import pathlib
import time
from typing import Any

import numpy as np

from tests.benchmarks.measuring import Report, percent, shared

SCENE, MATERIAL = "bunny_phong", "object"
TERMS = 1, 2, 4, 8, 16, 32, 64, 96
# The K that has a target.
AT = 64
# Receivers baked at a time; more change nothing but the memory taken.
GROUP = 128


def main():
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.terms_curve",
        description=__doc__,
        epilog="RESULTS.md is written only without options.",
    )
    parser.add_argument("--quick", action="store_true", help="few pixels, resolution 16")
    parser.add_argument("--pixels", type=int, default=1536, help="size of the subset")
    parser.add_argument("--resolution", type=int, default=64, help="side of the cube map's faces")
    parser.add_argument("--seed", type=int, default=0, help="of the subset")
    parser.add_argument("--factor-resolutions", type=int, nargs="+", default=[48, 96])
    arguments = parser.parse_args()
    shared("reference")
    write = arguments == parser.parse_args([])
    if arguments.quick:
        arguments.pixels, arguments.resolution = 256, 16
    parameters = (
        f"{SCENE} under its own light, {arguments.pixels:,} covered pixels of the bunny drawn with seed "
        f"{arguments.seed}, resolution {arguments.resolution}, streamed (no wavelets)"
    )
    with Report("terms_curve", "Terms of a glossy BRDF", parameters, write) as report:
        subset = Subset.draw(arguments.pixels, arguments.seed)
        curves = measure(report, subset, arguments.resolution, arguments.factor_resolutions)
        plot(report, curves, write)
        report.speed()


@dataclasses.dataclass(frozen=True)
class Points:
    """Receivers in scene space, with what they see."""

    positions: np.ndarray
    normals: np.ndarray
    origins: np.ndarray


@dataclasses.dataclass(frozen=True)
class Subset:
    """Some pixels of a scene, the vertices of the faces they show, and their reference colours."""

    scene: object
    tracer: object
    brdf: object
    pixels: Points
    omega_o: np.ndarray
    vertices: Points
    corners: np.ndarray
    weights: np.ndarray
    reference: np.ndarray

    @classmethod
    def draw(cls, count: int, seed: int) -> "Subset":
        """Pixels of the material that the reference covers wholly, without repetition."""
        from jaxrelight import load_scene, read_image
        from jaxrelight.geometry.gbuffer import trace_gbuffer
        from jaxrelight.geometry.surfaces import join
        from jaxrelight.geometry.tracer import Tracer

        scene = load_scene(shared("reference", f"{SCENE}.toml"))
        reference = read_image(shared("reference", f"{SCENE}_b0.exr"))
        surfaces = join([part.mesh for part in scene.parts])
        tracer = Tracer(surfaces)
        gbuffer = trace_gbuffer(surfaces, tracer, scene.camera)
        shown = np.array([part.material == MATERIAL for part in scene.parts])[gbuffer.mesh]
        whole = reference[gbuffer.covered][:, 3] > 0.999
        chosen, points = draw_points(surfaces, tracer, gbuffer, np.flatnonzero(shown & whole), count, seed)
        return cls(
            scene=scene,
            tracer=tracer,
            brdf=scene.materials[MATERIAL],
            reference=reference[gbuffer.covered][chosen, :3],
            **points,
        )


def draw_points(
    surfaces, tracer, gbuffer, candidates: np.ndarray, count: int, seed: int
) -> tuple[np.ndarray, dict[str, Any]]:
    """Some pixels of a G-buffer, without repetition, and the vertices of the faces they show, as `Subset` has them."""
    from jaxrelight.geometry.ray_origins import ray_origins
    from jaxrelight.geometry.receivers import vertex_receivers

    origins = ray_origins(surfaces, tracer, gbuffer)
    chosen = np.sort(np.random.default_rng(seed).choice(candidates, count, replace=False))
    vertices, corners = np.unique(gbuffer.corners[chosen], return_inverse=True)
    every = vertex_receivers(surfaces, np.zeros(int(surfaces.mesh_of_vertex.max()) + 1, int))
    slots = every.slot_of[vertices]

    def at_vertices(values):
        return values.reshape(-1, 3)[slots]

    return chosen, {
        "pixels": Points(gbuffer.positions[chosen], gbuffer.normals[chosen], origins[chosen]),
        "omega_o": gbuffer.omega_o[chosen],
        "vertices": Points(at_vertices(every.positions), at_vertices(every.normals), at_vertices(every.origins)),
        "corners": corners.reshape(-1, 3),
        "weights": gbuffer.barycentric[chosen],
    }


class Baked:
    """Receivers with their visibility, ready to be baked with any reflection, a group at a time."""

    def __init__(self, points: Points, tracer, resolution: int):
        import jax.numpy as jnp

        from jaxrelight.basis import cubemap
        from jaxrelight.geometry.frame import tangent_frame
        from jaxrelight.transport.bake import directions_for
        from jaxrelight.transport.visibility import trace_visibility

        self.count = len(points.positions)
        # The last group is filled up with copies, so that all are of one shape.
        member = np.minimum(np.arange(-(-self.count // GROUP) * GROUP), self.count - 1)
        normals = points.normals[member]
        self.bits, _ = trace_visibility(tracer, points.origins[member], normals, cubemap.directions(resolution))
        self.frames = tangent_frame(jnp.asarray(normals, jnp.float32))
        self.directions = directions_for(resolution)
        self.member = member

    def terms(self, reflection, light) -> np.ndarray:
        """Light terms [m, k, c]. Arrays of which every receiver has its own lead with m."""
        import equinox as eqx
        import jax

        from jaxrelight.transport.bake import bake_and_apply

        own, common = eqx.partition(reflection, reflection.per_receiver)
        parts = []
        for start in range(0, len(self.member), GROUP):
            group = slice(start, start + GROUP)
            part = eqx.combine(jax.tree.map(lambda x, member=self.member[group]: x[member], own), common)
            parts.append(np.asarray(bake_and_apply(self.bits[group], self.frames[group], part, self.directions, light)))
        return np.concatenate(parts)[: self.count]


def measure(report: Report, subset: Subset, resolution: int, sides: list[int]) -> dict[str, list[float]]:
    """All errors as a table; the curves by name."""
    import jax
    import jax.numpy as jnp

    from jaxrelight.basis import latlong
    from jaxrelight.basis.cubemap import Texels
    from jaxrelight.brdf.factors import factor
    from jaxrelight.brdf.reflection import FixedView
    from jaxrelight.images import image_error
    from jaxrelight.lights.environment import coarsened, encode

    environment = subset.scene.lights.environment  # pyright: ignore[reportAttributeAccessIssue]
    pixels = coarsened(environment.pixels, resolution)
    resampling = latlong.area_resampling(*pixels.shape[:2], resolution)
    light = encode(jnp.asarray(pixels), environment.rotate_y, environment.scale, resampling, Texels(resolution))

    def error(colours, reference=subset.reference):
        return image_error(np.asarray(colours)[None], np.asarray(reference)[None])

    at_pixels = Baked(subset.pixels, subset.tracer, resolution)
    at_vertices = Baked(subset.vertices, subset.tracer, resolution)
    omega_o = jnp.einsum("pxy,py->px", at_pixels.frames[: at_pixels.count], jnp.asarray(subset.omega_o, jnp.float32))
    above = np.asarray(omega_o[:, 2] > 0)[:, None]
    exact = at_pixels.terms(FixedView(subset.brdf, omega_o), light)[:, 0]  # pyright: ignore[reportArgumentType]
    of_exact = error(exact)
    report.text(
        f"(a) exact transport of each pixel's own view: {_both(of_exact)} against the reference. (b) K terms baked at "
        f"the same points. (c) K terms baked at the {at_vertices.count:,} vertices of the faces that are seen, "
        "interpolated: the vertex path. Errors are trimmed, untrimmed ones in brackets. Target: (c) at K = 64 within "
        "1 % of (a)'s error."
    )
    curves: dict[str, list[float]] = {"exact": [of_exact.trimmed] * len(TERMS)}
    for side in sides:
        start = time.perf_counter()
        factors = factor(subset.brdf, max(TERMS), side)  # pyright: ignore[reportArgumentType]
        factored = time.perf_counter() - start
        start = time.perf_counter()
        view = np.asarray(jax.vmap(factors.view_side)(omega_o))
        here = at_pixels.terms(factors, light)
        corners = at_vertices.terms(factors, light)[subset.corners]
        there = np.einsum("pb,pbkc->pkc", subset.weights, corners)
        baked = time.perf_counter() - start
        # Singular vectors come in order, so the best K terms are the first K.
        points = {k: np.where(above, (view * here)[:, :k].sum(axis=1), 0) for k in TERMS}
        corner = {k: np.where(above, (view * there)[:, :k].sum(axis=1), 0) for k in TERMS}
        few = factor(subset.brdf, 4, side)  # pyright: ignore[reportArgumentType]
        few_view = np.asarray(jax.vmap(few.view_side)(omega_o))
        alone = np.where(above, (few_view * at_pixels.terms(few, light)).sum(axis=1), 0)
        apart = error(alone, points[4]).untrimmed
        rows = []
        for k in TERMS:
            of_points, of_corners = error(points[k]), error(corner[k])
            more = percent(of_corners.trimmed - of_exact.trimmed)
            rows.append(
                [k, _both(of_points), _both(error(points[k], exact)), _both(of_corners),
                 _both(error(corner[k], exact)), more]
            )  # fmt: skip
        report.text(
            f"**Factor resolution {side}.** Factored in {factored:.1f} s, baked and applied in {baked:.1f} s; the "
            f"first 4 of {max(TERMS)} terms differ from a factorisation into 4 by {apart:.1e}."
        )
        heads = ["K", "(b) error", "(b) to (a)", "(c) error", "(c) to (a)", "(c) error less (a)'s"]
        report.table(heads, rows)
        spread = _redrawn(error, exact, corner[AT], subset)
        report.text(f"(c) less (a) at K = {AT}, had other pixels been drawn (bootstrap): {spread}.")
        curves[f"pixels, factors {side}"] = [error(points[k]).trimmed for k in TERMS]
        curves[f"vertices, factors {side}"] = [error(corner[k]).trimmed for k in TERMS]
    return curves


def _redrawn(error, exact, radiance, subset: Subset, draws: int = 200) -> str:
    """Mean and standard deviation of the difference of two trimmed errors over pixels drawn with repetition."""
    rng = np.random.default_rng(0)
    apart = []
    for _ in range(draws):
        chosen = rng.integers(0, len(exact), len(exact))
        reference = subset.reference[chosen]
        apart.append(error(radiance[chosen], reference).trimmed - error(exact[chosen], reference).trimmed)
    return f"{percent(float(np.mean(apart)))} ± {percent(float(np.std(apart)))}"


def _both(error) -> str:
    return f"{percent(error.trimmed)} ({percent(error.untrimmed)})"


def plot(report: Report, curves: dict[str, list[float]], write: bool):
    """The curves as a picture, where matplotlib is installed."""
    try:
        from matplotlib import pyplot  # pyright: ignore[reportMissingImports]
    except ImportError:
        return
    if not write:
        return
    figure, axes = pyplot.subplots(figsize=(6, 4))
    for name, errors in curves.items():
        axes.plot(TERMS, [100 * e for e in errors], "k:" if name == "exact" else "o-", label=name)
    axes.set(xscale="log", xlabel="terms K", ylabel="trimmed relative L2 / %", xticks=TERMS, xticklabels=TERMS)
    axes.legend()
    figure.tight_layout()
    figure.savefig(pathlib.Path(__file__).with_suffix(".png"), dpi=120)
    report.text("![errors over terms](terms_curve.png)")


if __name__ == "__main__":
    main()
