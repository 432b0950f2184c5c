"""Direct light of local lights, by every BRDF, at every pixel."""

import functools
from collections.abc import Callable, Sequence
from typing import Literal

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.spatial import PackedLobes
from jaxrelight.brdf.texture import look_up
from jaxrelight.errors import InputError
from jaxrelight.lighting.pixels import SurfacePixels
from jaxrelight.lighting.shadows import LightGroup, Visibility, sum_over_lights, unpacked
from jaxrelight.lighting.visible_surfaces import SurfaceMaterial, VisibleSurfaces

# Pixels shaded at a time: what is read and made for them fits a processor's cache.
PIXEL_BATCH = 4096
# What is interpolated between the texels of an SBRDF: its parameters, or what each of the four around reflects.
Texels = Literal["parameters", "reflectance"]


def shade_lights(
    materials: Sequence[SurfaceMaterial],
    surfaces: VisibleSurfaces,
    groups: Sequence[LightGroup],
    visibility: Visibility,
    texels: Texels = "parameters",
) -> Float[Array, "h w 3"] | None:
    """Radiance of every pixel under local lights: Σ f(ω_i, ω_o) cosθ_i E(ω_i) V; None where there are no lights.

    Differentiable in lights and BRDFs, the visibility held fixed.

    Args:
        materials: of the relighter.
        surfaces: what the camera sees.
        groups: the lights.
        visibility: of each group, from `trace_visibility`.
        texels: what is interpolated between the texels of an SBRDF.

    Raises:
        InputError: for the visibility of other lights.
    """
    if [len(bits) for bits in visibility] != [len(group.is_real) for group in groups]:
        raise InputError("what was traced is of other lights; call trace again with the light that is shaded")
    if not groups:
        return None
    rows = []
    for part in surfaces.parts:
        components = materials[part.material].components
        radiance = jnp.zeros((len(part.pixels.pixel), 3), part.pixels.omega_o.dtype)
        for group, bits in zip(groups, visibility, strict=True):
            positions = part.positions(surfaces.points)
            radiance = _reflected(
                radiance, components, part.pixels, positions, group.lights, bits, part.start, texels=texels
            )
        rows.append(radiance)
    return surfaces.image(rows)


def at_texel(
    brdf: Brdf | PackedLobes,
    uv: Float[Array, " u"],
    footprint: Float[Array, ""],
    texels: Texels,
    reflected: Callable[[Brdf], Float[Array, " c"]],
) -> Float[Array, " c"]:
    """What is reflected, by a function of a BRDF, at texture coordinates."""
    if not isinstance(brdf, PackedLobes):
        return reflected(brdf)
    if texels == "parameters":
        return reflected(brdf.at(uv, footprint))
    every, weights = brdf.around(uv, footprint)
    return weights @ jax.vmap(reflected)(every)


@functools.partial(jax.jit, static_argnames="texels")
def _reflected(radiance, components, pixels: SurfacePixels, positions, lights, bits, start, texels: Texels):
    """Radiance of pixels with that by a group of lights, one after the other."""
    count = len(pixels.pixel)

    def shade(frame, omega_o, uv, footprint, towards, irradiance, visible):
        omega_i = frame @ towards
        lit = (omega_i[2] > 0) & (omega_o[2] > 0) & (visible > 0)
        # Where nothing arrives the BRDF is asked at the normal, so that its gradients are finite.
        up = jnp.asarray([0, 0, 1], omega_i.dtype)
        pair = jnp.where(lit, omega_i, up), jnp.where(lit, omega_o, up)
        value = sum(
            at_texel(component.brdf, uv, footprint, texels, lambda brdf: brdf.evaluate(*pair))
            * look_up(component.weight, uv, footprint)
            for component in components
        )
        return jnp.where(lit, value * omega_i[2] * irradiance * visible, 0)

    def one_light(light, bits):
        incident = light.at(positions)
        visible = unpacked(bits, start, count, positions.dtype)
        rows = pixels.frame, pixels.omega_o, pixels.uv, pixels.footprint, incident.omega_i, incident.irradiance, visible
        return jax.lax.map(lambda one: shade(*one), rows, batch_size=PIXEL_BATCH)

    return sum_over_lights(one_light, radiance, lights, bits)
