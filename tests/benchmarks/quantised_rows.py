"""Rows and light in 8 and 16 bits: what it does to colours, bytes and the product's time (Wang 2006 §4.1.2, §4.3).

A scale for every run of 16 neighbours in a row is compared with one for the row, and with one for each of its wavelet
levels. The last is not offered: in about as many bytes it leaves larger errors under all lights but one, and its scales
would have to be gathered. The largest coefficient of every run is kept to rounding.
"""

import argparse
import dataclasses

import numpy as np
from jaxtyping import Float, Int

from tests.benchmarks.measuring import THREADS, Report, in_threads, interleaved, shared

RESOLUTION, KEPT, SEED = 64, 128, 0
COLUMNS, LEVELS = 6 * RESOLUTION**2, RESOLUTION.bit_length()
LIGHTS = {
    "venice": ("pmndrs_venice.exr", 1),
    "sunset": ("blender_sunset.exr", 1),
    "city": ("blender_city.exr", 1),
    "Grace": ("grace_latlong.exr", 10),
}


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.quantised_rows", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="few rows and runs; RESULTS.md is left as it is")
    quick = parser.parse_args().quick
    shared("reference")
    groups, rows, runs = (1, 4096, 3) if quick else (12, 131_072, 31)
    parameters = (
        f"resolution {RESOLUTION}, N = {KEPT}; {groups} groups of 128 vertices of a material, drawn with seed {SEED}; "
        "colours in the scene's view; errors are relative L2, ratios medians over interleaved runs"
    )
    with Report("quantised_rows", "Rows in 8 and 16 bits", parameters, not quick) as report:
        lights = {name: light_vector(file, scale) for name, (file, scale) in LIGHTS.items()}
        report.text(
            "Cells: **added** by rounding to the colours of the same rows in float32, untrimmed (trimmed); and the "
            "**increase** of the untrimmed error against colours of all coefficients, which stands in the first line. "
            "In percent, and percentage points. Bytes are of an index and its values, per kept coefficient."
        )
        for scene, material in (("bunny_phong", "object"), ("bunny_lambert", "object"), ("bunny_lambert", "floor")):
            patch = bake(scene, material, groups, lights)
            report.text(f"**{scene}, {material}**, K = {patch.view.shape[1]}, {patch.channels} channel(s):")
            errors(report, patch, lights)
            if patch.channels == 3:
                times(report, patch, lights["Grace"], rows, runs)
        report.speed()


@dataclasses.dataclass(frozen=True)
class Patch:
    """Some receivers of a material: m receivers, k terms, c channels, n kept coefficients.

    Attributes:
        indices: of the coefficients kept, in rows m·k.
        values: theirs.
        view: factors of a light term in the colour that the camera sees.
        exact: light terms by all coefficients, by light.
    """

    indices: Int[np.ndarray, "r n"]
    values: Float[np.ndarray, "r c n"]
    view: Float[np.ndarray, "m k c"]
    exact: dict[str, Float[np.ndarray, "m k c"]]

    @property
    def channels(self) -> int:
        """3, or 1 where rows are the same in all channels."""
        return self.values.shape[1]

    def colours(self, terms) -> Float[np.ndarray, "1 m c"]:
        """What the camera sees of light terms, as an image of one line."""
        terms = np.asarray(terms, float).reshape(*self.view.shape[:2], 3)
        return np.sum(terms * self.view, axis=1)[None]


def light_vector(file: str, scale: float, resolution: int = RESOLUTION) -> Float[np.ndarray, "d c"]:
    """The light vector of an environment."""
    import jax.numpy as jnp

    from jaxrelight import load_environment
    from jaxrelight.basis import latlong
    from jaxrelight.basis.haar import HaarFaces
    from jaxrelight.lights.environment import coarsened, encode

    pixels = coarsened(load_environment(shared("data", "env", file)).pixels, resolution)
    resampling = latlong.area_resampling(*pixels.shape[:2], resolution)
    number = jnp.float32
    return np.array(encode(jnp.asarray(pixels), number(0), number(scale), resampling, HaarFaces(resolution)))


