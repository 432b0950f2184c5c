"""Prefiltered environments: their error against quadrature, what the horizon and occlusion cost, and their time."""

import argparse
import dataclasses
import functools
import time

import jax
import jax.numpy as jnp
import numpy as np

from jaxrelight.lights.prefiltered import PrefilteredMaps
from tests.benchmarks.measuring import Report, interleaved, percent, shared

ENVIRONMENTS = "grace_latlong.exr", "blender_sunset.exr"
EXPONENTS = 1, 4, 16, 64, 256
# Half a step from the nearest maps, in the logarithm of n + 1.
BETWEEN = tuple(2 ** ((step + 0.5) / 2) - 1 for step in (3, 7, 11, 15))
ANGLES = 0, 20, 40, 60, 75, 85, 95
SAMPLES = 16, 64, 256, 1024
DIRECTIONS, FRAMES, SUBSET = 400, 100, 300
RUNS = 5
# Scenes of the reference renderer, and sides of cube maps that vertices look along.
SCENES, OCCLUSION = ("bunny_phong", "bunny_lambert", "spot_lafortune"), (0, 4, 8, 16)


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.prefiltered", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a small environment, few directions; RESULTS.md is left")
    quick = parser.parse_args().quick
    shared("data", "env")
    rows = 128 if quick else 512
    parameters = f"{', '.join(ENVIRONMENTS)} at {2 * rows}×{rows}; the finest map has {rows} rows"
    with Report("prefiltered", "Prefiltered environments", parameters, not quick) as report:
        skies = {name: sky(name, rows) for name in ENVIRONMENTS[: 1 if quick else None]}
        made = building(report, skies)
        quadrature(report, skies, made, 40 if quick else DIRECTIONS)
        horizons(report, skies, 10 if quick else FRAMES)
        sampling(report, skies, made, (80, 60) if quick else (800, 600))
        occlusion(report, quick)
        report.speed()


def sky(name: str, rows: int) -> np.ndarray:
    from jaxrelight import load_environment
    from jaxrelight.basis import latlong

    return latlong.resized(load_environment(shared("data", "env", name)).pixels, rows, 2 * rows)


def building(report: Report, skies: dict) -> dict:
    """The maps, and how long they take."""
    from jaxrelight.lights.prefiltered import prefilter

    seconds, made = [], {}
    for pixels in (next(iter(skies.values())), *skies.values()):
        start = time.perf_counter()
        maps = jax.block_until_ready(prefilter(pixels, len(pixels)))
        seconds.append(time.perf_counter() - start)
        made[id(pixels)] = maps
    first, *again = seconds
    report.text(
        f"**All maps** of one environment, {len(maps.heights)} exponents, {maps.texels.nbytes / 1e6:.0f} MB: "
        f"{first:.1f} s with all that is compiled, {np.median(again):.1f} s afterwards (target ≤ 5 s)."
    )
    start = time.perf_counter()
    pixels = next(iter(skies.values()))
    equal = jax.block_until_ready(prefilter(pixels, len(pixels), equal=True))
    report.text(
        f"All maps of equal size instead: {time.perf_counter() - start:.1f} s, {equal.texels.nbytes / 1e6:.0f} MB; "
        'they are the rows "equal maps" below.'
    )
    return {name: made[id(pixels)] for name, pixels in skies.items()} | {"equal": equal}


def occlusion(report: Report, quick: bool):
    """What hides the environment: pictures against the references, by how many rays vertices look with."""
    import jaxrelight as jr

    rows, step = [], 4 if quick else 1
    for name in SCENES[: 1 if quick else None]:
        scene = jr.load_scene(shared("reference", f"{name}.toml"))
        reference = jr.read_image(shared("reference", f"{name}_b0.exr"))[::step, ::step]
        size = {"width": scene.camera.width // step, "height": scene.camera.height // step}
        scene = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, **size))
        for resolution in OCCLUSION:
            # Once to compile.
            for _ in range(2):
                start = time.perf_counter()
                relighter = jr.prepare(scene, jr.Prefiltered(occlusion_resolution=resolution))
                seconds = time.perf_counter() - start
            error = jr.image_error(relighter.picture(scene.lights), reference)
            prepared = f"{seconds:.1f} s" if resolution else "–"
            rows.append([name, resolution or "none", percent(error.trimmed), percent(error.untrimmed), prepared])
    report.text(
        "**Occlusion** of the environment: every vertex looks along the texels of a cube map of so many rows. Whole "
        "pictures, floor and all, against the reference renderer's without bounces."
    )
    report.table(["scene", "rows", "trimmed", "untrimmed", "prepare"], rows)


