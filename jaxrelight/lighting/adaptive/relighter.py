"""Shading where bandwidth asks, with as many samples as noise asks (Bagher 2011): nothing is precomputed for a mesh.

A few samples of each pixel predict how its light varies. From that follow the pixels that are shaded, the samples that
each of them gets, and the weights by which all others lie between them. Components of a material are shaded apart and
multiplied by its textures in every pixel, so textures never ask for shading.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.material import Material
from jaxrelight.brdf.spatial import Minification
from jaxrelight.brdf.texture import PixelWeight
from jaxrelight.errors import InputError
from jaxrelight.geometry.camera import Camera
from jaxrelight.images.tone import auto_exposure
from jaxrelight.lighting.adaptive.estimate import Blocked, SampleWork, estimate, estimate_listed, list_work
from jaxrelight.lighting.adaptive.even_shading import even_layers, even_samples, planning_pays
from jaxrelight.lighting.adaptive.layer_estimates import estimate_layer, looked_up
from jaxrelight.lighting.adaptive.many_samples import MEANS, ManySamples, TakenPixels
from jaxrelight.lighting.adaptive.pilot import measure_plan
from jaxrelight.lighting.adaptive.planning import KnownHierarchies, Plan, make_plan
from jaxrelight.lighting.adaptive.prediction import Prediction, directions, draw, predict
from jaxrelight.lighting.adaptive.sampled_brdf import SampledBrdf, sampled
from jaxrelight.lighting.adaptive.trials import Trials, calibrate, try_noise
from jaxrelight.lighting.adaptive.view import AdaptiveView, Probe, make_view, scattered, taken_from
from jaxrelight.lighting.antialiasing import samples_along
from jaxrelight.lighting.contract import VISIBILITY, Image, Relighter, Report, behind, image_of
from jaxrelight.lighting.direct_light import shade_lights
from jaxrelight.lighting.picture_error import Pictured, PictureError
from jaxrelight.lighting.reference import ERROR_SAMPLES, Reference, Sample
from jaxrelight.lighting.shadows import LightGroup, Visibility, all_visible, group_lights, trace_visibility
from jaxrelight.lighting.visible_surfaces import SurfaceComponent, SurfaceMaterial, VisibleSurfaces, surface_material
from jaxrelight.lights.environment import Environment
from jaxrelight.lights.environment_mipmap import EnvironmentMipmap, environment_mipmap
from jaxrelight.lights.lights import Lights, LightsLike, as_lights
from jaxrelight.lights.local import Directional
from jaxrelight.methods import Adaptive
from jaxrelight.numerics.arrays import is_traced
from jaxrelight.transport.model import SceneGeometry

# Samples that predict a pixel: pictures are no better by the paper's 16, and 0.1 dB better by 1,024.
PREDICTING_SAMPLES = 8
# Where neither samples nor a tolerance are given.
DEFAULT_TOLERANCE = 0.01
# Pixels that tell the exposure where it is automatic, their samples, and the seed of those; users' seeds are others.
_EXPOSING_PIXELS, _EXPOSING_SAMPLES, _EXPOSING_SEED = 256, 64, -8
# How often a plan's errors are measured at a few pixels, and planned again.
_PILOTS = 1


class SampledComponent(eqx.Module):
    """One BRDF of a material with what draws directions for it, and the factor on it."""

    sampler: SampledBrdf
    weight: PixelWeight


class SampledMaterial(eqx.Module):
    """A material whose BRDFs can be sampled.

    Attributes:
        name: of the material.
        components: what it combines.
        emission: radiance that it emits; None for none.
    """

    name: str = eqx.field(static=True)
    components: tuple[SampledComponent, ...]
    emission: Float[Array, "3"] | None = None

    def unsampled(self) -> SurfaceMaterial:
        """The material alone."""
        components = tuple(SurfaceComponent(component.sampler.brdf, component.weight) for component in self.components)
        return SurfaceMaterial(self.name, components, self.emission)


def sampled_materials(
    materials: Sequence[SurfaceMaterial], report: Report | None = None
) -> tuple[SampledMaterial, ...]:
    """Finds what draws directions for every BRDF; seconds for one that is no sum of lobes."""
    brdfs = {id(component.brdf): component.brdf for material in materials for component in material.components}
    samplers: dict[int, SampledBrdf] = {}
    for done, (key, brdf) in enumerate(brdfs.items()):
        if report:
            report("materials", done, len(brdfs))
        samplers[key] = sampled(brdf)
    return tuple(
        SampledMaterial(
            material.name,
            tuple(
                SampledComponent(samplers[id(component.brdf)], component.weight) for component in material.components
            ),
            material.emission,
        )
        for material in materials
    )


def _resampled(before: SampledMaterial, material: Material, minification: Minification) -> SampledMaterial:
    """Another material with what draws directions for it."""
    given = surface_material(before.name, material, minification)
    components = []
    for number, component in enumerate(given.components):
        brdf = component.brdf
        old = before.components[number].sampler if number < len(before.components) else None
        if not is_traced(brdf):
            sampler = sampled(brdf)
        elif isinstance(brdf, LobeSum):
            sampler = SampledBrdf(brdf)
        elif old is not None and type(old.brdf) is type(brdf):
            sampler = dataclasses.replace(old, brdf=brdf)
        else:
            raise InputError(
                f"material '{before.name}': directions cannot be drawn for a traced {type(brdf).__name__}; prepare the "
                "scene with one"
            )
        components.append(SampledComponent(sampler, component.weight))
    return SampledMaterial(before.name, tuple(components), given.emission)


class AdaptiveLight(NamedTuple):
    """Light as `AdaptiveRelighter` takes it.

    Attributes:
        environment: None for none.
        mipmap: of it, as samples see it; its sun is the last of the groups.
        groups: local lights, and the environment's sun.
    """

    environment: Environment | None
    mipmap: EnvironmentMipmap | None
    groups: tuple[LightGroup, ...]


class AdaptiveTraced(NamedTuple):
    """What depends on light and view together.

    Attributes:
        plan: where to shade, and how often; None without an environment.
        work: of each layer of the plan and each part of the view, its samples with their shadow rays; None where there
            is none, or where `shade` casts them as it goes.
        visibility: of the groups of lights.
    """

    plan: Plan | None
    work: tuple[tuple[SampleWork | None, ...], ...] | None
    visibility: Visibility


class AdaptiveRelighter(Relighter[AdaptiveView, AdaptiveLight, AdaptiveTraced]):
    """Lights a scene by samples of its environment, and by local lights; see `Adaptive` for the dials."""

    sampled_materials: tuple[SampledMaterial, ...]
    own_lights: Lights
    method: Adaptive = eqx.field(static=True)
    camera: Camera = eqx.field(static=True)
    geometry: SceneGeometry = eqx.field(static=True)
    # Neighbouring pixels share samples, which sensors have none of.
    sensors: None = eqx.field(static=True, default=None)

    @property
    def materials(self) -> tuple[SurfaceMaterial, ...]:
        """The materials without what draws directions for them."""
        return tuple(
            SurfaceMaterial(
                material.name,
                tuple(SurfaceComponent(part.sampler.brdf, part.weight) for part in material.components),
                material.emission,
            )
            for material in self.sampled_materials
        )

    def scene_lights(self) -> Lights:
        """The scene's own lights."""
        return self.own_lights

    def view(self, camera: Camera | None = None, antialiasing: int = 1) -> AdaptiveView:
        """What a camera sees; by default the scene's. Traces its rays on the host."""
        return make_view(self.geometry, camera or self.camera, self.materials, samples_along(antialiasing))

    def light(self, lights: LightsLike) -> AdaptiveLight:
        """Means of the environment over ever larger cells; its sun joins the local lights."""
        lights = as_lights(lights)
        local = group_lights(lights.local, self.geometry.surfaces.centre)
        if lights.environment is None:
            return AdaptiveLight(None, None, local)
        mipmap = environment_mipmap(lights.environment)
        # It comes from a few directions: no sample would find them.
        shining = jnp.any(mipmap.sun.irradiance > 0, axis=1)
        sun = LightGroup(Directional(-mipmap.sun.directions, mipmap.sun.irradiance), shining)
        return AdaptiveLight(lights.environment, mipmap, (*local, sun))

    def with_materials(
        self, materials: Mapping[str, Brdf | Material], *, bounces: Literal["held", "followed"] | None = None
    ) -> "AdaptiveRelighter":
        """The same scene with other materials, see `Relighter.with_materials`; there are no bounces.

        What draws directions for a BRDF that is traced, and is no sum of lobes, is what the one before had.

        Raises:
            InputError: also for such a one where there was none before.
        """
        given = self._materials_of(materials, [one.name for one in self.sampled_materials])
        changed = tuple(
            _resampled(one, given[one.name], self.method.minification) if one.name in given else one
            for one in self.sampled_materials
        )
        return dataclasses.replace(self, sampled_materials=changed)

    @property
    def held(self) -> tuple[str, ...]:
        """Visibility, and where and how often is sampled, if that is traced before."""
        return VISIBILITY, "the plan of samples, and where they lie"

    def trace(self, lit: AdaptiveLight, view: AdaptiveView, *, report: Report | None = None) -> AdaptiveTraced:
        """The plan of samples, and all shadow rays: those of samples, and towards local lights.

        Args:
            lit: from `light`.
            view: from `view`.
            report: called with the progress.

        Raises:
            InputError: inside of jit under an environment, as a plan's size follows from the light's values.
        """
        visibility = self._visibility(lit, view.surfaces)
        if lit.mipmap is None:
            return AdaptiveTraced(None, None, visibility)
        plan = self.plan(lit, view, report=report)
        held, view = jax.lax.stop_gradient((self, view))
        return AdaptiveTraced(plan, held._work(view, plan, report), visibility)

    def _work(self, view: AdaptiveView, plan: Plan, report: Report | None):
        """See `AdaptiveTraced.work`."""
        heard, layers = _Progress(report, plan.samples) if report else None, []
        for number, layer in enumerate(plan.layers):
            work, counts = [], np.asarray(layer.counts)
            for part, components in enumerate(self._components(view)):
                if number >= len(components):
                    work.append(None)
                    continue
                part_counts = view.of_part(part, counts)
                pixels, blocked = view.surfaces.parts[part].pixels, self._blocked(view, part)
                work.append(list_work(components[number].sampler, pixels, part_counts, self.method.seed, blocked))
                if heard:
                    heard(int(part_counts.sum()))
            layers.append(tuple(work))
        return tuple(layers)

    def shade(
        self,
        lit: AdaptiveLight,
        view: AdaptiveView,
        traced: AdaptiveTraced | None = None,
        *,
        report: Report | None = None,
    ) -> Image:
        """The picture by the plan's samples, and what lies between them.

        `measured` has the plan, with the errors that it predicts.

        Differentiable in the light and in BRDFs, whose samples stay where they are.

        Args:
            lit: from `light`; a plan made for another light serves, too.
            view: from `view`.
            traced: from `trace`. Where it is left out, samples are drawn and their rays cast together, which is quicker
                for a single picture.
            report: called with the progress.
        """
        if traced is None:
            plan = None if lit.mipmap is None else self.plan(lit, view, report=report)
            traced = AdaptiveTraced(plan, None, self._visibility(lit, view.surfaces))
        surfaces, plan = view.surfaces, traced.plan
        under = None
        if plan is not None and lit.mipmap is not None:
            under = self._by_samples(lit.mipmap, view, plan, traced.work, report)
        direct = shade_lights(self.materials, surfaces, lit.groups, traced.visibility)
        image = image_of((under, direct, surfaces.emission(self.materials)), surfaces.covered, view.factor)
        image = dataclasses.replace(image, measured={"plan": plan}) if under is not None else image
        return self._measuring(image, lit, view)

    def reference(self, view: AdaptiveView, samples: int, seed: int) -> Reference:
        """Many samples of the view's pixels."""
        return ManySamples(self, view, samples, seed)

    def pictured(self, radiance: Float[np.ndarray, "s 3"], lit: AdaptiveLight, sample: Sample) -> Pictured:
        """What samples and interpolation bring: all but local lights, the sun and what surfaces emit."""
        taken: TakenPixels = sample.view
        alike = taken.in_picture(self._without_samples(lit, taken.surfaces))
        return Pictured({} if lit.mipmap is None else {MEANS: radiance - alike}, alike)

    def _without_samples(self, lit: AdaptiveLight, surfaces: VisibleSurfaces) -> Float[np.ndarray, "s 3"]:
        """Radiance of pixels in a row that takes no samples: of local lights, the sun and what surfaces emit."""
        visibility = self._visibility(lit, surfaces)
        parts = shade_lights(self.materials, surfaces, lit.groups, visibility), surfaces.emission(self.materials)
        return sum((np.asarray(part)[0] for part in parts if part is not None), np.zeros((surfaces.covered.size, 3)))

    def displayed_exposure(self, lit: AdaptiveLight, view: AdaptiveView) -> float:
        """Stops by which plans take it that the picture is made brighter: the dial's.

        Where that is "auto", what a few hundred of the view's pixels ask for, drawn evenly; see `auto_exposure`.
        """
        if self.method.exposure != "auto":
            return self.method.exposure
        pixels = view.surfaces.pixels
        count = min(_EXPOSING_PIXELS, len(pixels))
        surfaces, _ = view.surfaces.taken(np.sort(np.random.default_rng(0).choice(pixels, count, replace=False)))
        by_samples = self.exact_radiance(lit, surfaces, _EXPOSING_SAMPLES, _EXPOSING_SEED)
        return auto_exposure(by_samples + self._without_samples(lit, surfaces))

    def expected_error(
        self, lit: AdaptiveLight, view: AdaptiveView, *, samples: int = ERROR_SAMPLES, seed: int = 0
    ) -> PictureError | None:
        """Refused: plans tell how far off a picture will be.

        Raises:
            InputError: always.
        """
        raise InputError(
            "adaptive lighting predicts the error of a picture as it plans it, in displayed values: see "
            "plan(lit, view).error"
        )

    def not_measured(self, lit: AdaptiveLight) -> tuple[str, ...]:
        """Light that surfaces reflect onto each other; shadows of the environment without any."""
        environment, local = lit.environment is not None, bool(lit.groups)
        return self.method.leaves_out(environment, local)

    def exact_radiance(
        self, lit: AdaptiveLight, surfaces: VisibleSurfaces, samples: int, seed: int
    ) -> Float[np.ndarray, "s 3"]:
        """Radiance under the environment alone, without its sun, of pixels in a row: by many samples of each."""
        rows = []
        for part in surfaces.parts:
            counts = np.where(np.asarray(part.pixels.pixel) < surfaces.covered.size, samples, 0)
            start, points = int(part.start), surfaces.points
            radiance = jnp.zeros((len(counts), 3), part.pixels.omega_o.dtype)
            for component in self.sampled_materials[part.material].components:

                def blocked(place, towards, start=start, points=points):
                    return points.is_occluded(start + place, towards)

                hidden = blocked if self.method.shadows else None
                own = estimate(component.sampler, _mipmap_of(lit), part.pixels, counts, seed, blocked=hidden)
                radiance = _weighed(component.weight, part.pixels, own, radiance)
            rows.append(radiance)
        return np.asarray(surfaces.image(rows))[0]

    def background(self, lit: AdaptiveLight, view: AdaptiveView) -> Float[Array, "h w 3"]:
        """The environment where no surface is seen."""
        surfaces = view.surfaces
        if lit.environment is None:
            return jnp.zeros((*view.shape, 3), surfaces.u.dtype)
        return behind(surfaces.background(lit.environment), surfaces.covered, view.factor)

    def predicted(
        self, lit: AdaptiveLight, view: AdaptiveView, samples: int = PREDICTING_SAMPLES
    ) -> tuple[tuple[Prediction, ...], ...]:
        """Bandwidth and noise of the components of each part, at a quarter of the pixels.

        Args:
            lit: with an environment.
            view: whose pixels.
            samples: n_b of the paper.
        """
        spacing, light = jnp.float32(2 * view.factor), _mipmap_of(lit)

        def of(part: SampledBrdf, probe: Probe) -> Prediction:
            drawn = draw(part, probe.pixels, samples)
            arguments = part, light, probe.pixels, probe.curvature, probe.distance, view.pixel_angle, spacing, drawn
            if not self.method.shadows:
                return predict(*arguments)
            towards, points = np.asarray(directions(part, probe.pixels, drawn)), probe.known_points()
            far = np.full(towards.shape[:2], np.inf, np.float32)
            rays = np.repeat(points, samples), towards[: len(points)].reshape(-1, 3)
            far[: len(points)] = view.surfaces.points.distances(*rays).reshape(-1, samples)
            return predict(*arguments, jnp.asarray(far))

        pairs = zip(view.probes, self._components(view), strict=True)
        return tuple(tuple(of(part.sampler, probe) for part in components) for probe, components in pairs)

    def plan(
        self,
        lit: AdaptiveLight,
        view: AdaptiveView,
        predicted: tuple[tuple[Prediction, ...], ...] | None = None,
        *,
        report: Report | None = None,
    ) -> Plan:
        """Where to shade, by the budget or the error that the dials allow.

        Args:
            lit: with an environment.
            view: whose pixels.
            predicted: what `predicted` gives, where it is known.
            report: called with the progress.

        Raises:
            InputError: inside of jit, as a plan's size follows from the light's values.
        """
        held, lit, view, predicted = jax.lax.stop_gradient((self, lit, view, predicted))
        if is_traced((held, lit, view, predicted)):
            raise InputError(
                "a plan of samples follows from the light's values, which are not known inside of jit; call trace "
                "outside and pass its result to shade"
            )
        return held._plan(lit, view, predicted, report)

    def _plan(self, lit: AdaptiveLight, view: AdaptiveView, predicted, report: Report | None) -> Plan:
        method, light = self.method, _mipmap_of(lit)
        tolerance = DEFAULT_TOLERANCE if method.samples is None and method.tolerance is None else method.tolerance
        if report:
            report("plan", 0, 1)
        components = self._components(view)
        samplers = [[part.sampler for part in of_part] for of_part in components]
        weights = [[part.weight for part in of_part] for of_part in components]
        blocked = [self._blocked(view, part) for part in range(len(components))]
        trials = Trials(view, light, samplers, weights, blocked, 2.0 ** -self.displayed_exposure(lit, view))
        tried, pixels, shadows = try_noise(trials), max(view.covered_count(), 1), method.shadows
        layers, power = even_layers(view, tried, trials.layers)
        even = tolerance is not None and not planning_pays(
            view, layers, even_samples(layers, power, pixels, tolerance), shadows=shadows
        )
        if not even:
            predicted = predicted or self.predicted(lit, view)
            layers = [estimate_layer(view, weights, predicted, number, trials.white) for number in range(trials.layers)]
            layers, power = calibrate(view, tried, layers)
        known = KnownHierarchies()

        def plan() -> Plan:
            shape, factor = view.surfaces.shape, view.factor
            given = layers, power, shape, pixels, factor, method.samples, tolerance, shadows
            return make_plan(*given, known, even)

        for _ in range(_PILOTS):
            planned = plan()
            factors = measure_plan(trials, planned, method.seed)
            layers = [
                of._replace(deviation=of.deviation * noise, share=of.share * factors.between)
                for of, noise in zip(layers, factors.noise, strict=True)
            ]
        return plan()

    def shade_plan(
        self,
        lit: AdaptiveLight,
        view: AdaptiveView,
        plan: Plan,
        *,
        filtered: bool = True,
    ) -> Float[Array, "h w 3"]:
        """Radiance under the environment alone, without its sun, by a plan.

        Args:
            lit: with an environment, for which was planned or another.
            view: whose pixels.
            plan: where to shade.
            filtered: see `estimate`.
        """
        return self._by_samples(_mipmap_of(lit), view, plan, None, None, filtered)

    def shade_uniform(
        self, lit: AdaptiveLight, view: AdaptiveView, samples: int, *, filtered: bool = False
    ) -> Float[Array, "h w 3"]:
        """Radiance under the environment alone, by the same number of samples in every pixel for each component."""
        rows = []
        for number, components in enumerate(self._components(view)):
            part = view.surfaces.parts[number]
            counts = np.where(np.asarray(part.pixels.pixel) < view.surfaces.covered.size, samples, 0)
            radiance = jnp.zeros((len(counts), 3), part.pixels.omega_o.dtype)
            for component in components:
                arguments = part.pixels, counts, self.method.seed, filtered, self._blocked(view, number)
                radiance = _weighed(
                    component.weight, part.pixels, estimate(component.sampler, _mipmap_of(lit), *arguments), radiance
                )
            rows.append(radiance)
        return view.surfaces.image(rows)

    def _by_samples(
        self,
        light: EnvironmentMipmap,
        view: AdaptiveView,
        plan: Plan,
        work: tuple[tuple[SampleWork | None, ...], ...] | None,
        report: Report | None,
        filtered: bool = True,
    ) -> Float[Array, "h w 3"]:
        """Radiance under the environment, of all layers of a plan."""
        heard = _Progress(report, plan.samples) if report and work is None else None
        components, seed = self._components(view), self.method.seed
        rows = [jnp.zeros((len(part.pixels.pixel), 3), part.pixels.omega_o.dtype) for part in view.surfaces.parts]
        for number, layer in enumerate(plan.layers):
            shaded = []
            for part, part_components in enumerate(components):
                if number >= len(part_components):
                    continue
                sampler, pixels = part_components[number].sampler, view.surfaces.parts[part].pixels
                listed = None if work is None else work[number][part]
                if listed is not None:
                    radiance = estimate_listed(sampler, light, pixels, listed, seed, filtered)
                else:
                    counts = view.of_part(part, np.asarray(layer.counts))
                    blocked = self._blocked(view, part)
                    radiance = estimate(sampler, light, pixels, counts, seed, filtered, blocked, heard)
                shaded.append((part, radiance))
            image = layer.hierarchy.interpolate(
                scattered([(view.places[part], radiance) for part, radiance in shaded], view.padded_shape)
            )
            for part, _ in shaded:
                pixels, weight = view.surfaces.parts[part].pixels, components[part][number].weight
                rows[part] = _weighed(weight, pixels, taken_from(image, view.places[part]), rows[part])
        return view.surfaces.image(rows)

    def _components(self, view: AdaptiveView) -> list[tuple[SampledComponent, ...]]:
        """The components of each part's material."""
        return [self.sampled_materials[part.material].components for part in view.surfaces.parts]

    def _visibility(self, lit: AdaptiveLight, surfaces: VisibleSurfaces) -> Visibility:
        points = surfaces.points
        return trace_visibility(points, lit.groups) if self.method.shadows else all_visible(points, lit.groups)

    def _blocked(self, view: AdaptiveView, part: int) -> Blocked | None:
        """Whether rays from the pixels of a part meet anything."""
        if not self.method.shadows:
            return None
        start, points = int(view.surfaces.parts[part].start), view.surfaces.points
        return lambda place, towards: points.is_occluded(start + place, towards)


class _Progress:
    """Progress of several parts as one."""

    def __init__(self, report: Report, total: int):
        self._report, self._total, self._done = report, total, 0

    def __call__(self, samples: int) -> None:
        self._done += samples
        self._report("samples", min(self._done, self._total), self._total)


def _mipmap_of(lit: AdaptiveLight) -> EnvironmentMipmap:
    if lit.mipmap is None:
        raise InputError("adaptive shading plans samples of an environment, and the light has none")
    return lit.mipmap


@jax.jit
def _weighed(weight: PixelWeight, pixels, radiance, others):
    """Radiance of pixels by a component's weight, added to that of other components."""
    return others + radiance * looked_up(weight, pixels)
