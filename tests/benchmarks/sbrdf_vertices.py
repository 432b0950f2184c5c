"""A spatial BRDF in transport: vertices with filtered lobes or shared factors, against every pixel's own lobes."""

import argparse
import dataclasses
import pathlib
import tempfile

from tests.benchmarks.measuring import Report, interleaved, megabytes, percent, shared

# With the trimmed errors that filtered lobes are to reach.
SKIES = {"grace_latlong.exr": 0.04, "pmndrs_venice.exr": 0.05}
TERMS = 4, 16, 48
RESOLUTION, COEFFICIENTS, EDGE, RUNS = 32, 256, 0.02, 5


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.sbrdf_vertices", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="small maps and pictures; RESULTS.md is left as it is")
    quick = parser.parse_args().quick
    shared("data", "mesh", "spot_texture.png")
    side, size, edge, resolution = (8, 48, 0.1, 8) if quick else (256, 256, EDGE, RESOLUTION)
    parameters = (
        f"spot with {side}² texels of six materials, edges of at most {edge}, {size}² pixels, resolution {resolution}, "
        f"{COEFFICIENTS} coefficients; relative L2 against pixel receivers with all coefficients, trimmed / untrimmed"
    )
    with Report("sbrdf_vertices", "Spatial BRDFs at vertices", parameters, not quick) as report:
        measure(report, side, size, edge, resolution, TERMS[:1] if quick else TERMS)
        report.speed()


def measure(report: Report, side: int, size: int, edge: float, resolution: int, terms: tuple[int, ...]):
    """A row for every number of terms."""
    from jaxrelight import Transport, image_error, load_environment, subdivided
    from jaxrelight.lighting.prepare import prepare_with_build
    from tests.benchmarks.composed_cow import compose, cow, materials

    scene = cow([compose(materials(side), side)], size)
    alone = dataclasses.replace(scene.parts[0], mesh=subdivided(scene.parts[0].mesh, edge))
    scene = dataclasses.replace(scene, parts=[alone], lights=())
    skies = [load_environment(shared("data", "env", name)) for name in SKIES]
    ways = {"pixels": Transport("pixels", resolution, coefficients="all")}
    for reflection in "filtered", "traced":
        ways[reflection] = Transport("vertices", resolution, reflection=reflection, coefficients=COEFFICIENTS)
    for count in terms:
        ways[f"K = {count}"] = Transport(
            "vertices", resolution, reflection="factors", terms=count, coefficients=COEFFICIENTS, factor_resolution=48
        )
    truth, rows = [], []
    for name, method in ways.items():
        with tempfile.TemporaryDirectory() as folder:
            relighter, made = prepare_with_build(scene, method, pathlib.Path(folder))
            assert made is not None
            view, lit = relighter.view(), relighter.light(skies[0])
            pictures = [relighter.shade(relighter.light(sky), view).rgba() for sky in skies]
            if not truth:
                truth = pictures
                continue
            for note in made.notes:
                report.text(f"{name}: {note}.")
            sides = {
                "light": lambda r=relighter: r.light(skies[0]),
                "view": lambda r=relighter, lit=lit, view=view: r.shade(lit, view),
            }
            times = interleaved(sides, RUNS)
            errors = [image_error(one, other) for one, other in zip(pictures, truth, strict=True)]
            rows.append(
                [
                    name,
                    *(f"{percent(error.trimmed)} / {percent(error.untrimmed)}" for error in errors),
                    f"{made.seconds['transport']:.1f} s",
                    *(megabytes(made.nbytes.get(kind, 0)) for kind in ("factors", "filtered", "transport")),
                    *(f"{1e3 * times[side].median:.1f} ms" for side in ("light", "view")),
                ]
            )
    skies_named = [name.split(".")[0] for name in SKIES]
    targets = " and ".join(percent(target) for target in SKIES.values())
    report.text(f"Filtered lobes are to reach {targets}, trimmed. A next view is of shading; its rays come first.")
    heads = ["reflection", *skies_named, "factors and bake", "factors", "filtered", "store", "next light", "next view"]
    report.table(heads, rows)


if __name__ == "__main__":
    main()
