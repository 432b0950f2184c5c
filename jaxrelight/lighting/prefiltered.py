"""Lighting without transport: prefiltered environments, and local lights with shadow rays (McAllister 2002 §4, §6).

Nothing is precomputed for a mesh, and every texel may have a BRDF of its own. What is left out: the environment casts
no shadows, and surfaces do not light each other.
"""

import dataclasses
import functools
from collections.abc import Mapping, Sequence
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxrelight.basis import latlong
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.horizon import cut
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.material import Component, Material, as_material
from jaxrelight.brdf.normal_maps import see
from jaxrelight.brdf.spatial import Minification, PackedLobes, SpatialLobes
from jaxrelight.brdf.texture import Weight, look_up
from jaxrelight.errors import InputError
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.frame import frames_of_points, to_local
from jaxrelight.geometry.gbuffer import GBuffer
from jaxrelight.geometry.morton import morton
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import OFFSET, Tracer
from jaxrelight.lighting.pixels import Pixels, assembled, padded, places
from jaxrelight.lighting.shadows import Shadows
from jaxrelight.lights.environment import Environment
from jaxrelight.lights.local import Incident, Light
from jaxrelight.lights.prefiltered import Prefiltered
from jaxrelight.numerics import safe
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.buckets import bucket, filled_up
from jaxrelight.scene.scene import Scene

# Pixels shaded at a time: what is read and made for them fits a processor's cache.
_TOGETHER = 4096
# How the cosine and the horizon come in: by a lobe that stands for the product, or outside the integral (eq. 11).
Horizon = Literal["cut", "outside"]
# What is interpolated between the texels of an SBRDF: its parameters, or what each of the four around reflects.
Texels = Literal["parameters", "reflectance"]


class SurfacePixels(Pixels):
    """Pixels that see a material, with what light needs to find it.

    Attributes:
        frame: rows tangent, binormal, normal.
    """

    frame: Float[Array, "p 3 3"]


@dataclasses.dataclass(frozen=True)
class SeenComponent:
    """A `Component` whose maps of lobes, where it has any, are packed once for all frames."""

    brdf: Brdf | PackedLobes
    weight: Weight


@dataclasses.dataclass(frozen=True)
class SeenMaterial:
    """A material, and the pixels that see it.

    Attributes:
        name: of the material.
        components: of it.
        pixels: that see it.
        start: of them among the points that lights reach.
    """

    name: str
    components: tuple[SeenComponent, ...]
    pixels: SurfacePixels
    start: int

    def positions(self, shadows: Shadows) -> Float[Array, "p 3"]:
        """Of the pixels, in the world; of padding, those of others."""
        return jax.lax.dynamic_slice_in_dim(shadows.positions, self.start, len(self.pixels.pixel))


@dataclasses.dataclass(frozen=True)
class Seen:
    """What a camera sees of a scene, ready to be lit again and again.

    Attributes:
        materials: those that are seen.
        gbuffer: the surface points.
        shadows: what lights reach of them, material by material.
    """

    materials: tuple[SeenMaterial, ...]
    gbuffer: GBuffer
    shadows: Shadows

    @property
    def covered(self) -> Bool[np.ndarray, "h w"]:
        """Which pixels show a surface."""
        return self.gbuffer.covered

    def under(
        self,
        maps: Prefiltered,
        rotate_y: float | Float[Array, ""] = 0.0,
        scale: float | Float[Array, ""] = 1.0,
        horizon: Horizon = "cut",
        texels: Texels = "parameters",
    ) -> Float[Array, "h w 3"]:
        """Radiance under a prefiltered environment, without shadows; differentiable in the maps and in BRDFs.

        Args:
            maps: of the environment's pixels.
            rotate_y: degrees that it is turned about +y, as `Environment`.
            scale: factor on its radiance.
            horizon: "cut" lets each lobe's cosine and horizon move and sharpen it; "outside" multiplies by the cosine
                of its peak (eq. 11), which counts light from below the surface.
            texels: "parameters" of an SBRDF are interpolated, or the "reflectance" of the four texels around, which
                is right between unlike ones and takes three to five times as long.

        Raises:
            InputError: for a BRDF that is no sum of lobes.
        """
        parts, turn = [], rotate_y * np.float32(np.pi / 180)
        for part in self.materials:
            found = _black(part)
            for component in part.components:
                if not isinstance(component.brdf, LobeSum | PackedLobes):
                    raise InputError(
                        f"[material.{part.name}]: prefiltered environments are for sums of lobes; fit lobes to it with "
                        "'jaxrelight-fit lafortune', or use --lighting transport"
                    )
                found = _under(found, component.brdf, component.weight, part.pixels, maps, turn, horizon, texels)
            parts.append(found)
        return _scaled(self.image(parts), scale)

    def lit_by(
        self, lights: Sequence[Light], shadows: bool = True, texels: Texels = "parameters"
    ) -> Float[Array, "h w 3"]:
        """Radiance under local lights, of any BRDF; differentiable in lights and BRDFs while shadows stand still."""
        found = [_black(part) for part in self.materials]
        for punctual in (one for light in lights for one in light.parts()):
            arriving = self.shadows.arriving(punctual, shadows)
            for number, part in enumerate(self.materials):
                for one in part.components:
                    given = found[number], one.brdf, one.weight, part.pixels, *arriving, part.start
                    found[number] = _lit(*given, texels)
        return self.image(found)

    def background(self, environment: Environment) -> Float[Array, "h w 3"]:
        """The environment in every pixel's direction."""
        u, v = latlong.coordinates(self.gbuffer.directions)
        u, v = as_array(u + environment.rotate_y / 360, jnp.float32), as_array(v, jnp.float32)
        return _scaled(latlong.look_up(environment.pixels, u, v), environment.scale)

    def image(self, parts: Sequence[Float[Array, "p 3"]]) -> Float[Array, "h w 3"]:
        """What the pixels of each material show."""
        if not parts:
            return as_array(np.zeros((*self.covered.shape, 3)), jnp.float32)
        return assembled(parts, self._place, self.covered.shape)

    @functools.cached_property
    def _place(self) -> Int[Array, " n"]:
        return places([part.pixels for part in self.materials], self.covered.size)


