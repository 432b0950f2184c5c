"""Directional albedo, and sampling of directions to the light, for any BRDF: by values on a grid of the hemisphere.

The grid divides the disc of projected directions into rings × sectors of equal cosθ dω, so that a sum over it is an
integral with the cosine in it.
"""

import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Key

from jaxrelight.brdf.contract import Brdf
from jaxrelight.numerics import safe

# Share of samples that are spread by the cosine alone, so that no direction is missed.
_SPREAD = 0.1


@functools.partial(jax.jit, static_argnames=("rings", "sectors"))
def directional_albedo(
    brdf: Brdf, omega_o: Float[Array, "3"], rings: int = 64, sectors: int = 128
) -> Float[Array, " c"]:
    """∫ f(ω_i, ω_o) cosθ_i dω_i by the midpoint rule over rings × sectors, differentiable in the BRDF.

    Highlights narrower than a cell, π/rings across at the normal, are missed or counted too high: ask for more.
    """
    return math.pi * jnp.mean(_over_cells(brdf, omega_o, rings, sectors), axis=0)


class CellSampler(eqx.Module):
    """Draws ω_i for one ω_o in proportion to f(ω_i, ω_o) cosθ_i at the cells' centres, summed over channels.

    Within a cell directions are spread by the cosine; a tenth of all samples is spread over the hemisphere by it, so
    that every direction above the surface may come and estimates have no bias.
    """

    shares: Float[Array, " d"]
    rings: int = eqx.field(static=True)
    sectors: int = eqx.field(static=True)

    def __init__(self, brdf: Brdf, omega_o: Float[Array, "3"], rings: int = 32, sectors: int = 64):
        self.rings, self.sectors = rings, sectors
        self.shares = _shares(brdf, omega_o, rings, sectors)

    @jax.jit
    def sample(self, key: Key[Array, ""]) -> Float[Array, "3"]:
        """One direction."""
        choice, place = jax.random.split(key)
        cell = jax.random.categorical(choice, jnp.log(self.shares))
        u, v = jax.random.uniform(place, (2,), self.shares.dtype)
        return from_disc((cell // self.sectors + u) / self.rings, (cell % self.sectors + v) / self.sectors)

    @jax.jit
    def pdf(self, omega_i: Float[Array, "3"]) -> Float[Array, ""]:
        """Density of `sample` by solid angle; 0 below the surface."""
        square, azimuth = to_disc(omega_i)
        ring = jnp.clip((square * self.rings).astype(jnp.int32), 0, self.rings - 1)
        sector = jnp.clip((azimuth * self.sectors).astype(jnp.int32), 0, self.sectors - 1)
        density = self.shares[ring * self.sectors + sector] * (self.rings * self.sectors / math.pi)
        return density * safe.clamp(omega_i[2], 0)


def from_disc(square: Float[Array, ""], azimuth: Float[Array, ""]) -> Float[Array, "3"]:
    """The direction of sin²θ and φ/2π, both in 0 … 1: uniform numbers become cosine-weighted directions.

    Slopes by sin²θ, infinite at the normal and at the horizon, are 0 there.
    """
    sine, angle = safe.root(square), 2 * math.pi * azimuth
    return jnp.stack([sine * jnp.cos(angle), sine * jnp.sin(angle), safe.root(1 - square)])


def to_disc(omega: Float[Array, "3"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """sin²θ, and φ/2π in 0 … 1, of a direction; at the normal the azimuth is 0, with no slope."""
    normal = (omega[0] == 0) & (omega[1] == 0)
    azimuth = jnp.arctan2(jnp.where(normal, 0, omega[1]), jnp.where(normal, 1, omega[0]))
    return omega[0] ** 2 + omega[1] ** 2, jnp.mod(azimuth / (2 * math.pi), 1)


@functools.partial(jax.jit, static_argnames=("rings", "sectors"))
def _shares(brdf: Brdf, omega_o, rings: int, sectors: int) -> Float[Array, " d"]:
    """The share of samples in each cell."""
    values = jnp.maximum(jnp.sum(_over_cells(brdf, omega_o, rings, sectors), axis=-1), 0)
    total, count = jnp.sum(values), rings * sectors
    shares = jnp.where(total > 0, values / jnp.where(total > 0, total, 1), 1 / count)
    return (1 - _SPREAD) * shares + _SPREAD / count


def _over_cells(brdf: Brdf, omega_o, rings: int, sectors: int) -> Float[Array, "d c"]:
    """F at the centres of the cells, ring by ring."""
    square = (jnp.arange(rings, dtype=omega_o.dtype) + 0.5) / rings
    azimuth = (jnp.arange(sectors, dtype=omega_o.dtype) + 0.5) / sectors

    def ring(square):
        centres = jax.vmap(from_disc, in_axes=(None, 0))(square, azimuth)
        return jax.vmap(brdf.evaluate, in_axes=(0, None))(centres, omega_o)

    return jax.lax.map(ring, square).reshape(rings * sectors, -1)