def bake(name: str, material: str, count: int, lights) -> Patch:
    """Traces and bakes some groups of a scene's vertices, as precomputation does."""
    import jax
    import jax.numpy as jnp

    from jaxrelight import factor, load_scene
    from jaxrelight.basis import cubemap
    from jaxrelight.basis.haar import HaarFaces
    from jaxrelight.brdf.material import as_material
    from jaxrelight.geometry.receivers import GROUP, vertex_receivers
    from jaxrelight.geometry.tracer import Tracer
    from jaxrelight.transport import bake as baking
    from jaxrelight.transport.model import frames_of
    from jaxrelight.transport.visibility import trace_visibility

    scene = load_scene(shared("reference", f"{name}.toml"))
    surfaces = scene.surfaces()
    receivers = vertex_receivers(surfaces, np.array([part.material == material for part in scene.parts], int))
    mine = receivers.groups_of(1)
    chosen = np.random.default_rng(SEED).choice(mine[receivers.filled[mine] == GROUP], count, replace=False)
    reflection = factor(as_material(scene.materials[material]).components[0].brdf)
    basis, directions = HaarFaces(RESOLUTION), baking.directions_for(RESOLUTION)
    texels = {key: basis.decode(jnp.asarray(light.T)).T for key, light in lights.items()}
    tracer, view_side = Tracer(surfaces), jax.jit(jax.vmap(reflection.view_side))
    indices, values, view, exact = [], [], [], {key: [] for key in lights}
    for group, frames in zip(chosen, frames_of(receivers, chosen), strict=True):
        points = receivers.origins[group], receivers.normals[group]
        bits = jnp.asarray(trace_visibility(tracer, *points, cubemap.directions(RESOLUTION))[0])
        kept = baking.bake_truncated(bits, frames, reflection, directions, basis, KEPT)
        indices.append(np.asarray(kept.indices, np.uint16).reshape(-1, KEPT))
        values.append(np.asarray(kept.values).reshape(-1, reflection.channels, KEPT))
        to_eye = np.asarray(scene.camera.origin) - points[0]
        local = np.einsum("mij,mj->mi", frames, to_eye / np.linalg.norm(to_eye, axis=-1, keepdims=True))
        view.append(np.asarray(view_side(jnp.asarray(local, jnp.float32))) * (local[:, 2] > 0)[:, None, None])
        for key, light in texels.items():
            exact[key].append(np.asarray(baking.bake_and_apply(bits, frames, reflection, directions, light)))
    joined = {key: np.concatenate(terms) for key, terms in exact.items()}
    return Patch(np.concatenate(indices), np.concatenate(values), np.concatenate(view), joined)


def errors(report: Report, patch: Patch, lights):
    """Rows: ways to keep rows and light. Columns: lights."""
    import jax
    import jax.numpy as jnp

    from jaxrelight import image_error
    from jaxrelight.operators.quantised import quantised
    from jaxrelight.operators.sparse_rows import sparse_rows

    apply = jax.jit(lambda operator, light: operator.apply(light))

    def colours(operator, light):
        return patch.colours(apply(operator, jnp.asarray(light)))

    def per_coefficient(nbytes: float) -> str:
        return f"{nbytes / patch.indices.size:.2f}"

    whole = sparse_rows(patch.indices, patch.values, COLUMNS)
    coarse = {
        key: np.asarray(quantised(np.ascontiguousarray(light.T), 16).decoded()).T for key, light in lights.items()
    }
    ways = {"float32, light in 16 bits": (whole, coarse, "")}
    for bits, run in ((8, KEPT), (8, 32), (8, 16), (8, 8), (16, KEPT)):
        coded = sparse_rows(patch.indices, quantised(patch.values, bits, run), COLUMNS)
        name = f"{bits} bits, a scale per {'row' if run == KEPT else f'run of {run}'}"
        ways[name] = coded, lights, per_coefficient(coded.nbytes)
    ways["8 bits, a scale per run of 16, light in 16 bits"] = ways["8 bits, a scale per run of 16"][0], coarse, ""
    for bits in (8, 16):
        values = quantised_by_level(patch.indices, patch.values, bits)
        nbytes = patch.indices.nbytes + patch.values.size * (bits / 8 + 4 * LEVELS / KEPT)
        ways[f"{bits} bits, a scale per row and level"] = (
            sparse_rows(patch.indices, values, COLUMNS),
            lights,
            per_coefficient(nbytes),
        )

    exact = {key: patch.colours(terms) for key, terms in patch.exact.items()}
    plain = {key: colours(whole, light) for key, light in lights.items()}
    before = {key: image_error(plain[key], exact[key]).untrimmed for key in lights}
    table = [["float32", per_coefficient(whole.nbytes), *(f"{100 * error:.2f}" for error in before.values())]]
    for name, (operator, given, size) in ways.items():
        cells = []
        for key, light in given.items():
            image = colours(operator, light)
            added, off = image_error(image, plain[key]), image_error(image, exact[key]).untrimmed
            increase = f"{100 * (off - before[key]):+.2f}"
            cells.append(f"{100 * added.untrimmed:.3f} ({100 * added.trimmed:.3f}), {increase}")
        table.append([name, size, *cells])
    report.table(["kept as", "bytes", *lights], table)


