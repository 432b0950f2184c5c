"""Direct light that filtered lobes reflect at the pixels of a material."""

import functools
import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.brdf.horizon import clipped_exponents
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.spatial import PackedLobes
from jaxrelight.brdf.sub_lobes import narrower_exponent
from jaxrelight.brdf.texture import PixelWeight, look_up
from jaxrelight.lighting.direct_light import PIXEL_BATCH, at_texel
from jaxrelight.lighting.filtered_lobes import lobe_radiance
from jaxrelight.lighting.pixels import SurfacePixels
from jaxrelight.lights.prefiltered import PrefilteredMaps
from jaxrelight.numerics.arrays import is_traced
from jaxrelight.numerics.few_parameters import of_few_parameters
from jaxrelight.numerics.numbers import Number
from jaxrelight.transport.filtered_visibility import FilteredVisibility
from jaxrelight.transport.model import FilteredLobes


def exponents_of(lobes: Sequence[FilteredLobes]) -> tuple[float, float] | None:
    """The least and the largest exponent that filtered light is asked for; None where lobes are traced."""
    if is_traced([part.brdf for part in lobes]):
        return None
    least, most = math.inf, 0.0
    for part in lobes:
        brdf = part.brdf.texels if isinstance(part.brdf, PackedLobes) else part.brdf
        exponent, scale = np.asarray(brdf.exponent), np.abs(np.asarray(brdf.scale)).max(axis=-1, keepdims=True)
        # Of a black lobe the exponent is nothing.
        reflecting = exponent[np.broadcast_to(scale > 1e-6 * scale.max(initial=0), exponent.shape)]
        if reflecting.size:
            ends = (narrower_exponent(float(end), part.narrower) for end in (reflecting.min(), reflecting.max()))
            low, high = clipped_exponents(*ends)
            least, most = min(least, low), max(most, high)
    return (least, most) if most else (1.0, 1.0)


def filtered_radiance(
    lobes: FilteredLobes,
    pixels: SurfacePixels,
    receivers: Int[Array, "p b"],
    weights: Float[Array, "p b"],
    shares: Float[Array, "p l c1 j"] | None,
    maps: PrefilteredMaps,
    rotate_y: Number,
    scale: Number,
    others: Float[Array, "p c"],
) -> Float[Array, "p c"]:
    """Radiance of pixels with that of one material's lobes: filtered light times the visible share of each lobe.

    Args:
        lobes: of the material.
        pixels: that see it.
        receivers: between which each pixel lies, among the material's.
        weights: theirs.
        shares: visible ones, where they were traced.
        maps: of the environment.
        rotate_y: degrees that it is turned about +y.
        scale: factor on its radiance.
        others: what the pixels have of others.
    """
    own = lobes.brdf, lobes.weight, lobes.visibility
    rows = pixels.frame, pixels.omega_o, pixels.uv, pixels.footprint, receivers, weights, shares
    return _filtered_radiance(*own, rows, maps, rotate_y, scale, others, narrower=lobes.narrower)


@functools.partial(jax.jit, static_argnames="narrower")
def _filtered_radiance(
    brdf: LobeSum | PackedLobes,
    weight: PixelWeight,
    held: FilteredVisibility | None,
    rows,
    maps: PrefilteredMaps,
    rotate_y,
    scale,
    others: Float[Array, "p c"],
    narrower: int,
) -> Float[Array, "p c"]:
    def reflect(lobes, given):
        (frame, omega_o, receivers, weights, traced), held, maps, rotate_y = given

        def light(direction, exponent):
            return maps.look_up(direction, exponent, rotate_y)

        def visibility(direction, exponent):
            assert held is not None
            return held.share(receivers, weights, direction, exponent)

        seen = visibility if traced is None else traced
        return lobe_radiance(lobes, omega_o, frame, light, seen, narrower=narrower)

    # Pixels share the numbers of one BRDF, but not those of a map of them.
    of_lobes = reflect if isinstance(brdf, PackedLobes) else of_few_parameters(reflect)

    def shade(frame, omega_o, uv, footprint, receivers, weights, traced):
        given = (frame, omega_o, receivers, weights, traced), held, maps, rotate_y
        reflected = at_texel(brdf, uv, footprint, "parameters", lambda lobes: of_lobes(lobes, given))
        return jnp.where(omega_o[2] > 0, reflected * look_up(weight, uv, footprint) * scale, 0)

    return others + jax.lax.map(lambda one: shade(*one), rows, batch_size=PIXEL_BATCH)
