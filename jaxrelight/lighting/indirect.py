"""Lighting by direct-to-indirect transfer: local lights move, and many bounces follow (Hašan 2006 §3)."""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.sharding import Mesh
from jaxtyping import Array, Float, Int, UInt8

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.material import Material
from jaxrelight.errors import InputError
from jaxrelight.gather.gather_cloud import FAR
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.sensors import Sensors
from jaxrelight.geometry.tracer import OFFSET
from jaxrelight.lighting.antialiasing import averaged, joined, samples_along
from jaxrelight.lighting.contract import VISIBILITY, Image, Relighter, Report, behind
from jaxrelight.lighting.direct_light import shade_lights
from jaxrelight.lighting.every_link import MEANS, EveryLink, encoded
from jaxrelight.lighting.picture_error import Pictured
from jaxrelight.lighting.reference import Reference, Sample
from jaxrelight.lighting.shadows import (
    LightGroup,
    SurfacePoints,
    Visibility,
    all_visible,
    group_lights,
    sum_over_lights,
    surface_points,
    trace_visibility,
    unpacked,
)
from jaxrelight.lighting.transport import TransportRelighter
from jaxrelight.lighting.transport_view import TransportView, samples_of_pixels
from jaxrelight.lighting.visible_surfaces import SurfaceMaterial, VisibleSurfaces
from jaxrelight.lights.environment import Environment, coarsened
from jaxrelight.lights.lights import Lights, LightsLike, as_lights
from jaxrelight.lights.local import Light, Punctual
from jaxrelight.lights.sky import mean_radiance, nearest_directions, sky_of
from jaxrelight.methods import Indirect
from jaxrelight.numerics.arrays import as_array
from jaxrelight.operators.contract import Operator
from jaxrelight.operators.sharded import sharded
from jaxrelight.precomputation.surface_albedo import albedo_at_points
from jaxrelight.transport.changed_materials import with_materials
from jaxrelight.transport.model import PrecomputedIndirect, PrecomputedTransport

# Side of the cube map that is as fine as maps of a sky in the cloud are read.
SKY_RESOLUTION = 32


