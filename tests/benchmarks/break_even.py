"""After how many frames a precomputation has paid for itself, against Mitsuba at equal error.

Frames are direct light of the bunny on its floor under a sky that changes. Mitsuba 3 is none of this project's
packages: `pip install mitsuba`; its LLVM variant needs a libLLVM that DRJIT_LIBLLVM_PATH names.
"""

import argparse
import dataclasses
import importlib.util
import math
import pathlib
import sys
import tempfile
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from tests.benchmarks.measuring import Report, answer, interleaved, percent, run_child, shared

MODULE = "tests.benchmarks.break_even"
SKIES = {"Grace": "grace_latlong.exr", "Uffizi": "probulator_uffizi.hdr"}
WAYS = "all", "adaptive"
# Largest ratio of the frames until it pays, adaptive rays over all rays.
TARGET = 0.6
# Mean ratios of pictures further from 1 than this would be other scenes, not errors.
SAME = 0.03
VARIANTS = "llvm_ad_rgb", "scalar_rgb"
# What light a path of one bounce gets, and how samples are spread: for each sky the fastest at equal error is taken.
INTEGRATORS: dict[str, tuple[dict[str, Any], str]] = {
    "path": ({"type": "path", "max_depth": 2}, "independent"),
    "path, multijitter": ({"type": "path", "max_depth": 2}, "multijitter"),
    "1 light sample, multijitter": ({"type": "direct", "emitter_samples": 1, "bsdf_samples": 0}, "multijitter"),
    "4 light samples, multijitter": ({"type": "direct", "emitter_samples": 4, "bsdf_samples": 0}, "multijitter"),
    "4 + 1 samples, multijitter": ({"type": "direct", "emitter_samples": 4, "bsdf_samples": 1}, "multijitter"),
}
REFERENCE = "4 light samples, multijitter"
# Samples of the trials from which the fastest is chosen, those of a pass of the reference, and the most that are tried.
TRIALS, PASS, MOST = (16, 64), 1024, 2**15
# Frames are timed up to three times, and no more after so many seconds.
TIMED = 20
# Paths that Mitsuba holds in memory at once.
PATHS = 2**25


@dataclasses.dataclass(frozen=True)
class Size:
    """What is rendered: pixels along a side, samples of the reference, and the cube map's resolution."""

    side: int
    samples: int
    resolution: int


SIZES = Size(256, 2048, 64), Size(512, 1024, 64)
QUICK = (Size(48, 256, 8),)


