"""What adaptive shading promises: the error of pictures, measured, over the tolerance that was asked for."""

import argparse
import dataclasses
import time
from collections.abc import Callable

import numpy as np
from jaxtyping import Float

import jaxrelight as jr
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.material import Component, Material, white_lambert, white_phong
from jaxrelight.brdf.texture import Texture, constant
from jaxrelight.geometry.mesh import normalized
from jaxrelight.images import srgb_encode
from jaxrelight.images.tone import to_unit
from jaxrelight.lighting.adaptive.planning import Plan
from jaxrelight.lighting.direct_light import shade_lights
from jaxrelight.lighting.shadows import all_visible, trace_visibility
from jaxrelight.numerics.arrays import as_array
from tests.benchmarks.adaptive import brdf_of, prepared
from tests.benchmarks.measuring import Report, percent, shared

TOLERANCES = 0.02, 0.01, 0.005, 0.002
# What stands for the truth: the mean of two pictures by so many filtered samples of every pixel, with other seeds.
MANY, SEEDS = 4096, (7, 8)
# Of displayed brightness 1: this quantile of the picture's radiance.
WHITE = 0.97
# The promise is kept where the measured error is so much of the tolerance.
KEPT = 0.6, 1.2
# A case is judged where its truth is off by no more than this share of the tolerance.
KNOWN = 0.5


@dataclasses.dataclass(frozen=True)
class Case:
    """A mesh on a floor, in some light."""

    mesh: str
    material: str
    sky: str

    @property
    def name(self) -> str:
        """As tables call it."""
        return f"{self.mesh.split('_')[0].split('.')[0]}, {self.material}, {self.sky.split('.')[0].split('_')[-1]}"

    def scene(self, size: int) -> jr.Scene:
        """The scene of a square picture."""
        mesh = normalized(jr.load_mesh(shared("data", "mesh", self.mesh)), 1.0)
        camera = jr.Camera((0.3, 0.9, 2.3), (0.0, 0.3, 0.0), fov_y=32.0, width=size, height=size)
        parts = [jr.Part(mesh, "skin"), jr.Part(jr.plane([2.4, 2.4]), "floor")]
        materials = {"skin": MATERIALS[self.material](), "floor": jr.lambert(0.5)}
        sky = jr.load_environment(shared("data", "env", self.sky))
        return jr.Scene(parts, materials, camera, lights=[sky], name=self.name)


def textured() -> Material:
    """Paint of several colours under a coat."""
    from PIL import Image

    colours = np.asarray(Image.open(shared("data", "mesh", "spot_texture.png")).convert("RGB"), np.float32) / 255
    paint = Component(white_lambert(), (Texture(as_array(colours**2.2 * 0.7, np.float32)).minified(),))
    return Material((paint, Component(white_phong(200.0), (constant(0.2),))))


def metallic() -> Material:
    """A matt ground, a wide lobe of one colour and a narrow one of another."""
    lobes = (
        Component(white_phong(12.0), (constant([0.3, 0.22, 0.1]),)),
        Component(white_phong(900.0), (constant([0.15, 0.15, 0.2]),)),
    )
    return Material((Component(jr.lambert([0.15, 0.1, 0.05])), *lobes))


def spatial() -> Material:
    """A BRDF of its own in every texel, from matt to glossy."""
    from tests.benchmarks.sbrdf_frames import maps

    return Material((Component(maps(32, 2)),))


def lafortune() -> Brdf:
    """Glossy, and shining back towards the light."""
    shining = jr.lobe([-1, -1, 0.9], 20, specular=np.full(3, 0.25))
    back = jr.lobe([0.9, -0.6, 0.6], 5, specular=np.array([0.05, 0.08, 0.1]))
    return jr.lobe_sum([0.3, 0.2, 0.2], [shining, back])


MATERIALS: dict[str, Callable[[], Brdf | Material]] = {
    "Phong": lambda: jr.phong([0.4, 0.1, 0.1], 0.4, 50),
    "Lafortune": lafortune,
    "RGL paint": lambda: brdf_of("RGL paint"),
    "sharp": lambda: jr.phong([0.05, 0.05, 0.1], 0.5, 3000),
    "textured": textured,
    "SBRDF": spatial,
    "MERL surrogate": lambda: brdf_of("MERL surrogate"),
    "three components": metallic,
}
CASES = (
    Case("bunny_mitsuba.ply", "Phong", "grace_latlong.exr"),
    Case("spot.obj", "Lafortune", "pmndrs_venice.exr"),
    Case("dragon_vrip_res4.ply", "RGL paint", "probulator_uffizi.hdr"),
    Case("teapot.obj", "sharp", "blender_city.exr"),
    Case("spot.obj", "textured", "grace_latlong.exr"),
    Case("spot.obj", "SBRDF", "blender_studio.exr"),
    Case("bunny_mitsuba.ply", "MERL surrogate", "blender_sunset.exr"),
    Case("dragon_vrip_res4.ply", "three components", "pmndrs_lab.exr"),
)


