"""How to keep visibility for glossy lobes: error against bytes of several forms, at the points of exact transport."""

import argparse
import dataclasses
import math

import numpy as np

from tests.benchmarks.measuring import Report, shared
from tests.benchmarks.terms_curve import Baked, Points, draw_points

MESHES = {"bunny": "bunny_mitsuba.ply", "dragon": "dragon_vrip_res3.ply"}
SKIES = {
    "Grace": "grace_latlong.exr",
    "Venice": "pmndrs_venice.exr",
    "sunset": "blender_sunset.exr",
    "Uffizi": "probulator_uffizi.hdr",
}
EXPONENTS = 10, 50, 300
ORDERS = 4, 6, 8, 10
SIDES = 2, 3, 4
TERMS = 4, 64
# Rows of the receiver × direction tables that are held at a time.
BLOCK = 64


def main():
    parser = argparse.ArgumentParser(
        prog="python -m tests.benchmarks.filtered_visibility",
        description=__doc__,
        epilog="RESULTS.md is written only without options.",
    )
    parser.add_argument("--quick", action="store_true", help="few pixels, resolution 16, the bunny alone")
    parser.add_argument("--pixels", type=int, default=1536, help="size of the subset")
    parser.add_argument("--resolution", type=int, default=64, help="side of the cube map's faces")
    parser.add_argument("--seed", type=int, default=0, help="of the subset")
    arguments = parser.parse_args()
    shared("data")
    write = arguments == parser.parse_args([])
    meshes = dict(MESHES)
    if arguments.quick:
        arguments.pixels, arguments.resolution = 192, 16
        meshes.pop("dragon")
    parameters = (
        f"pixels of each mesh, framed by itself on a floor, {arguments.pixels:,} drawn with seed {arguments.seed}, "
        f"resolution {arguments.resolution}; Phong lobes alone, of 8 bits where bytes are given"
    )
    with Report("filtered_visibility", "Visibility for glossy lobes", parameters, write) as report:
        report.text(
            "Radiance of a lobe is its unshadowed radiance, here exact, times the share of it that is visible. Forms "
            "of visibility are kept at vertices and interpolated; exact transport of every pixel is the reference. The "
            "rows of K terms, here not compressed, are kilobytes a receiver. "
            f"Errors under {' / '.join(SKIES)} in %, trimmed, untrimmed ones in brackets."
        )
        for name, file in meshes.items():
            report.text(f"**{name}**")
            subset = Subset.draw(shared("data", "mesh", file), arguments.pixels, arguments.seed)
            measure(report, subset, arguments.resolution)


@dataclasses.dataclass(frozen=True)
class Subset:
    """Some pixels that show a mesh, and the vertices of the faces they show."""

    tracer: object
    pixels: Points
    omega_o: np.ndarray
    vertices: Points
    corners: np.ndarray
    weights: np.ndarray

    @classmethod
    def draw(cls, path, count: int, seed: int) -> "Subset":
        """Pixels of the mesh, not of the floor, without repetition."""
        import jaxrelight as jr
        from jaxrelight.geometry.gbuffer import trace_gbuffer
        from jaxrelight.geometry.surfaces import join
        from jaxrelight.geometry.tracer import Tracer

        scene = jr.scene_of_mesh(path)
        surfaces = join([part.mesh for part in scene.parts])
        tracer = Tracer(surfaces)
        gbuffer = trace_gbuffer(surfaces, tracer, scene.camera)
        _, points = draw_points(surfaces, gbuffer, np.flatnonzero((gbuffer.mesh == 0) & ~gbuffer.back), count, seed)
        return cls(tracer=tracer, **points)


