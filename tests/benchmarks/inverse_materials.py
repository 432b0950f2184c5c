"""Materials from pictures: what their derivatives cost, how honest intervals are, and an albedo under a shadow."""

import argparse
import contextlib
import dataclasses
import functools
import pathlib
import sys
import tempfile
import time

import numpy as np
from jaxtyping import Float

from tests.benchmarks.measuring import Report, answer, interleaved, megabytes, peak_memory, percent, run_child, shared

SCENE = "bunny_phong"
# Ways in which a glossy BRDF's parameters reach the picture.
WAYS = {
    "rows at pixels, baked at use": {"receivers": "pixels"},
    "filtered lobes at vertices": {"receivers": "vertices"},
}
NOISE = 0.01


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.inverse_materials", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small pictures, few draws; RESULTS.md is left as it is")
    parser.add_argument("--folder", type=pathlib.Path, help="keep the stores here and reuse them")
    parser.add_argument("--cost", nargs=4, metavar=("WAY", "SIZE", "RESOLUTION", "STORE"), help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.cost:
        way, size, resolution, store = arguments.cost
        cost_of(way, int(size), int(resolution), pathlib.Path(store))
        return
    shared("reference")
    quick = arguments.quick
    size, resolution, draws = (48, 8, 4) if quick else (128, 32, 100)
    parameters = f"{size}×{size} pixels and resolution {resolution} for derivatives; {draws} draws of {NOISE:.0%} noise"
    with contextlib.ExitStack() as stack:
        folder = arguments.folder or pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
        report = stack.enter_context(Report("inverse_materials", "Materials from pictures", parameters, not quick))
        costs(report, size, resolution, folder)
        intervals(report, draws, folder)
        shadow(report, quick, folder)
        report.speed()


# Derivatives


def costs(report: Report, size: int, resolution: int, folder: pathlib.Path):
    """Reverse mode and the whole Jacobian against the picture."""
    rows = []
    for number, way in enumerate(WAYS):
        child = run_child(
            "tests.benchmarks.inverse_materials",
            "--cost",
            way,
            f"{size}",
            f"{resolution}",
            str(folder / f"cost-{number}"),
        )
        times = child["seconds"]
        rows.append(
            [
                way,
                f"{1e3 * times['picture']:.0f} ms",
                f"{child['reverse']:.2f} ×",
                f"{child['jacobian']:.2f} ×",
                megabytes(child["added"]),
            ]
        )
    report.table([f"{SCENE}: a Phong BRDF's 7 numbers", "picture", "reverse mode", "Jacobian", "memory added"], rows)


def cost_of(way: str, size: int, resolution: int, folder: pathlib.Path):
    """Answers with seconds, ratios and bytes of one way."""
    import jax
    import jax.numpy as jnp

    import jaxrelight as jr

    scene = jr.load_scene(shared("reference", f"{SCENE}.toml"))
    scene = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, width=size, height=size))
    relighter = jr.prepare(scene, jr.Transport(resolution=resolution, **WAYS[way]), folder)
    at = jnp.asarray([0.4, 0.1, 0.1]), jnp.asarray([0.4, 0.4, 0.4]), jnp.asarray(30.0)
    base = relighter.with_materials({"object": jr.phong(*at)})
    view, lit = relighter.view(), base.light(scene.lights)
    weight = np.random.default_rng(0).random((size, size, 3)).astype(np.float32)

    def picture(numbers, base, lit, view):
        changed = base.with_materials({"object": jr.phong(*numbers)})
        return changed.shade(changed.relit(lit), view).radiance

    fixed = base, lit, view
    forward, jacobian = jax.jit(picture), jax.jit(jax.jacfwd(picture))
    reverse = jax.jit(lambda numbers, *fixed: jax.vjp(lambda at: picture(at, *fixed), numbers)[1](weight))
    jax.block_until_ready(forward(at, *fixed))
    before = peak_memory()
    jax.block_until_ready(reverse(at, *fixed))
    added = peak_memory() - before
    sides = {"picture": forward, "reverse": reverse, "jacobian": jacobian}
    times = interleaved({name: functools.partial(of, at, *fixed) for name, of in sides.items()}, 7)
    ratios = {name: times[name].over(times["picture"]) for name in ("reverse", "jacobian")}
    answer({"seconds": {name: time.median for name, time in times.items()}, **ratios, "added": added})


