"""Lighting without transport: prefiltered environments, and local lights with shadow rays (McAllister 2002 §4, §6).

Nothing is stored of a mesh, and every texel may have a BRDF of its own. The environment casts soft shadows, of what a
few hundred rays from each vertex meet. What is left out: surfaces do not light each other.
"""

import dataclasses
import functools
from collections.abc import Mapping
from typing import Literal, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.material import Material
from jaxrelight.brdf.spatial import PackedLobes
from jaxrelight.brdf.sub_lobes import PATTERNS, sub_lobes
from jaxrelight.brdf.texture import look_up
from jaxrelight.errors import InputError
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.sensors import Sensors
from jaxrelight.lighting.antialiasing import samples_along
from jaxrelight.lighting.contract import VISIBILITY, Image, Relighter, Report, behind, image_of, kept_beside
from jaxrelight.lighting.direct_light import PIXEL_BATCH, Texels, at_texel, shade_lights
from jaxrelight.lighting.exact_pixels import NamedComponent
from jaxrelight.lighting.filtered_lobes import Horizon, LobeMean, lobe_radiance
from jaxrelight.lighting.picture_error import Pictured
from jaxrelight.lighting.pixels import SurfacePixels
from jaxrelight.lighting.reference import ExactTransport, Reference, Sample
from jaxrelight.lighting.shadows import LightGroup, Visibility, all_visible, group_lights, trace_visibility
from jaxrelight.lighting.visible_surfaces import (
    Corners,
    SurfaceMaterial,
    VisibleSurfaces,
    corners_of,
    surface_material,
    trace_view,
)
from jaxrelight.lights.environment import Environment
from jaxrelight.lights.lights import Lights, LightsLike, as_lights
from jaxrelight.lights.prefiltered import PrefilteredMaps, maps_of
from jaxrelight.methods import BETWEEN_SURFACES, Prefiltered
from jaxrelight.numerics.numbers import Number
from jaxrelight.precomputation.vertex_occlusion import VertexOcclusion
from jaxrelight.transport.filtered_visibility import FilteredVisibility
from jaxrelight.transport.model import SceneGeometry

# What is measured of pictures, and the resolution of exact transport that they are compared with.
_MEANS, _REFERENCE_RESOLUTION = "filtered light and visibility", 64


class PrefilteredLight(NamedTuple):
    """Light as `PrefilteredRelighter` takes it.

    Attributes:
        environment: that was filtered; None for none.
        maps: of it.
        groups: the local lights.
    """

    environment: Environment | None
    maps: PrefilteredMaps | None
    groups: tuple[LightGroup, ...]