class Seen:
    """Visibility of some receivers over a hemisphere each: 1 and 0, and the mean below the horizon."""

    def __init__(self, baked: Baked):
        self.baked = baked
        self.normals = np.asarray(baked.frames[: baked.count, 2], np.float32)
        self.vectors = np.asarray(baked.directions.vectors)
        self.areas = np.asarray(baked.directions.solid_angles)

    def of(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Visibility and cosines [rows, f]."""
        bits = np.unpackbits(np.asarray(self.baked.bits)[rows], axis=1, bitorder="little")
        cosines = np.maximum(self.normals[rows] @ self.vectors.T, 0)
        return bits[:, : len(self.vectors)] * (cosines > 0), cosines

    def filled(self, rows: np.ndarray) -> np.ndarray:
        """Visibility, continued below the horizon by its mean."""
        visible, cosines = self.of(rows)
        weight = cosines * self.areas
        mean = (visible * weight).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-20)
        return np.where(cosines > 0, visible, mean[:, None]).astype(np.float32)


def blocks(count: int):
    """Consecutive rows, few at a time."""
    return [np.arange(start, min(start + BLOCK, count)) for start in range(0, count, BLOCK)]


def measure(report: Report, subset: Subset, resolution: int):
    """One mesh: a table for every exponent."""
    pixels, vertices = (Seen(Baked(points, subset.tracer, resolution)) for points in (subset.pixels, subset.vertices))
    frames = np.asarray(pixels.baked.frames[: pixels.baked.count])
    omega_o = np.einsum("pxy,py->px", frames, subset.omega_o.astype(np.float32))
    above = omega_o[:, 2] > 0
    peaks = np.einsum("px,pxy->py", omega_o * [-1, -1, 1], frames).astype(np.float32)
    lights = _lights(resolution)
    forms = _forms(vertices, subset)
    for exponent in EXPONENTS:
        exact, open_to_all, own = _exact(pixels, peaks, exponent, lights)
        shares = {("its own, of the pixel", 0): own}
        for (name, size), share in forms.items():
            shares[name, size] = share(peaks, float(exponent))
        rows = [
            [name, size or "–", *_errors(share[:, None] * open_to_all, exact, above)]
            for (name, size), share in shares.items()
        ]
        blocked = 100 * (1 - exact.sum() / open_to_all.sum())
        rows += [
            [f"K = {k}, rows of each term", "–", *_errors(radiance, exact, above)]
            for k, radiance in _factored(vertices, subset, omega_o, exponent, lights).items()
        ]
        report.text(f"Exponent {exponent}; {blocked:.0f} % of the light is blocked.")
        report.table(["visibility", "bytes a receiver", *SKIES], rows)


def _lights(resolution: int) -> np.ndarray:
    """The skies' texels side by side, [d, 12]."""
    import jax.numpy as jnp

    from jaxrelight.basis import latlong
    from jaxrelight.basis.cubemap import Texels
    from jaxrelight.lights.environment import coarsened, encode, load_environment

    every = []
    for file in SKIES.values():
        pixels = coarsened(load_environment(shared("data", "env", file)).pixels, resolution)
        resampling = latlong.area_resampling(*pixels.shape[:2], resolution)
        every.append(np.asarray(encode(jnp.asarray(pixels), 0.0, 1.0, resampling, Texels(resolution))))  # pyright: ignore[reportArgumentType]
    return np.concatenate(every, axis=1)


def _exact(pixels: Seen, peaks: np.ndarray, exponent: int, lights: np.ndarray):
    """Radiance of each pixel's lobe with visibility, without, and the visible share of the lobe."""
    exact, open_to_all, own = [], [], []
    for rows in blocks(len(peaks)):
        visible, cosines = pixels.of(rows)
        lobe = np.maximum(peaks[rows] @ pixels.vectors.T, 0) ** exponent * cosines * pixels.areas
        exact.append((visible * lobe) @ lights)
        open_to_all.append(lobe @ lights)
        own.append((visible * lobe).sum(axis=1) / np.maximum(lobe.sum(axis=1), 1e-20))
    return np.concatenate(exact), np.concatenate(open_to_all), np.concatenate(own)


def _forms(vertices: Seen, subset: Subset):
    """Functions (peaks, exponent) → visible shares of the pixels, by name and bytes a receiver."""
    import jax
    import jax.numpy as jnp

    from jaxrelight.basis import cubemap
    from jaxrelight.transport.filtered_visibility import coded, project_visibility, visible_share

    baked, forms = vertices.baked, {}
    corners, weights = jnp.asarray(subset.corners), jnp.asarray(subset.weights, jnp.float32)
    share_of = jax.jit(jax.vmap(visible_share, in_axes=(0, 0, None)))
    for order in ORDERS:
        parts = [
            np.asarray(project_visibility(baked.bits[i : i + 128], baked.frames[i : i + 128], baked.directions, order))
            for i in range(0, len(baked.member), 128)
        ]
        held = coded(np.concatenate(parts)[: baked.count])

        def harmonics(peaks, exponent, held=held):
            return np.asarray(share_of(held.at(corners, weights), peaks, jnp.float32(exponent)))

        forms[f"harmonics to order {order}", (order + 1) ** 2] = harmonics
    for side in SIDES:
        centres = cubemap.directions(side).astype(np.float32)
        # A lobe as wide as a texel.
        widest = 6 * side**2 / 2 - 1
        kernel = np.maximum(centres @ vertices.vectors.T, 0) ** widest * vertices.areas
        kernel /= kernel.sum(axis=1, keepdims=True)
        means, distances = [], []
        for rows in blocks(baked.count):
            visible = vertices.filled(rows)
            means.append(visible @ kernel.T)
            distances.append(_distances(visible, vertices.vectors, centres))
        table = np.rint(255 * np.concatenate(means)) / 255
        signed = np.rint(np.concatenate(distances) / np.pi * 127) / 127 * np.pi

        def from_means(peaks, exponent, table=table, centres=centres, widest=widest):
            near = np.maximum(peaks @ centres.T, 0) ** min(exponent, widest)
            near /= np.maximum(near.sum(axis=1, keepdims=True), 1e-20)
            return np.einsum("pt,pb,pbt->p", near, subset.weights, table[subset.corners])

        def from_distances(peaks, exponent, signed=signed, centres=centres, widest=widest):
            near = np.maximum(peaks @ centres.T, 0) ** widest
            near /= np.maximum(near.sum(axis=1, keepdims=True), 1e-20)
            distance = np.einsum("pt,pb,pbt->p", near, subset.weights, signed[subset.corners])
            # An edge that is straight near the peak parts a Gaussian lobe so.
            wide = math.sqrt((exponent + 1) / 2)
            return 0.5 * (1 + np.vectorize(math.erf)(distance * wide))

        forms[f"means over a cube map of 6·{side}² texels", 6 * side**2] = from_means
        forms[f"signed distances, 6·{side}² texels", 6 * side**2] = from_distances
    return forms


def _distances(visible: np.ndarray, vectors: np.ndarray, centres: np.ndarray) -> np.ndarray:
    """Radians from centres to the nearest direction of the other kind, negative where the centre is blocked."""
    nearest = np.argmax(centres @ vectors.T, axis=1)
    cosines = centres @ vectors.T
    distances = np.empty((len(visible), len(centres)))
    for row, seen in enumerate(visible > 0.5):
        inside = seen[nearest]
        to_open = np.where(seen, cosines, -1).max(axis=1)
        to_blocked = np.where(seen, -1, cosines).max(axis=1)
        angle = np.arccos(np.clip(np.where(inside, to_blocked, to_open), -1, 1))
        distances[row] = np.where(inside, angle, -angle)
    return distances


def _factored(vertices: Seen, subset: Subset, omega_o: np.ndarray, exponent: int, lights: np.ndarray):
    """Radiance by K terms of the vertices, interpolated: what vertices have without filtered visibility."""
    import jax

    import jaxrelight as jr
    from jaxrelight.brdf.factors import factor

    brdf = jr.lobe_sum(0.0, [jr.lobe([-1, -1, 1], float(exponent), peak=1.0)])
    factors = factor(brdf, max(TERMS), 48)
    view = np.asarray(jax.vmap(factors.view_side)(omega_o.astype(np.float32)))
    radiance = {k: [] for k in TERMS}
    for start in range(0, lights.shape[1], 3):
        terms = vertices.baked.terms(factors, lights[:, start : start + 3])
        there = np.einsum("pb,pbkc->pkc", subset.weights, terms[subset.corners])
        for k, parts in radiance.items():
            parts.append((view * there)[:, :k].sum(axis=1))
    return {k: np.concatenate(parts, axis=1) for k, parts in radiance.items()}


def _errors(radiance: np.ndarray, exact: np.ndarray, above: np.ndarray) -> list[str]:
    from jaxrelight.images import image_error

    cells = []
    for start in range(0, exact.shape[1], 3):
        colours = slice(start, start + 3)
        error = image_error(radiance[above, colours][None], exact[above, colours][None])
        cells.append(f"{100 * error.trimmed:.1f} ({100 * error.untrimmed:.1f})")
    return cells


if __name__ == "__main__":
    main()
