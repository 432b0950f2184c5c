"""Ashikhmin and Shirley's anisotropic Phong model (2000): a BRDF of Wang 2006 §5."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from jaxrelight.brdf.contract import Brdf
from jaxrelight.errors import InputError
from jaxrelight.numerics import safe
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.numbers import Number, Numbers, as_numbers, float_dtype, holds, module_of

# Directions nearer to the horizon than this count as this in denominators: there the model grows without bound.
_MIN_COSINE = 1e-4


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
        below = jnp.maximum(cosine, _MIN_COSINE) * jnp.maximum(jnp.maximum(omega_i[2], omega_o[2]), _MIN_COSINE)
        scale = jnp.sqrt((self.nu + 1) * (self.nv + 1)) / (8 * math.pi)
        specular = scale * jnp.exp(exponent_log) / below * fresnel
        rise_i, rise_o = (1 - _fifth(1 - safe.clamp(omega[2], 0) / 2) for omega in (omega_i, omega_o))
        return specular + 28 / (23 * math.pi) * self.kd * (1 - self.ks) * rise_i * rise_o

    @property
    def channels(self) -> int:
        """c, the number of colour channels."""
        return self.kd.shape[0]

    @property
    def is_constant(self) -> bool:
        """Never: the diffuse base depends on direction, too."""
        return False


def ashikhmin_shirley(
    kd: Numbers, ks: Numbers, nu: Number, nv: Number, dtype: DTypeLike | None = None
) -> AshikhminShirley:
    """The model of diffuse and specular reflectance, and of two exponents. Differentiable; numbers may be traced.

    Args:
        kd: diffuse reflectance, one number or one per channel.
        ks: specular reflectance, likewise.
        nu: the exponent along the tangent.
        nv: the exponent along the binormal.
        dtype: of the arrays; by default that of the arrays given, or JAX's own for numbers of Python.

    Raises:
        InputError: if a reflectance is not within 0 … 1, or an exponent not a finite number of at least 0.
    """
    dtype = float_dtype(kd, ks, nu, nv) if dtype is None else dtype
    reflectances = {"kd": as_numbers(kd), "ks": as_numbers(ks)}
    for name, value in reflectances.items():
        if not holds(lambda value: (value >= 0) & (value <= 1), value):
            raise InputError(f"'{name}' must be from 0 to 1 in every channel")
    exponents = {"nu": as_numbers(nu), "nv": as_numbers(nv)}
    for name, value in exponents.items():
        if value.ndim != 0 or not holds(lambda value: (value >= 0) & (value < np.inf), value):
            raise InputError(f"'{name}' must be one finite number of at least 0")
    channels = max(3, *(value.size for value in reflectances.values()))
    spread = (module_of(value).broadcast_to(value, (channels,)) for value in reflectances.values())
    return AshikhminShirley(*(as_array(value, dtype) for value in (*spread, *exponents.values())))


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
