"""Textures whose size is a number, not a shape: one program looks up all that have about as many texels."""

import functools

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.brdf.texture import (
    Factor,
    Footprint,
    PixelWeight,
    Texture,
    Weight,
    Wrap,
    four_texels,
    image_coordinates,
    image_footprint,
    level_sizes,
    read_texel,
    wrapped,
)
from jaxrelight.numerics import safe
from jaxrelight.numerics.arrays import as_array, is_traced
from jaxrelight.numerics.buckets import bucket, filled_up

# Levels of detail that there is room for: images have at most 2¹⁹ rows or columns.
_MAX_LEVELS = 20
# Up to as many texels the room for them doubles from one length to the next.
_DOUBLED = 2**22


class PackedTexture(eqx.Module):
    """A `Texture` with all of its levels one after the other, filled up to one of few lengths.

    Attributes:
        texels: of all levels, the finest first, each row by row.
        levels: rows, columns and the first texel of each level; the last one again after the coarsest.
        coarsest: number of the coarsest level, counted from 0.
        placement, uv_set, wrap: as of a `Texture`.
    """

    texels: Float[Array, "t c"]
    levels: Int[Array, "l 3"]
    coarsest: Int[Array, ""]
    placement: Float[Array, "2 3"] | None = None
    uv_set: int = eqx.field(default=0, static=True)
    wrap: tuple[Wrap, Wrap] = eqx.field(default=("repeat", "repeat"), static=True)

    @jax.jit
    def look_up(self, uv: Float[Array, " u"], footprint: Footprint = 0.0) -> Float[Array, " c"]:
        """The image at surface coordinates: linear between texels, and between the two levels of nearest size."""
        return functools.reduce(jnp.add, [weight * texel for texel, weight in self.around(uv, footprint)])

    @jax.jit
    def around(
        self, uv: Float[Array, " u"], footprint: Footprint = 0.0
    ) -> list[tuple[Float[Array, " c"], Float[Array, ""]]]:
        """The texels that `look_up` reads, four of either level, each with its weight."""
        place = image_coordinates(uv, self.placement, self.uv_set)
        footprint = image_footprint(uv, footprint, self.placement, self.uv_set)
        texels, levels = jnp.asarray(self.texels), jnp.asarray(self.levels)
        h, w = (levels[0, axis].astype(uv.dtype) for axis in (0, 1))
        x, y = wrapped(place[0], self.wrap[0]) * w, (1 - wrapped(place[1], self.wrap[1])) * h
        last = self.coarsest.astype(uv.dtype)
        level = 0.5 * jnp.log2(safe.clamp(jnp.asarray(footprint * (h * w), uv.dtype), 1, jnp.exp2(2 * last)))
        lower = jnp.clip(jnp.floor(level), 0, jnp.maximum(last - 1, 0)).astype(jnp.int32)
        share = level - lower

        def of_level(number):
            scale = jnp.exp2(-number.astype(x.dtype))
            rows, columns, start = levels[number]
            return [(start + at, weight) for at, weight in four_texels(x * scale, y * scale, rows, columns, self.wrap)]

        pairs = (of_level(lower), 1 - share), (of_level(lower + 1), share)
        return [(read_texel(texels, at), part * weight) for level, part in pairs for at, weight in level]


def pack(texture: Texture) -> PackedTexture:
    """A texture that is not constant, packed; its texels are known, not traced."""
    h, w, c = texture.pixels.shape
    coarser = np.zeros((0, c)) if texture.coarser is None else np.asarray(texture.coarser)
    sizes = level_sizes(h, w, len(coarser))
    starts = np.cumsum([0, *(rows * columns for rows, columns in sizes)])[:-1]
    levels = [(*size, start) for size, start in zip(sizes, starts, strict=True)]
    levels += levels[-1:] * (_MAX_LEVELS - len(levels))
    pixels = np.asarray(texture.pixels)
    count = h * w + len(coarser)
    room = bucket(count, 1024, 1) if count <= _DOUBLED else bucket(count, _DOUBLED)
    texels = filled_up(np.concatenate([pixels.reshape(h * w, c), coarser]), room, dtype=pixels.dtype)
    return PackedTexture(
        as_array(texels),
        as_array(np.array(levels, np.int32)),
        as_array(np.int32(len(sizes) - 1)),
        texture.placement,
        texture.uv_set,
        texture.wrap,
    )


def pack_weight(weight: Weight | PixelWeight) -> PixelWeight:
    """A product whose images are packed; what is constant or traced stays as it is."""

    def packed(one: Factor) -> Factor:
        return pack(one) if isinstance(one, Texture) and not (one.is_constant or is_traced(one)) else one

    return tuple(packed(one) for one in weight)
