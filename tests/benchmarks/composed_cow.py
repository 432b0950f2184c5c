"""One SBRDF composed of six materials by masks, on a cow under two skies and three lights: its steps and their time."""

import argparse
import pathlib
import time

import jax
import numpy as np

from tests.benchmarks.factor_error import published
from tests.benchmarks.measuring import Report, shared
from tests.benchmarks.pictures import contact_sheet

SKIES = "grace_latlong.exr", "blender_sunset.exr"
# sRGB colours in spot's texture, each of which becomes a material.
COLOURS = {
    "hide": (255, 238, 229),
    "spots": (64, 64, 64),
    "hooves": (130, 130, 130),
    "ears": (158, 91, 53),
    "muzzle": (255, 197, 168),
    "eyes": (0, 0, 0),
}
LOBES = 2


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.composed_cow", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small maps and pictures; RESULTS.md is left as it is")
    parser.add_argument("--picture", type=pathlib.Path, metavar="PNG", help="write the pictures side by side")
    arguments = parser.parse_args()
    side, size = (8, 64) if arguments.quick else (256, 384)
    parameters = f"spot.obj, its texture as masks, {side}² texels of {LOBES} lobes, {size}² pixels"
    with Report("composed_cow", "An SBRDF of six materials", parameters, not arguments.quick) as report:
        measure(report, side, size, arguments.picture)


def measure(report: Report, side: int, size: int, picture: pathlib.Path | None):
    """A row for every step."""
    from jaxrelight import Prefiltered, load_environment, prepare

    rows = []

    def timed(step: str, make):
        start = time.perf_counter()
        result = make()
        rows.append([step, f"{time.perf_counter() - start:.1f} s"])
        return result

    layers = timed("fit six materials", lambda: materials(side))
    level = timed(f"compose {side}² texels, refitted where masks meet", lambda: compose(layers, side))
    levels = timed("refit the coarser levels", lambda: with_coarser(level))
    scene = cow(levels, size)

    def see():
        relighter = prepare(scene, Prefiltered(occlusion_resolution=0))
        return relighter, relighter.view()

    relighter, view = timed("what the camera sees", see)

    def radiance(lit) -> np.ndarray:
        return np.asarray(relighter.shade(lit, view).radiance)

    by_lights = timed("three lights, with shadows", lambda: radiance(relighter.light(scene.lights)))
    shown = {}
    for name in SKIES:
        sky = load_environment(shared("data", "env", name), rotate_y=60.0)
        lit = timed(f"{name}: all maps", lambda sky=sky: jax.block_until_ready(relighter.light(sky)))
        image = timed(f"{name}: picture", lambda lit=lit: radiance(lit))
        bright = float(np.quantile(image[np.asarray(view.covered)].mean(axis=-1), 0.9))
        behind = np.asarray(relighter.background(lit, view))
        shown[name.split(".")[0]] = (image + behind) / bright
        shown[f"{name.split('.')[0]}, three lights"] = (image + behind) / bright + by_lights
    report.table(["step", "seconds, with what is compiled"], rows)
    if picture:
        contact_sheet(picture, shown, 4, -1.3)


def materials(side: int):
    """SBRDFs of the materials, each the same in all texels but for the direction that the hide is brushed in."""
    from fitting import Options, fit_lafortune, painted, uniform
    from jaxrelight.brdf.files import load_brdf
    from jaxrelight.brdf.lobes import lobe, lobe_sum, phong

    fits = shared("data", "published", "lafortune_published.json")
    measured = load_brdf(shared("data", "brdf", "rgl_cc_ibiza_sunset_rgb.bsdf")).brdf
    brushed = lobe_sum([0.08, 0.05, 0.02], [lobe([-1, -0.93, 0.99], 60, peak=[2.2, 1.6, 0.8])])
    options = Options(lobes=LOBES)
    fitted = {
        "spots": fit_lafortune(measured, options, hold_out=0).brdf,
        "ears": fit_lafortune(published("clay", fits), options, hold_out=0).brdf,
        "muzzle": fit_lafortune(published("skin", fits), options, hold_out=0).brdf,
        "hooves": fit_lafortune(published("bluepaint", fits), options, hold_out=0).brdf,
    }
    every = {"hide": brushed, **fitted, "eyes": phong(0.01, 0.1, 300)}
    levels = {name: uniform(brdf, (side, side)) for name, brdf in every.items()}
    u, v = np.meshgrid((np.arange(side) + 0.5) / side, 1 - (np.arange(side) + 0.5) / side)
    return {**levels, "hide": painted(levels["hide"], 2 * np.pi * (np.sin(9 * u) + np.cos(11 * v)) / 4)}


def masks(side: int) -> dict[str, np.ndarray]:
    """The share of every texel of each colour of spot's texture."""
    from PIL import Image
    from scipy import ndimage

    pixels = np.asarray(Image.open(shared("data", "mesh", "spot_texture.png")).convert("RGB"), float)
    apart = [((pixels - colour) ** 2).sum(axis=-1) for colour in COLOURS.values()]
    # Between two colours lie those of others: such pixels are of the nearest one that is clear.
    unclear = np.min(apart, axis=0) > 100
    index = ndimage.distance_transform_edt(unclear, return_distances=False, return_indices=True)
    row, column = np.asarray(index)
    nearest, block = np.argmin(apart, axis=0)[row, column], len(pixels) // side
    return {
        name: (nearest == number).reshape(side, block, side, block).mean(axis=(1, 3))
        for number, name in enumerate(COLOURS)
    }


def compose(layers, side: int):
    """Of every material where its mask says."""
    from fitting import Options, composed

    shares = masks(side)
    return composed([(layers[name], shares[name]) for name in COLOURS], Options(lobes=LOBES))


def with_coarser(level):
    """The level and all that are refitted to it."""
    from fitting import Options
    from fitting.sbrdf_levels import coarser

    levels, mask = [level], np.ones(level.lobes.shape, bool)
    while max(mask.shape) > 1:
        level, mask = coarser(levels[-1], mask, Options())
        levels.append(level)
    return levels


def cow(levels, size: int):
    """The scene."""
    from jaxrelight import Camera, Part, Scene, lambert, load_mesh, plane
    from jaxrelight.brdf.files.sbrdf import spatial
    from jaxrelight.geometry.mesh import normalized
    from jaxrelight.lights.local import directional, point, spot

    mesh = normalized(load_mesh(shared("data", "mesh", "spot.obj")), 1.0)
    camera = Camera((1.35, 0.95, -1.75), (0.0, 0.4, 0.02), fov_y=32.0, width=size, height=size)
    lights = (
        point([1.2, 1.5, -0.4], [1.5, 1.2, 0.9]),
        directional([0.6, -1.0, 0.3], [0.4, 0.45, 0.6]),
        spot([-1.2, 1.6, -1.4], [0, 0.5, -0.3], [4.0, 3.6, 3.2], 24),
    )
    parts = [Part(mesh, "cow"), Part(plane((6, 6), 8), "floor")]
    surfaces = {"cow": spatial(levels), "floor": lambert([0.3, 0.3, 0.32])}
    return Scene(parts, surfaces, camera, lights=lights, name="composed cow")


if __name__ == "__main__":
    main()
