"""Errors that pictures report, against those of the whole pictures; and what reporting costs."""

import argparse
import collections
import dataclasses
import pathlib
import tempfile
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np

from tests.benchmarks.measuring import Report, interleaved, percent, shared

SCENES = "bunny_lambert", "bunny_phong", "spot_lafortune"
ROOMS = "room_point", "room_spot", "room_glossy"
SKIES = {
    "Grace": "grace_latlong.exr",
    "Venice": "pmndrs_venice.exr",
    "sunset": "blender_sunset.exr",
    "city": "blender_city.exr",
    "studio": "blender_studio.exr",
    "lab": "pmndrs_lab.exr",
    "Uffizi": "probulator_uffizi.hdr",
    "Mitsuba": "mitsuba_principled_envmap.hdr",
}
# Dials by method, in words.
WAYS: dict[str, tuple[str, dict[str, Any]]] = {
    "vertices": ("Transport", {"receivers": "vertices"}),
    "vertices, 4 factors": ("Transport", {"receivers": "vertices", "reflection": "factors"}),
    "vertices, 32 coefficients": ("Transport", {"receivers": "vertices", "coefficients": 32}),
    "pixels": ("Transport", {}),
    "pixels, 32 coefficients": ("Transport", {"coefficients": 32}),
    "prefiltered": ("Prefiltered", {}),
    "prefiltered, no occlusion": ("Prefiltered", {"occlusion_resolution": 0}),
    "adaptive, 0.02": ("Adaptive", {"tolerance": 0.02}),
    "adaptive, 0.005": ("Adaptive", {"tolerance": 0.005}),
}
# To be covered.
TRIMMED, UNTRIMMED = 0.92, 0.85
RUNS = 5


class Case(NamedTuple):
    """One picture: what it was, what was expected before it was shaded, what it reports, and what is true."""

    way: str
    expected: Any
    reported: Any
    trimmed: float
    untrimmed: float

    def is_inside(self, name: str) -> bool:
        """Whether an interval holds the true error."""
        interval = getattr(self.reported, name)
        return interval.low <= getattr(self, name) <= interval.high


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.picture_error", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two scenes, two skies, small pictures, resolution 16")
    parser.add_argument("--folder", type=pathlib.Path, help="keep the stores here and reuse them")
    parser.add_argument("--only", choices=("errors", "times"), help="one of the sections")
    arguments = parser.parse_args()
    quick = arguments.quick
    shared("reference")
    side, resolution = (32, 16) if quick else (96, 64)
    ways = list(WAYS)[:: 4 if quick else 1]
    with tempfile.TemporaryDirectory() as temporary:
        folder = arguments.folder or pathlib.Path(temporary)
        write = not (quick or arguments.folder)
        if arguments.only != "times":
            skies = dict(list(SKIES.items())[: 2 if quick else None])
            parameters = f"{side}² pixels, of which 256 are compared; resolution {resolution}; {len(skies)} skies"
            with Report("picture_error", "Errors that pictures report", parameters, write) as report:
                scenes, rooms = (SCENES[:1], ROOMS[:1]) if quick else (SCENES, ROOMS)
                cases = [
                    case for name in scenes for case in of_scene(name, skies, side, resolution, folder / name, ways)
                ]
                cases += [case for name in rooms for case in of_room(name, side // 2, folder / name)]
                tell(report, cases)
        if arguments.only != "errors":
            side = 64 if quick else 256
            title, parameters = "The time that errors of pictures take", f"bunny_phong, {side}² pixels"
            with Report("picture_error", title, parameters, write, part="_times") as report:
                costs(report, resolution, side, folder / "bunny_phong", ways)
                report.speed()


def _scene(name: str, side: int):
    import jaxrelight as jr

    scene = jr.load_scene(shared("reference", f"{name}.toml"))
    return dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, width=side, height=side))


def _methods(resolution: int) -> dict[str, Any]:
    import jaxrelight as jr

    methods = {}
    for way, (name, dials) in WAYS.items():
        own = {"resolution": resolution, **dials} if name == "Transport" else dials
        methods[way] = getattr(jr, name)(**own)
    return methods


def of_scene(
    name: str, skies: dict[str, str], side: int, resolution: int, folder: pathlib.Path, ways: list[str]
) -> list[Case]:
    """Pictures of a scene under skies, by all methods that light by one.

    Transport and prefiltered lighting are compared with exact transport of all pixels by twice the resolution, and
    adaptive lighting with many samples of all pixels.
    """
    import jaxrelight as jr

    scene, cases = _scene(name, side), []
    lights = {sky: jr.load_environment(shared("data", "env", file)) for sky, file in skies.items()}
    truth = jr.prepare(scene, jr.Transport("pixels", resolution=2 * resolution, coefficients="all"), folder)
    view = truth.view()
    exact = {sky: truth.shade(truth.light(light), view).rgba() for sky, light in lights.items()}
    for way, method in _methods(resolution).items():
        if way not in ways:
            continue
        stored = isinstance(method, jr.Transport)
        relighter = jr.prepare(scene, method, folder if stored else None)
        view = relighter.view()
        for sky, light in lights.items():
            lit = relighter.light(light)
            expected = None if isinstance(method, jr.Adaptive) else relighter.expected_error(lit, view)
            image = relighter.shade(lit, view)
            reported = image.error
            if isinstance(method, jr.Adaptive):
                whole: Any = image.measure(side**2)
                true = whole.trimmed.value, whole.untrimmed.value
            else:
                error = jr.image_error(image.rgba(), exact[sky])
                true = error.trimmed, error.untrimmed
            cases.append(Case(way, expected, reported, *true))
    return cases