def main():
    parser = argparse.ArgumentParser(prog=f"python -m {MODULE}", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="a small case; RESULTS.md is left as it is")
    parser.add_argument("--folder", type=pathlib.Path, help="keep stores and pictures here, and take those there are")
    parser.add_argument("--only", choices=SKIES, help="one of the skies; RESULTS.md is left as it is")
    parser.add_argument("--child", choices=("precompute", "ours", "speed", "theirs"), help=argparse.SUPPRESS)
    parser.add_argument("--name", default="", help=argparse.SUPPRESS)
    parser.add_argument("--variant", choices=VARIANTS, help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    quick, sizes = arguments.quick, QUICK if arguments.quick else SIZES
    match arguments.child:
        case "precompute":
            answer(
                _precomputed(
                    arguments.folder / arguments.name, arguments.name.split("-")[0], sizes[0].resolution, quick
                )
            )
        case "ours":
            answer(_ours(arguments.folder, sizes, quick))
        case "speed":
            answer(_speed(arguments.variant, sizes[0].side, quick))
        case "theirs":
            answer(_theirs(arguments.folder, arguments.name, arguments.variant, sizes, quick))
        case _:
            shared("data", "mesh")
            skies = [arguments.only] if arguments.only else list(SKIES)[: 1 if quick else None]
            parameters = (
                f"bunny on its floor, Lambert, vertices as receivers, resolution {sizes[0].resolution}, direct light"
            )
            with (
                Report("break_even", "Break-even", parameters, not (quick or arguments.only)) as report,
                tempfile.TemporaryDirectory() as temporary,
            ):
                folder = (arguments.folder or pathlib.Path(temporary)).resolve()
                folder.mkdir(parents=True, exist_ok=True)
                measure(report, folder, skies, sizes, quick)
                report.speed()


def measure(report: Report, folder: pathlib.Path, skies: list[str], sizes: tuple[Size, ...], quick: bool):
    """Precomputes, draws pictures, lets Mitsuba search for the same error, and reports."""

    def child(what: str, *dials: str) -> dict:
        return run_child(MODULE, "--child", what, "--folder", str(folder), *dials, *(["--quick"] if quick else []))

    made: dict[str, list[dict]] = {way: [] for way in WAYS}
    for turn in range(1 if quick else 3):
        for way, runs in made.items():
            runs.append(child("precompute", "--name", f"{way}-{turn}"))
            print(f"rays {way}: {runs[-1]['wall']:.1f} s", flush=True)
    best = {way: min(run["wall"] for run in runs) for way, runs in made.items()}
    ratios = [few["wall"] / every["wall"] for every, few in zip(made["all"], made["adaptive"], strict=True)]
    report.text(
        "**Precomputation**, in new processes and stores, in turns: seconds of the whole call, "
        f"{len(ratios)} of each. The ratios in turn are {', '.join(f'{ratio:.2f}' for ratio in ratios)}."
    )
    rows = [[way, *(f"{run['wall']:.1f} s" for run in made[way]), f"{best[way]:.1f} s"] for way in WAYS]
    report.table(["rays", *(f"turn {turn + 1}" for turn in range(len(ratios))), "best"], rows)
    if importlib.util.find_spec("mitsuba") is None:
        report.text("Mitsuba is not installed: frames are not compared.")
        return
    ours = child("ours")
    speeds = {}
    for variant in VARIANTS[: 1 if quick else None]:
        try:
            speeds[variant] = child("speed", "--variant", variant)["rate"]
        except RuntimeError:
            report.text(f"Mitsuba's variant {variant} does not run here, and is left out.")
    if not speeds:
        return
    variant = max(speeds, key=speeds.__getitem__)
    rates = ", ".join(f"{name} {rate / 1e6:.2f} million samples a second" for name, rate in speeds.items())
    report.text(f"**Mitsuba's variants**, one light sample, all cores: {rates}; {variant} is taken.")
    rows, trials = [], []
    for sky in skies:
        told = child("theirs", "--name", sky, "--variant", variant)
        trials += [[f"{sky}, {name}", *cells] for name, cells in told["trials"].items()]
        rows += [_row(sky, size, told, told["sizes"][str(size.side)], ours, best) for size in sizes]
    report.text(
        f"**Ways of Mitsuba's to sample**, {sizes[0].side}²: trimmed error by samples a pixel, and the seconds that "
        "the error of ours would take by the line through both; the shortest is taken."
    )
    report.table(["sky, way", *(f"{count} samples" for count in TRIALS), "seconds"], trials)
    report.text(
        "**Break-even.** Errors are against Mitsuba's picture of many samples, trimmed, over pixels that surfaces "
        "cover whole; behind them the mean of ours over that of the reference, and what the reference itself is off, "
        "from its two halves, which adds to both sides' errors alike. Mitsuba's samples are searched for by powers of "
        "two, with lines between them in logarithms; its frame is timed warm, in its fastest variant and way, with its "
        "light as it was, and ours is a turned sky: light, shading, and the picture as an array of the host. The "
        "frames until it pays are the precomputation's seconds over what a frame of ours saves (target: those of "
        "adaptive rays are at most "
        f"{TARGET:g} of those of all rays)."
    )
    heads = ["sky, size", "error: all", "adaptive", "mean ratio", "reference off", "Mitsuba's samples", "its frame"]
    report.table([*heads, "our frame", "faster", "frames: all", "adaptive", "ratio"], rows)


def _row(sky: str, size: Size, told: dict, theirs: dict, ours: dict, best: dict[str, float]) -> list[str]:
    """What is reported of a sky at a size."""
    frames, seconds = {}, {way: ours["seconds"][f"{way} {size.side}"] for way in WAYS}
    for way in WAYS:
        saved = theirs["seconds"][way] - seconds[way]
        frames[way] = best[way] / saved if saved > 0 else math.inf
    if all(map(math.isfinite, frames.values())):
        reached = [f"{frames[way]:.1f}" for way in WAYS] + [f"{frames['adaptive'] / frames['all']:.2f}"]
    else:
        reached = ["never: Mitsuba is faster", "never: Mitsuba is faster", "–"]
    ratio = theirs["mean_ratio"]
    return [
        f"{sky}, {size.side}²",
        *(percent(theirs["errors"][way]) for way in WAYS),
        f"{ratio:.4f}" + ("" if abs(ratio - 1) <= SAME else " (not the same scene!)"),
        percent(theirs["noise"]),
        f"{theirs['samples']['adaptive']:.0f} ({told['way']})",
        f"{theirs['seconds']['adaptive']:.3f} s",
        f"{seconds['adaptive'] * 1e3:.1f} ms",
        f"{theirs['seconds']['adaptive'] / seconds['adaptive']:.0f}×",
        *reached,
    ]


# Ours


def _scene(quick: bool):
    """The bunny on its floor; something smaller for a trial."""
    import jaxrelight as jr

    return jr.scene_of_mesh(shared("data", "mesh", "spot.obj" if quick else "bunny_mitsuba.ply"))


def _precomputed(folder: pathlib.Path, way: str, resolution: int, quick: bool) -> dict:
    """Seconds of the whole call; those of before where the folder is there already."""
    import jaxrelight as jr
    from jaxrelight.precomputation.precompute import precompute

    kept = folder.with_suffix(".txt")
    if not kept.exists():
        if folder.exists():
            raise SystemExit(f"{folder} is half made; this measures fresh stores, so remove it")
        scene = _scene(quick)
        start = time.perf_counter()
        precompute(scene, jr.Transport("vertices", resolution=resolution, rays=way), folder)  # pyright: ignore[reportArgumentType]
        kept.write_text(str(time.perf_counter() - start))
    return {"wall": float(kept.read_text())}


def _ours(folder: pathlib.Path, sizes: tuple[Size, ...], quick: bool) -> dict:
    """Seconds of a frame of both stores, whose pictures are left in the folder."""
    import jaxrelight as jr

    relighters = {way: jr.open_store(folder / f"{way}-0") for way in WAYS}
    lights = {sky: jr.load_environment(shared("data", "env", file)) for sky, file in SKIES.items()}
    turns = iter(np.random.default_rng(0).uniform(0, 360, 10_000))
    seconds: dict[str, float] = {}
    for size in sizes:
        sides = {}
        for way, relighter in relighters.items():
            camera = dataclasses.replace(relighter.camera, width=size.side, height=size.side)
            view: Any = relighter.view(camera)
            for sky, light in lights.items():
                picture = relighter.shade(relighter.light(light), view).rgba()
                np.save(_picture(folder, way, sky, size), picture)

            def frame(relighter: Any = relighter, view: Any = view):
                light = lights["Grace"].with_(rotate_y=float(next(turns)))
                return relighter.shade(relighter.light(light), view).rgba()

            sides[f"{way} {size.side}"] = frame
        seconds |= {name: timing.median for name, timing in interleaved(sides, 3 if quick else 21).items()}
    return {"seconds": seconds}


def _picture(folder: pathlib.Path, way: str, sky: str, size: Size) -> pathlib.Path:
    return folder / f"{way}_{sky}_{size.side}.npy"


# Mitsuba's


class Rendered:
    """The same scene in Mitsuba.

    Args:
        variant: of Mitsuba.
        sky: its name.
        side: pixels along each side.
        way: one of `INTEGRATORS`.
        quick: whether it is a trial.
        as_file: whether the sky's pixels are left as they are. Mitsuba's rows span one less than there are, so that
            pixels are repeated until that shift is negligible wherever pictures are compared; frames are timed without.
    """

    def __init__(self, variant: str, sky: str, side: int, way: str, quick: bool, as_file: bool = False):
        import mitsuba as mi  # pyright: ignore[reportMissingImports]

        import jaxrelight as jr

        if mi.variant() != variant:
            mi.set_variant(variant)
        # Warnings go to where the answer is expected.
        mi.set_log_level(mi.LogLevel.Error)
        scene, (integrator, sampler) = _scene(quick), INTEGRATORS[way]
        pixels = np.asarray(jr.load_environment(shared("data", "env", SKIES[sky])).pixels)
        repeated = 1 if as_file else -(-2048 // len(pixels))
        pixels = np.ascontiguousarray(pixels.repeat(repeated, axis=0).repeat(repeated, axis=1), np.float32)
        camera, self._way, self._mi, self._side = scene.camera, (integrator, sampler), mi, side
        film = {"type": "hdrfilm", "width": side, "height": side, "component_format": "float32"}
        self._sensor = {
            "type": "perspective",
            "fov": camera.fov_y,
            "fov_axis": "y",
            "near_clip": 1e-3,
            "far_clip": 1e4,
            "to_world": mi.ScalarTransform4f().look_at(camera.origin, camera.target, camera.up),
            "film": film | {"pixel_format": "rgb", "rfilter": {"type": "box"}},
        }
        things: dict[str, Any] = {"type": "scene", "sky": {"type": "envmap", "bitmap": mi.Bitmap(pixels)}}
        for number, part in enumerate(scene.parts):
            things[f"mesh{number}"] = self._mesh(f"mesh{number}", part.mesh, scene.materials[part.material])
        self._scene = mi.load_dict(things)

    def _mesh(self, name: str, mesh, material):
        mi = self._mi
        properties = mi.Properties()
        albedo = {"type": "rgb", "value": np.asarray(material.diffuse).tolist()}
        properties["bsdf"] = mi.load_dict({"type": "diffuse", "reflectance": albedo})
        made = mi.Mesh(name, len(mesh.vertices), len(mesh.faces), has_vertex_normals=True, props=properties)
        parameters = mi.traverse(made)
        parameters["vertex_positions"] = mesh.vertices.astype(np.float32).ravel()
        parameters["vertex_normals"] = mesh.normals.astype(np.float32).ravel()
        parameters["faces"] = mesh.faces.astype(np.uint32).ravel()
        parameters.update()
        return made

    def picture(self, samples: int, seed: int = 0) -> np.ndarray:
        """A picture of so many samples a pixel, a power of two."""
        integrator, sampler = self._way
        at_once = 2 ** int(math.log2(max(1, PATHS // self._side**2)))
        passes = {"samples_per_pass": at_once} if at_once < samples else {}
        made = self._mi.load_dict({**integrator, **passes})
        sensor = self._mi.load_dict({**self._sensor, "sampler": {"type": sampler, "sample_count": samples}})
        return np.array(self._mi.render(self._scene, integrator=made, sensor=sensor, spp=samples, seed=seed))

    def seconds(self, samples: int) -> float:
        """Of a frame, the median of three or fewer, warm."""
        self.picture(min(samples, TRIALS[0]))
        times: list[float] = []
        while len(times) < 3 and sum(times) < TIMED:
            start = time.perf_counter()
            self.picture(samples, seed=len(times))
            times.append(time.perf_counter() - start)
        return float(np.median(times))


def _speed(variant: str, side: int, quick: bool) -> dict:
    """Samples a second of a variant, under Grace."""
    samples = 4 if quick else 64
    rendered = Rendered(variant, "Grace", side, "1 light sample, multijitter", quick, as_file=True)
    return {"rate": samples * side**2 / rendered.seconds(samples)}


def _theirs(folder: pathlib.Path, sky: str, variant: str, sizes: tuple[Size, ...], quick: bool) -> dict:
    """At every size the samples, and seconds a frame, of the errors that our pictures have."""
    told: dict[str, Any] = {"sizes": {}}
    way, start = "", TRIALS[-1]
    for size in sizes:
        halves = _reference(folder, sky, variant, size, quick)
        alpha = np.load(_picture(folder, "all", sky, size))[..., 3:]
        reference = np.concatenate([halves.mean(axis=0), alpha], axis=-1)
        pictures = {way: np.load(_picture(folder, way, sky, size)) for way in WAYS}
        errors = {way: _error(picture, reference) for way, picture in pictures.items()}
        noise = _error(halves[0], np.concatenate([halves[1], alpha], axis=-1)) / 2
        covered = alpha[..., 0] > 0.999
        ratio = float(pictures["adaptive"][covered][:, :3].mean() / reference[covered][:, :3].mean())
        _say(f"{sky}, {size.side}²: errors {errors}, mean ratio {ratio:.4f}, reference off {noise:.4f}")
        if not way:
            way, told["trials"] = _fastest(variant, sky, size, reference, errors["adaptive"], quick)
        rendered = Rendered(variant, sky, size.side, way, quick)

        def error_of(samples: int, rendered=rendered, reference=reference) -> float:
            error = _error(rendered.picture(samples, seed=1000 + samples), reference)
            _say(f"{sky}: {samples} samples, {error:.4f}")
            return error

        samples, seconds, start = {}, {}, start
        known: dict[int, float] = {}
        timed = Rendered(variant, sky, size.side, way, quick, as_file=True)
        times: dict[int, float] = {}
        for name in WAYS:
            samples[name], few, many = _search(error_of, errors[name], start, known)
            start = few
            for count in {few, many} - times.keys():
                times[count] = timed.seconds(count)
                _say(f"{sky}: {count} samples, {times[count]:.3f} s")
            share = (samples[name] - few) / (many - few) if many > few else 0.0
            seconds[name] = times[few] + share * (times[many] - times[few])
        told["sizes"][size.side] = {
            "errors": errors,
            "noise": noise,
            "mean_ratio": ratio,
            "samples": samples,
            "seconds": seconds,
        }
    return told | {"way": way}


def _reference(folder: pathlib.Path, sky: str, variant: str, size: Size, quick: bool) -> np.ndarray:
    """Two halves of a picture of many samples."""
    path = folder / f"reference_{sky}_{size.side}.npy"
    if not path.exists():
        rendered = Rendered(variant, sky, size.side, REFERENCE, quick)
        samples = min(PASS, size.samples // 2)
        passes, halves = size.samples // samples, [np.zeros((size.side, size.side, 3)) for _ in range(2)]
        for number in range(passes):
            halves[number % 2] += rendered.picture(samples, seed=5000 + number) / (passes // 2)
            _say(f"reference of {sky}, {size.side}²: {number + 1} of {passes}")
        np.save(path, np.stack(halves))
    return np.load(path)


def _fastest(
    variant: str, sky: str, size: Size, reference: np.ndarray, error: float, quick: bool
) -> tuple[str, dict[str, list[str]]]:
    """The way that takes the fewest seconds to an error, by lines in logarithms; what was found of each."""
    expected, cells = {}, {}
    for way in list(INTEGRATORS)[:: 3 if quick else 1]:
        rendered = Rendered(variant, sky, size.side, way, quick)
        errors = [_error(rendered.picture(count, seed=100 + count), reference) for count in TRIALS]
        seconds = rendered.seconds(TRIALS[-1])
        slope = math.log(errors[1] / errors[0]) / math.log(TRIALS[1] / TRIALS[0])
        # Samples that do not depend on each other have half a power, and stratified ones no more than one.
        expected[way] = seconds * (error / errors[1]) ** (1 / min(max(slope, -1.0), -0.5))
        cells[way] = [*map(percent, errors), f"{expected[way]:.2f}"]
        _say(f"{sky}, {way}: {', '.join(cells[way])}")
    return min(expected, key=expected.__getitem__), cells


def _search(
    error_of: Callable[[int], float], error: float, start: int, known: dict[int, float]
) -> tuple[float, int, int]:
    """Samples of an error, between the powers of two that bracket it; the same number twice at an end of the range.

    Args:
        error_of: of a number of samples.
        error: to be had.
        start: where the search begins.
        known: errors by samples, which are not measured again, and to which others are added.
    """

    def of(samples: int) -> float:
        if samples not in known:
            known[samples] = error_of(samples)
        return known[samples]

    many = start
    # A guess by half a power; then step by step.
    if of(many) > error:
        many = 2 ** round(math.log2(min(MOST, max(many, many * (of(many) / error) ** 1.6))))
    while of(many) > error and many < MOST:
        many *= 2
    while many > 1 and of(many // 2) <= error:
        many //= 2
    few = many // 2
    if not few or of(many) > error:
        return float(many), many, many
    share = math.log(of(few) / error) / math.log(of(few) / of(many))
    return few * 2**share, few, many


def _error(picture: np.ndarray, reference: np.ndarray) -> float:
    from jaxrelight import image_error

    return image_error(picture, reference).trimmed


def _say(line: str):
    """Progress, for who waits."""
    print(line, file=sys.stderr, flush=True)


if __name__ == "__main__":
    main()
