"""Frames of spatial BRDFs under local lights and environments: lobes, lights, and the number of distinct BRDFs."""

import argparse
import dataclasses
from typing import NamedTuple

import jax.numpy as jnp
import numpy as np

from jaxrelight.brdf.spatial import Minification
from jaxrelight.lighting.prefiltered import PrefilteredRelighter
from jaxrelight.lighting.visible_surfaces import VisibleSurfaces
from tests.benchmarks.measuring import Report, Timing, interleaved, shared

LOBES = LIGHTS = 1, 2, 3
SIDES = 2, 1, 32, 256, 1024
BRDFS = 1, 2, 4, 8, 16
TERMS, RUNS = 4, 7


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.sbrdf_frames", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small pictures and maps; RESULTS.md is left as it is")
    quick = parser.parse_args().quick
    size, sides = ((80, 60), (2, 32)) if quick else ((800, 600), SIDES)
    shared("data", "mesh", "spot.obj")
    parameters = f"spot, close, {size[0]}×{size[1]}; frames a second of shading what the camera sees"
    with Report("sbrdf_frames", "Frames of spatial BRDFs", parameters, not quick) as report:
        scene = spot(size)
        lobes_and_lights(report, scene, sides[-1])
        distinct(report, scene, sides, 4 if quick else len(BRDFS))
        report.speed()


def spot(size: tuple[int, int]):
    """The cow alone, filling the picture."""
    from jaxrelight import Camera, Part, Scene, lambert, load_mesh
    from jaxrelight.geometry.mesh import normalized

    mesh = normalized(load_mesh(shared("data", "mesh", "spot.obj")), 1.0)
    camera = Camera((0.9, 0.6, -1.1), (0.0, 0.32, 0.0), (0.0, 1.0, 0.0), 38.0, *size)
    return Scene([Part(mesh, "skin")], {"skin": lambert(0.5)}, camera, name="spot")


def maps(side: int, lobes: int):
    """A BRDF of its own in each of side² texels."""
    from jaxrelight.brdf.spatial import SpatialLobes

    chance = np.random.default_rng(side)
    C = chance.uniform(-1, 1, (side, side, lobes, 3)) * 0.3 + [-0.8, -0.8, 0.8]
    angle = chance.uniform(0, np.pi, (side, side))
    arrays = (
        chance.uniform(0, 0.5, (side, side, 3)),
        C / np.abs(C).max(axis=-1, keepdims=True),
        np.exp(chance.uniform(0, 5, (side, side, lobes))),
        chance.uniform(0, 1, (side, side, lobes, 3)) / lobes,
        np.stack([np.cos(2 * angle), np.sin(2 * angle)], axis=-1),
    )
    return SpatialLobes(*(jnp.asarray(array, jnp.float32) for array in arrays))


def lamps():
    from jaxrelight.lights.local import directional, point, spot

    return [
        point([1, 2, -2], [8, 7, 6]),
        directional([1, -1, 0.4], 2),
        spot([-2, 2, -1], [0, 0.3, 0], [20, 20, 25], 30),
    ]


class Frame(NamedTuple):
    """What the scene's camera sees, ready to be lit."""

    relighter: PrefilteredRelighter
    view: VisibleSurfaces

    def under(self, light):
        """The picture of a light that is prepared already."""
        return self.relighter.shade(light, self.view).radiance

    def lit_by(self, lamps):
        """The picture of local lights, which may have moved."""
        return self.under(self.relighter.light(lamps))

    def by(self, **dials) -> "Frame":
        """The same by other dials."""
        method = dataclasses.replace(self.relighter.method, **dials)
        return self._replace(relighter=dataclasses.replace(self.relighter, method=method))


def frame_of(scene, brdf, minification: Minification = "none") -> Frame:
    """A frame without shadows."""
    from jaxrelight import Prefiltered, prepare
    from jaxrelight.brdf.material import Component, Material

    material = brdf if isinstance(brdf, Material) else Material((Component(brdf),))
    scene = dataclasses.replace(scene, materials={"skin": material})
    relighter = prepare(scene, Prefiltered(shadows=False, minification=minification, occlusion_resolution=0))
    assert isinstance(relighter, PrefilteredRelighter)
    return Frame(relighter, relighter.view())


def grey_sky():
    from jaxrelight import environment

    return environment(np.ones((8, 16, 3), np.float32))


