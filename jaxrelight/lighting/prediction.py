"""What the light of pixels will be like before they are shaded: bandwidth and noise, from few samples (Bagher 2011 §2).

Every sample is a direction drawn by the BRDF, at which the environment's pyramid tells mean, square and bandwidth of
all the directions that it stands for. So few samples say what many would.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.lighting.local_bandwidth import Bandwidth, reflected, travelled
from jaxrelight.lighting.prefiltered import SurfacePixels
from jaxrelight.lighting.random_numbers import even_numbers
from jaxrelight.lighting.sampled import Sampled
from jaxrelight.lights.pyramid import LightPyramid

# Pixels at a time: what is made for them fits a processor's cache.
_TOGETHER = 1024


class Prediction(NamedTuple):
    """For each pixel.

    Attributes:
        radiance: the mean of the channels.
        variance: of one sample's estimate of it.
        angular: bandwidth of the reflected light by the direction in which the eye is mirrored, in cycles per radian.
        image: bandwidth in the image, in cycles per pixel (eq. 5, joined by the average of eq. 4).
        largest: the same, joined by the maximum of figure 6.
        variance_of_bandwidth: what eq. 8 has for the variance.
    """

    radiance: Float[Array, " p"]
    variance: Float[Array, " p"]
    angular: Float[Array, " p"]
    image: Float[Array, " p"]
    largest: Float[Array, " p"]
    variance_of_bandwidth: Float[Array, " p"]


@eqx.filter_jit
def predict(
    part: Sampled,
    light: LightPyramid,
    pixels: SurfacePixels,
    curvature: Float[Array, " p"],
    distance: Float[Array, " p"],
    pixel_angle: Float[Array, ""],
    samples: int = 16,
) -> Prediction:
    """Predicts pixels of one component without its weight.

    Args:
        part: the component.
        light: the environment.
        pixels: any.
        curvature: radians per metre, see `geometry.curvature`.
        distance: to the eye, in metres.
        pixel_angle: that a pixel covers along a side, in radians.
        samples: n_b.
    """
    # The same numbers for all, so that neighbours differ by what they are alone.
    numbers = even_numbers(jnp.arange(samples), jnp.full(3, np.uint32(1 << 31)))

    def one(given):
        frame, omega_o, uv, footprint, curvature, distance = given
        point = part.towards(omega_o, uv, footprint)

        def sample(number):
            drawn = point.draw(number)
            omega = jnp.sum(drawn.omega_i[:, None] * frame, axis=0)
            own = point.bandwidth(drawn.omega_i)
            mean, square, varied = light.detail_at(omega, drawn.solid_angle / samples)
            weight = jnp.mean(drawn.weight)
            arriving = Bandwidth(jnp.zeros_like(varied), varied)
            leaving = reflected(arriving, drawn.omega_i[2], point.omega_o[2], curvature, own, jnp.zeros_like(own))
            # Seen from afar, what varies along the surface varies with the angle between pixels.
            seen = travelled(leaving, distance).a * pixel_angle
            given = weight * mean
            return (
                given,
                weight**2 * square,
                given * jnp.minimum(own, varied),
                given * seen,
                jnp.where(given > 0, seen, 0),
                given**2 * (own + varied),
            )

        given, square, angular, image, largest, varied = jax.vmap(sample)(numbers)
        radiance = jnp.mean(given)
        some = jnp.where(radiance > 0, radiance, 1)
        return Prediction(
            radiance,
            jnp.maximum(jnp.mean(square) - radiance**2, 0),
            jnp.mean(angular) / some,
            jnp.mean(image) / some,
            jnp.max(largest),
            jnp.mean(varied),
        )

    rows = pixels.frame, pixels.omega_o, pixels.uv, pixels.footprint, curvature, distance
    return jax.lax.map(one, rows, batch_size=_TOGETHER)
