"""How to keep visibility for glossy lobes: error against bytes of several forms, at the points of exact transport."""

import argparse
import dataclasses
import pathlib
import tempfile

import numpy as np

from tests.benchmarks.measuring import Report, shared
from tests.benchmarks.terms_curve import Baked, Points, draw_points

SCENE = "bunny_phong"
MESHES = {"bunny": "bunny_mitsuba.ply", "dragon": "dragon_vrip_res2_bin.ply"}
SKIES = {
    "Grace": "grace_latlong.exr",
    "Venice": "pmndrs_venice.exr",
    "sunset": "blender_sunset.exr",
    "Uffizi": "probulator_uffizi.hdr",
}
EXPONENTS = 10, 50, 300
ORDERS = 4, 6, 8
CELLS = 2, 3, 4
NARROWER = 1, 7, 19
TERMS = 4, 64
# The largest trimmed errors that are to be reached by mesh and exponent, in %, in the order of the skies.
TARGETS = {
    ("bunny", 10): (6.5, 2, 2.5, 2.5),
    ("bunny", 50): (3.5, 2.5, 2.5, 2.5),
    ("bunny", 300): (5, 5, 5, 5),
    ("dragon", 10): (9.5, 2.5, 4.5, 2.5),
    ("dragon", 50): (6, 3, 4, 2),
    ("dragon", 300): (5, 5, 5, 5),
}
# The same of shares that are traced, at the exponent of that column, by so many rays a pixel.
TRACED, RAYS = {("bunny", 50): (2.8, 1, 1.5, 1), ("dragon", 50): (4.5, 2, 3.5, 1)}, 64
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
        f"{SCENE} with each mesh, {arguments.pixels:,} pixels of it drawn with seed {arguments.seed}, resolution "
        f"{arguments.resolution}; the radiance of Phong lobes alone"
    )
    with Report("filtered_visibility", "Visibility for glossy lobes", parameters, write) as report:
        report.text(
            "Exact transport of every pixel's lobe is the reference. First, forms of visibility: kept at vertices in 8 "
            "bits, interpolated, multiplied by the lobe's unshadowed radiance, which is exact here. Then the library's "
            "own shading: light of prefiltered maps times filtered visibility, each lobe as 1, 7 or 19 narrower ones, "
            "and times shares that rays of each pixel find, each lobe divided as by default. Last, rows "
            "of K terms, not compressed, which are kilobytes a receiver. "
            f"Errors under {' / '.join(SKIES)} in %, trimmed, untrimmed ones in brackets."
        )
        for name, file in meshes.items():
            report.text(f"**{name}**")
            subset = Subset.draw(file, arguments.pixels, arguments.seed)
            measure(report, subset, arguments.resolution, name)


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
    def draw(cls, file: str, count: int, seed: int) -> "Subset":
        """Pixels of a mesh in place of the scene's, not of the floor, without repetition."""
        import jaxrelight as jr
        from jaxrelight.geometry.gbuffer import trace_gbuffer
        from jaxrelight.geometry.surfaces import join
        from jaxrelight.geometry.tracer import Tracer

        original = shared("reference", f"{SCENE}.toml").read_text()
        with tempfile.TemporaryDirectory() as folder:
            path = pathlib.Path(folder, "scene.toml")
            path.write_text(original.replace("bunny_mitsuba.ply", file).replace("../data", str(shared("data"))))
            scene = jr.load_scene(path)
        surfaces = join([part.mesh for part in scene.parts])
        tracer = Tracer(surfaces)
        gbuffer = trace_gbuffer(surfaces, tracer, scene.camera)
        _, points = draw_points(
            surfaces, tracer, gbuffer, np.flatnonzero((gbuffer.mesh == 0) & ~gbuffer.back), count, seed
        )
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

    def mean(self, rows: np.ndarray) -> np.ndarray:
        """Mean visibility over the hemisphere, weighted by the cosine."""
        visible, cosines = self.of(rows)
        weight = cosines * self.areas
        return (visible * weight).sum(axis=1) / np.maximum(weight.sum(axis=1), 1e-20)


def blocks(count: int):
    """Consecutive rows, few at a time."""
    return [np.arange(start, min(start + BLOCK, count)) for start in range(0, count, BLOCK)]


