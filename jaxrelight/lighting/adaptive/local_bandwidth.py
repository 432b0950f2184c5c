"""Two-component bandwidth on its way from the light to a pixel (Bagher 2011 §2.1-2.3).

A bandwidth is the half-sides of a rectangle that holds the spectrum of light around a ray: (s, a), spatial in cycles
per metre across the ray, and angular in cycles per radian. Signs are left out: a rectangle is symmetric, and what a
shear adds to one side it adds at both ends.
"""

from typing import NamedTuple

import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

# Surfaces seen more obliquely than this count as this.
_MIN_COSINE = 0.02


class Bandwidth(NamedTuple):
    """The half-sides of the rectangle."""

    s: Float[Array, "..."]
    a: Float[Array, "..."]


def travelled(band: Bandwidth, distance: ArrayLike) -> Bandwidth:
    """T_d: through free space."""
    return Bandwidth(band.s, band.a + distance * band.s)


def onto_surface(band: Bandwidth, cosine: ArrayLike) -> Bandwidth:
    """P_i: from across the ray to along the surface."""
    return Bandwidth(band.s * cosine, band.a)


def off_surface(band: Bandwidth, cosine: ArrayLike) -> Bandwidth:
    """P_x: from along the surface to across the ray."""
    return Bandwidth(band.s / jnp.maximum(cosine, _MIN_COSINE), band.a)


def curved(band: Bandwidth, curvature: ArrayLike) -> Bandwidth:
    """C_c: into, or out of, the frame that turns with the surface's normal."""
    return Bandwidth(band.s + curvature * band.a, band.a)


def filtered(band: Bandwidth, brdf: ArrayLike, texture: ArrayLike) -> Bandwidth:
    """B: no angle varies faster than the BRDF; a texture adds its spatial bandwidth.

    Curvature has put the spectrum along a line: where its end is cut off in angle it is cut off in space, too. The
    paper's operator leaves space as it is, which makes every diffuse surface vary as fast as its light.
    """
    angular = jnp.minimum(brdf, band.a)
    share = jnp.where(band.a > 0, angular / jnp.where(band.a > 0, band.a, 1), 1)
    return Bandwidth(band.s * share + texture, angular)


def reflected(
    band: Bandwidth,
    cosine_i: ArrayLike,
    cosine_o: ArrayLike,
    curvature: ArrayLike,
    brdf: ArrayLike,
    texture: ArrayLike,
) -> Bandwidth:
    """R = P_x C₋c S B C_c P_i: one reflection. S mirrors angles, so that C₋c adds as C_c does."""
    arriving = curved(onto_surface(band, cosine_i), curvature)
    return off_surface(curved(filtered(arriving, brdf, texture), curvature), cosine_o)
