"""Measured reflectance in the adaptive parametrisation of Dupuy and Jakob (2018), which RGL's files hold.

The surface's own distribution of microfacet normals says where reflectance was measured densely, so that a picture of
32² numbers for each direction to the eye holds a sharp highlight as well as a soft one.
"""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrelight.brdf import bilinear_warp
from jaxrelight.brdf.contract import Brdf

# Directions nearer to the horizon than this count as this where f is divided by the cosine.
_MIN_COSINE = 1e-4


class Adaptive(Brdf):
    """f(ω_i, ω_o) · cosθ_i = S(x) · D(h) / (4 σ(ω_o)), with x where the map of visible normals sends the half vector.

    The samples S were taken with one direction at the entries of `phi` and `theta`; that one is ω_o here, so that
    transport, which multiplies by cosθ_i, gets the very numbers of the file however low the light stands. A measured
    BRDF is as reciprocal as its measurement.

    Directions are points of the unit square: (√(2θ/π), (φ + π)/2π). Arrays over it are rows of φ and columns of θ,
    bilinear between grid points. s counts φ, then θ, of ω_o.

    Attributes:
        phi: azimuths of ω_o, ascending; up to two mean an isotropic surface, for which azimuths count from that of
            ω_o. Where they span a half or a quarter of the circle, the rest follows by mirroring the surface.
        theta: elevations of ω_o from the normal, ascending.
        normals: D, the distribution of microfacet normals.
        area: σ, the projected area of microfacets.
        visible: the distribution of normals seen from ω_o, with
        along: its mass before every point of a row, and
        down: that of all rows before a row.
        samples: S.
    """

    phi: Float[Array, " p"]
    theta: Float[Array, " t"]
    normals: Float[Array, "y1 x1"]
    area: Float[Array, "y2 x2"]
    visible: Float[Array, "s y x"]
    along: Float[Array, "s y x"]
    down: Float[Array, "s y"]
    samples: Float[Array, "s c v u"]

    @jax.jit
    def evaluate(self, omega_i: Float[Array, "3"], omega_o: Float[Array, "3"]) -> Float[Array, " c"]:
        """f(ω_i, ω_o) of every channel."""
        isotropic = len(self.phi) <= 2
        if not isotropic:
            omega_i, omega_o = self._into_span(omega_i, omega_o)
        theta_o, phi_o = _spherical(omega_o)
        theta_h, phi_h = _spherical(omega_i + omega_o)
        x, y = _square(theta_h, phi_h - phi_o if isotropic else phi_h)
        y = y - jnp.floor(y)
        (slow, slow_weight), (fast, fast_weight) = (
            bilinear_warp.bracket(value, grid) for value, grid in ((phi_o, self.phi), (theta_o, self.theta))
        )
        if len(self.phi) == 1:
            slices, weights = fast, fast_weight
        else:
            slices = (slow[:, None] * len(self.theta) + fast[None]).ravel()
            weights = (slow_weight[:, None] * fast_weight[None]).ravel()
        u, v = bilinear_warp.invert(self.visible, self.along, self.down, x, y, slices, weights)
        samples = bilinear_warp.look_up(self.samples, u, v, slices, weights)
        first, one = jnp.zeros(1, jnp.int32), jnp.ones(1, weights.dtype)
        normals = bilinear_warp.look_up(self.normals[None], x, y, first, one)
        area = bilinear_warp.look_up(self.area[None], *_square(theta_o, phi_o), first, one)
        return samples * normals / (4 * area * jnp.maximum(omega_i[2], _MIN_COSINE))

    def _into_span(self, omega_i, omega_o):
        """Both directions mirrored so that ω_o lies in the span that was measured: φ in −π … 0, or −π … −π/2."""
        mirrors = jnp.round(2 * math.pi / (self.phi[-1] - self.phi[0]))
        flip_y = jnp.where((mirrors >= 2) & (omega_o[1] >= 0), -1, 1)
        flip_x = jnp.where((mirrors >= 2) & (jnp.where(mirrors == 4, omega_o[0], omega_o[1]) >= 0), -1, 1)
        flip = jnp.stack([flip_x, flip_y, 1]).astype(omega_o.dtype)
        return omega_i * flip, omega_o * flip

    @property
    def channels(self) -> int:
        """c, the number of colour channels."""
        return self.samples.shape[1]

    @property
    def is_constant(self) -> bool:
        """Never."""
        return False


def _spherical(vector):
    """(θ, φ) of any length; along the normal φ is 0, with a zero gradient."""
    # The sums are written out: over three components, XLA's take longer than all the rest.
    x, y, z = vector
    square = x * x + y * y
    upright = square <= 1e-18 * z * z
    aside = jnp.sqrt(jnp.where(upright, 1, square))
    theta = jnp.arctan2(jnp.where(upright, 0, aside), jnp.where(upright & (z == 0), 1, z))
    return theta, jnp.arctan2(jnp.where(upright, 0, y), jnp.where(upright, 1, x))


def _square(theta, phi):
    """The point of the unit square; beyond θ = π/2, and next to 0 where the root has no slope, clamped."""
    return jnp.sqrt(jnp.clip(theta * (2 / math.pi), 1e-12, 1)), phi / (2 * math.pi) + 0.5
