"""The few texels of a light that outshine all others, as a sun does: split off, to be integrated by themselves."""

from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

# The most texels, how many times as bright they are as the next one after them, and what share of the light's energy
# they hold together, at least. Of eight photographed skies and rooms, those with a sun are split at any rotation.
MOST, BRIGHTER, SHARE = 16, 4.0, 0.5


class Split(NamedTuple):
    """A light in two parts.

    Attributes:
        rest: the light without its sun: of those texels, as much as the brightest of the others has.
        texels: numbers of the brightest.
        radiance: what was taken off them; 0 where a texel is none of the sun's.
    """

    rest: Float[Array, "d c"]
    texels: Int[Array, " n"]
    radiance: Float[Array, "n c"]

    @property
    def sun(self) -> Float[Array, "d c"]:
        """What was taken off, as a light."""
        return jnp.zeros_like(self.rest).at[self.texels].set(self.radiance)


def split_sun(texels: Float[Array, "d c"]) -> Split:
    """Takes the sun off a light: rest + sun is the light. Pure; where there is no sun, nothing is taken.

    What compressed rows leave out is an error that grows with the light's coefficients, and a sun's are as large in
    fine levels as in coarse ones.

    Args:
        texels: radiance of d > 16 texels of a cube map.
    """
    largest = jnp.max(jnp.abs(texels))
    scaled = texels / jnp.where(largest > 0, largest, 1)
    energy = jnp.sum(jnp.square(scaled), axis=1)
    top, index = jax.lax.top_k(energy, MOST + 1)
    limit, top, index = top[-1], top[:-1], index[:-1]
    bright = (top > BRIGHTER**2 * limit) & (top > 0)
    is_sun = jnp.sum(jnp.where(bright, top, 0)) >= SHARE * jnp.sum(energy)
    stays = jnp.where(bright & is_sun, jnp.sqrt(limit / jnp.where(bright, top, 1)), 1.0)[:, None]
    # A product, not a difference: exactly 0 where all stays, however XLA may round.
    return Split(texels.at[index].multiply(stays), index, texels[index] * (1 - stays))