def measure(report: Report, subset: Subset, resolution: int, mesh: str):
    """One mesh: a table for every exponent."""
    pixels, vertices = (Seen(Baked(points, subset.tracer, resolution)) for points in (subset.pixels, subset.vertices))
    frames = np.asarray(pixels.baked.frames[: pixels.baked.count])
    omega_o = np.einsum("pxy,py->px", frames, subset.omega_o.astype(np.float32))
    above = omega_o[:, 2] > 0
    peaks = np.einsum("px,pxy->py", omega_o * [-1, -1, 1], frames).astype(np.float32)
    lights = _lights(resolution)
    forms, product = _forms(vertices, subset), Product(vertices, subset, frames, omega_o)
    for exponent in EXPONENTS:
        exact, open_to_all, own = _exact(pixels, peaks, exponent, lights)
        shares = {("its own, of the pixel", 0): own}
        for (name, size), share in forms.items():
            shares[name, size] = share(peaks, float(exponent))
        rows = [
            [name, size or "–", *_errors(share[:, None] * open_to_all, exact, above)]
            for (name, size), share in shares.items()
        ]
        chosen = product.chosen(exponent)
        for narrower in NARROWER:
            label = f"filtered, {narrower} narrower lobes" if narrower > 1 else "filtered, the lobe itself"
            label = f"**{label}** (the default)" if narrower == chosen else label
            rows.append([label, product.nbytes, *_errors(product.radiance(exponent, narrower), exact, above)])
        targets = TARGETS[mesh, exponent]
        rows.append(["to be reached", "≤ 96", *(f"{target:g}" for target in targets)])
        traced = product.radiance(exponent, chosen, product.traced(exponent, chosen))
        rows.append([f"traced, {RAYS} rays a pixel", "–", *_errors(traced, exact, above)])
        if (mesh, exponent) in TRACED:
            rows.append(["to be reached by it", "–", *(f"{target:g}" for target in TRACED[mesh, exponent])])
        blocked = 100 * (1 - exact.sum() / open_to_all.sum())
        rows += [
            [f"K = {k}, rows of each term", "–", *_errors(radiance, exact, above)]
            for k, radiance in _factored(vertices, subset, omega_o, exponent, lights).items()
        ]
        report.text(f"Exponent {exponent}; {blocked:.0f} % of the light is blocked.")
        report.table(["visibility", "bytes a receiver", *SKIES], rows)


class Product:
    """The library's own shading of lobes at vertices, at the subset's pixels."""

    def __init__(self, vertices: Seen, subset: Subset, frames: np.ndarray, omega_o: np.ndarray):
        import jax.numpy as jnp

        from jaxrelight.lights.environment import load_environment
        from jaxrelight.transport.filtered_visibility import FilteredVisibility

        codes = _codes(vertices, 3)
        self.visibility = FilteredVisibility(jnp.asarray(codes))
        self.nbytes = codes.shape[1]
        self.rows = (frames, omega_o, subset.corners, subset.weights.astype(np.float32))
        self.subset = subset
        self.pixels = [load_environment(shared("data", "env", file)).pixels for file in SKIES.values()]

    def chosen(self, exponent: float) -> int:
        """Into how many narrower lobes a lobe is divided by default."""
        from jaxrelight.brdf.sub_lobes import narrower_lobes
        from jaxrelight.methods import Transport

        return narrower_lobes(_phong(exponent), Transport.reflection_tolerance)

    def traced(self, exponent: float, narrower: int) -> np.ndarray:
        """Visible shares of the pixels' lobes, by rays of each pixel."""
        import jax.numpy as jnp

        from jaxrelight.lighting.lobe_rays import traced_shares
        from jaxrelight.lighting.pixels import SurfacePixels
        from jaxrelight.lighting.shadows import surface_points

        (frames, omega_o, *_), at = self.rows, self.subset.pixels
        count = len(frames)
        nothing = jnp.zeros((count, 2)), jnp.zeros(count)
        pixels = SurfacePixels(jnp.arange(count), *nothing, jnp.asarray(omega_o), jnp.asarray(frames))
        arrays = at.positions, at.origins, at.normals
        points = surface_points(self.subset.tracer, *arrays, 1.0)  # pyright: ignore[reportArgumentType]
        return np.asarray(traced_shares(_phong(exponent), pixels, points, 0, RAYS, narrower))

    def radiance(self, exponent: float, narrower: int, shares: np.ndarray | None = None) -> np.ndarray:
        """Under all skies [p, 12], by shares of each pixel or by filtered visibility."""
        import jax

        from jaxrelight.lighting.filtered_lobes import lobe_radiance
        from jaxrelight.lights.prefiltered import prefilter

        brdf = _phong(exponent)

        @jax.jit
        def shade(visibility, maps, rows):
            def one(frame, omega_o, corners, weights, own):
                def visible(direction, exponent):
                    return visibility.share(corners, weights, direction, exponent)

                seen = visible if own is None else own
                return lobe_radiance(brdf, omega_o, frame, maps.look_up, seen, narrower=narrower)

            return jax.lax.map(lambda row: one(*row), rows, batch_size=256)

        rows = *self.rows, shares
        every = [np.asarray(shade(self.visibility, prefilter(one), rows)) for one in self.pixels]
        return np.concatenate(every, axis=1)


def _phong(exponent: float):
    """The lobe without its scale, as the reference is."""
    import jaxrelight as jr

    return jr.lobe_sum(0.0, [jr.lobe([-1, -1, 1], float(exponent), peak=1.0)])


