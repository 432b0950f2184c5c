"""Adaptive shading against the best uniform one, as many filtered samples in every pixel: time at equal quality."""

import argparse
import dataclasses
import tempfile
import time
from collections.abc import Callable, Sequence

import jax
import numpy as np
from jaxtyping import Bool

import jaxrelight as jr
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.tabulated import Tabulated
from jaxrelight.geometry.mesh import transformed
from jaxrelight.images import srgb_encode
from jaxrelight.images.tone import to_unit
from jaxrelight.lighting.adaptive.planning import Plan
from jaxrelight.lighting.adaptive.relighter import AdaptiveRelighter
from jaxrelight.lighting.direct_light import shade_lights
from jaxrelight.lighting.shadows import all_visible, trace_visibility
from tests.benchmarks.measuring import Report, percent, shared

MESHES = {"bunny": "bunny_mitsuba.ply", "dragon": "dragon_vrip_res2_bin.ply", "spot": "spot.obj"}
MATERIALS = "RGL paint", "MERL surrogate", "two lobes"
# The quality is that of so many samples of single texels in every pixel; how many times as many what stands for the
# truth has, filtered and with another seed.
BASELINE, TRUTH, SEED = 1024, 2, 7
# Tolerances are tried in eighths of an octave, so many on both sides of the quality.
_STEPS = 12
# Of displayed brightness 1: this quantile of the picture's radiance.
WHITE = 0.97
SCENE = """
[camera]
origin = [0, 0.75, 2.2]
target = [0, 0.45, 0]
fov_y = 30
width = {size}
height = {size}
[environment]
file = "{environment}"
[material.any]
type = "lambert"
albedo = 0.5
[[mesh]]
file = "{mesh}"
normalize = 1.0
material = "any"
"""


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.adaptive", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one small picture; RESULTS.md is left as it is")
    parser.add_argument("--meshes", nargs="+", choices=MESHES, default=list(MESHES), help="some of them")
    parser.add_argument("--materials", nargs="+", choices=MATERIALS, help="some of them; RESULTS.md is left as it is")
    shadows = parser.add_mutually_exclusive_group()
    shadows.add_argument("--without-shadows", action="store_true", help="those pictures alone")
    shadows.add_argument("--with-shadows", action="store_true", help="those pictures alone")
    arguments = parser.parse_args()
    quick = arguments.quick
    size, samples = (64, 256) if quick else (512, BASELINE)
    # Pictures take minutes each, so every mesh is a section of its own.
    for shaded in [False] * (not arguments.with_shadows) + [True] * (not arguments.without_shadows):
        for mesh in ["spot"] if quick else arguments.meshes:
            where = "on a floor, with shadows" if shaded else "without shadows"
            part, title = f"_{mesh}{'_shadows' * shaded}", f"Shading where bandwidth asks: {mesh}, {where}"
            parameters = f"{size}×{size}, Venice sunset, as good as {samples} samples of single texels in every pixel"
            materials = arguments.materials or (MATERIALS[-1:] if quick else MATERIALS)
            write = not quick and arguments.materials is None
            with Report("adaptive", title, parameters, write=write, part=part) as report:
                compare(report, mesh, materials, size, samples, shadows=shaded)


class Case:
    """One picture, its truth and its baseline."""

    def __init__(self, mesh: str, material: str, size: int, samples: int, *, shadows: bool):
        self.name, self.samples, self.shadows = f"{mesh}, {material}", samples, shadows
        scene = scene_of(mesh, brdf_of(material), size, floor=shadows)
        self._relighter = prepared(scene, shadows=shadows)
        self.lit, self.view = self._relighter.light(scene.lights), self._relighter.view()
        self.covered: Bool[np.ndarray, "h w"] = np.asarray(self.view.surfaces.covered)
        self.white = 1.0
        self.truth = np.asarray(self.uniform(TRUTH * samples, SEED, filtered=True))
        self.white = float(np.quantile(self.truth[self.covered].mean(axis=1), WHITE))

    def relighter(self, **dials) -> AdaptiveRelighter:
        """With this picture's white, and other dials."""
        method = dataclasses.replace(self._relighter.method, exposure=-float(np.log2(self.white)), **dials)
        return dataclasses.replace(self._relighter, method=method)

    def uniform(self, samples: int, seed: int = 0, *, filtered: bool = False):
        """The same number in every pixel."""
        relighter = self.relighter(seed=seed)
        return self._with_sun(relighter.shade_uniform(self.lit, self.view, samples, filtered=filtered))

    def adaptive(self, plan: Plan, *, filtered: bool = True):
        """The picture of a plan."""
        return self._with_sun(self.relighter().shade_plan(self.lit, self.view, plan, filtered=filtered))

    def _with_sun(self, radiance):
        """No sample finds the environment's sun, which is a light of its own."""
        surfaces, groups = self.view.surfaces, self.lit.groups
        traced = trace_visibility(surfaces.points, groups) if self.shadows else all_visible(surfaces.points, groups)
        direct = shade_lights(self._relighter.materials, surfaces, groups, traced)
        return radiance if direct is None else radiance + direct

    def baseline(self) -> tuple[float, float]:
        """Its quality and time."""
        # Compiled by a few samples, so that the long run is the one that counts.
        jax.block_until_ready(self.uniform(16))
        start = time.perf_counter()
        image = jax.block_until_ready(self.uniform(self.samples))
        seconds = time.perf_counter() - start
        return self.psnr(image), seconds

    def predicted(self, **count: int):
        """Bandwidth and noise."""
        return self._relighter.predicted(self.lit, self.view, **count)

    def plan(self, samples: float, predicted=None) -> Plan:
        """Of a budget, by what is predicted."""
        return self.relighter(samples=samples).plan(self.lit, self.view, predicted)

    def planned(self, tolerance: float) -> Plan:
        """Of a tolerance."""
        return self.relighter(tolerance=tolerance).plan(self.lit, self.view)

    def psnr(self, image) -> float:
        """Of displayed values, from 0 to 1, of covered pixels."""
        one, other = (srgb_encode(to_unit(np.asarray(x) / self.white))[self.covered] for x in (image, self.truth))
        return float(-10 * np.log10(np.mean((one - other) ** 2)))