def _sphere(count: int, seed: int = 0) -> np.ndarray:
    omega = np.random.default_rng(seed).normal(size=(count, 3))
    return omega / np.linalg.norm(omega, axis=1, keepdims=True)


def _cells(pixels: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Direction and solid angle of every pixel."""
    from jaxrelight.basis import latlong

    height, width = pixels.shape[:2]
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    solid = np.repeat(latlong.solid_angles(height, width), width)
    return latlong.directions(u, v).reshape(-1, 3).astype(np.float32), solid.astype(np.float32)


def quadrature(report: Report, skies: dict, made: dict, count: int):
    """S and D against sums over all pixels."""
    omega, rows = _sphere(count).astype(np.float32), []
    for name, pixels in skies.items():
        directions, solid = _cells(pixels)
        cosine = np.maximum(omega @ directions.T, 0)
        ways = {name: made[name]} | ({"… equal maps": made["equal"]} if not rows else {})
        look_ups = {way: jax.jit(jax.vmap(maps.look_up, (0, None))) for way, maps in ways.items()}
        errors = {way: [] for way in ways}
        for n in (*EXPONENTS, *BETWEEN):
            wanted = (cosine ** np.float32(n) * solid) @ pixels.reshape(-1, 3) * ((n + 1) / (2 * np.pi))
            for way, find in look_ups.items():
                error = np.asarray(find(jnp.asarray(omega), jnp.float32(n))) - wanted
                errors[way].append(percent(float(np.sqrt(np.mean(error**2) / np.mean(wanted**2)))))
        rows += [[way, *row] for way, row in errors.items()]
    report.text(
        f"**S and D against brute-force quadrature** over all pixels, {count} random directions: root mean square of "
        "the difference over that of the map (target ≤ 1 %). D is S at exponent 1. The last columns lie halfway "
        "between two maps."
    )
    report.table(["environment", *(f"n = {n:.3g}" for n in (*EXPONENTS, *BETWEEN))], rows)


def horizons(report: Report, skies: dict, count: int):
    """One lobe under the environment: the paper's form and ours against quadrature with the cosine inside."""
    from jaxrelight.basis import latlong
    from jaxrelight.brdf.lobes import LobeSum
    from jaxrelight.lights.prefiltered import prefilter

    report.text(
        f"**Cosine and horizon**: one lobe whose peak stands at an angle from the normal, unshadowed, {count} random "
        "frames, maps of 256×128 pixels: relative L2 against quadrature with the cosine inside the integral; the "
        "cosine outside (eq. 11) / the one lobe that stands for lobe, cosine and horizon together."
    )
    normals, omega_o = _sphere(count, 2), jnp.asarray([0.5**0.5, 0, 0.5**0.5])
    across = np.cross(normals, _sphere(count, 3))
    across /= np.linalg.norm(across, axis=1, keepdims=True)
    frames = jnp.asarray(np.stack([across, np.cross(normals, across), normals], axis=1), jnp.float32)
    rows = []
    for name, pixels in skies.items():
        small = latlong.resized(pixels, 128, 256)
        maps = prefilter(small)
        directions, solid = _cells(small)
        local = np.einsum("fxy,dy->fdx", frames, directions)
        light = np.maximum(local[..., 2:], 0) * solid[:, None] * small.reshape(-1, 3)
        for n in (0, *EXPONENTS):
            cells = []
            for angle in ANGLES:
                x, z = np.sin(np.radians(angle)), np.cos(np.radians(angle))
                # C that sends this eye to a unit vector at the angle.
                C = jnp.asarray([[[-x, -x, z]]]) / omega_o[0]
                brdf = LobeSum(jnp.zeros(3), C, jnp.full((1, 1), float(n)), jnp.ones((1, 3)))
                peak, length = (np.asarray(part)[0, 0] for part in brdf.peak(omega_o))
                dot = local @ peak
                exact = np.einsum("fd,fdc->fc", np.where(dot > 0, np.maximum(dot, 0) ** n, 0) * length**n, light)
                forms = []
                for horizon in ("outside", "cut"):
                    radiance = _forms(brdf, omega_o, frames, maps, horizon)
                    forms.append(np.sqrt(np.sum((radiance - exact) ** 2) / np.sum(exact**2)))
                cells.append(" / ".join(f"{100 * error:.1f}" for error in forms))
            rows.append([f"{name}, n = {n}", *cells])
    report.table(["percent", *(f"{angle}°" for angle in ANGLES)], rows)


@functools.partial(jax.jit, static_argnames="horizon")
def _forms(brdf, omega_o, frames, maps, horizon):
    from jaxrelight.lighting.prefiltered import prefiltered_radiance

    return jax.vmap(lambda frame: prefiltered_radiance(brdf, omega_o, frame, maps, horizon))(frames)


def sampling(report: Report, skies: dict, made: dict, size: tuple[int, int]):
    """A picture against sampling the environment by the BRDF's lobes."""
    from jaxrelight import load_scene, prepare
    from jaxrelight.lighting.prefiltered import PrefilteredRelighter
    from jaxrelight.methods import Prefiltered

    scene = load_scene(shared("reference", "spot_lafortune.toml"))
    relighter = prepare(scene, Prefiltered(occlusion_resolution=0))
    assert isinstance(relighter, PrefilteredRelighter)
    view = relighter.view(dataclasses.replace(scene.camera, width=size[0], height=size[1]))
    names = [material.name for material in relighter.materials]
    part = next(part for part in view.parts if names[part.material] == "object")
    brdf = relighter.materials[part.material].components[0].brdf
    pixels_of_it = int(np.sum(np.asarray(part.pixels.pixel) < view.covered.size))
    some = np.sort(np.random.default_rng(0).choice(pixels_of_it, min(pixels_of_it, SUBSET), replace=False))
    few = jax.tree.map(lambda leaf: leaf[some], part.pixels)
    rows = []
    for name, pixels in skies.items():
        maps, texels = made[name], jnp.asarray(pixels)
        exact = _exactly(brdf, few, pixels)

        def error(radiance, exact=exact):
            return float(np.sqrt(np.sum((np.asarray(radiance) - exact) ** 2) / np.sum(exact**2)))

        mine = error(_prefiltered(brdf, few, maps))
        for way, pyramid in (("at their place", texels), ("filtered", mips(pixels))):
            errors = {n: error(_sampled(brdf, few, pyramid, n)) for n in SAMPLES}
            enough = [n for n, off in errors.items() if off <= mine]
            times = interleaved(
                {
                    "prefiltered": lambda m=maps: _prefiltered(brdf, part.pixels, m),
                    "sampled": lambda p=pyramid: _sampled(brdf, part.pixels, p, SAMPLES[0]),
                },
                RUNS,
                1,
            )
            count = enough[0] if enough else SAMPLES[-1]
            ratio = times["sampled"].over(times["prefiltered"]) * count / SAMPLES[0]
            row = [f"{name}, {way}", percent(mine), *(percent(value) for value in errors.values())]
            rows.append([*row, *map(str, times.values()), f"{'' if enough else '> '}{ratio:,.0f}×"])
    report.text(
        f"**Against sampling by the BRDF**: the reference scene of a Lafortune cow, no shadows, {size[0]}×{size[1]}, "
        f"{pixels_of_it:,} pixels of it, errors over {len(some):,} of them against quadrature over all pixels of the "
        "map. Samples are drawn by the lobes from a rank-one lattice, turned in every pixel by its own numbers, and "
        "look the map up at their place, or filtered over what each stands for (Křivánek and Colbert 2008). The last "
        f"column: the time of as many samples as are no worse, in proportion to that of {SAMPLES[0]}, over that of the "
        "prefiltered picture (target ≥ 20); > where none of the counts is enough."
    )
    heads = [f"{n} samples" for n in SAMPLES]
    report.table(["environment, samples", "prefiltered", *heads, "time", f"of {heads[0]}", "time ratio"], rows)


def mips(pixels: np.ndarray):
    """The map at half the size, and so on, each by area; looked up like prefiltered maps."""
    from jaxrelight.basis import latlong

    heights = tuple(len(pixels) >> level for level in range(8))
    maps = [latlong.resized(pixels, height, 2 * height).reshape(-1, 3) for height in heights]
    return PrefilteredMaps(jnp.asarray(np.concatenate(maps)), heights)


def _exactly(brdf, pixels, sky: np.ndarray) -> np.ndarray:
    """∫ f cos L over all pixels of the map, for every surface point."""
    directions, solid = _cells(sky)
    light = jnp.asarray(solid[:, None] * sky.reshape(-1, 3))

    @jax.jit
    def one(frame, omega_o):
        local = jnp.asarray(directions) @ frame.T
        value = jax.vmap(lambda omega_i: brdf.evaluate(omega_i, omega_o) * jnp.maximum(omega_i[2], 0))(local)
        return jnp.where(omega_o[2] > 0, jnp.sum(value * light, axis=0), 0)

    return np.stack([np.asarray(one(*given)) for given in zip(pixels.frame, pixels.omega_o, strict=True)])


@jax.jit
def _prefiltered(brdf, pixels, maps):
    from jaxrelight.lighting.prefiltered import prefiltered_radiance

    def shade(frame, omega_o):
        return jnp.where(omega_o[2] > 0, prefiltered_radiance(brdf, omega_o, frame, maps), 0)

    return jax.lax.map(lambda one: shade(*one), (pixels.frame, pixels.omega_o), batch_size=4096)


@functools.partial(jax.jit, static_argnames="count")
def _sampled(brdf, pixels, sky, count: int):
    """Estimates with lobe samples; of a lattice, which is nearer than random numbers."""
    from jaxrelight.basis import latlong
    from jaxrelight.brdf.lobe_sampling import LobeSampler

    # The generalised golden ratio in two dimensions.
    lattice = jnp.asarray(np.outer(np.arange(count) + 0.5, 1.324717957244746 ** -np.arange(1.0, 3.0)) % 1, jnp.float32)
    turns = jax.random.uniform(jax.random.key(0), (len(pixels.omega_o), 2))

    def shade(frame, omega_o, turn):
        sampler = LobeSampler(brdf, omega_o)

        def one(numbers):
            omega_i = sampler.at(*((numbers + turn) % 1))
            u, v = latlong.finite_coordinates(omega_i @ frame)
            density = sampler.pdf(omega_i)
            value = brdf.evaluate(omega_i, omega_o) * jnp.maximum(omega_i[2], 0) / density
            if not isinstance(sky, PrefilteredMaps):
                return value * latlong.look_up(sky, u, v)
            # A sample stands for 1/(count · density) steradians, a pixel of the finest map for 4π/2h².
            level = jnp.log2(sky.heights[0] ** 2 / (2 * np.pi * count * density)) / 2
            level = jnp.clip(level, 0, len(sky.heights) - 1.001)
            lower = jnp.floor(level).astype(jnp.int32)
            part = level - lower
            return value * ((1 - part) * sky.at_level(lower, u, v) + part * sky.at_level(lower + 1, u, v))

        return jnp.where(omega_o[2] > 0, jnp.mean(jax.vmap(one)(lattice), axis=0), 0)

    given = pixels.frame, pixels.omega_o, turns
    return jax.lax.map(lambda one: shade(*one), given, batch_size=max(4096 * 16 // count, 1))


if __name__ == "__main__":
    main()