# A small scene


def ball_over_floor(gloss, paper, camera, lamp=1.0):
    """A ball over a floor, under a sky and a lamp of some strength."""
    import jaxrelight as jr
    from tests import scenes

    sky = jr.environment((0.2 + np.random.default_rng(0).gamma(0.4, size=(16, 32, 3))).astype(np.float32))
    light = jr.point([1.0, 2.0, 1.0], lamp * np.array([9.0, 8.0, 7.0]))
    return scenes.ball_over_floor(gloss, camera, [sky, light], paper=paper, quads=(8, 12))


def rendered(relighter, materials) -> Float[np.ndarray, "h w 3"]:
    """A picture under the scene's own lights."""
    changed = relighter.with_materials(materials)
    return np.asarray(changed.shade(changed.light(changed.scene_lights()), relighter.view()).radiance)


def intervals(report: Report, draws: int, folder: pathlib.Path):
    """Eight numbers of a Lafortune lobe from one noisy picture, again and again."""
    import jaxrelight as jr
    from jaxrelight.inverse.material_unknowns import Unknown
    from jaxrelight.inverse.solve_materials import materials

    true = jr.lobe_sum([0.2, 0.15, 0.1], [jr.lobe([-1.0, -1.0, 0.9], 18, peak=[0.9, 0.7, 0.5])])
    truth = {
        "diffuse": [0.2, 0.15, 0.1],
        "specular": 2 * np.pi / 20 * np.array([[0.9, 0.7, 0.5]]),
        "exponent": [[18.0]],
        "C": [[[0.9]]],
    }
    start = Unknown(jr.lobe_sum(0.3, [jr.lobe([-1, -1, 0.7], 6, peak=0.4)]), tuple(truth))
    camera = jr.Camera((0.3, 0.9, 1.9), (0, 0.35, 0), fov_y=32, width=64, height=48)
    scene = ball_over_floor(true, jr.lambert(0.5), camera)
    relighter = jr.prepare(scene, jr.Transport(resolution=16), folder / "ball")
    picture = rendered(relighter, {"gloss": true})
    sigma = NOISE * picture + 1e-4
    inside, widths, seconds, converged = [], [], [], 0
    for draw in range(draws):
        noisy = picture + sigma * np.random.default_rng(draw).normal(size=picture.shape)
        began = time.perf_counter()
        found = materials(relighter, [noisy], unknowns={"gloss": start}, deviations=[sigma])
        seconds.append(time.perf_counter() - began)
        converged += found.converged
        estimates = [found.estimates[f"gloss.{name}"] for name in truth]
        wanted = [np.asarray(values) for values in truth.values()]
        pairs = list(zip(estimates, wanted, strict=True))
        inside.append(np.concatenate([((e.low <= w) & (w <= e.high)).ravel() for e, w in pairs]))
        widths.append(np.concatenate([e.width.ravel() for e in estimates]))
        assert found.undetermined == ()
    covered, width = np.stack(inside), np.stack(widths)
    names = [f"{name} {i}" if np.size(of) > 1 else name for name, of in truth.items() for i in range(np.size(of))]
    rows = [
        [name, percent(covered[:, i].mean()), percent(float(np.median(width[:, i])))] for i, name in enumerate(names)
    ]
    rows.append(["all", percent(covered.mean()), percent(float(np.median(width)))])
    report.text(
        f"Eight numbers of a Lafortune lobe from one picture of {camera.width}×{camera.height} pixels, {NOISE:.0%} "
        f"noise, from a wrong start: {draws} draws, of which {converged} converged; median "
        f"{np.median(seconds):.2f} s a draw."
    )
    report.table(["95 % interval", "holds the truth", "median width"], rows)


