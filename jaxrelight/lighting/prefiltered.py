"""Lighting without transport: prefiltered environments, and local lights with shadow rays (McAllister 2002 §4, §6).

Nothing is precomputed for a mesh, and every texel may have a BRDF of its own. What is left out: the environment casts
no shadows, and surfaces do not light each other.
"""

import functools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.spatial import PackedLobes
from jaxrelight.brdf.texture import look_up
from jaxrelight.errors import InputError
from jaxrelight.geometry.camera import Camera
from jaxrelight.lighting.contract import Image, Relighter, Report, behind, image_of
from jaxrelight.lighting.direct_light import PIXEL_BATCH, Texels, at_texel, shade_lights
from jaxrelight.lighting.filtered_lobes import Horizon, lobe_radiance
from jaxrelight.lighting.pixels import SurfacePixels
from jaxrelight.lighting.shadows import LightGroup, Visibility, all_visible, group_lights, trace_visibility
from jaxrelight.lighting.visible_surfaces import SurfaceMaterial, VisibleSurfaces, trace_view
from jaxrelight.lights.environment import Environment
from jaxrelight.lights.lights import Lights, LightsLike, as_lights
from jaxrelight.lights.prefiltered import PrefilteredMaps, prefilter
from jaxrelight.methods import Prefiltered
from jaxrelight.numerics.arrays import on_host
from jaxrelight.numerics.numbers import Number
from jaxrelight.transport.model import SceneGeometry


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

    def scene_lights(self) -> Lights:
        """The scene's own lights."""
        return self.own_lights

    def view(self, camera: Camera | None = None) -> VisibleSurfaces:
        """What a camera sees; by default the scene's. Traces its rays on the host."""
        return trace_view(self.geometry, camera or self.camera, self.materials)[0]

    def light(self, lights: LightsLike) -> PrefilteredLight:
        """Filters the environment for lobes of every exponent, and groups the local lights.

        Raises:
            InputError: for an environment where a material is no sum of lobes.
        """
        lights = as_lights(lights)
        environment, maps = lights.environment, None
        if environment is not None:
            self._check_filtered()
            maps = prefilter(on_host(environment.pixels), self.method.map_rows)
        return PrefilteredLight(environment, maps, group_lights(lights.local))

    def _check_filtered(self):
        for material in self.materials:
            if not all(isinstance(one.brdf, LobeSum | PackedLobes) for one in material.components):
                raise InputError(
                    f"[material.{material.name}]: prefiltered environments are for sums of lobes; fit lobes to it with "
                    "'jaxrelight-fit lafortune', or use --lighting transport"
                )

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
        """Radiance under the filtered environment, which casts no shadows, and under local lights."""
        traced = self.trace(lit, view) if traced is None else traced
        method, sky, under = self.method, lit.environment, None
        if lit.maps is not None and sky is not None:
            under = shade_environment(
                self.materials, view, lit.maps, sky.rotate_y, sky.scale, method.horizon, method.texels
            )
        direct = shade_lights(self.materials, view, lit.groups, traced, method.texels)
        return image_of((under, direct, view.emission(self.materials)), view.covered)

    def background(self, lit: PrefilteredLight, view: VisibleSurfaces) -> Float[Array, "h w 3"]:
        """The environment where no surface is seen."""
        if lit.environment is None:
            return jnp.zeros((*view.shape, 3), view.u.dtype)
        return behind(view.background(lit.environment), view.covered)


def shade_environment(
    materials: tuple[SurfaceMaterial, ...],
    surfaces: VisibleSurfaces,
    maps: PrefilteredMaps,
    rotate_y: Number = 0.0,
    scale: float | Float[Array, ""] = 1.0,
    horizon: Horizon = "cut",
    texels: Texels = "parameters",
) -> Float[Array, "h w 3"]:
    """Radiance under a prefiltered environment, without shadows; differentiable in the maps and in BRDFs.

    Args:
        materials: sums of lobes, the same everywhere or for every texel.
        surfaces: what a camera sees.
        maps: of the environment's pixels.
        rotate_y: degrees that it is turned about +y, as `Environment`.
        scale: factor on its radiance.
        horizon: see `Prefiltered`.
        texels: see `Prefiltered`.
    """
    rows = []
    for part in surfaces.parts:
        components = materials[part.material].components
        rows.append(_under(components, part.pixels, maps, rotate_y, scale, horizon=horizon, texels=texels))
    return surfaces.image(rows)


@functools.partial(jax.jit, static_argnames=("horizon", "texels"))
def _under(components, pixels: SurfacePixels, maps: PrefilteredMaps, rotate_y, scale, horizon: Horizon, texels: Texels):
    def shade(frame, omega_o, uv, footprint):
        def reflected(lobes):
            return prefiltered_radiance(lobes, omega_o, frame, maps, horizon, rotate_y)

        radiance = sum(
            at_texel(one.brdf, uv, footprint, texels, reflected) * look_up(one.weight, uv, footprint)
            for one in components
        )
        return jnp.where(omega_o[2] > 0, radiance * scale, 0)

    rows = pixels.frame, pixels.omega_o, pixels.uv, pixels.footprint
    return jax.lax.map(lambda one: shade(*one), rows, batch_size=PIXEL_BATCH)


def prefiltered_radiance(
    lobes: LobeSum,
    omega_o: Float[Array, "3"],
    frame: Float[Array, "3 3"],
    maps: PrefilteredMaps,
    horizon: Horizon = "cut",
    rotate_y: Number = 0.0,
) -> Float[Array, " c"]:
    """Radiance towards ω_o of one point under a prefiltered environment, without shadows (eq. 11, or better).

    ρ_d D(N) and what `lobe_radiance` adds.
    """

    def light(direction, exponent):
        return maps.look_up(direction, exponent, rotate_y)

    diffuse = lobes.diffuse * light(frame[2], jnp.asarray(1.0, frame.dtype))
    return diffuse + lobe_radiance(lobes, omega_o, frame, light, horizon=horizon)
