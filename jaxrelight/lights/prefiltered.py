"""Environments filtered for lobes of every exponent: one set of maps for all BRDFs (McAllister 2002 §6, eqs. 7–11)."""

import math

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.basis import latlong
from jaxrelight.basis.zonal import zonal_means

# n + 1 of neighbouring maps differs by the factor √2: a lobe between them is their mixture within 1 % of its norm.
_PER_DOUBLING = 2
# The largest n + 1; a sharper lobe counts as one of the last map, under a degree wide.
_SHARPEST = 2**14


class PrefilteredMaps(eqx.Module):
    """Means S(p, n) (n + 1)/2π of an environment's radiance, weighted by max(0, p·ω)ⁿ around every direction p.

    The diffuse map D(n) = ∫ max(0, n·ω) L(ω) dω is the same as S(n, 1), so it is among them.

    Attributes:
        texels: of all maps, one after the other; each is a lat-long map of `heights` rows and twice as many columns.
        heights: of the maps, by ascending exponent.
    """

    texels: Float[Array, "t c"]
    heights: tuple[int, ...] = eqx.field(static=True)

    def look_up(self, direction: Float[Array, "3"], exponent: Float[Array, ""]) -> Float[Array, " c"]:
        """The mean around a unit direction; between texels and maps, linearly. Differentiable in everything.

        Exponents run from 0 to `most`, and are held there beyond; the maps between which one lies go with log(n + 1).
        """
        level = jnp.log2(jnp.maximum(exponent, 0) + 1) * _PER_DOUBLING
        level = jnp.clip(level, 0, len(self.heights) - 1)
        lower = jnp.minimum(jnp.floor(level), len(self.heights) - 2)
        part = level - lower
        lower = lower.astype(jnp.int32)
        u, v = latlong.finite_coordinates(direction)
        return (1 - part) * self.at_level(lower, u, v) + part * self.at_level(lower + 1, u, v)

    @property
    def most(self) -> float:
        """The largest exponent."""
        return exponents()[-1]

    def map(self, level: int) -> Float[Array, "h w c"]:
        """One map, for the exponent of that place in `exponents()`."""
        start, height = self._starts[level], self.heights[level]
        return self.texels[start : start + 2 * height**2].reshape(height, 2 * height, -1)

    @property
    def _starts(self) -> np.ndarray:
        return np.cumsum([0, *(2 * height**2 for height in self.heights[:-1])])

    def at_level(self, level: Int[Array, ""], u: Float[Array, ""], v: Float[Array, ""]) -> Float[Array, " c"]:
        """One map at image coordinates, bilinearly; beyond a pole lies the other side of it."""
        height = jnp.asarray(self.heights, jnp.int32)[level]
        start = jnp.asarray(self._starts, jnp.int32)[level]
        x, y = u * (2 * height) - 0.5, v * height - 0.5
        left, top = jnp.floor(x), jnp.floor(y)

        def texel(row, column):
            beyond = (row < 0) | (row >= height)
            row = jnp.where(row < 0, -1 - row, jnp.where(row >= height, 2 * height - 1 - row, row))
            column = jnp.mod(column + jnp.where(beyond, height, 0), 2 * height)
            return self.texels.at[start + row * (2 * height) + column].get(mode="promise_in_bounds")

        row, column = top.astype(jnp.int32), left.astype(jnp.int32)
        right, down = x - left, y - top
        upper = (1 - right) * texel(row, column) + right * texel(row, column + 1)
        lower = (1 - right) * texel(row + 1, column) + right * texel(row + 1, column + 1)
        return (1 - down) * upper + down * lower


def exponents() -> list[float]:
    """The exponents that maps are made for, from 0."""
    count = _PER_DOUBLING * round(math.log2(_SHARPEST)) + 1
    return [2 ** (level / _PER_DOUBLING) - 1 for level in range(count)]


def prefilter(pixels: Float[Array | np.ndarray, "h w c"], finest: int = 512, equal: bool = False) -> PrefilteredMaps:
    """All maps of an environment's radiance; linear and differentiable in it.

    Args:
        pixels: a lat-long map of any size.
        finest: rows of the finest map, a power of two of at least 32. A map has the next power of two from 4π√(n + 1).
        equal: give all maps the finest's rows instead: larger, and nearer between texels.

    Raises:
        ValueError: for another number of rows.
    """
    if finest < 32 or finest & (finest - 1):
        raise ValueError(f"the finest map has {finest} rows; they must be a power of two from 32")
    fitting = [2 ** math.ceil(math.log2(4 * math.pi * math.sqrt(n + 1))) for n in exponents()]
    heights = [finest if equal else min(max(height, 32), finest) for height in fitting]
    resized = {height: jnp.asarray(latlong.resized(pixels, height, 2 * height)) for height in sorted({*heights})}
    maps = [zonal_means(resized[height], n) for height, n in zip(heights, exponents(), strict=True)]
    return PrefilteredMaps(jnp.concatenate([one.reshape(-1, one.shape[-1]) for one in maps]), tuple(heights))
