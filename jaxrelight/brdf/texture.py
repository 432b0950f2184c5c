"""Numbers that vary over a surface: images by texture coordinates, and the colours of vertices.

Surface coordinates of a point are u and v of the first set of texture coordinates; then, where there are more, three
numbers for each further set: u, v and the area of that set over that of the first; and last, where any mesh of the
scene has colours, the three channels of the colour. `jaxrelight.geometry.surfaces` makes them.
"""

import dataclasses
import functools
from typing import Any, Literal, Protocol, runtime_checkable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int

from jaxrelight.errors import InputError
from jaxrelight.numerics import safe
from jaxrelight.numerics.arrays import as_array, on_host
from jaxrelight.numerics.numbers import Numbers, as_numbers, float_dtype, module_of

# The area in the first set of texture coordinates that a pixel of the picture covers.
Footprint = Float[Array, ""] | float
# What is beyond an edge of an image: the image again, its outermost texels, or its mirror image.
Wrap = Literal["repeat", "clamp", "mirror"]


class Texture(eqx.Module):
    """An image over the unit square of texture coordinates, by default repeated beyond it, and looked up bilinearly.

    Row 0 is the top: (u, v) = (0, 1) is the image's upper left corner, as in OBJ files. An image of one pixel is a
    constant. Differentiable in the pixels and in the placement.

    Attributes:
        pixels: the image.
        coarser: texels of the levels of detail that follow it, one after the other, each row by row; a texel of a level
            stands for 2×2 of the one before. None for none: `minified` makes them.
        placement: the matrix that takes (u, v, 1) of a surface to (u, v) in the image; None for the identity.
        uv_set: number of the set of texture coordinates that it follows, counted from 0.
        wrap: what is beyond the edges, along u and along v.
    """

    pixels: Float[Array, "h w c"]
    coarser: Float[Array, "t c"] | None = None
    placement: Float[Array, "2 3"] | None = None
    uv_set: int = eqx.field(default=0, static=True)
    wrap: tuple[Wrap, Wrap] = eqx.field(default=("repeat", "repeat"), static=True)

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
        return self if self.is_constant else dataclasses.replace(self, coarser=_coarser(self.pixels))

    @property
    def mean(self) -> np.ndarray:
        """The mean of the image by channel; not for gradients."""
        return np.asarray(self.pixels).mean(axis=(0, 1))

    def content(self) -> list:
        """Arrays and settings that tell it from other textures, for the keys of a store."""
        layout = [] if self.has_plain_layout else [self.uv_set, *self.wrap]
        placement = [] if self.placement is None else [np.asarray(self.placement)]
        return [np.asarray(self.pixels), *layout, *placement]

    @property
    def has_plain_layout(self) -> bool:
        """Whether it lies at (u, v) of the first set of texture coordinates and repeats."""
        return self.placement is None and self.uv_set == 0 and self.wrap == ("repeat", "repeat")

    def coordinates(self, uv: Float[Array | np.ndarray, "*p u"]) -> Float[Array | np.ndarray, "*p 2"]:
        """(u, v) in the image, of surface coordinates that lead with any axes."""
        return image_coordinates(uv, self.placement, self.uv_set)

    @jax.jit
    def look_up(self, uv: Float[Array, " u"], footprint: Footprint = 0.0) -> Float[Array, " c"]:
        """The image at surface coordinates: linear between texels, and between the two levels of nearest size."""
        if self.is_constant:
            return self.pixels[0, 0]
        # One texel at a time: arrays of four are several times slower.
        return functools.reduce(jnp.add, [weight * texel for texel, weight in self.around(uv, footprint)])

    @jax.jit
    def around(
        self, uv: Float[Array, " u"], footprint: Footprint = 0.0
    ) -> list[tuple[Float[Array, " c"], Float[Array, ""]]]:
        """The texels that `look_up` reads, four of a level, each with its weight."""
        h, w, c = self.pixels.shape
        finest = jnp.asarray(self.pixels).reshape(h * w, c)
        place, footprint = self.coordinates(uv), image_footprint(uv, footprint, self.placement, self.uv_set)
        x, y = wrapped(place[0], self.wrap[0]) * w, (1 - wrapped(place[1], self.wrap[1])) * h
        if self.coarser is None:
            return [(read_texel(finest, place), weight) for place, weight in four_texels(x, y, h, w, self.wrap)]
        sizes = level_sizes(h, w, len(self.coarser))
        starts = np.cumsum([0, *(rows * columns for rows, columns in sizes[1:])])[:-1]
        level = 0.5 * jnp.log2(safe.clamp(jnp.asarray(footprint * (h * w), uv.dtype), 1, 4.0 ** (len(sizes) - 1)))
        lower = jnp.minimum(jnp.floor(level), len(sizes) - 2).astype(jnp.int32)
        share = level - lower
        coarser, table, at = jnp.asarray(self.coarser), jnp.asarray(sizes, jnp.int32), jnp.asarray(starts, jnp.int32)

        def of_level(number):
            scale = jnp.exp2(-number.astype(x.dtype))
            return four_texels(x * scale, y * scale, table[number, 0], table[number, 1], self.wrap)

        texels = []
        for place, weight in of_level(lower):
            # The finest level is read only where it is the lower one; elsewhere both reads are of `coarser`.
            first = read_texel(finest, jnp.where(lower == 0, place, 0))
            other = read_texel(coarser, jnp.where(lower == 0, 0, at[lower - 1] + place))
            texels.append((jnp.where(lower == 0, first, other), (1 - share) * weight))
        return texels + [
            (read_texel(coarser, at[lower] + place), share * weight) for place, weight in of_level(lower + 1)
        ]


