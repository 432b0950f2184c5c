"""What the light of pixels will be like before they are shaded: bandwidth and noise, from few samples (Bagher 2011 §2).

Every sample is a direction drawn by the BRDF, at which the environment's mipmap tells mean, square and bandwidth of
all the directions that it stands for. So few samples say what many would.

Shadows are not known by bandwidth alone: where some samples of a pixel are hidden and others are not, an edge lies
between. It has all frequencies, so the BRDF decides what is left of them: in angle, and by how far away what hides them
is, along the surface.
"""

from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.lighting.adaptive.local_bandwidth import Bandwidth, reflected, travelled
from jaxrelight.lighting.adaptive.sampled_brdf import SampledBrdf
from jaxrelight.lighting.pixels import SurfacePixels
from jaxrelight.lights.environment_mipmap import EnvironmentMipmap
from jaxrelight.numerics.random_numbers import vogel_points

# Pixels at a time: enough for all cores, and what is made for them nearly fits their caches.
_PIXEL_BATCH = 8192
# What hides light from nearer than this share of the distance to the eye is a pixel's own neighbourhood.
_MIN_RELATIVE_DISTANCE = 1e-3
# Textures count as so many times faster: a checked one has all its contrast at its bandwidth, where light has little.
_OF_TEXTURES = 2.0
# Surfaces seen more obliquely than this count as this; and mirrors turn no further from pixel to pixel.
_MIN_COSINE, _MAX_TURN = 0.02, 0.3


class Prediction(NamedTuple):
    """For each pixel.

    Attributes:
        radiance: the mean of the channels.
        variance: of one sample's estimate of it.
        contrast: radiance, and what edges of shadows may take from it or add.
        angular: bandwidth of the reflected light by the direction in which the eye is mirrored, in cycles per radian;
            the root mean square, as errors of what lies between grow with its square.
        spatial: bandwidth by place, in cycles per metre: of shadows, and of BRDFs that differ by texel.
        image: bandwidth in the image, in cycles per pixel (eq. 5, joined by the average of eq. 4).
        largest: the same, joined by the maximum of figure 6.
        variance_of_bandwidth: what eq. 8 has for the variance.
    """

    radiance: Float[Array, " p"]
    variance: Float[Array, " p"]
    contrast: Float[Array, " p"]
    angular: Float[Array, " p"]
    spatial: Float[Array, " p"]
    image: Float[Array, " p"]
    largest: Float[Array, " p"]
    variance_of_bandwidth: Float[Array, " p"]


# The same numbers for all pixels, so that neighbours differ by what they are alone.
_ROTATION = np.full(2, 1 << 31, np.uint32)


@eqx.filter_jit
def draw(part: SampledBrdf, pixels: SurfacePixels, samples: int) -> tuple[Float[Array, "p n 3"], Float[Array, "p n"]]:
    """Directions of the samples that predict, in each pixel's frame, and their densities."""
    numbers = vogel_points(jnp.arange(samples), samples, jnp.asarray(_ROTATION))

    def one(given):
        point = part.towards(*given)
        return jax.vmap(point.direction)(numbers)

    return jax.lax.map(one, (pixels.omega_o, pixels.uv, pixels.footprint), batch_size=_PIXEL_BATCH)


@jax.jit
def directions(
    part: SampledBrdf, pixels: SurfacePixels, drawn: tuple[Float[Array, "p n 3"], Float[Array, "p n"]]
) -> Float[Array, "p n 3"]:
    """What was drawn, in the world; where nothing is reflected, the normal."""

    def one(given):
        frame, omega_o, uv, footprint, omega_i, density = given
        point = part.towards(omega_o, uv, footprint)
        return jax.vmap(lambda *sample: _world(point.weighed(*sample).omega_i, frame))(omega_i, density)

    rows = pixels.frame, pixels.omega_o, pixels.uv, pixels.footprint, *drawn
    return jax.lax.map(one, rows, batch_size=_PIXEL_BATCH)