class IndirectView(eqx.Module):
    """What the scene's camera sees: samples of direct light, and pixels of indirect light.

    Attributes:
        samples: what the camera sees with several samples a pixel.
        nearest: of every sample the pixel whose indirect light it takes; −1 where it shows no surface.
        pixels: the receivers of gathered light.
    """

    samples: VisibleSurfaces
    nearest: Int[Array, "fh fw"]
    pixels: TransportView

    @property
    def surfaces(self) -> VisibleSurfaces:
        """What is lit directly."""
        return self.samples

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)."""
        return self.pixels.shape


class IndirectLight(NamedTuple):
    """Light as `IndirectRelighter` takes it.

    Attributes:
        environment: that lights, and is seen behind surfaces; None for none.
        cloud: radiance of the cloud's points that pixels see, with all bounces.
        groups: lights that light pixels directly: local ones, and distant ones that stand for the environment.
        arriving: what the light of the cloud is made of, for other materials.
    """

    environment: Environment | None
    cloud: Float[Array, "g c"]
    groups: tuple[LightGroup, ...]
    arriving: "CloudLight | None" = None


class CloudLight(eqx.Module):
    """What arrives at the points of a cloud without having been reflected.

    Attributes:
        irradiance: by lights; None where nothing of lights or emission is to be reflected.
        sky: radiance of directions of the sky; None where there are none, or no sky lights.
        bounces: how often light is reflected at most.
    """

    irradiance: Float[Array, "g c"] | None
    sky: Float[Array, "g c"] | None
    bounces: int = eqx.field(static=True)


class IndirectRelighter(Relighter[IndirectView, IndirectLight, Visibility]):
    """Lights what one camera sees by lights at any place; see `Indirect` for the dials.

    The steps of `light` and `shade` are apart, too: `direct_light_at_cloud` is what the points of the cloud emit and
    reflect of lights, `add_bounces` adds what they get from each other, and `final_gather` what pixels get of it.
    """

    precomputed: PrecomputedIndirect
    points: SurfacePoints
    pixels: TransportRelighter

    def __init__(self, precomputed: PrecomputedIndirect):
        self.precomputed = precomputed
        self.pixels = TransportRelighter(precomputed.transport)
        surfaces, points = precomputed.stored.geometry.surfaces, precomputed.points
        # Nothing lights the sky.
        normals = np.where(points.of_sky[:, None], 0, points.normals)
        self.points = surface_points(
            precomputed.stored.geometry.tracer,
            points.positions,
            points.positions + OFFSET * points.face_normals,
            normals,
            surfaces.radius,
        )

    @property
    def method(self) -> Indirect:
        """The dials of the store."""
        return self.precomputed.method

    @property
    def camera(self) -> Camera:
        """The scene's."""
        return self.precomputed.stored.camera

    @property
    def sensors(self) -> Sensors | None:
        """The scene's, where it was prepared at them."""
        return self.precomputed.stored.sensors

    @property
    def transport(self) -> PrecomputedTransport:
        """From light of the cloud to light terms of pixels."""
        return self.precomputed.transport

    @property
    def materials(self) -> tuple[SurfaceMaterial, ...]:
        """The materials of what is seen."""
        return self.pixels.materials

    @property
    def _centre(self) -> Float[np.ndarray, "3"]:
        """Of the scene, in the world."""
        return self.precomputed.stored.geometry.surfaces.centre

    def scene_lights(self) -> Lights:
        """The scene's own lights, read from the store."""
        return self.precomputed.stored.lights()

    def sharded(self, mesh: Mesh) -> "IndirectRelighter":
        """The same with the rows of pixels and points spread over the devices of a mesh of one axis.

        Raises:
            InputError: for another mesh.
        """
        cloud = self.precomputed.cloud
        between = None if cloud.between is None else sharded(cloud.between, mesh)
        transport = self.precomputed.transport.sharded(mesh)
        return IndirectRelighter(PrecomputedIndirect(transport, dataclasses.replace(cloud, between=between)))

    def view(self, camera: Camera | None = None, antialiasing: int = 1) -> IndirectView:
        """What the scene's camera sees.

        Args:
            camera: the scene's, or none.
            antialiasing: samples of surfaces and of their direct light in a pixel: 1, 4 or 16. Each takes the indirect
                light of the pixel that it is most like.

        Raises:
            InputError: for another camera than the scene's, or another number of samples.
        """
        if camera is not None and camera != self.camera:
            raise InputError("this scene was precomputed for one camera; prepare the scene with another one instead")
        geometry, eye = self.precomputed.stored.geometry, self.sensors or self.camera
        pixels = self.pixels.view()
        return IndirectView(*samples_of_pixels(geometry, eye, self.materials, samples_along(antialiasing)), pixels)

    def light(self, lights: LightsLike, bounces: int | None = None) -> IndirectLight:
        """Light of the cloud with all bounces. Shadow rays from its points are cast on the host, or by a callback.

        Args:
            lights: any.
            bounces: the store's own number, or fewer; 0 for direct light alone.
        """
        lights = as_lights(lights)
        bounces = self.method.bounces if bounces is None else bounces
        environment, local = lights.environment, list[Light](lights.local)
        if environment is not None and not self.method.sky:
            local.append(sky_of(environment, self.method.sky_samples))
        groups = group_lights(local, self._centre)
        irradiance, sky = None, None
        if bounces and (groups or self.transport.emits or environment is None):
            irradiance = self.irradiance_at_cloud(groups, trace_visibility(self.points, groups))
        if environment is not None and self.method.sky:
            pixels = coarsened(environment.pixels, SKY_RESOLUTION)
            sky = self.sky_light(pixels, environment.rotate_y, environment.scale)
        arriving = CloudLight(irradiance, sky, bounces)
        return IndirectLight(environment, self._light_of_cloud(arriving), groups, arriving)

    def _light_of_cloud(self, arriving: CloudLight) -> Float[Array, "g c"]:
        """Radiance of the cloud's points that pixels see, with all bounces."""
        cloud, bounces = self.precomputed.cloud, arriving.bounces
        total = jnp.zeros_like(cloud.albedo)
        if arriving.irradiance is not None:
            total = self.add_bounces(_reflected(arriving.irradiance, cloud.albedo, cloud.emission), bounces)
        if arriving.sky is not None:
            # It has not been reflected yet.
            total = total + self.add_bounces(arriving.sky, bounces + 1)
        return total

    def relit(self, lit: IndirectLight) -> IndirectLight:
        """The light as the cloud's albedos and emission reflect it now; see `Relighter.relit`."""
        return lit if lit.arriving is None else lit._replace(cloud=self._light_of_cloud(lit.arriving))

    def with_materials(
        self, materials: Mapping[str, Brdf | Material], *, bounces: Literal["held", "followed"] | None = None
    ) -> "IndirectRelighter":
        """The same scene with other materials, see `Relighter.with_materials`.

        Direct light follows in everything. Gathered light is reflected by diffuse surfaces exactly; other BRDFs reflect
        it by the shape of the lobes that were prepared, and as much as the new ones. The albedos of the cloud's points
        follow, or are held.

        Raises:
            InputError: as every relighter; for bounces that are to be followed where photons met the albedos.
        """
        photons = bool(self.method.photons) and self.method.bounces > 2
        if bounces == "followed" and photons:
            raise InputError("photons met the albedos that they were shot with; take bounces='held', or gather instead")
        given = self._materials_of(materials, [one.name for one in self.materials])
        transport, cloud = with_materials(self.transport, given), self.precomputed.cloud
        if bounces == "followed" or (bounces is None and not photons):
            geometry = self.precomputed.stored.geometry
            reflected = albedo_at_points(geometry, self.precomputed.points, given, cloud.albedo, cloud.emission)
            cloud = dataclasses.replace(cloud, albedo=reflected[0], emission=reflected[1])
        precomputed = PrecomputedIndirect(transport, cloud)
        changed = precomputed, TransportRelighter(transport)
        return eqx.tree_at(lambda of: (of.precomputed, of.pixels), self, changed)

    @property
    def held(self) -> tuple[str, ...]:
        """Visibility, and by what shape lobes reflect gathered light."""
        glossy = any(not block.reflection.is_constant for block in self.transport.blocks)
        return (
            VISIBILITY,
            *(["the shape of the lobes that reflect gathered light"] if glossy else []),
            *(["the albedos that photons met"] if self.method.photons else []),
        )

    def direct_light_at_cloud(
        self,
        lights: Sequence[Light] | Sequence[LightGroup],
        albedo: Float[Array, "g c"] | None = None,
        shadows: bool = True,
    ) -> Float[Array, "g c"]:
        """Radiance that the cloud's points emit, and reflect of lights: g_d of the paper."""
        groups = [one for one in lights if isinstance(one, LightGroup)]
        groups += group_lights([one for one in lights if isinstance(one, Light)], self._centre)
        visibility = trace_visibility(self.points, groups) if shadows else all_visible(self.points, groups)
        cloud, irradiance = self.precomputed.cloud, self.irradiance_at_cloud(groups, visibility)
        return _reflected(irradiance, cloud.albedo if albedo is None else albedo, cloud.emission)

    def irradiance_at_cloud(self, groups: Sequence[LightGroup], visibility: Visibility) -> Float[Array, "g c"]:
        """What arrives at the cloud's points of lights, whose visibility from `points` is known. Pure."""
        irradiance = jnp.zeros_like(self.precomputed.cloud.albedo)
        for group, bits in zip(groups, visibility, strict=True):
            irradiance = add_irradiance(irradiance, self.points, group.lights, bits)
        return irradiance

    def sky_light(
        self,
        pixels: Float[Array | np.ndarray, "h w 3"],
        rotate_y: float | Float[Array, ""] = 0.0,
        scale: float | Float[Array, ""] = 1.0,
    ) -> Float[Array, "g c"]:
        """Radiance of the cloud's directions of the sky under a lat-long map. Pure and differentiable in all three.

        It was not reflected yet: it takes one bounce more than light of lamps.

        Raises:
            InputError: for a store whose cloud has none.
        """
        sky = np.flatnonzero(self.precomputed.points.of_sky)
        if not len(sky):
            raise InputError(f"{self.precomputed.stored.folder}: precomputed without the sky; precompute with --sky")
        towards = self.precomputed.points.positions[sky] / FAR
        nearest = _nearest_directions(towards.tobytes(), len(sky), *pixels.shape[:2])
        radiance = mean_radiance(pixels, rotate_y, scale, nearest, len(sky))
        return jnp.zeros_like(self.precomputed.cloud.albedo).at[sky].set(radiance)

    def add_bounces(
        self, light: Float[Array, "g c"], bounces: int | None = None, albedo: Float[Array, "g c"] | None = None
    ) -> Float[Array, "g c"]:
        """(M + I) g: light of the cloud with what its points get from each other, so that pixels see `bounces`.

        Raises:
            InputError: for more than one bounce where the store is of one; where photons were shot, for others than
                the store's, or for albedos where they met any on their way.
        """
        cloud, folder = self.precomputed.cloud, self.precomputed.stored.folder
        bounces = self.method.bounces if bounces is None else bounces
        if bounces > 1 and cloud.between is None:
            raise InputError(f"{folder}: precomputed for one bounce; precompute with --bounces 2 or more")
        photons, most = self.method.photons, self.method.bounces
        if photons and bounces not in (1, most):
            raise InputError(f"{folder}: photons were shot for {most} bounces, not {bounces}")
        if photons and bounces > 2 and albedo is not None:
            raise InputError(f"{folder}: its photons met the albedos they were shot with; gather instead")
        total = light
        for _ in range(min(bounces - 1, 1) if photons else bounces - 1):
            reflected = cloud.albedo if albedo is None else albedo
            total = _bounced(light, reflected, cloud.between, self._encoded(total), cloud.slot_of)
        return total

    def reflected_once(self, light: Float[Array, "g c"]) -> Float[Array, "g c"]:
        """M g: what the cloud's points reflect of light of the cloud; of one bounce, or by photons of all. Linear.

        Raises:
            InputError: where the store is of one bounce, whose points get nothing from each other.
        """
        cloud = self.precomputed.cloud
        if cloud.between is None:
            raise InputError(
                f"{self.precomputed.stored.folder}: precomputed for one bounce; nothing is between surfaces"
            )
        return _bounced(jnp.zeros_like(light), cloud.albedo, cloud.between, self._encoded(light), cloud.slot_of)

    def final_gather(
        self, light: Float[Array, "g c"], view: IndirectView, by: Literal["all", "diffuse", "glossy"] = "all"
    ) -> Float[Array, "h w c"]:
        """Radiance of the pixels by light of the cloud, as all of their BRDFs reflect it or some; with emission."""
        terms = self.pixels.terms(self._encoded(light))
        if by != "all":
            chosen = [block.brdf.is_constant == (by == "diffuse") for block in self.transport.blocks]
            terms = tuple(
                part if is_chosen else jnp.zeros_like(part) for part, is_chosen in zip(terms, chosen, strict=True)
            )
        return self.pixels.shade_terms(terms, view.pixels)

    def trace(self, lit: IndirectLight, view: IndirectView, *, report: Report | None = None) -> Visibility:
        """Shadow rays from the samples of pixels towards all lights."""
        return trace_visibility(view.samples.points, lit.groups)

    def shade(
        self, lit: IndirectLight, view: IndirectView, traced: Visibility | None = None, *, report: Report | None = None
    ) -> Image:
        """Several samples of direct light a pixel, and one of indirect light; both are layers of the picture."""
        traced = self.trace(lit, view) if traced is None else traced
        layers = {
            "direct": self._direct(lit, view, traced),
            "indirect": self._smooth(self.final_gather(lit.cloud, view), view),
        }
        image = Image(layers["direct"] + layers["indirect"], self.alpha(view), layers)
        return self._measuring(image, lit, view)

    def reference(self, view: IndirectView, samples: int, seed: int) -> Reference:
        """What the pixels gather from every point of the cloud."""
        return EveryLink(self.precomputed, view.pixels, samples, seed)

    def pictured(self, radiance: Float[np.ndarray, "s 3"], lit: IndirectLight, sample: Sample) -> Pictured:
        """What pixels gather by links and kept coefficients.

        The rest is the picture's own: its pixels are means of what several samples see.
        """
        terms = self.pixels.terms(self._encoded(lit.cloud))
        gathered, emission = (
            np.asarray(self.pixels.shade_terms(of, sample.view))[0]
            for of in (terms, tuple(jnp.zeros_like(part) for part in terms))
        )
        own = gathered - emission
        return Pictured({MEANS: own}, radiance - own)

    def sampled(self, lit: IndirectLight, sample: Sample) -> Float[np.ndarray, "s 3"]:
        """What the pixels of a sample show in their middle."""
        surfaces = sample.view.surfaces
        direct = shade_lights(self.materials, surfaces, lit.groups, trace_visibility(surfaces.points, lit.groups))
        gathered = self.pixels.shade_terms(self.pixels.terms(self._encoded(lit.cloud)), sample.view)
        return np.asarray(gathered if direct is None else gathered + direct)[0]

    def not_measured(self, lit: IndirectLight) -> tuple[str, ...]:
        """What is reflected on its way to the points otherwise than by them."""
        between = ("what the cloud's points get from each other",) if self.method.bounces > 1 else ()
        return (*between, *self.method.leaves_out(lit.environment is not None, bool(lit.groups)))

    def layers(self, lights: LightsLike, view: IndirectView, bounces: int | None = None) -> Image:
        """The picture with all of its layers, which add up; and again, of each light.

        "direct", "indirect.diffuse" and "indirect.glossy" are the picture, with "emission" where surfaces emit light;
        so are "light1", "light2" … and "sky", where there is one, with what emission gives them.
        """
        lights = as_lights(lights)
        lit = self.light(lights, bounces)
        own = self.final_gather(jnp.zeros_like(lit.cloud), view)
        layers = {"direct": self._direct(lit, view, self.trace(lit, view))}
        for kind in ("diffuse", "glossy"):
            layers[f"indirect.{kind}"] = self._smooth(self.final_gather(lit.cloud, view, kind) - own, view)
        none = jnp.zeros_like(layers["direct"])
        if self.transport.emits:
            layers["emission"] = self._smooth(own, view)
            none = self.shade(self.light(None, bounces), view).radiance
        radiance = sum(layers.values(), jnp.zeros_like(none))
        for number, light in enumerate(lights.local, 1):
            layers[f"light{number}"] = self.shade(self.light(light, bounces), view).radiance - none
        if lights.environment is not None:
            layers["sky"] = self.shade(self.light(lights.environment, bounces), view).radiance - none
        return self._measuring(Image(radiance, self.alpha(view), layers), lit, view)

    def alpha(self, view: IndirectView) -> Float[Array, "h w"]:
        """The share of each pixel's samples that show a surface."""
        covered = view.samples.covered.astype(view.samples.u.dtype)
        return averaged(covered[..., None], _factor(view))[..., 0]

    def background(self, lit: IndirectLight, view: IndirectView) -> Float[Array, "h w 3"]:
        """The environment where samples show no surface."""
        if lit.environment is None:
            return jnp.zeros((*view.shape, 3), view.samples.u.dtype)
        return behind(view.samples.background(lit.environment), view.samples.covered, _factor(view))

    def _direct(self, lit: IndirectLight, view: IndirectView, traced: Visibility) -> Float[Array, "h w 3"]:
        direct = shade_lights(self.materials, view.samples, lit.groups, traced)
        if direct is None:
            return jnp.zeros((*view.shape, 3), view.samples.u.dtype)
        return averaged(direct, _factor(view))

    def _smooth(self, radiance: Float[Array, "h w c"], view: IndirectView) -> Float[Array, "h w c"]:
        """Radiance of pixels as the samples of each see it."""
        black = jnp.zeros((*view.samples.shape, radiance.shape[-1]), radiance.dtype)
        return joined(black, radiance, view.nearest)

    def _encoded(self, light: Float[Array, "g c"]) -> Float[Array, "g c"]:
        return encoded(self.transport.basis, light)


