"""What lamps give at sensors or in a picture, with shadows held fixed: direct light, and what surfaces pass on of it.

Lighting is linear. Where light bounces and outputs are the points of sensors, the way from the light that arrives at
the cloud to each of them is one row of weights, found once by the adjoint of the bounces (Hašan 2006 §3 backwards);
lamps that move then cost a product with it.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from jaxrelight.errors import InputError
from jaxrelight.lighting.adaptive.relighter import AdaptiveRelighter
from jaxrelight.lighting.contract import Relighter
from jaxrelight.lighting.direct_light import Texels, shade_lights
from jaxrelight.lighting.indirect import IndirectRelighter, IndirectView, add_irradiance
from jaxrelight.lighting.measurement import illuminance_of, irradiance_of
from jaxrelight.lighting.prefiltered import PrefilteredRelighter
from jaxrelight.lighting.shadows import LightGroup, SurfacePoints, all_visible, trace_visibility
from jaxrelight.lighting.transport import TransportRelighter
from jaxrelight.lighting.visible_surfaces import SurfaceMaterial, VisibleSurfaces
from jaxrelight.lights.lights import Lights

# Points of sensors whose rows of weights are held; of more, the bounces are followed for every lamp.
_MAX_ROWS = 256

# What reaches the points that are seen, and those of the cloud: packed bits of every light.
Bits = tuple[UInt8[Array, "*n b"], UInt8[Array, "*n b"] | None]


class LampResponse(eqx.Module):
    """How lamps become outputs: the lux of sensors' points, or the radiance of a picture's pixels and channels.

    Attributes:
        materials: of what is seen.
        surfaces: what is seen.
        bounced: the relighter and its view, where light bounces and outputs are many; None elsewhere.
        cloud: the points that pass light on; None where none do.
        rows: of sensors, lux by irradiance of the cloud's points; None elsewhere.
        is_of_sensors: whether outputs are lux.
        shadows: whether lamps cast any.
        texels: see `Prefiltered`.
    """

    materials: tuple[SurfaceMaterial, ...]
    surfaces: VisibleSurfaces
    bounced: tuple[IndirectRelighter, IndirectView] | None
    cloud: SurfacePoints | None
    rows: Float[Array, "m g c"] | None
    is_of_sensors: bool = eqx.field(static=True)
    shadows: bool = eqx.field(static=True, default=True)
    texels: Texels = eqx.field(static=True, default="parameters")

    def trace(self, lights: LightGroup) -> Bits:
        """Shadow rays towards lights, on the host."""
        trace = trace_visibility if self.shadows else all_visible
        (seen,) = trace(self.surfaces.points, [lights])
        return seen, None if self.cloud is None else trace_visibility(self.cloud, [lights])[0]

    def outputs(self, lights: LightGroup, bits: Bits) -> Float[Array, " m"]:
        """What lights give beside all other light. Pure, linear in their power, and differentiable."""
        seen, at_cloud = bits
        direct = shade_lights(self.materials, self.surfaces, [lights], (seen,), self.texels)
        assert direct is not None
        outputs = _outputs(direct, self.is_of_sensors)
        if self.cloud is None or at_cloud is None:
            return outputs
        if self.rows is not None:
            none = jnp.zeros(self.rows.shape[1:], self.rows.dtype)
            irradiance = add_irradiance(none, self.cloud, lights.lights, at_cloud)
            # outputs m, cloud points g, channels c
            return outputs + jnp.einsum("mgc,gc->m", self.rows, irradiance, precision="highest")
        assert self.bounced is not None
        relighter, view = self.bounced
        irradiance = relighter.irradiance_at_cloud([lights], (at_cloud,))
        return outputs + passed_on(relighter, view, irradiance, self.is_of_sensors)


def make_response(relighter: Relighter, view: Any) -> LampResponse:
    """How lamps become what a view shows; of the relighter's sensors, where it has any.

    Raises:
        InputError: for a relighter of a class of one's own.
    """
    of_sensors = relighter.sensors is not None
    match relighter:
        case IndirectRelighter():
            rows, bounced = None, None
            if of_sensors and view.samples.covered.size <= _MAX_ROWS:
                rows = rows_of_sensors(relighter, view)
            else:
                bounced = relighter, view
            shown, cloud = view.samples, relighter.points
            return LampResponse(relighter.materials, shown, bounced, cloud, rows, of_sensors)
        case TransportRelighter():
            return LampResponse(relighter.materials, view.shown, None, None, None, of_sensors)
        case PrefilteredRelighter():
            dials = relighter.method.shadows, relighter.method.texels
            return LampResponse(relighter.materials, view, None, None, None, of_sensors, *dials)
        case AdaptiveRelighter():
            return LampResponse(relighter.materials, view.surfaces, None, None, None, of_sensors)
    raise InputError(f"lamps are solved for by the relighters of prepare, not by a {type(relighter).__name__}")


def other_outputs(relighter: Relighter, view: Any, lights: Lights, is_of_sensors: bool) -> Float[Array, " m"]:
    """What lights that stay as they are give, with all that surfaces emit."""
    return _outputs(relighter.shade(relighter.light(lights), view).radiance, is_of_sensors)


@eqx.filter_jit
def passed_on(
    relighter: IndirectRelighter, view: IndirectView, irradiance: Float[Array, "g c"], is_of_sensors: bool
) -> Float[Array, " m"]:
    """What outputs get of light that arrives at the cloud, over all bounces; without what surfaces emit."""
    light = relighter.add_bounces(relighter.precomputed.cloud.albedo / np.pi * irradiance)
    # Gathering is linear but for emission, which slopes do not have.
    _, gathered = jax.jvp(lambda light: relighter.final_gather(light, view), (light,), (light,))
    return _outputs(gathered, is_of_sensors)


def rows_of_sensors(relighter: IndirectRelighter, view: IndirectView) -> Float[Array, "m g c"]:
    """Lux of each point of sensors by the irradiance of each of the cloud's points: adjoints of all that follows."""
    method, albedo = relighter.method, relighter.precomputed.cloud.albedo
    gathered = rows = _gather_adjoint(relighter, view, albedo)
    between = min(method.bounces - 1, 1) if method.photons else method.bounces - 1
    for _ in range(between):
        rows = gathered + _bounce_adjoint(relighter, albedo, rows)
    return rows * (albedo / np.pi)[None]


# In both, an array of the cloud's shape is an argument: the compiler would work out all that follows from zeros.
@eqx.filter_jit
def _gather_adjoint(
    relighter: IndirectRelighter, view: IndirectView, light: Float[Array, "g c"]
) -> Float[Array, "m g c"]:
    value, pull = jax.vjp(lambda light: _outputs(relighter.final_gather(light, view), True), light)
    return jax.lax.map(lambda one: pull(one)[0], jnp.eye(len(value), dtype=value.dtype))


@eqx.filter_jit
def _bounce_adjoint(
    relighter: IndirectRelighter, light: Float[Array, "g c"], rows: Float[Array, "m g c"]
) -> Float[Array, "m g c"]:
    _, pull = jax.vjp(relighter.reflected_once, light)
    return jax.lax.map(lambda row: pull(row)[0], rows)


def _outputs(radiance: Float[Array, "h w 3"], is_of_sensors: bool) -> Float[Array, " m"]:
    return illuminance_of(irradiance_of(radiance)) if is_of_sensors else radiance.reshape(-1)