def image_coordinates(
    uv: Float[Array | np.ndarray, "*p u"], placement: Float[Array | np.ndarray, "2 3"] | None, uv_set: int
) -> Float[Array | np.ndarray, "*p 2"]:
    """(u, v) in an image that lies on a surface as a `Texture` says, of surface coordinates."""
    first = _first_column(uv_set)
    if uv.shape[-1] < first + 2:
        raise InputError(f"a texture needs set {uv_set} of texture coordinates; add it to the mesh, or take set 0")
    place = uv if uv.shape[-1] == 2 else uv[..., first : first + 2]
    if placement is None:
        return place
    u, v, matrix = place[..., 0], place[..., 1], as_array(placement, place.dtype)
    if isinstance(uv, np.ndarray):
        matrix = np.asarray(placement, uv.dtype)
    rows = [matrix[i, 0] * u + matrix[i, 1] * v + matrix[i, 2] for i in (0, 1)]
    return (np if isinstance(uv, np.ndarray) else jnp).stack(rows, axis=-1)


def image_footprint(
    uv: Float[Array, " u"], footprint: Footprint, placement: Float[Array, "2 3"] | None, uv_set: int
) -> Footprint:
    """The area in an image of what covers an area in the first set of texture coordinates."""
    if uv_set:
        footprint = footprint * uv[_first_column(uv_set) + 2]
    if placement is not None:
        (a, b), (c, d) = placement[0, :2], placement[1, :2]
        footprint = footprint * jnp.abs(a * d - b * c)
    return footprint


def read_texel(texels: Float[Array, "t c"], place: Int[Array, ""]) -> Float[Array, " c"]:
    """A texel by its number, which is known to be there."""
    return texels.at[place].get(mode="promise_in_bounds")


def _first_column(uv_set: int) -> int:
    """Where u of a set of texture coordinates is in surface coordinates."""
    return 0 if uv_set == 0 else 3 * uv_set - 1


def wrapped(u: Float[Array, ""], wrap: Wrap) -> Float[Array, ""]:
    """The place between 0 and 1 in an image that a coordinate shows."""
    if wrap == "clamp":
        return safe.clamp(u, 0, 1)
    if wrap == "mirror":
        u = u - 2 * jnp.floor(u / 2)
        return jnp.minimum(u, 2 - u)
    # The whole part goes first, so that far repetitions lose no more digits than their coordinates have lost.
    return u - jnp.floor(u)


def four_texels(
    x: Float[Array, ""],
    y: Float[Array, ""],
    h: int | Int[Array, ""],
    w: int | Int[Array, ""],
    wrap: tuple[Wrap, Wrap],
) -> list[tuple[Int[Array, ""], Float[Array, ""]]]:
    """Places of the four texels around (x, y), counted in texels from the upper left corner, and their weights."""

    def neighbour(number, count, along: Wrap):
        # A mirrored image begins with the texel that it ends with, as a clamped one does.
        return number % count if along == "repeat" else jnp.clip(number, 0, count - 1)

    left, top = jnp.floor(x - 0.5), jnp.floor(y - 0.5)
    right, down = x - 0.5 - left, y - 0.5 - top
    column, row = left.astype(jnp.int32), top.astype(jnp.int32)
    return [
        (
            neighbour(row + i, h, wrap[1]) * w + neighbour(column + j, w, wrap[0]),
            (down if i else 1 - down) * (right if j else 1 - right),
        )
        for i in (0, 1)
        for j in (0, 1)
    ]


def level_sizes(h: int, w: int, coarser: int) -> list[tuple[int, int]]:
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


class VertexColours(eqx.Module):
    """The colours of a mesh's vertices, interpolated over its faces."""

    @property
    def is_constant(self) -> bool:
        """Never: they vary over the surface."""
        return False

    @property
    def mean(self) -> np.ndarray:
        """White, since it is the meshes that have the colours: they are no brighter."""
        return np.ones(3)

    def content(self) -> list:
        """What tells it from textures, for the keys of a store; the colours themselves are with the geometry."""
        return ["vertex colours"]

    def look_up(self, uv: Float[Array, " u"], footprint: Footprint = 0.0) -> Float[Array, "3"]:
        """The last three of the surface coordinates; white where there are but texture coordinates of one set."""
        return uv[-3:] if len(uv) > 2 else jnp.ones(3, uv.dtype)


# A product of textures and vertex colours; the empty one is 1.
Weight = tuple[Texture | VertexColours, ...]


@runtime_checkable
class Factor(Protocol):
    """What is looked up by surface coordinates: a texture as it is or packed, or vertex colours."""

    def look_up(self, uv: Float[Array, " u"], footprint: Footprint = 0.0) -> Float[Array, " c"]:
        """The numbers at surface coordinates."""
        ...


# A product as pixels look it up.
PixelWeight = tuple[Factor, ...]


def constant(values: Numbers, dtype: DTypeLike | None = None) -> Texture:
    """The same numbers everywhere: one, or one per channel, traced or not.

    The dtype is by default that of the arrays given, or JAX's own for numbers of Python.
    """
    dtype = float_dtype(values) if dtype is None else dtype
    numbers = as_numbers(values)
    return Texture(as_array(module_of(numbers).atleast_1d(numbers)[None, None], dtype))


@jax.jit
def look_up(weight: PixelWeight, uv: Float[Array, " u"], footprint: Footprint = 0.0) -> Float[Array, " c"]:
    """The product of textures and vertex colours at surface coordinates."""
    value = jnp.ones(1, uv.dtype)
    for texture in weight:
        value = value * texture.look_up(uv, footprint)
    return value