def of_room(name: str, side: int, folder: pathlib.Path) -> list[Case]:
    """Pictures of a room by indirect lighting, under its own lamp and others: against the same of all pixels."""
    import jaxrelight as jr

    scene, cases = _scene(name, side), []
    for samples in 1024, 4096:
        relighter = jr.prepare(scene, jr.Indirect(gather_samples=samples, bounces=2), folder)
        view = relighter.view()
        for number in range(3):
            more = [jr.point([0.2 * number, 0.5, 0.1], 1.0 + number)] if number else []
            lit = relighter.light([*scene.lights.local, *more])
            expected, image = relighter.expected_error(lit, view), relighter.shade(lit, view)
            whole: Any = image.measure(side**2)
            cases.append(Case("indirect", expected, image.error, whole.trimmed.value, whole.untrimmed.value))
    return cases


def tell(report: Report, cases: list[Case]):
    """How often intervals hold the true error, by method."""
    by_way = collections.defaultdict(list)
    for case in cases:
        by_way[case.way].append(case)
    rows = []
    for way, own in [*by_way.items(), ("all", cases)]:
        inside = [float(np.mean([case.is_inside(name) for case in own])) for name in ("trimmed", "untrimmed")]
        ratio = [case.reported.trimmed.value / max(case.trimmed, 1e-12) for case in own]
        true = [case.trimmed for case in own]
        width = [(case.reported.trimmed.high - case.reported.trimmed.low) / case.reported.trimmed.value for case in own]
        spread = " … ".join(f"{value:.2f}" for value in np.quantile(ratio, [0.05, 0.5, 0.95]))
        span = f"{percent(min(true))} … {percent(max(true))}"
        close = [_far_off(case) for case in own if case.expected is not None]
        expected = [percent(float(np.mean(np.array(close) <= times))) if close else "" for times in (1.5, 3)]
        rows.append([way, len(own), span, *map(percent, inside), spread, percent(float(np.median(width))), *expected])
    report.text(
        f"The interval is to hold the error of the whole picture in {percent(TRIMMED)} of the cases trimmed, and in "
        f"{percent(UNTRIMMED)} untrimmed. The ratio is of the reported to the true trimmed error, at 5, 50 and 95 % of "
        "the cases; the width is of the interval, as a share of the reported error. True are whole pictures against "
        "exact transport with four times the texels and rays, against many samples of all pixels for adaptive "
        "lighting, and against all links of all pixels for indirect lighting. Expected is the trimmed error before a "
        "picture is shaded, which is to be within 1.5 times of the true one in 80 % of the cases, and within 3 in 98 %."
    )
    inside = "trimmed inside", "untrimmed inside"
    expected = "expected within 1.5×", "within 3×"
    report.table(["way", "cases", "true, trimmed", *inside, "ratio", "width", *expected], rows)


def _far_off(case: Case) -> float:
    """How many times as large as the true error the expected one is, or the other way round."""
    ratio = max(case.expected.trimmed.value, 1e-12) / max(case.trimmed, 1e-12)
    return max(ratio, 1 / ratio)


def costs(report: Report, resolution: int, side: int, folder: pathlib.Path, ways: list[str]):
    """Seconds of an error, once a view and once a light."""
    import jaxrelight as jr

    scene, rows = _scene("bunny_phong", side), []
    light = jr.load_environment(shared("data", "env", SKIES["Grace"]))
    for way, method in _methods(resolution).items():
        if way not in ways or ("," in way and not way.startswith("adaptive, 0.02")):
            continue
        relighter = jr.prepare(scene, method, folder if isinstance(method, jr.Transport) else None)
        lit, seconds = relighter.light(light), []
        # Once to compile.
        for _ in range(3):
            view = relighter.view()
            image = relighter.shade(lit, view)
            start = time.perf_counter()
            image.error  # noqa: B018
            seconds.append(time.perf_counter() - start)
        others = []
        for turn in range(1, RUNS + 1):
            turned = relighter.light(light.with_(rotate_y=30.0 * turn))
            image = relighter.shade(turned, view)
            start = time.perf_counter()
            relighter.error(image, turned, view)
            others.append(time.perf_counter() - start)
        run: dict[str, Callable] = {"again": lambda r=relighter, lit=turned, view=view, i=image: r.error(i, lit, view)}
        if not isinstance(method, jr.Adaptive):
            run["expected"] = lambda r=relighter, lit=turned, view=view: r.expected_error(lit, view)
        again = interleaved(run, RUNS)
        told = (f"{again[name].median:.3f} s" if name in again else "" for name in ("again", "expected"))
        rows.append([way, f"{min(seconds[1:]):.2f} s", f"{np.median(others):.3f} s", *told])
    report.text("To be reached are 0.6 s once a view, and 0.1 s a light.")
    first = "once a view, the first light with it"
    report.table(["way", first, "another light", "the same again", "expected before a picture"], rows)


if __name__ == "__main__":
    main()
