"""Real spherical harmonics as polynomials of a unit vector, and how lobes damp them.

Functions on the sphere that vary slowly are few numbers, the same for every direction of looking: filtered by a lobe
around p they are Σ_lm A_l c_lm Y_lm(p), A_l the lobe's own zonal coefficients (Ramamoorthi and Hanrahan 2001).
"""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def count(order: int) -> int:
    """How many functions there are up to an order: (order + 1)²."""
    return (order + 1) ** 2


def harmonics(direction: Float[Array, "*p 3"], order: int) -> Float[Array, "*p h"]:
    """Y_lm of unit vectors, l = 0 … order and m = −l … l, number l² + l + m; orthonormal over the sphere.

    z is the axis; sines of the longitude have m < 0, cosines m > 0, without the sign (−1)^m. Polynomials, so that
    derivatives are finite everywhere, poles included. The recurrence in l is the normalised one (Holmes and
    Featherstone 2002).

    Args:
        direction: unit vectors.
        order: the largest l.
    """
    x, y, z = direction[..., 0], direction[..., 1], direction[..., 2]
    values = [jnp.zeros_like(z)] * count(order)
    # (x + iy)^m, of which both parts are polynomials.
    real, imaginary = jnp.ones_like(z), jnp.zeros_like(z)
    sectoral = math.sqrt(1 / (4 * math.pi))
    for m in range(order + 1):
        if m:
            real, imaginary = x * real - y * imaginary, x * imaginary + y * real
            sectoral *= math.sqrt((2 * m + 1) / (2 * m))
        factor = math.sqrt(2) if m else 1.0
        before, legendre = jnp.zeros_like(z), jnp.full_like(z, sectoral)
        for degree in range(m, order + 1):
            if degree > m:
                a = math.sqrt((4 * degree**2 - 1) / (degree**2 - m**2))
                b = math.sqrt(((degree - 1) ** 2 - m**2) / (4 * (degree - 1) ** 2 - 1))
                before, legendre = legendre, a * (z * legendre - b * before)
            middle = degree**2 + degree
            values[middle + m] = factor * legendre * real
            if m:
                values[middle - m] = factor * legendre * imaginary
    return jnp.stack(values, axis=-1)


def lobe_bands(exponent: Float[Array, "..."], order: int) -> Float[Array, "... b"]:
    """A_l, l = 0 … order, of the lobe max(0, cosθ)ⁿ (n + 1)/2π, whose integral is 1.

    A_l = (n + 1) ∫₀¹ tⁿ P_l(t) dt: A_0 = 1, A_1 = (n + 1)/(n + 2), A_l = A_{l−2} (n − l + 2)/(n + l + 1).
    Differentiable in the exponent, from 0.
    """
    bands = [jnp.ones_like(exponent), (exponent + 1) / (exponent + 2)]
    for degree in range(2, order + 1):
        bands.append(bands[-2] * (exponent - degree + 2) / (exponent + degree + 1))
    return jnp.stack(bands[: order + 1], axis=-1)


def by_function(bands: Float[Array, "... b"]) -> Float[Array, "... h"]:
    """A number for each order as one for each function."""
    order = bands.shape[-1] - 1
    functions = [degree for degree in range(order + 1) for _ in range(2 * degree + 1)]
    return jnp.stack([bands[..., degree] for degree in functions], axis=-1)


@jax.jit
def filtered_by_lobe(
    coefficients: Float[Array, " h"], peak: Float[Array, "3"], exponent: Float[Array, ""]
) -> Float[Array, ""]:
    """The mean of a function under the lobe max(0, p·ω)ⁿ: Σ_lm A_l(n) c_lm Y_lm(p). Linear in the coefficients."""
    order = math.isqrt(coefficients.shape[-1]) - 1
    damped = coefficients * by_function(lobe_bands(exponent, order))
    return jnp.sum(damped * harmonics(peak, order), axis=-1)