class PrefilteredRelighter(Relighter[VisibleSurfaces, PrefilteredLight, Visibility]):
    """Lights a scene by filtered environments and by local lights; see `Prefiltered` for the dials."""

    materials: tuple[SurfaceMaterial, ...]
    own_lights: Lights
    method: Prefiltered = eqx.field(static=True)
    camera: Camera = eqx.field(static=True)
    geometry: SceneGeometry = eqx.field(static=True)
    occlusion: VertexOcclusion | None = None
    sensors: Sensors | None = eqx.field(static=True, default=None)

    def scene_lights(self) -> Lights:
        """The scene's own lights."""
        return self.own_lights

    def view(self, camera: Camera | None = None, antialiasing: int = 1) -> VisibleSurfaces:
        """What a camera sees; by default the scene's. Traces its rays on the host."""
        factor = samples_along(antialiasing)
        eye = self.sensors or camera or self.camera
        seen, gbuffer = trace_view(self.geometry, eye, self.materials, factor=factor)
        if self.occlusion is None:
            return seen
        if gbuffer.is_of_sensors:
            slots, weights = self.occlusion.slots.of_vertex[:, None], np.ones((len(gbuffer.positions), 1))
            return dataclasses.replace(seen, corners=corners_of(seen, gbuffer, slots, weights, [0]))
        vertices, weights = self.geometry.corners(gbuffer)
        corners = corners_of(seen, gbuffer, self.occlusion.slots.of_vertex[vertices], weights, [0] * len(seen.parts))
        return dataclasses.replace(seen, corners=corners)

    def light(self, lights: LightsLike) -> PrefilteredLight:
        """Filters the environment for lobes of every exponent, and groups the local lights.

        Raises:
            InputError: for an environment where a material is no sum of lobes.
        """
        lights = as_lights(lights)
        environment, maps = lights.environment, None
        if environment is not None:
            self._check_filtered()
            maps = maps_of(environment, self.method.map_rows)
        return PrefilteredLight(environment, maps, group_lights(lights.local, self.geometry.surfaces.centre))

    def _check_filtered(self):
        for material in self.materials:
            if not all(isinstance(one.brdf, LobeSum | PackedLobes) for one in material.components):
                raise InputError(
                    f"[material.{material.name}]: prefiltered environments are for sums of lobes; fit lobes to it with "
                    "'jaxrelight-fit lafortune', or use --lighting transport"
                )

    def with_materials(
        self, materials: Mapping[str, Brdf | Material], *, bounces: Literal["held", "followed"] | None = None
    ) -> "PrefilteredRelighter":
        """The same scene with other materials, see `Relighter.with_materials`; there are no bounces."""
        given = self._materials_of(materials, [one.name for one in self.materials])
        changed = tuple(
            surface_material(one.name, given[one.name], self.method.minification) if one.name in given else one
            for one in self.materials
        )
        return dataclasses.replace(self, materials=changed)

    @property
    def held(self) -> tuple[str, ...]:
        """Visibility."""
        return (VISIBILITY,)

    def trace(self, lit: PrefilteredLight, view: VisibleSurfaces, *, report: Report | None = None) -> Visibility:
        """Shadow rays towards local lights."""
        return (
            trace_visibility(view.points, lit.groups) if self.method.shadows else all_visible(view.points, lit.groups)
        )

    def shade(
        self,
        lit: PrefilteredLight,
        view: VisibleSurfaces,
        traced: Visibility | None = None,
        *,
        report: Report | None = None,
    ) -> Image:
        """Radiance under the filtered environment, with what hides it from vertices, and under local lights."""
        traced = self.trace(lit, view) if traced is None else traced
        under = self._under_environment(lit, view)
        direct = shade_lights(self.materials, view, lit.groups, traced, self.method.texels)
        image = image_of((under, direct, view.emission(self.materials)), view.covered, view.factor)
        return self._measuring(image, lit, view)

    def samples_of(self, view: VisibleSurfaces) -> VisibleSurfaces:
        """The view whose pixels are this one's samples."""
        return view if view.factor == 1 else kept_beside(view, "_samples", lambda: dataclasses.replace(view, factor=1))

    def reference(self, view: VisibleSurfaces, samples: int, seed: int) -> Reference:
        """Exact transport of the view's pixels, without bounces."""

        def taken(chosen: Int[np.ndarray, " s"]) -> tuple[VisibleSurfaces, VisibleSurfaces]:
            some = view.taken(chosen)[0]
            return some, some

        def named(number: int) -> list[NamedComponent]:
            return [NamedComponent(_MEANS, component) for component in self.materials[number].components]

        return ExactTransport(view, taken, named, _REFERENCE_RESOLUTION, samples, seed)

    def pictured(self, radiance: Float[np.ndarray, "s 3"], lit: PrefilteredLight, sample: Sample) -> Pictured:
        """All light of the environment, and local lights and emission beside it."""
        whole = np.asarray(self.shade(lit, sample.view).radiance)[0]
        under = self._under_environment(lit, sample.view)
        if under is None:
            return Pictured({}, whole)
        own = np.asarray(under)[0]
        return Pictured({_MEANS: own}, whole - own)

    def not_measured(self, lit: PrefilteredLight) -> tuple[str, ...]:
        """Light that surfaces reflect onto each other."""
        return (BETWEEN_SURFACES,)

    def _under_environment(self, lit: PrefilteredLight, view: VisibleSurfaces) -> Float[Array, "h w 3"] | None:
        """Radiance under the filtered environment; None without one."""
        method, sky = self.method, lit.environment
        if lit.maps is None or sky is None:
            return None
        return shade_environment(
            self.materials,
            view,
            lit.maps,
            sky.rotate_y,
            sky.scale,
            method.horizon,
            method.texels,
            None if self.occlusion is None else self.occlusion.visibility,
        )

    def background(self, lit: PrefilteredLight, view: VisibleSurfaces) -> Float[Array, "h w 3"]:
        """The environment where no surface is seen."""
        if lit.environment is None:
            return jnp.zeros((*view.picture_shape, 3), view.u.dtype)
        return behind(view.background(lit.environment), view.covered, view.factor)