def lobes_and_lights(report: Report, scene, side: int):
    """Table 1 of the paper."""
    every, lights = {lobes: frame_of(scene, maps(side, lobes)) for lobes in LOBES}, lamps()
    sky, ways = every[LOBES[0]].relighter.light(grey_sky()), {}
    for count in LIGHTS:
        some, name = lights[:count], f"{count} light{'s' if count > 1 else ''}"
        ways[name] = lambda frame, some=some: frame.lit_by(some)
        ways[f"{name}, shadows"] = lambda frame, some=some: frame.by(shadows=True).lit_by(some)
    ways["prefiltered environment"] = lambda frame: frame.under(sky)
    ways["… four texels evaluated"] = lambda frame: frame.by(texels="reflectance").under(sky)
    sides = {f"{way}, {n}": lambda f=frame, w=shade: w(f) for way, shade in ways.items() for n, frame in every.items()}
    times = interleaved(sides, RUNS)
    rows = [[way, *(f"{1 / times[f'{way}, {n}'].median:.1f}" for n in LOBES)] for way in ways]
    covered = int(every[LOBES[0]].view.covered.sum())
    report.text(
        f"**Lobes × lights**, the layout of Table 1, maps of {side}² distinct BRDFs, {covered:,} pixels of the "
        "surface. The paper's rates, on its hardware and 25 % of its scene: 50.7, 29.5, 20.8 with one light, 20.8, "
        "11.1, 7.6 with three."
    )
    report.table(["frames a second", *(f"{n} lobe{'s' if n > 1 else ''}" for n in LOBES)], rows)


def distinct(report: Report, scene, sides: tuple[int, ...], most: int):
    """The cost against the number of BRDFs: maps of lobes, and factored BRDFs with masks (Table 2)."""
    from jaxrelight import factor, phong
    from jaxrelight.brdf.material import Component, Material
    from jaxrelight.brdf.separable import separable
    from jaxrelight.brdf.texture import Texture

    light, drawn = lamps()[:1], {f"{side**2:,}": maps(side, 1) for side in sides}
    frames = {(count, m): frame_of(scene, one, m) for count, one in drawn.items() for m in ("none", "averaged")}
    sky = next(iter(frames.values())).relighter.light(grey_sky())
    ways = {
        "finest level, light": ("none", lambda frame: frame.lit_by(light)),
        "environment": ("none", lambda frame: frame.under(sky)),
        "levels, light": ("averaged", lambda frame: frame.lit_by(light)),
        "levels, environment": ("averaged", lambda frame: frame.under(sky)),
    }
    runs = {
        f"{count} {way}": lambda f=frames[count, m], w=shade: w(f)
        for count in drawn
        for way, (m, shade) in ways.items()
    }
    times = interleaved(runs, RUNS)
    rows = []
    for count in drawn:
        pairs = [(times[f"{count} {way}"], times[f"4 {way}"]) for way in ways]
        rows.append([count, *(cell for time, one in pairs for cell in (_milliseconds(time), f"{time.over(one):.2f}"))])
    report.text(
        "**Distinct BRDFs** in a map of one lobe, under one light without shadows, or an environment; ratios to a map "
        "of four (target: within 10 %): of single texels, and of two levels of detail, as far as the picture's pixels "
        "are from the texels' size. One alone is a constant, which needs no look-up."
    )
    report.table(["BRDFs", *(cell for way in ways for cell in (way, "ratio"))], rows)
    masks = [Texture(jnp.asarray(np.random.default_rng(i).random((64, 64, 1)), jnp.float32)) for i in range(BRDFS[-1])]
    brdfs = [separable(factor(phong(0.3, 0.3, 5 + i), TERMS)) for i in range(BRDFS[most - 1])]
    parts = [Component(brdf, (mask,)) for brdf, mask in zip(brdfs, masks, strict=False)]
    factored = {count: frame_of(scene, Material(tuple(parts[:count]))) for count in BRDFS[:most]}
    times = interleaved({str(n): lambda f=frame: f.lit_by(light) for n, frame in factored.items()}, RUNS)
    report.text(f"**Factored BRDFs**, {TERMS} terms each, blended by masks, one light without shadows.")
    rows = [[count, _milliseconds(time), f"{time.over(times['1']):.2f}"] for count, time in times.items()]
    report.table(["BRDFs", "light", "ratio"], rows)


def _milliseconds(time: Timing) -> str:
    return f"{1e3 * time.median:.1f} ms"


if __name__ == "__main__":
    main()