def shadow(report: Report, quick: bool, folder: pathlib.Path):
    """A textured floor under the shadow of a ball: its picture has no coefficient left out, and noise."""
    import jax

    import jaxrelight as jr
    from jaxrelight.brdf.material import textured_lambert, white_lambert
    from jaxrelight.brdf.texture import Texture
    from jaxrelight.inverse.material_unknowns import Unknown
    from jaxrelight.inverse.solve_materials import materials

    rows, columns = (8, 8) if quick else (32, 32)
    v, u = (np.mgrid[:rows, :columns] + 0.5) / rows
    red, green = 0.45 + 0.3 * np.sin(6.28 * u) * np.cos(6.28 * v), 0.4 + 0.2 * np.cos(12.57 * u)
    true = np.stack([red, green, 0.3 + 0.2 * np.sin(6.28 * (u + v))], axis=-1)
    texture = Texture(jax.device_put(true.astype(np.float32))).minified()
    camera = jr.Camera((0.3, 2.3, 0.9), (0, 0.0, 0), fov_y=46, width=48 if quick else 128, height=36 if quick else 96)
    method = jr.Transport(resolution=8 if quick else 32)
    flat = textured_lambert(Texture(jax.device_put(np.full((rows, columns, 3), 0.5, np.float32))))
    scene = ball_over_floor(jr.lambert(0.4), flat, camera, lamp=4.0)
    relighter = jr.prepare(scene, method, folder / "floor")
    open_floor = dataclasses.replace(scene, parts=scene.parts[:1], materials={"paper": scene.materials["paper"]})
    bare = jr.prepare(open_floor, method, folder / "bare")
    whole = jr.prepare(scene, dataclasses.replace(method, coefficients="all"), folder / "floor")
    white, textured = {"paper": jr.Material((jr.Component(white_lambert()),))}, {"paper": textured_lambert(texture)}
    image = rendered(whole, textured)
    image = image * (1 + NOISE * np.random.default_rng(0).normal(size=image.shape))
    under, free = rendered(relighter, white), rendered(bare, white)
    view = relighter.view()
    part = next(p for p in view.surfaces.parts if relighter.materials[p.material].name == "paper")
    pixel = np.asarray(part.pixels.pixel)
    on_floor = np.zeros(image.shape[:2], bool)
    on_floor.ravel()[pixel[pixel < on_floor.size]] = True
    began = time.perf_counter()
    found = materials(
        relighter,
        [image.astype(np.float32)],
        unknowns={"paper": Unknown(jr.lambert(0.5), textures={"albedo": (rows, columns)})},
        masks=[on_floor],
    )
    seconds = time.perf_counter() - began
    albedo = found.pictures[0] / np.maximum(under, 1e-6)
    wanted = rendered(relighter, textured) / np.maximum(under, 1e-6)
    open_share = (under / np.maximum(free, 1e-6)).mean(axis=-1)
    dark = on_floor & (open_share < 0.6)
    lit = on_floor & (open_share > 0.9)
    table = []
    for name, chosen in (("in light", lit), ("in shadow", dark)):
        error = np.linalg.norm((albedo - wanted)[chosen]) / np.linalg.norm(wanted[chosen])
        table.append([name, f"{chosen.sum():,}", percent(float(error))])
    off = ((albedo - wanted)[on_floor] / wanted[on_floor]).mean(axis=-1)
    correlation = float(np.corrcoef(off, open_share[on_floor])[0, 1])
    report.text(
        f"An albedo of {rows}×{columns} texels from one picture of {camera.width}×{camera.height} pixels with "
        f"{NOISE:.0%} noise, known lights; the picture has all coefficients, the solved scene is compressed. "
        f"{seconds:.1f} s with what is compiled; residual {percent(found.residual)}, held out "
        f"{percent(found.held_out or 0.0)}; correlation of the albedo's relative error with the share of light that is "
        f"not in shadow {correlation:+.3f}; not told: {', '.join(found.undetermined) or 'nothing'}."
    )
    report.table(["albedo at pixels", "pixels", "relative error"], table)


if __name__ == "__main__":
    sys.exit(main())