def shade_environment(
    materials: tuple[SurfaceMaterial, ...],
    surfaces: VisibleSurfaces,
    maps: PrefilteredMaps,
    rotate_y: Number = 0.0,
    scale: float | Float[Array, ""] = 1.0,
    horizon: Horizon = "cut",
    texels: Texels = "parameters",
    occlusion: FilteredVisibility | None = None,
) -> Float[Array, "h w 3"]:
    """Radiance under a prefiltered environment; differentiable in the maps and in BRDFs.

    Args:
        materials: sums of lobes, the same everywhere or for every texel.
        surfaces: what a camera sees.
        maps: of the environment's pixels.
        rotate_y: degrees that it is turned about +y, as `Environment`.
        scale: factor on its radiance.
        horizon: see `Prefiltered`.
        texels: see `Prefiltered`.
        occlusion: visibility of the vertices that are the surfaces' corners; None for no shadows.
    """
    rows = []
    for number, part in enumerate(surfaces.parts):
        components = materials[part.material].components
        corners = None if occlusion is None else surfaces.corners[number]
        dials = {"horizon": horizon, "texels": texels}
        rows.append(_under(components, part.pixels, corners, occlusion, maps, rotate_y, scale, **dials))
    return surfaces.image(rows)


@functools.partial(jax.jit, static_argnames=("horizon", "texels"))
def _under(
    components,
    pixels: SurfacePixels,
    corners: Corners | None,
    occlusion: FilteredVisibility | None,
    maps: PrefilteredMaps,
    rotate_y,
    scale,
    horizon: Horizon,
    texels: Texels,
):
    def shade(frame, omega_o, uv, footprint, corner):
        def visibility(direction, exponent):
            assert occlusion is not None
            return occlusion.share(corner.receivers, corner.weights, direction, exponent)

        def reflected(lobes):
            seen = None if occlusion is None else visibility
            return prefiltered_radiance(lobes, omega_o, frame, maps, horizon, rotate_y, seen)

        radiance = sum(
            at_texel(one.brdf, uv, footprint, texels, reflected) * look_up(one.weight, uv, footprint)
            for one in components
        )
        return jnp.where(omega_o[2] > 0, radiance * scale, 0)

    rows = pixels.frame, pixels.omega_o, pixels.uv, pixels.footprint, corners
    return jax.lax.map(jax.checkpoint(lambda one: shade(*one)), rows, batch_size=PIXEL_BATCH)


def prefiltered_radiance(
    lobes: LobeSum,
    omega_o: Float[Array, "3"],
    frame: Float[Array, "3 3"],
    maps: PrefilteredMaps,
    horizon: Horizon = "cut",
    rotate_y: Number = 0.0,
    visibility: LobeMean | None = None,
) -> Float[Array, " c"]:
    """Radiance towards ω_o of one point under a prefiltered environment (eq. 11, or better): ρ_d D(N), and its lobes.

    With visibility, diffuse light is that of narrower lobes, each by the share of it that is visible; what they do not
    make up of D(N) is visible as all of them are in the mean.

    Args:
        lobes: of the point.
        omega_o: local direction to the eye.
        frame: rows tangent, binormal, normal.
        maps: of the environment.
        horizon: see `Prefiltered.horizon`.
        rotate_y: degrees that the environment is turned about +y.
        visibility: the share of a lobe that is visible; None where nothing is hidden.
    """

    def light(direction, exponent):
        return maps.look_up(direction, exponent, rotate_y)

    arriving = light(frame[2], jnp.asarray(1.0, frame.dtype))
    if visibility is not None:
        up, exponent = jnp.asarray([0.0, 0.0, 1.0], frame.dtype), jnp.asarray(1.0, frame.dtype)
        parts = sub_lobes(up, exponent, max(PATTERNS))
        pairs = parts.peaks @ frame, jnp.broadcast_to(parts.exponent, parts.shares.shape)
        means, seen = jax.vmap(light)(*pairs), jax.vmap(visibility)(*pairs)
        arriving = (parts.shares * seen) @ means + (parts.shares @ seen) * (arriving - parts.shares @ means)
    return lobes.diffuse * arriving + lobe_radiance(lobes, omega_o, frame, light, visibility, horizon=horizon)
