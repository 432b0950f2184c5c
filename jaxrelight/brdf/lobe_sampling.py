"""Drawing directions to the light by the lobes of a Lafortune BRDF (Lafortune 1997 §4; McAllister 2002 §5)."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.geometry.frame import tangent_frame
from jaxrelight.numerics import safe

# Share of samples that the cosine takes at least, so that estimates have no bias where lobes are 0.
_MIN_COSINE_SHARE = 0.05


class LobeSampler(eqx.Module):
    """ω_i for one ω_o, drawn from a mixture: the cosine, and for every lobe max(0, ω_i · p)ⁿ about its peak p.

    The cosine is a lobe about the normal, of exponent 1, and comes first. A lobe's density is
    (n + 1)/2π · max(0, ω · p)ⁿ; its frame's third row is p.

    A lobe's share grows with what it holds over the whole sphere, scale · |Cᵀω_o|ⁿ · 2π/(n + 1), summed over channels;
    the cosine's with the diffuse albedo. A lobe whose C or exponent differ by channel is drawn by each channel's.
    Directions drawn below the surface reflect nothing; they count as samples all the same, so the density integrates
    to 1 over the sphere, not the hemisphere.
    """

    shares: Float[Array, " m"]
    frames: Float[Array, "m 3 3"]
    exponents: Float[Array, " m"]

    def __init__(self, brdf: LobeSum, omega_o: Float[Array, "3"]):
        self.shares, self.frames, self.exponents = _mixture(brdf, omega_o)

    @jax.jit
    def sample(self, key: Key[Array, ""]) -> Float[Array, "3"]:
        """One direction; it may lie below the surface."""
        return self.at(*jax.random.uniform(key, (2,), self.shares.dtype))

    @jax.jit
    def at(self, u: Float[Array, ""], v: Float[Array, ""]) -> Float[Array, "3"]:
        """The direction that two numbers from 0 to 1 stand for: uniform ones, random or not, give its density.

        The first also chooses the lobe, by which of their shares it falls into, so that evenly spread numbers are so
        in each of them. At a lobe's first number the direction is its peak; the slope by it, infinite, is 0 there.
        """
        # The choice is written out, which is several times faster than look-ups and products of small matrices.
        reached, exponent, frame = jnp.cumsum(self.shares), self.exponents[0], self.frames[0]
        start, share = jnp.zeros_like(u), self.shares[0]
        for k in range(1, len(self.shares)):
            beyond = (u >= reached[k - 1]) & (self.shares[k] > 0)
            exponent = jnp.where(beyond, self.exponents[k], exponent)
            frame = jnp.where(beyond, self.frames[k], frame)
            start, share = jnp.where(beyond, reached[k - 1], start), jnp.where(beyond, self.shares[k], share)
        # Rounding of shares must not reach 1.
        u = safe.clamp((u - start) / share, 0, 1 - float(jnp.finfo(u.dtype).eps))
        # 1 − u, since u may be 0 but not 1.
        log_cosine = jnp.log1p(-u) / (exponent + 1)
        cosine, sine = jnp.exp(log_cosine), safe.root(-jnp.expm1(2 * log_cosine))
        angle = 2 * math.pi * v
        return sine * (jnp.cos(angle) * frame[0] + jnp.sin(angle) * frame[1]) + cosine * frame[2]

    @jax.jit
    def drawn(self, *numbers: Float[Array, ""]) -> tuple[Float[Array, "3"], Float[Array, ""]]:
        """`at`, and its density."""
        omega_i = self.at(*numbers)
        return omega_i, self.pdf(omega_i)

    @jax.jit
    def pdf(self, omega_i: Float[Array, "3"]) -> Float[Array, ""]:
        """Density of `sample` by solid angle, over the whole sphere."""
        # The sum is written out: over an axis, XLA 0.10 for CPUs fuses it with those of a BRDF and makes both wrong.
        density = jnp.zeros((), omega_i.dtype)
        for share, frame, exponent in zip(self.shares, self.frames, self.exponents, strict=True):
            cosine = frame[2, 0] * omega_i[0] + frame[2, 1] * omega_i[1] + frame[2, 2] * omega_i[2]
            density += share * (exponent + 1) / (2 * math.pi) * safe.power(cosine, exponent)
        return density


@jax.jit
def _mixture(brdf: LobeSum, omega_o: Float[Array, "3"]) -> tuple[Array, Array, Array]:
    """Shares, frames and exponents."""
    peaks, lengths = brdf.peak(omega_o)
    shared = brdf.C.shape[1] == 1
    scale = jnp.sum(brdf.scale, axis=1, keepdims=True) if shared else brdf.scale
    held = scale * safe.power(lengths, brdf.exponent) * (2 * math.pi) / (brdf.exponent + 1)
    shares = jnp.concatenate([jnp.sum(brdf.diffuse)[None], jnp.maximum(held, 0).ravel()])
    total = jnp.sum(shares)
    even = jnp.zeros_like(shares).at[0].set(1)
    shares = jnp.where(total > 0, shares / jnp.where(total > 0, total, 1), even)
    shares = (1 - _MIN_COSINE_SHARE) * shares + _MIN_COSINE_SHARE * even
    up = jnp.asarray([[0, 0, 1]], peaks.dtype)
    frames = tangent_frame(jnp.concatenate([up, peaks.reshape(-1, 3)]))
    exponents = jnp.concatenate([jnp.ones(1, peaks.dtype), brdf.exponent.ravel()])
    return shares, frames, exponents