class Picture:
    """One case and its truth."""

    def __init__(self, case: Case, size: int, many: int, *, shadows: bool):
        scene = case.scene(size)
        self.shadows, self.relighter = shadows, prepared(scene, shadows=shadows)
        self.lit, self.view = self.relighter.light(scene.lights), self.relighter.view()
        self.covered = np.asarray(self.view.surfaces.covered)
        one, other = (self._many(many, seed) for seed in SEEDS)
        self.truth = (one + other) / 2
        self.white = float(np.quantile(self.truth[self.covered].mean(axis=1), WHITE))
        # Half of what both are apart is what their mean is off.
        self.truth_error = float(np.sqrt(np.mean((self._shown(one) - self._shown(other)) ** 2)) / 2)

    def planned(self, tolerance: float) -> tuple[Plan, np.ndarray]:
        """The plan for a tolerance, and its picture."""
        method = dataclasses.replace(self.relighter.method, tolerance=tolerance, exposure=-float(np.log2(self.white)))
        relighter = dataclasses.replace(self.relighter, method=method)
        plan = relighter.plan(self.lit, self.view)
        return plan, np.asarray(self._with_sun(relighter.shade_plan(self.lit, self.view, plan)))

    def error(self, image: Float[np.ndarray, "h w 3"]) -> float:
        """Root mean square of displayed values in covered pixels, without the truth's own."""
        square = np.mean((self._shown(image) - self._shown(self.truth)) ** 2)
        return float(np.sqrt(max(square - self.truth_error**2, 0)))

    def _many(self, samples: int, seed: int) -> np.ndarray:
        other = dataclasses.replace(self.relighter, method=dataclasses.replace(self.relighter.method, seed=seed))
        return np.asarray(self._with_sun(other.shade_uniform(self.lit, self.view, samples, filtered=True)))

    def _shown(self, image) -> np.ndarray:
        return srgb_encode(to_unit(image / self.white))[self.covered]

    def _with_sun(self, radiance):
        """No sample finds the environment's sun, which is a light of its own."""
        surfaces, groups = self.view.surfaces, self.lit.groups
        traced = trace_visibility(surfaces.points, groups) if self.shadows else all_visible(surfaces.points, groups)
        direct = shade_lights(self.relighter.materials, surfaces, groups, traced)
        return radiance if direct is None else radiance + direct


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.adaptive_promise", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="one small picture; RESULTS.md is left as it is")
    quick = parser.parse_args().quick
    size, many = (48, 512) if quick else (96, MANY)
    title = "The error that is asked of adaptive shading, and the one that pictures have"
    parameters = f"meshes on a floor, {size}×{size}, against {many:,} filtered samples of every pixel"
    with Report("adaptive_promise", title, parameters, write=not quick) as report:
        measure(report, CASES[:1] if quick else CASES, size, many)


def measure(report: Report, cases: tuple[Case, ...], size: int, many: int):
    """A row for every case, without shadows and with them."""
    start, rows, ratios, announced, unjudged = time.perf_counter(), [], [], 0, 0
    for shadows in (False, True):
        for case in cases:
            picture, cells = Picture(case, size, many, shadows=shadows), []
            for tolerance in TOLERANCES:
                plan, image = picture.planned(tolerance)
                ratio, unknown = picture.error(image) / tolerance, picture.truth_error > KNOWN * tolerance
                announced += not plan.is_met
                unjudged += plan.is_met and unknown
                if plan.is_met and not unknown:
                    ratios.append(ratio)
                shaded = plan.shaded / sum(np.count_nonzero(layer.hierarchy.asked) for layer in plan.layers)
                cells.append(f"{ratio:.2f}{'' if plan.is_met else ' *'}{' ?' * unknown} ({shaded:.0%})")
            rows.append([f"{case.name}{', shadows' * shadows}", *cells])
            # The table follows after minutes.
            print(rows[-1], flush=True)
    report.text(
        "The measured error over the tolerance, root mean squares of displayed values in covered pixels, and in "
        "parentheses the share of pixels that are shaded. A star marks what the plan says beforehand that it cannot "
        "meet, a question mark what cannot be judged, as the truth itself is off by more than half of the tolerance."
    )
    report.table(["picture", *(f"{tolerance}" for tolerance in TOLERANCES)], rows)
    inside = np.mean([KEPT[0] <= ratio <= KEPT[1] for ratio in ratios])
    report.text(
        f"Of {len(ratios)} promises, {percent(float(inside))} are kept to within {KEPT[0]} … {KEPT[1]} of the "
        f"tolerance; the least is {min(ratios):.2f}, the largest {max(ratios):.2f}. {announced} were said not to "
        f"be met, {unjudged} cannot be judged. The program took {(time.perf_counter() - start) / 60:.1f} minutes."
    )


if __name__ == "__main__":
    main()
