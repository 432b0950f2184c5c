"""Lobes by unknowns that are free of bounds."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

# A lobe of the smallest is constant to 1 %; one of the largest is a fifth of a degree wide.
EXPONENTS = 1e-3, 1e5
_LOW, _HIGH = (math.log(n) for n in EXPONENTS)


class Chart(eqx.Module):
    """The lobes around given ones, each by the logit of its exponent and one or two coordinates of its C.

    C is centre + u · tangents, of which only the direction counts: its length is a linear factor. The logarithm of the
    exponent is a sigmoid over `EXPONENTS`.
    """

    centre: Float[Array, "l 3"]
    tangents: Float[Array, "l t 3"]

    def lobes(self, unknowns: Float[Array, "l q"]) -> tuple[Float[Array, "l 3"], Float[Array, " l"]]:
        """C with max|C| = 1, and the exponents, of unknowns q = 1 + t."""
        C = self.centre + jnp.sum(unknowns[:, 1:, None] * self.tangents, axis=1)
        C = C / jnp.max(jnp.abs(C), axis=-1, keepdims=True)
        return C, jnp.exp(_LOW + (_HIGH - _LOW) * jax.nn.sigmoid(unknowns[:, 0]))

    def log_exponent_slope(self, unknowns: Float[Array, "l q"]) -> Float[Array, " l"]:
        """∂ log exponent / ∂ its unknown."""
        share = jax.nn.sigmoid(unknowns[:, 0])
        return (_HIGH - _LOW) * share * (1 - share)


def chart_around(
    C: Float[Array, "l 3"], exponent: Float[Array, " l"], anisotropic: bool
) -> tuple[Chart, Float[Array, "l q"]]:
    """The chart around lobes, and their own unknowns in it.

    Without `anisotropic`, Cx = Cy, and the only tangent is the one along which they stay equal.
    """
    x, y, z = (C / jnp.sqrt(jnp.sum(C * C, axis=-1, keepdims=True))).T
    if anisotropic:
        # Two of the columns of an orthonormal matrix whose third is C (Duff et al. 2017).
        sign = jnp.where(z >= 0, 1.0, -1.0).astype(C.dtype)
        a = -1 / (sign + z)
        first = jnp.stack([1 + sign * x * x * a, sign * x * y * a, -sign * x], axis=-1)
        second = jnp.stack([x * y * a, sign + y * y * a, -y], axis=-1)
        tangents = jnp.stack([first, second], axis=1)
    else:
        half = math.sqrt(0.5)
        tangents = jnp.stack([-z * half, -z * half, (x + y) * half], axis=-1)[:, None]
    share = jnp.clip((jnp.log(exponent) - _LOW) / (_HIGH - _LOW), 1e-4, 1 - 1e-4)
    logit = jnp.log(share) - jnp.log1p(-share)
    unknowns = jnp.concatenate([logit[:, None], jnp.zeros((len(C), tangents.shape[1]), C.dtype)], axis=1)
    return Chart(jnp.stack([x, y, z], axis=-1), tangents), unknowns
