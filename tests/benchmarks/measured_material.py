"""One measured material on the bunny: from its table, from fits, and from factors; error and time of each."""

import argparse
import dataclasses
import pathlib
import tempfile
import time
from typing import Literal

import jax
import numpy as np

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.reflection import Reflection
from tests.benchmarks.measuring import Report, interleaved, megabytes, percent, shared
from tests.benchmarks.pictures import contact_sheet

MATERIAL = "rgl_cc_ibiza_sunset_rgb.bsdf"
LOBES, TERMS = (1, 2, 3), (4, 8, 16)
RESOLUTION, COEFFICIENTS, RUNS = 32, 128, 5


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.measured_material", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small pictures, few ways; RESULTS.md is left as it is")
    parser.add_argument("--picture", type=pathlib.Path, metavar="PNG", help="write the pictures side by side")
    arguments = parser.parse_args()
    shared("data", "brdf", MATERIAL)
    size, resolution = (64, 8) if arguments.quick else (256, RESOLUTION)
    parameters = (
        f"{MATERIAL} on the bunny, a grey floor, Grace Cathedral, {size}×{size} pixels, resolution {resolution}; "
        "relative L2, trimmed / untrimmed, against the table at every pixel with all coefficients"
    )
    with (
        Report("measured_material", "A measured material", parameters, not arguments.quick) as report,
        tempfile.TemporaryDirectory() as folder,
    ):
        measure(report, pathlib.Path(folder), size, resolution, arguments.quick, arguments.picture)
        report.speed()


def measure(
    report: Report, folder: pathlib.Path, size: int, resolution: int, quick: bool, picture: pathlib.Path | None
):
    """A row for the table, for every fit and for every number of factors."""
    from fitting import Options, fit_lafortune
    from jaxrelight import factor, image_error, load_scene
    from jaxrelight.brdf.files import load_brdf

    table = load_brdf(shared("data", "brdf", MATERIAL)).brdf
    few = 1 if quick else None
    ways = [Way("its table", table)]
    for lobes in LOBES[:few]:
        fit, seconds = _timed(lambda n=lobes: fit_lafortune(table, Options(lobes=n), hold_out=0).brdf)
        ways.append(Way("1 lobe" if lobes == 1 else f"{lobes} lobes", fit, made=seconds))
    for terms in TERMS[:few]:
        factors, seconds = _timed(lambda k=terms: factor(table, k))
        ways.append(Way(f"K = {terms}", table, factors, seconds))

    scene = load_scene(shared("reference", "bunny_phong.toml"))
    scene = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, width=size, height=size))
    first = stored(scene, ways[0], resolution, folder)
    whole = first[0].exact()
    same = whole.view()
    truth = whole.shade(whole.light(scene.lights), same).rgba()
    shown, rows = {}, []
    for way in ways:
        relighter, made = first if way is ways[0] else stored(scene, way, resolution, folder)
        floor, own = whole.transport.blocks[0], relighter.transport.blocks[1]
        uncut = whole.rebake([floor.reflection, way.factors or own.reflection])
        alone = uncut.shade(uncut.light(scene.lights), same).rgba()
        view, lit = relighter.view(), relighter.light(scene.lights)
        shown[way.name] = relighter.shade(lit, view).rgba()
        times = interleaved(
            {
                "light": lambda r=relighter: r.light(scene.lights),
                "view": lambda r=relighter, lit=lit, view=view: r.shade(lit, view),
            },
            RUNS,
        )
        errors = [image_error(image, truth) for image in (alone, shown[way.name])]
        rows.append(
            [
                f"{way.name}, {way.receivers}",
                *(f"{percent(error.trimmed)} / {percent(error.untrimmed)}" for error in errors),
                f"{way.made:.1f} s" if way.made else "",
                f"{made.seconds['transport']:.1f} s",
                megabytes(made.nbytes["transport"]),
                *(f"{1e3 * times[side].median:.1f} ms" for side in ("light", "view")),
            ]
        )
    heads = [
        "the bunny from",
        "the BRDF alone",
        f"N = {COEFFICIENTS}",
        "fit",
        "bake",
        "store",
        "next light",
        "next view",
    ]
    report.text(
        "**The BRDF alone**: at every pixel, all coefficients. **N**: as stored, fits at pixels, factors at "
        "vertices for any view. **Bake**: of all receivers from stored visibility, compiling included."
    )
    report.table(heads, rows)
    if picture:
        level = float(np.quantile(truth[truth[..., 3] > 0][:, :3].mean(axis=-1), 0.95))
        contact_sheet(picture, shown, 4, -np.log2(level) - 0.3)


@dataclasses.dataclass(frozen=True)
class Way:
    """A way to write the material; `made` is the seconds it took."""

    name: str
    brdf: Brdf
    factors: Reflection | None = None
    made: float = 0.0

    @property
    def receivers(self) -> Literal["vertices", "pixels"]:
        """Factors are for receivers that know no view; the rest is baked for the view of every pixel."""
        return "vertices" if self.factors else "pixels"


def stored(scene, way: Way, resolution: int, folder: pathlib.Path):
    """(the scene precomputed with the material, what that took)."""
    from jaxrelight import Transport
    from jaxrelight.lighting.prepare import prepare_with_build
    from jaxrelight.lighting.transport import TransportRelighter

    terms = way.factors.terms if way.factors else 1
    method = Transport(way.receivers, resolution, terms=terms, coefficients=COEFFICIENTS)
    scene = dataclasses.replace(scene, materials={**scene.materials, "object": way.brdf})
    relighter, made = prepare_with_build(scene, method, folder / way.receivers)
    assert isinstance(relighter, TransportRelighter)
    assert made is not None
    return relighter, made


def _timed(make):
    start = time.perf_counter()
    made = jax.block_until_ready(make())
    return made, time.perf_counter() - start


if __name__ == "__main__":
    main()