def look_at(scene: Scene, minification: Minification = "levels") -> Seen:
    """Traces the pixels of a scene's camera.

    Args:
        scene: what to look at.
        minification: of SBRDFs whose texels are smaller than pixels: the coarser "levels" that were fitted, as far as
            maps have any; "averaged" parameters; or "none".

    Raises:
        InputError: for a part of a material that is not given, one that needs texture coordinates on a mesh without, or
            one that emits light.
    """
    scene.check_materials()
    names = [part.material for part in scene.parts]
    materials = {name: as_material(scene.materials[name]) for name in sorted(set(names))}
    for name, material in materials.items():
        if material.emission is not None:
            raise InputError(
                f"{scene.name}: material '{name}' emits light, which prefiltered lighting has not; light it with "
                "transport, or remove 'emission'"
            )
    surfaces = scene.surfaces()
    return look(surfaces, Tracer(surfaces), scene.camera, names, materials, minification)


def look(
    surfaces: Surfaces,
    tracer: Tracer,
    camera: Camera,
    names: Sequence[str | None],
    materials: Mapping[str, Material],
    minification: Minification = "levels",
) -> Seen:
    """Traces the pixels of a camera; see `look_at`.

    Args:
        surfaces: of all meshes.
        tracer: of those.
        camera: any.
        names: the material of each mesh; None for one that is black.
        materials: all of them.
        minification: of SBRDFs.
    """
    gbuffer = see(surfaces, tracer, camera, [materials[name].normal_map if name else None for name in names])
    seen = np.asarray([[*materials].index(name) if name else -1 for name in names])[gbuffer.mesh]
    pixel = np.flatnonzero(gbuffer.covered)
    world = gbuffer.positions * surfaces.radius + surfaces.centre
    lifted = gbuffer.positions + OFFSET * gbuffer.face_normals
    parts, order, end = [], [np.zeros(0, int)], 0
    for number, name in enumerate(materials):
        mine = np.flatnonzero(seen == number)
        if len(mine):
            if materials[name].is_spatial:
                # Neighbours in the maps one after the other: large maps are read a tenth faster.
                mine = mine[np.argsort(morton(gbuffer.uv[mine] % 1), kind="stable")]
            frames = frames_of_points(gbuffer.normals[mine], gbuffer.tangents[mine])
            own, omega_o = np.arange(len(mine)), to_local(frames, gbuffer.omega_o[mine])
            pixels = SurfacePixels(
                pixel=jax.device_put(padded(pixel, mine, gbuffer.covered.size)),
                uv=jax.device_put(padded(gbuffer.uv, mine)),
                footprint=jax.device_put(padded(gbuffer.footprint, mine)),
                omega_o=jax.device_put(padded(omega_o, own)),
                frame=jax.device_put(padded(frames, own)),
            )
            components = tuple(seen_component(part, minification) for part in materials[name].components)
            parts.append(SeenMaterial(name, components, pixels, sum(map(len, order))))
            end = parts[-1].start + len(pixels.pixel)
            order.append(mine)
    mine, length = np.concatenate(order), bucket(end, 1024)
    positions, normals = (jax.device_put(filled_up(rows[mine], length)) for rows in (world, gbuffer.normals))
    return Seen(tuple(parts), gbuffer, Shadows(tracer, lifted[mine], positions, normals, surfaces.radius))


