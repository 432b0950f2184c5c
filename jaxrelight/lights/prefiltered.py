"""Environments filtered for lobes of every exponent: one set of maps for all BRDFs (McAllister 2002 §6, eqs. 7–11)."""

import collections
import math
import weakref
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.basis import latlong
from jaxrelight.basis.zonal import filtered_maps
from jaxrelight.lights.environment import Environment, check_pixels, coarsened
from jaxrelight.numerics import safe
from jaxrelight.numerics.arrays import is_traced, on_host
from jaxrelight.numerics.numbers import Number

# n + 1 of neighbouring maps differs by the factor √2: a lobe between them is their mixture within 1 % of its norm.
_PER_DOUBLING = 2
# The largest n + 1; a sharper lobe counts as one of the last map, under a degree wide.
_SHARPEST = 2**14
# Rows of maps are multiples of so many.
_ROWS = 16
# An environment is made coarse first, as for a cube map of this resolution, or of a quarter of the finest map's rows.
COARSE_RESOLUTION = 128
# Environments whose maps are remembered.
_MAX_REMEMBERED = 4


class PrefilteredMaps(eqx.Module):
    """Means S(p, n) (n + 1)/2π of an environment's radiance, weighted by max(0, p·ω)ⁿ around every direction p.

    The diffuse map D(n) = ∫ max(0, n·ω) L(ω) dω is the same as S(n, 1), so it is among them.

    Attributes:
        texels: of all maps, one after the other; each is a lat-long map of `heights` rows and twice as many columns.
        heights: of the maps, by ascending exponent.
        first: the place in `exponents()` of the first map's exponent.
    """

    texels: Float[Array, "t c"]
    heights: tuple[int, ...] = eqx.field(static=True)
    first: int = eqx.field(static=True, default=0)

    def look_up(
        self, direction: Float[Array, "3"], exponent: Float[Array, ""], rotate_y: Number = 0.0
    ) -> Float[Array, " c"]:
        """The mean around a unit direction; between texels and maps, linearly. Differentiable in everything.

        Args:
            direction: in the world.
            exponent: held within those of the maps; the maps between which one lies go with log(n + 1).
            rotate_y: degrees that the environment is turned about +y, as `Environment`.
        """
        level = jnp.log2(safe.clamp(exponent, 0) + 1) * _PER_DOUBLING - self.first
        level = safe.clamp(level, 0, len(self.heights) - 1)
        lower = jnp.clip(jnp.floor(level), 0, max(len(self.heights) - 2, 0))
        part = level - lower
        lower = lower.astype(jnp.int32)
        u, v = latlong.finite_coordinates(direction)
        u = u + jnp.asarray(rotate_y, u.dtype) / 360
        if len(self.heights) == 1:
            return self.at_level(lower, u, v)
        return (1 - part) * self.at_level(lower, u, v) + part * self.at_level(lower + 1, u, v)

    @property
    def exponents(self) -> list[float]:
        """The exponents of the maps."""
        return exponents()[self.first : self.first + len(self.heights)]

    def map(self, level: int) -> Float[Array, "h w c"]:
        """One map, for the exponent of that place in `exponents`."""
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


def prefilter(
    pixels: Float[Array | np.ndarray, "h w c"],
    finest: int = 512,
    equal: bool = False,
    between: tuple[float, float] | None = None,
) -> PrefilteredMaps:
    """Maps of an environment's radiance; linear and differentiable in it.

    Args:
        pixels: a lat-long map of any size.
        finest: rows of the finest map, a power of two of at least 32. A map has 8π√(n + 1) rows.
        equal: give all maps the finest's rows instead: larger, and nearer between texels.
        between: the least and the largest exponent that will be asked for; by default there are maps for all.

    Raises:
        ValueError: for another number of rows.
        InputError: for known pixels that are not finite.
    """
    check_pixels(pixels, "the environment")
    return _prefiltered(pixels, finest, equal, between)


def _prefiltered(pixels, finest: int, equal: bool, between: tuple[float, float] | None) -> PrefilteredMaps:
    if finest < 32 or finest & (finest - 1):
        raise ValueError(f"the finest map has {finest} rows; they must be a power of two from 32")
    every, first = exponents(), 0
    if between is not None:
        first = int(np.clip(np.searchsorted(every, between[0], side="right") - 1, 0, len(every) - 1))
        end = int(np.searchsorted(every, between[1], side="left")) + 1
        every = every[first : max(end, first + 1)]
    rows = [finest if equal else _ROWS * math.ceil(8 * math.pi * math.sqrt(n + 1) / _ROWS) for n in every]
    heights = [min(max(height, 32), finest) for height in rows]
    # Finer pixels are seen by none of the maps, but cost memory and time.
    maps = filtered_maps(coarsened(pixels, max(COARSE_RESOLUTION, finest // 4)), every, heights)
    return PrefilteredMaps(_joined(maps), tuple(heights), first)


@jax.jit
def _joined(maps: list[Float[Array, "_ _ c"]]) -> Float[Array, "t c"]:
    return jnp.concatenate([one.reshape(-1, one.shape[-1]) for one in maps])


class _Remembered(NamedTuple):
    """Maps, and what they were made of."""

    pixels: weakref.ref
    asked: tuple
    maps: PrefilteredMaps


_REMEMBERED: collections.deque[_Remembered] = collections.deque(maxlen=_MAX_REMEMBERED)


def maps_of(environment: Environment, finest: int = 512, between: tuple[float, float] | None = None) -> PrefilteredMaps:
    """Maps of an environment before it is turned and scaled; those of the last few are remembered while they live.

    Args:
        environment: whose pixels are filtered; one that is turned or scaled otherwise has the same maps.
        finest: see `prefilter`.
        between: see `prefilter`.
    """
    pixels, asked = environment.pixels, (finest, between)
    if is_traced(pixels):
        return _prefiltered(pixels, finest, False, between)
    # JAX's arrays do not change.
    for known in _REMEMBERED:
        if known.pixels() is pixels and known.asked == asked:
            return known.maps
    maps = _prefiltered(on_host(pixels), finest, False, between)
    _REMEMBERED.append(_Remembered(weakref.ref(pixels), asked, maps))
    return maps
