"""Numbers that vary over a surface: an image by texture coordinates, and coarser ones for surfaces far away."""

import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int

from jaxrelight.numerics.arrays import as_array, on_host
from jaxrelight.numerics.numbers import Numbers, as_numbers, float_dtype, module_of

# The area in texture coordinates that a pixel of the picture covers.
Footprint = Float[Array, ""] | float


class Texture(eqx.Module):
    """An image over the unit square of texture coordinates, repeated beyond it and looked up bilinearly.

    Row 0 is the top: (u, v) = (0, 1) is the image's upper left corner, as in OBJ files. An image of one pixel is a
    constant. Differentiable in the pixels.

    Attributes:
        pixels: the image.
        coarser: texels of the levels of detail that follow it, one after the other, each row by row; a texel of a level
            stands for 2×2 of the one before. None for none: `minified` makes them.
    """

    pixels: Float[Array, "h w c"]
    coarser: Float[Array, "t c"] | None = None

    @property
    def is_constant(self) -> bool:
        """Whether no texture coordinates are needed."""
        return self.pixels.shape[:2] == (1, 1)

    @property
    def shape(self) -> tuple[int, int]:
        """(rows, columns)."""
        return self.pixels.shape[0], self.pixels.shape[1]

    def minified(self) -> "Texture":
        """The same image with all coarser levels, each the means of 2×2 texels, as far as a single one."""
        return self if self.is_constant else Texture(self.pixels, _coarser(self.pixels))

    @jax.jit
    def look_up(self, uv: Float[Array, "2"], footprint: Footprint = 0.0) -> Float[Array, " c"]:
        """The image at (u, v): linear between texels, and between the two levels whose texels are nearest in size."""
        if self.is_constant:
            return self.pixels[0, 0]
        # One texel at a time: arrays of four are several times slower.
        return functools.reduce(jnp.add, [weight * texel for texel, weight in self.around(uv, footprint)])

    @jax.jit
    def around(
        self, uv: Float[Array, "2"], footprint: Footprint = 0.0
    ) -> list[tuple[Float[Array, " c"], Float[Array, ""]]]:
        """The texels that `look_up` reads, four of a level, each with its weight."""
        h, w, c = self.pixels.shape
        finest = jnp.asarray(self.pixels).reshape(h * w, c)
        # The whole part goes first, so that far repetitions lose no more digits than their coordinates have lost.
        x, y = (uv[0] - jnp.floor(uv[0])) * w, (1 - (uv[1] - jnp.floor(uv[1]))) * h
        if self.coarser is None:
            return [(_read(finest, place), weight) for place, weight in _four(x, y, h, w)]
        sizes = _sizes(h, w, len(self.coarser))
        starts = np.cumsum([0, *(rows * columns for rows, columns in sizes[1:])])[:-1]
        level = 0.5 * jnp.log2(jnp.clip(footprint * (h * w), 1, 4.0 ** (len(sizes) - 1)))
        lower = jnp.minimum(jnp.floor(level), len(sizes) - 2).astype(jnp.int32)
        share = level - lower
        coarser, table, at = jnp.asarray(self.coarser), jnp.asarray(sizes, jnp.int32), jnp.asarray(starts, jnp.int32)

        def of_level(number):
            scale = jnp.exp2(-number.astype(x.dtype))
            return _four(x * scale, y * scale, table[number, 0], table[number, 1])

        texels = []
        for place, weight in of_level(lower):
            # The finest level is read only where it is the lower one; elsewhere both reads are of `coarser`.
            first = _read(finest, jnp.where(lower == 0, place, 0))
            other = _read(coarser, jnp.where(lower == 0, 0, at[lower - 1] + place))
            texels.append((jnp.where(lower == 0, first, other), (1 - share) * weight))
        return texels + [(_read(coarser, at[lower] + place), share * weight) for place, weight in of_level(lower + 1)]


def _read(texels, place):
    return texels.at[place].get(mode="promise_in_bounds")


def _four(x, y, h, w) -> list[tuple[Int[Array, ""], Float[Array, ""]]]:
    """Places of the four texels around (x, y), counted in texels from the upper left corner, and their weights."""
    left, top = jnp.floor(x - 0.5), jnp.floor(y - 0.5)
    right, down = x - 0.5 - left, y - 0.5 - top
    column, row = left.astype(jnp.int32), top.astype(jnp.int32)
    return [
        ((row + i) % h * w + (column + j) % w, (down if i else 1 - down) * (right if j else 1 - right))
        for i in (0, 1)
        for j in (0, 1)
    ]


def _sizes(h: int, w: int, coarser: int) -> list[tuple[int, int]]:
    """Rows and columns of an image and of the levels that so many texels hold."""
    sizes = [(h, w)]
    while coarser > 0:
        sizes.append(halved_shape(*sizes[-1]))
        coarser -= sizes[-1][0] * sizes[-1][1]
    assert coarser == 0, "the texels of coarser levels do not fit the image"
    return sizes


def halved_shape(h: int, w: int) -> tuple[int, int]:
    """Rows and columns of the next level of detail."""
    return -(-h // 2), -(-w // 2)


def _coarser(pixels: Float[Array | np.ndarray, "h w c"]) -> Float[Array, "t c"]:
    """Texels of the coarser levels, made by NumPy where they are known: a compiled program would serve one size."""
    module, flat, level = module_of(pixels), [], on_host(pixels)
    while level.shape[:2] != (1, 1):
        level = _halved(module, level)
        flat.append(level.reshape(-1, level.shape[-1]))
    return as_array(module.concatenate(flat))


def _halved(module: Any, level: Float[Array | np.ndarray, "h w c"]) -> Float[Array | np.ndarray, "r q c"]:
    """Means of 2×2 texels; of those that are there at an odd border."""
    for axis in (0, 1):
        first, second = (level[i::2] if axis == 0 else level[:, i::2] for i in (0, 1))
        if level.shape[axis] % 2:
            last = level[-1:] if axis == 0 else level[:, -1:]
            second = module.concatenate([second, last], axis=axis)
        level = (first + second) / 2
    return level


# A product of textures; the empty one is 1.
Weight = tuple[Texture, ...]


def constant(values: Numbers, dtype: DTypeLike | None = None) -> Texture:
    """The same numbers everywhere: one, or one per channel, traced or not.

    The dtype is by default that of the arrays given, or JAX's own for numbers of Python.
    """
    dtype = float_dtype(values) if dtype is None else dtype
    numbers = as_numbers(values)
    return Texture(as_array(module_of(numbers).atleast_1d(numbers)[None, None], dtype))


@jax.jit
def look_up(weight: Weight, uv: Float[Array, "2"], footprint: Footprint = 0.0) -> Float[Array, " c"]:
    """The product of textures at (u, v)."""
    value = jnp.ones(1, uv.dtype)
    for texture in weight:
        value = value * texture.look_up(uv, footprint)
    return value
