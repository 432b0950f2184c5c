"""Ashikhmin and Shirley's anisotropic Phong model (2000): a BRDF of Wang 2006 §5."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.brdf.contract import Brdf
from jaxrelight.errors import InputError
from jaxrelight.numerics import safe
from jaxrelight.numerics.arrays import as_array

# Directions nearer to the horizon than this count as this in denominators: there the model grows without bound.
_LEAST_COSINE = 1e-4


class AshikhminShirley(Brdf):
    """A specular lobe around the half vector, with Schlick's Fresnel term, above a diffuse base that gives way to it.

    With h the half vector and θ_d its angle to either direction,

        f_s = √((nu + 1)(nv + 1)) / (8π) · h_z^((nu h_x² + nv h_y²) / (1 − h_z²)) · F / (cosθ_d · max(i_z, o_z)),
        F = ks + (1 − ks)(1 − cosθ_d)⁵,
        f_d = 28 kd / (23π) · (1 − ks) · (1 − (1 − i_z/2)⁵)(1 − (1 − o_z/2)⁵).

    nu is the exponent along the tangent, nv along the binormal; both are at least 0, kd and ks within 0 … 1.
    """

    kd: Float[Array, " c"]
    ks: Float[Array, " c"]
    nu: Float[Array, ""]
    nv: Float[Array, ""]

    @jax.jit
    def evaluate(self, omega_i: Float[Array, "3"], omega_o: Float[Array, "3"]) -> Float[Array, " c"]:
        """f(ω_i, ω_o) of every channel."""
        total = omega_i + omega_o
        length = safe.norm(total)
        x, y, z = safe.normalize(total)
        exponent_log = (self.nu * x * x + self.nv * y * y) * _log_cosine_over_square_sine(z, x * x + y * y)
        # Both directions are unit vectors, so that cosθ_d is half of the sum's length.
        cosine = length / 2
        fresnel = self.ks + (1 - self.ks) * _fifth(jnp.maximum(1 - cosine, 0))
        below = jnp.maximum(cosine, _LEAST_COSINE) * jnp.maximum(jnp.maximum(omega_i[2], omega_o[2]), _LEAST_COSINE)
        scale = jnp.sqrt((self.nu + 1) * (self.nv + 1)) / (8 * math.pi)
        specular = scale * jnp.exp(exponent_log) / below * fresnel
        rise_i, rise_o = (1 - _fifth(1 - jnp.maximum(omega[2], 0) / 2) for omega in (omega_i, omega_o))
        return specular + 28 / (23 * math.pi) * self.kd * (1 - self.ks) * rise_i * rise_o

    @property
    def channels(self) -> int:
        """c, the number of colour channels."""
        return self.kd.shape[0]

    @property
    def is_constant(self) -> bool:
        """Never: the diffuse base depends on direction, too."""
        return False


def ashikhmin_shirley(kd, ks, nu, nv, dtype=jnp.float32) -> AshikhminShirley:
    """The model of diffuse and specular reflectance, each a number or one per channel, and the two exponents.

    Raises:
        InputError: if a reflectance is not within 0 … 1, or an exponent not a finite number of at least 0.
    """
    kd, ks = (np.atleast_1d(np.asarray(value, float)) for value in (kd, ks))
    for name, value in (("kd", kd), ("ks", ks)):
        if not ((value >= 0) & (value <= 1)).all():
            raise InputError(f"'{name}' must be from 0 to 1 in every channel")
    for name, value in (("nu", nu), ("nv", nv)):
        if not (np.ndim(value) == 0 and 0 <= value < np.inf):
            raise InputError(f"'{name}' must be one finite number of at least 0")
    channels = max(3, kd.size, ks.size)
    kd, ks = (as_array(np.broadcast_to(value, (channels,)), dtype) for value in (kd, ks))
    return AshikhminShirley(kd, ks, as_array(nu, dtype), as_array(nv, dtype))


def _fifth(x):
    return x * x * (x * x) * x


def _log_cosine_over_square_sine(cosine, square_sine):
    """log(cosθ) / sin²θ, which is −½ at θ = 0: by its series there, and by the cosine itself where that is small."""
    near, far = square_sine < 1e-3, square_sine > 0.5
    series = -0.5 - square_sine * (0.25 + square_sine / 6)
    middle = 0.5 * jnp.log1p(-jnp.where(near | far, 0.25, square_sine)) / jnp.where(near | far, 0.25, square_sine)
    # cosθ = 0 belongs to two opposite directions along the surface.
    small = jnp.log(jnp.where(far, jnp.maximum(cosine, 1e-12), 0.5)) / jnp.where(far, square_sine, 0.5)
    return jnp.where(near, series, jnp.where(far, small, middle))