def timed(function: Callable[[], object], runs: int = 1) -> tuple[np.ndarray, float]:
    """What a function makes, and the least seconds, compiled before."""
    image, best = jax.block_until_ready(function()), np.inf
    for _ in range(runs):
        start = time.perf_counter()
        image = jax.block_until_ready(function())
        best = min(best, time.perf_counter() - start)
    return np.asarray(image), best


def compare(report: Report, mesh: str, materials: Sequence[str], size: int, samples: int, *, shadows: bool):
    """Time, samples and pixels at equal quality (figure 11)."""
    rows = []
    for material in materials:
        case = Case(mesh, material, size, samples, shadows=shadows)
        rows.append([material, *_as_best(case)])
        # The table follows after minutes.
        print(rows[-1], flush=True)
    report.text(
        "The quality; the fewest filtered samples of every pixel that reach it, and their time: the baseline; "
        "the tolerance that reaches it, samples of a pixel on average, pixels shaded, the time with planning, how many "
        "times faster that is than the baseline, the share of the time that planning takes, and how many times faster "
        "than samples of single texels. Times are the better of two, taken in turns."
    )
    heads = [
        "picture",
        "quality",
        "uniform",
        "time",
        "tolerance",
        "samples",
        "shaded",
        "time",
        "faster",
        "plan",
        "texels",
    ]
    report.table(heads, rows)