@eqx.filter_jit
def predict(
    part: SampledBrdf,
    light: EnvironmentMipmap,
    pixels: SurfacePixels,
    curvature: Float[Array, " p"],
    distance: Float[Array, " p"],
    pixel_angle: Float[Array, ""],
    spacing: Float[Array, ""],
    drawn: tuple[Float[Array, "p n 3"], Float[Array, "p n"]],
    hidden: Float[Array, "p n"] | None = None,
) -> Prediction:
    """Predicts pixels of one component without its weight.

    Args:
        part: the component.
        light: the environment.
        pixels: any.
        curvature: radians per metre, see `geometry.curvature`.
        distance: to the eye, in metres.
        pixel_angle: that a pixel covers along a side, in radians.
        spacing: pixels from one to the next: what is thinner than that in the mirror is met, too.
        drawn: n_b samples of each, see `draw`.
        hidden: how far away what hides each of the `directions` is, infinite for nothing; None without shadows.
    """
    samples = drawn[1].shape[1]
    # The share of light that is expected of the next sample when all so far were hidden.
    unseen = 1 / (samples + 2)

    def predict_pixel(pixel_inputs):
        frame, omega_o, uv, footprint, curvature, distance, omega_i, density, *hidden = pixel_inputs
        point = part.towards(omega_o, uv, footprint)
        # Mirrors turn twice as far as normals, and a pixel is longer where the surface is seen obliquely.
        turn = 2 * curvature * distance * pixel_angle * spacing / jnp.maximum(omega_o[2], _MIN_COSINE)
        least = jnp.minimum(turn, _MAX_TURN) ** 2
        width = distance * pixel_angle / jnp.sqrt(jnp.maximum(omega_o[2], _MIN_COSINE))
        texture = _OF_TEXTURES * part.texture_bandwidth(uv, footprint) / jnp.where(width > 0, width, 1)

        def sample(omega_i, density, *hidden):
            drawn = point.weighed(omega_i, density)
            own = point.bandwidth(drawn.omega_i)
            covered = jnp.maximum(drawn.solid_angle / samples, least)
            mean, square, varied = light.detail_at(_world(drawn.omega_i, frame), covered)
            # A step has little energy at high frequencies. What lies between its ends is off by half its height all
            # the same, which is twice the deviation: as a wave is whose bend is as large, 0.9 of one in a cell.
            spread = jnp.maximum(square - mean**2, 0)
            some = (spread > 0) & (mean > 0)
            steep = 0.9 * jnp.sqrt(jnp.where(some, spread, 1) / covered) / jnp.where(some, mean, 1)
            varied = jnp.maximum(varied, jnp.where(some, steep, 0))
            weight = jnp.mean(drawn.weight)
            arriving = Bandwidth(jnp.zeros_like(varied), varied)
            leaving = reflected(arriving, drawn.omega_i[2], point.omega_o[2], curvature, own, texture)
            # Seen from afar, what varies along the surface varies with the angle between pixels.
            seen = travelled(leaving, distance).a * pixel_angle
            unshadowed, far = weight * mean, hidden[0] if hidden else jnp.full_like(mean, jnp.inf)
            contribution = jnp.where(jnp.isinf(far), unshadowed, 0)
            return {
                "unshadowed": unshadowed,
                "contribution": contribution,
                "square": jnp.where(jnp.isinf(far), 1, unseen) * weight**2 * square,
                "angular": contribution * jnp.minimum(own, varied) ** 2,
                "edge": unshadowed * own,
                "spatial": jnp.where(
                    jnp.isinf(far), 0, unshadowed * own / jnp.maximum(far, _MIN_RELATIVE_DISTANCE * distance)
                ),
                "image": contribution * seen,
                "largest": jnp.where(contribution > 0, seen, 0),
                "varied": contribution**2 * (own + varied),
            }

        every = jax.vmap(sample)(omega_i, density, *hidden)
        means = {name: jnp.mean(values) for name, values in every.items()}
        radiance, unshadowed = means["contribution"], means["unshadowed"]
        some, all_of_it = (jnp.where(x > 0, x, 1) for x in (radiance, unshadowed))
        # 1 where half of the light is hidden; the finest thing that hides is as far from all as from none.
        share = jnp.minimum(1 - radiance / all_of_it, 1 - unseen)
        edge = jnp.where(unshadowed > 0, 4 * share * (1 - share), 0)
        taken = jnp.where(share > 0, share * all_of_it, 1)
        return Prediction(
            radiance,
            jnp.maximum(means["square"] - radiance**2, 0),
            radiance + edge * unshadowed,
            jnp.sqrt(jnp.maximum(means["angular"] / some, 1e-12)) + edge * means["edge"] / all_of_it,
            jnp.maximum(edge * means["spatial"] / taken, texture),
            means["image"] / some,
            jnp.max(every["largest"]),
            means["varied"],
        )

    rows = pixels.frame, pixels.omega_o, pixels.uv, pixels.footprint, curvature, distance, *drawn
    return jax.lax.map(predict_pixel, rows if hidden is None else (*rows, hidden), batch_size=_PIXEL_BATCH)


def _world(omega, frame):
    # The product is written out, since products of small matrices are slow.
    return jnp.sum(omega[:, None] * frame, axis=0)