def quantised_by_level(indices: Int[np.ndarray, "r n"], values: Float[np.ndarray, "r c n"], bits: int):
    """Values rounded to steps of their row's wavelet level."""
    from jaxrelight.operators.quantised import quantised

    v, u = np.divmod(indices % RESOLUTION**2, RESOLUTION)
    level = np.ceil(np.log2(np.maximum(u, v) + 1))[:, None]
    out = np.zeros_like(values)
    for one in np.unique(level):
        # What is not of this level is zero meanwhile, so that the row's largest is the level's.
        out += np.asarray(quantised(np.where(level == one, values, 0), bits).decoded())
    return out


def times(report: Report, patch: Patch, light: Float[np.ndarray, "d c"], rows: int, runs: int):
    """The product, against scipy's and against the same rows in float32."""
    import jax
    import jax.numpy as jnp
    import scipy.sparse

    from jaxrelight.operators.quantised import quantised
    from jaxrelight.operators.sparse_rows import sparse_rows

    apply = jax.jit(lambda operator, light: operator.apply(light))
    on_device, by_channel = jnp.asarray(light), [np.ascontiguousarray(light[:, c]) for c in range(3)]
    again = -(-rows // len(patch.indices))
    values = np.tile(patch.values, (again, 1, 1))[:rows]
    real = np.tile(patch.indices, (again, 1))[:rows]
    random = np.sort(np.random.default_rng(SEED).integers(0, COLUMNS, real.shape), axis=-1)
    starts = np.arange(rows + 1, dtype=np.int32) * KEPT
    cut = rows // THREADS

    def products(matrices):
        return [matrix @ x for matrix, x in zip(matrices, by_channel, strict=True)]

    def in_one(matrices):
        return lambda: products(matrices)

    def in_each(matrices):
        parts = [[matrix[i * cut : (i + 1) * cut] for matrix in matrices] for i in range(THREADS)]
        return lambda: in_threads(lambda i: products(parts[i]), THREADS)

    def ours(operator):
        return lambda: apply(operator, on_device)

    one, each = "scipy CSR, 1 thread", f"scipy CSR, rows shared by {THREADS} threads"
    table = []
    for label, indices in (("real indices", real), ("random indices", random)):
        flat = indices.ravel().astype(np.int32)
        matrices = [
            scipy.sparse.csr_matrix((np.ascontiguousarray(values[:, c]).ravel(), flat, starts), shape=(rows, COLUMNS))
            for c in range(3)
        ]
        operators = {
            "float32": sparse_rows(indices, values, COLUMNS),
            "8 bits, a scale per row": sparse_rows(indices, quantised(values, 8), COLUMNS),
            "8 bits, a scale per run of 16": sparse_rows(indices, quantised(values, 8, 16), COLUMNS),
            "16 bits, a scale per row": sparse_rows(indices, quantised(values, 16), COLUMNS),
        }
        sides = {one: in_one(matrices), each: in_each(matrices)}
        sides |= {name: ours(operator) for name, operator in operators.items()}
        taken = interleaved(sides, runs)
        for name, timing in taken.items():
            factors = [f"{taken[other].over(timing):.2f}" for other in (one, each, "float32")]
            held = operators[name].nbytes if name in operators else 0
            profile = f"{held / 1e6:.0f} MB" if held else "", f"{held / timing.median / 1e9:.1f}" if held else ""
            each_one = f"{timing.median / (rows * KEPT) * 1e9:.2f}"
            table.append([f"{label}: {name}", *profile, each_one, timing, *factors])
    report.text(
        f"**Row-sparse apply**, {rows:,} rows × {KEPT} of {COLUMNS:,} coefficients, three channels, {runs} runs; the "
        "rows above, repeated. Target: 8 bits at least 2.5 times as fast as scipy's CSR in float32."
    )
    heads = ["what", "held", "GB/s", "ns a coefficient", "time"]
    report.table([*heads, "scipy 1 / this", f"scipy {THREADS} / this", "float32 / this"], table)
    report.text(
        "Where float32 and 8 bits take the same time, and read their rows more slowly than the machine copies, what "
        "bounds them is not reading but looking up the light of each coefficient."
    )


if __name__ == "__main__":
    main()