def seen_component(part: Component, minification: Minification = "levels") -> SeenComponent:
    """A component as pixels ask for it."""
    brdf = part.brdf
    return SeenComponent(brdf.packed(minification) if isinstance(brdf, SpatialLobes) else brdf, part.weight)


def _black(part: SeenMaterial) -> Float[Array, "p 3"]:
    return as_array(np.zeros((len(part.pixels.pixel), 3)), jnp.float32)


@jax.jit
def _scaled(image, factor):
    return image * factor


def _at(brdf, uv: Float[Array, "2"], footprint, texels: Texels, reflected):
    """What is reflected, by a function of a BRDF, at texture coordinates."""
    if not isinstance(brdf, PackedLobes):
        return reflected(brdf)
    if texels == "parameters":
        return reflected(brdf.at(uv, footprint))
    every, weights = brdf.around(uv, footprint)
    return weights @ jax.vmap(reflected)(every)


@functools.partial(jax.jit, static_argnames=("horizon", "texels"))
def _under(others, brdf, weight, pixels: SurfacePixels, maps: Prefiltered, turn, horizon: Horizon, texels: Texels):
    # The environment turned one way is the scene turned the other.
    cosine, sine = jnp.cos(turn), jnp.sin(turn)
    rotation = jnp.array([[cosine, 0, -sine], [0, 1, 0], [sine, 0, cosine]])

    def shade(frame, omega_o, uv, footprint):
        turned = frame @ rotation.T
        radiance = _at(
            brdf, uv, footprint, texels, lambda lobes: prefiltered_radiance(lobes, omega_o, turned, maps, horizon)
        )
        return jnp.where(omega_o[2] > 0, radiance * look_up(weight, uv, footprint), 0)

    given = pixels.frame, pixels.omega_o, pixels.uv, pixels.footprint
    return others + jax.lax.map(lambda one: shade(*one), given, batch_size=_TOGETHER)


def prefiltered_radiance(
    lobes: LobeSum, omega_o: Float[Array, "3"], frame: Float[Array, "3 3"], maps: Prefiltered, horizon: Horizon = "cut"
) -> Float[Array, " c"]:
    """Radiance towards ω_o of one point under a prefiltered environment (eq. 11, or better; see `Seen.under`).

    ρ_d D(N) + Σ_l scale_l |p_l|ⁿ ∫ max(0, p̂_l·ω)ⁿ max(0, N·ω) L(ω) dω with p_l = C_l ω_o.
    """
    radiance = lobes.diffuse * maps.look_up(frame[2], jnp.asarray(1.0, frame.dtype))
    if lobes.is_constant:
        return radiance
    peak, length = lobes.peak(omega_o)
    exponent = lobes.exponent
    if horizon == "cut":
        share, peak, sharpness = cut(peak, exponent)
    else:
        share, sharpness = jnp.maximum(peak[..., 2], 0), exponent
    mean = jax.vmap(jax.vmap(maps.look_up))(peak @ frame, sharpness)  # [l, c1, channels]
    mean = mean[:, 0] if mean.shape[1] == 1 else jnp.diagonal(mean, axis1=1, axis2=2)
    strength = safe.power(length, exponent) * share * (2 * np.pi / (exponent + 1))
    return radiance + jnp.sum(lobes.scale * strength * mean, axis=0)


@functools.partial(jax.jit, static_argnames="texels")
def _lit(
    others, brdf: Brdf | PackedLobes, weight, pixels: SurfacePixels, incident: Incident, visible, start, texels: Texels
):
    # What follows a material's own pixels are those of others, for padding, which nobody reads.
    arriving = (
        jax.lax.dynamic_slice_in_dim(x, start, len(pixels.pixel))
        for x in (incident.omega_i, incident.irradiance, visible)
    )

    def shade(frame, omega_o, uv, footprint, towards, irradiance, visible):
        omega_i = frame @ towards
        lit = (omega_i[2] > 0) & (omega_o[2] > 0) & (visible > 0)
        # Where nothing arrives the BRDF is asked at the normal, so that its gradients are finite.
        up = jnp.asarray([0, 0, 1], omega_i.dtype)
        pair = jnp.where(lit, omega_i, up), jnp.where(lit, omega_o, up)
        value = _at(brdf, uv, footprint, texels, lambda one: one.evaluate(*pair))
        return jnp.where(lit, value * look_up(weight, uv, footprint) * omega_i[2] * irradiance * visible, 0)

    given = pixels.frame, pixels.omega_o, pixels.uv, pixels.footprint, *arriving
    return others + jax.lax.map(lambda one: shade(*one), given, batch_size=_TOGETHER)
