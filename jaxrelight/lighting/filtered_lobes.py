"""Light reflected by lobes: filtered light times filtered visibility.

Filtered light is the mean radiance of an environment under a lobe (McAllister 2002 eq. 11, with the cosine and the
horizon inside of the integral); filtered visibility is the share of the lobe that nothing blocks.

Axes: l lobes, c1 channels that they differ in, or 1, j narrower lobes that each is divided into.
"""

from collections.abc import Callable
from typing import Literal, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.brdf.horizon import clip_lobe
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.sub_lobes import sub_lobes
from jaxrelight.numerics import safe

# How the cosine and the horizon come in: by a lobe that stands for the product, or outside the integral (eq. 11).
Horizon = Literal["cut", "outside"]
# A mean under the lobe max(0, p·ω)ⁿ, by p in the world and n: of radiance by channel, or of visibility.
LobeMean = Callable[[Float[Array, "3"], Float[Array, ""]], Array]


class ReflectedLobes(NamedTuple):
    """Where the lobes of a BRDF gather light from, for one direction to the eye.

    Attributes:
        directions: p in the world.
        exponents: n of the lobes max(0, p·ω)ⁿ under which light is averaged.
        weights: factors on those means, without the lobes' scale.
    """

    directions: Float[Array, "l c1 j 3"]
    exponents: Float[Array, "l c1 j"]
    weights: Float[Array, "l c1 j"]


def reflected_lobes(
    lobes: LobeSum,
    omega_o: Float[Array, "3"],
    frame: Float[Array, "3 3"],
    *,
    horizon: Horizon = "cut",
    narrower: int = 1,
) -> ReflectedLobes:
    """The lobes max(0, ω_oᵀC_l ω)ⁿ max(0, N·ω) of ω, each as lobes of a single peak; differentiable in everything.

    Args:
        lobes: of one point.
        omega_o: local direction to the eye.
        frame: rows tangent, binormal, normal.
        horizon: see `Prefiltered.horizon`.
        narrower: lobes that each is divided into, see `brdf.sub_lobes`; with horizon "cut".
    """
    peak, length = lobes.peak(omega_o)

    def divided(peak, exponent):
        parts = sub_lobes(peak, exponent, narrower)
        share, peaks, sharpness = clip_lobe(parts.peaks, jnp.broadcast_to(parts.exponent, (narrower,)))
        weight = parts.shares * share
        # In a white world they reflect what the whole lobe does.
        total = jnp.sum(weight)
        is_seen = total > 1e-12
        weight = weight * jnp.where(is_seen, clip_lobe(peak, exponent).share / jnp.where(is_seen, total, 1), 0)
        return peaks, sharpness, weight

    if horizon == "outside":
        peaks, sharpness, share = peak[..., None, :], lobes.exponent[..., None], jnp.maximum(peak[..., 2:], 0)
    elif narrower == 1:
        share, peaks, sharpness = clip_lobe(peak[..., None, :], lobes.exponent[..., None])
    else:
        peaks, sharpness, share = jax.vmap(jax.vmap(divided))(peak, lobes.exponent)
    strength = safe.power(length, lobes.exponent) * (2 * np.pi / (lobes.exponent + 1))
    return ReflectedLobes(peaks @ frame, sharpness, share * strength[..., None])


def lobe_radiance(
    lobes: LobeSum,
    omega_o: Float[Array, "3"],
    frame: Float[Array, "3 3"],
    light: LobeMean,
    visibility: LobeMean | Float[Array, "l c1 j"] | None = None,
    *,
    horizon: Horizon = "cut",
    narrower: int = 1,
) -> Float[Array, " c"]:
    """Radiance towards ω_o that the lobes of a BRDF reflect at one point; its diffuse part is left out.

    Σ_l scale_l ∫ max(0, ω_oᵀC_l ω)ⁿ max(0, N·ω) L(ω) V(ω) dω, the mean of L V under each lobe taken as that of L times
    that of V. Linear in light; differentiable in everything.

    Args:
        lobes: of the point.
        omega_o: local direction to the eye.
        frame: rows tangent, binormal, normal.
        light: mean radiance [c].
        visibility: mean visibility, or its values for `reflected_lobes`; None where nothing is blocked.
        horizon: see `Prefiltered.horizon`.
        narrower: lobes that each is divided into.
    """
    if lobes.is_constant:
        return jnp.zeros(lobes.channels, frame.dtype)
    reflected = reflected_lobes(lobes, omega_o, frame, horizon=horizon, narrower=narrower)
    pair, weights = (reflected.directions, reflected.exponents), reflected.weights
    if callable(visibility):
        weights = weights * _vmapped(visibility)(*pair)
    elif visibility is not None:
        weights = weights * visibility
    means = jnp.einsum("lcj,lcjx->lcx", weights, _vmapped(light)(*pair), precision="highest")
    means = means[:, 0] if means.shape[1] == 1 else jnp.diagonal(means, axis1=1, axis2=2)
    return jnp.sum(lobes.scale * means, axis=0)


def _vmapped(mean: LobeMean) -> Callable:
    """A mean of all lobes."""
    return jax.vmap(jax.vmap(jax.vmap(mean)))