def _factor(view: IndirectView) -> int:
    """Samples along each side of a pixel."""
    return view.samples.shape[0] // view.shape[0]


@functools.lru_cache(maxsize=4)
def _nearest_directions(towards: bytes, count: int, height: int, width: int) -> Int[Array, "fh fw"]:
    """See `nearest_directions`; kept for the next map of the same size."""
    directions = np.frombuffer(towards).reshape(count, 3)
    # The array is cached, so it must not be a caller's tracer.
    with jax.ensure_compile_time_eval():
        return as_array(nearest_directions(directions, height, width))


@jax.jit
def add_irradiance(
    irradiance: Float[Array, "g c"], points: SurfacePoints, lights: Punctual, bits: UInt8[Array, "n b"]
) -> Float[Array, "g c"]:
    """Irradiance of the first of some points with that of lights, whose visibility from them is known. Pure."""
    count = len(irradiance)
    positions, normals = points.positions[:count], points.normals[:count]

    def one_light(light, bits):
        incident = light.at(positions)
        cosine = jnp.maximum(jnp.sum(incident.omega_i * normals, axis=1), 0)
        visible = unpacked(bits, jnp.zeros((), jnp.int32), count, normals.dtype)
        return incident.irradiance * (cosine * visible)[:, None]

    return sum_over_lights(one_light, irradiance, lights, bits)


@jax.jit
def _reflected(irradiance, albedo, emission):
    return albedo / np.pi * irradiance + emission


@jax.jit
def _bounced(light, albedo, between: Operator, encoded: Float[Array, "g c"], slot) -> Float[Array, "g c"]:
    """Light of the cloud, and what its points reflect of encoded light."""
    return light + albedo * between.apply(encoded).at[slot].get(mode="promise_in_bounds")