def _codes(vertices: Seen, cells: int) -> np.ndarray:
    """Codes of the vertices' signed angles."""
    from jaxrelight.transport.filtered_visibility import visibility_distances

    baked = vertices.baked
    parts = [
        np.asarray(visibility_distances(baked.bits[i : i + 128], baked.frames[i : i + 128], baked.directions, cells))
        for i in range(0, len(baked.member), 128)
    ]
    return np.concatenate(parts)[: baked.count]


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

    from jaxrelight.basis import cube_grid
    from jaxrelight.transport.filtered_visibility import FilteredVisibility

    forms, corners, weights = {}, jnp.asarray(subset.corners), jnp.asarray(subset.weights, jnp.float32)
    between = jax.jit(jax.vmap(cube_grid.bilinear, in_axes=(0, None)), static_argnums=1)
    coefficients = _harmonics(vertices, max(ORDERS))
    for order in ORDERS:
        count = (order + 1) ** 2

        def harmonics(peaks, exponent, order=order, count=count):
            at_pixels = np.einsum("pk,pkh->ph", subset.weights, coefficients[subset.corners, :count])
            degree = np.repeat(np.arange(order + 1), 2 * np.arange(order + 1) + 1)
            damped = at_pixels * _bands(exponent, order)[degree]
            return np.clip((damped * _spherical(peaks, order)).sum(axis=1), 0, 1)

        forms[f"harmonics to order {order}", count] = harmonics
    for cells in CELLS:
        points = cube_grid.directions(cells).astype(np.float32)
        # A lobe as wide as the grid's spacing.
        widest = len(points) / 2 - 1
        kernel = np.maximum(points @ vertices.vectors.T, 0) ** widest * vertices.areas
        kernel /= kernel.sum(axis=1, keepdims=True)
        table = []
        for rows in blocks(vertices.baked.count):
            visible, cosines = vertices.of(rows)
            table.append(np.where(cosines > 0, visible, vertices.mean(rows)[:, None]) @ kernel.T)
        table = np.rint(255 * np.concatenate(table)) / 255
        held = FilteredVisibility(jnp.asarray(_codes(vertices, cells)), cells)

        def means(peaks, exponent, cells=cells, table=table):
            numbers, shares = (np.asarray(part) for part in between(peaks, cells))
            return np.einsum(
                "pb,pk,pbk->p", subset.weights, shares, table[subset.corners[:, :, None], numbers[:, None]]
            )

        def angles(peaks, exponent, held=held):
            share = jax.jit(jax.vmap(held.share, in_axes=(0, 0, 0, None)))
            return np.asarray(share(corners, weights, jnp.asarray(peaks), jnp.float32(exponent)))

        forms[f"means on a grid of {cells} cells", len(points)] = means
        forms[f"signed angles on a grid of {cells} cells", len(points)] = angles
    return forms


def _harmonics(vertices: Seen, order: int) -> np.ndarray:
    """Coefficients of the vertices' visibility, in codes of 8 bits with a scale for each degree, decoded again."""
    basis = _spherical(vertices.vectors, order) * vertices.areas[:, None]
    parts = []
    for rows in blocks(vertices.baked.count):
        visible, cosines = vertices.of(rows)
        parts.append(np.where(cosines > 0, visible, vertices.mean(rows)[:, None]) @ basis)
    coefficients = np.concatenate(parts)
    for degree in range(order + 1):
        band = slice(degree**2, (degree + 1) ** 2)
        step = np.abs(coefficients[:, band]).max() / 127
        coefficients[:, band] = np.rint(coefficients[:, band] / step) * step
    return coefficients


def _spherical(directions: np.ndarray, order: int) -> np.ndarray:
    """Real spherical harmonics of unit vectors, by degree."""
    from scipy.special import sph_harm_y

    polar, azimuth = np.arccos(np.clip(directions[:, 2], -1, 1)), np.arctan2(directions[:, 1], directions[:, 0])
    values = []
    for degree in range(order + 1):
        for m in range(-degree, degree + 1):
            value = sph_harm_y(degree, abs(m), polar, azimuth) * (np.sqrt(2) if m else 1)
            values.append(value.imag if m < 0 else value.real)
    return np.stack(values, axis=1)


def _bands(exponent: float, order: int) -> np.ndarray:
    """How much a lobe damps each degree."""
    from jaxrelight.basis.zonal import lobe_bands

    return lobe_bands(exponent, order)


def _factored(vertices: Seen, subset: Subset, omega_o: np.ndarray, exponent: int, lights: np.ndarray):
    """Radiance by K terms of the vertices, interpolated: what vertices have without filtered visibility."""
    import jax

    from jaxrelight.brdf.factors import factor

    factors = factor(_phong(exponent), max(TERMS), 48)
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