def _as_best(case: Case) -> list[str]:
    """The best uniform shading, and the largest tolerance whose picture is as good."""
    wanted, texels = case.baseline()

    def even_is_good(samples: float) -> bool:
        return case.psnr(case.uniform(16 * round(samples / 16), filtered=True)) >= wanted

    even, error = 16 * round(first_good(even_is_good, 2 * case.samples) / 16), 10 ** (-wanted / 20)

    def tolerance(step: int) -> float:
        return error * 2 ** (step / 8)

    low, high = -_STEPS, _STEPS
    while low < high:
        middle = -((-low - high) // 2)
        good = case.psnr(case.adaptive(case.planned(tolerance(middle)))) >= wanted
        low, high = (middle, high) if good else (low, middle - 1)
    sides = []
    for _ in range(2):
        uniform = timed(lambda: case.uniform(even, filtered=True))[1]
        start = time.perf_counter()
        plan = case.planned(tolerance(low))
        planning = time.perf_counter() - start
        sides.append((uniform, planning, timed(lambda plan=plan: case.adaptive(plan))[1]))
    baseline = min(side[0] for side in sides)
    planning, shading = min((side[1:] for side in sides), key=sum)
    total, pixels = planning + shading, int(case.covered.sum())
    return [
        f"{wanted:.1f} dB",
        f"{even}",
        f"{baseline:.2f} s",
        f"{tolerance(low):.4f}",
        f"{plan.samples / pixels:.0f}",
        percent(plan.shaded / pixels),
        f"{total:.2f} s",
        f"{baseline / total:.1f}×",
        percent(planning / total),
        f"{texels / total:.1f}×",
    ]


def first_good(good: Callable[[float], bool], most: float) -> float:
    """The first number of samples that is good enough, from 16 up to the most, eight from one to twice as many."""
    low, high = 0, int(np.ceil(8 * np.log2(most / 16)))
    while low < high:
        middle = (low + high) // 2
        low, high = (low, middle) if good(16 * 2 ** (middle / 8)) else (middle + 1, high)
    return 16 * 2 ** (low / 8)


def as_good(case: Case, wanted: float, baseline: float, *, filtered: bool = True) -> list[str]:
    """The baseline, and the least budget whose picture is as good."""

    def good(budget: float) -> bool:
        return case.psnr(case.adaptive(case.plan(budget), filtered=filtered)) >= wanted

    budget = first_good(good, 2 * case.samples)
    one = _run(case, budget, filtered)
    # The machine's speed changes within minutes: the baseline between two runs, and the best time of each.
    baseline = min(baseline, case.baseline()[1])
    plan, *seconds = min(one, _run(case, budget, filtered), key=lambda run: sum(run[1:]))
    total, pixels = sum(seconds), int(case.covered.sum())
    per_sample = baseline / case.samples
    equal = case.psnr(case.uniform(max(16, round(total / per_sample / 16) * 16))) if filtered else 0.0
    return [
        f"{baseline:.1f} s, {wanted:.1f} dB",
        f"{plan.samples / pixels:.0f}",
        f"{total:.2f} s",
        f"{baseline / total:.1f}×",
        percent(plan.samples / pixels / case.samples),
        percent(plan.shaded / pixels),
        *(percent(of / total) for of in seconds[:2]),
        f"{equal:.1f} dB",
    ]


def _run(case: Case, budget: float, filtered: bool) -> tuple[Plan, float, float, float]:
    """A plan, and the seconds that prediction takes, what follows from it, and shading."""
    case.plan(budget)
    start = time.perf_counter()
    predicted = jax.block_until_ready(case.predicted())
    middle = time.perf_counter()
    plan = case.plan(budget, predicted)
    planning = time.perf_counter() - middle
    _, shading = timed(lambda: case.adaptive(plan, filtered=filtered))
    return plan, middle - start, planning, shading


def prepared(scene: jr.Scene, **dials) -> AdaptiveRelighter:
    """A relighter of the scene by some dials."""
    relighter = jr.prepare(scene, jr.Adaptive(**dials))
    assert isinstance(relighter, AdaptiveRelighter)
    return relighter


def scene_of(mesh: str, brdf: Brdf, size: int, *, floor: bool = False) -> jr.Scene:
    """A mesh in Venice, on a floor or in the air."""
    files = {"mesh": shared("data", "mesh", MESHES[mesh]), "environment": shared("data", "env", "pmndrs_venice.exr")}
    with tempfile.NamedTemporaryFile("w", suffix=".toml") as file:
        file.write(SCENE.format(size=size, **files))
        file.flush()
        scene = jr.load_scene(file.name)
    parts = [dataclasses.replace(part, material="skin") for part in scene.parts]
    if floor:
        parts.append(jr.Part(transformed(jr.plane([4, 4]), np.eye(4)), "floor"))
    return dataclasses.replace(scene, parts=parts, materials={"skin": brdf, "floor": jr.lambert(0.5)})


def brdf_of(material: str) -> Brdf:
    """One of the three."""
    if material == "RGL paint":
        return jr.load_brdf(shared("data", "brdf", "rgl_cc_ibiza_sunset_rgb.bsdf")).brdf
    if material == "two lobes":
        wide = jr.lobe([-1, -1, 1], 40, specular=np.array([1.3, 1.2, 1.1]))
        narrow = jr.lobe([-0.98, -0.98, 1], 400, peak=np.full(3, 5.8))
        return jr.lobe_sum([0.12, 0.08, 0.06], [wide, narrow])
    return _surrogate("color-changing-paint2")


def _surrogate(name: str) -> Brdf:
    """A network's values on MERL's grid: not a measurement."""
    import jax.numpy as jnp

    with np.load(shared("data", "brdf", "merl_nbrdf.npz")) as weights:
        index = [str(one) for one in weights["names"]].index(name)
        layers = [(weights[f"fc{i}"][index].astype(float), weights[f"b{i}"][index].astype(float)) for i in (1, 2, 3)]
    half = ((np.arange(90) + 0.5) / 90) ** 2 * (np.pi / 2)
    difference, around = (np.arange(90) + 0.5) / 90 * (np.pi / 2), (np.arange(180) + 0.5) / 180 * np.pi
    h, d, p = np.meshgrid(half, difference, around, indexing="ij")
    x = np.stack([np.sin(h), 0 * h, np.cos(h), np.sin(d) * np.cos(p), np.sin(d) * np.sin(p), np.cos(d)], axis=-1)
    for i, (matrix, bias) in enumerate(layers):
        x = x @ matrix + bias
        x = np.maximum(x, 0) if i < 2 else np.maximum(np.exp(x) - 1, 0)
    return Tabulated(jnp.asarray(x, jnp.float32))


if __name__ == "__main__":
    main()
