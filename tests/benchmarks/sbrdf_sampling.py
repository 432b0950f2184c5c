"""Spatial BRDFs between texels and of texels smaller than pixels: what each way to look them up costs and misses."""

import argparse
import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from jaxrelight.brdf.spatial import Minification
from jaxrelight.lighting.direct_light import Texels
from tests.benchmarks.measuring import Report, interleaved, percent, shared
from tests.benchmarks.sbrdf_frames import Frame

# Texels across a pixel: a close view, and ever farther ones.
ACROSS = 0.25, 2, 4, 8, 16
MINIFICATIONS: tuple[Minification, ...] = "none", "averaged", "levels"
TEXELS: tuple[Texels, ...] = "parameters", "reflectance"
EYE = 0.13, 1.6, 1.2
RUNS = 5


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.sbrdf_sampling", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small maps and pictures; RESULTS.md is left as it is")
    quick = parser.parse_args().quick
    shared("data", "env", "grace_latlong.exr")
    side, size, many = (8, 8, 4) if quick else (128, 32, 16)
    parameters = (
        f"a card of {side}² texels, {size}² pixels, Grace Cathedral and a point light together; relative L2 against "
        f"the mean over {many}² rays a pixel, at each of which the reflectances of four texels are blended"
    )
    with Report("sbrdf_sampling", "SBRDFs between texels and far away", parameters, not quick) as report:
        for name, level in list(patterns(side).items())[: 1 if quick else None]:
            measure(report, name, level, size, many, ACROSS[: 2 if quick else None])
        report.speed()


def patterns(side: int) -> dict:
    """Maps whose texels are unlike their neighbours."""
    from fitting import Options, composed, painted, uniform
    from jaxrelight.brdf.lobes import lobe, lobe_sum

    gold = uniform(lobe_sum([0.1, 0.07, 0.02], [lobe([-1, -1, 0.98], 150, peak=[12, 9, 4])]), (side, side))
    clay = uniform(lobe_sum([0.2, 0.3, 0.5], [lobe([-1, -1, 0.9], 6, peak=[0.1, 0.1, 0.1])]), (side, side))
    two = [lobe([-1, -0.8, 0.98], 60, peak=[4, 4, 4]), lobe([-1, -1, 1], 1, peak=[0, 0, 0])]
    brushed = uniform(lobe_sum([0.05] * 3, two), (side, side))
    chance = np.random.default_rng(0)
    flakes = (chance.random((side, side)) < 0.3).astype(float)
    return {
        "flakes of gold in clay, 30 % of the texels": composed([(gold, flakes), (clay, 1 - flakes)], Options(lobes=2)),
        "brushed metal, every texel in a direction of its own": painted(
            brushed, chance.uniform(0, np.pi, (side, side))
        ),
    }


def measure(report: Report, name: str, level, size: int, many: int, every: Sequence[float]):
    """A row for every way to look up, by how many texels a pixel covers."""
    from jaxrelight import load_environment
    from jaxrelight.lights.local import point
    from tests.benchmarks.composed_cow import with_coarser

    sky = load_environment(shared("data", "env", "grace_latlong.exr"))
    lamp = point((EYE[0], EYE[1], -EYE[2]), [3, 3, 3])
    levels = with_coarser(level)
    sky_and_lamp = card(levels, 8, 2, 1, "none").relighter.light([sky, lamp])
    sky_alone = sky_and_lamp._replace(groups=())

    def picture(frame: Frame, texels: Texels) -> np.ndarray:
        return np.asarray(frame.by(texels=texels).under(sky_and_lamp))

    ways: dict[tuple[Minification, Texels], list[str]] = {(m, t): [] for m in MINIFICATIONS for t in TEXELS}
    for across in every:
        truth = picture(card(levels, size, across, many, "none"), "reflectance")
        truth = truth.reshape(size, many, size, many, 3).mean(axis=(1, 3))
        for minification, texels in ways:
            image = picture(card(levels, size, across, 1, minification), texels)
            error = float(np.linalg.norm(image - truth) / np.linalg.norm(truth))
            ways[minification, texels].append(percent(error))
    cards = {m: card(levels, 512 if size > 8 else size, 2, 1, m) for m in MINIFICATIONS}
    frames = {f"{m}, {t}": functools.partial(cards[m].by(texels=t).under, sky_alone) for m, t in ways}
    times = interleaved(frames, RUNS)
    first = times[next(iter(frames))]
    rows = [
        [f"{minification}, {texels}", *errors, f"{times[f'{minification}, {texels}'].over(first):.2f}"]
        for (minification, texels), errors in ways.items()
    ]
    report.text(f"**{name[0].upper()}{name[1:]}**, by texels across a pixel; time of a frame under the environment:")
    report.table(["coarser texels, between texels", *(f"{across:g}" for across in every), "time"], rows)


def card(levels, size: int, across: float, many: int, minification: Minification) -> Frame:
    """A view of a card on which a pixel of `size` is so many texels wide in the middle, `many` rays to its side.

    The map repeats, as often as it takes: eye and lamp, whose mirror image is in the middle, are the same for all.
    """
    from jaxrelight import Camera, Part, Prefiltered, Scene, plane, prepare
    from jaxrelight.brdf.files.sbrdf import spatial
    from jaxrelight.lighting.prefiltered import PrefilteredRelighter

    mesh, fov = plane((8, 8), 1), 30.0
    assert mesh.uv is not None
    pixel = 2 * np.tan(np.radians(fov) / 2) * np.linalg.norm(EYE) / size
    mesh = dataclasses.replace(mesh, uv=mesh.uv * (8 * across / pixel / levels[0].lobes.shape[0]))
    camera = Camera(EYE, (0.0, 0.0, 0.0), fov_y=fov, width=size * many, height=size * many)
    scene = Scene([Part(mesh, "card")], {"card": spatial(levels)}, camera)
    relighter = prepare(scene, Prefiltered(minification=minification, occlusion_resolution=0))
    assert isinstance(relighter, PrefilteredRelighter)
    return Frame(relighter, relighter.view())


if __name__ == "__main__":
    main()
