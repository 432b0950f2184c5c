"""Transport rows from visibility and reflection: pure, jit-compiled, one group of receivers at a time.

A row is light side × visibility × cosine × solid angle over the texels of a cube map (Wang 2006 eq. 3), written in
a basis. Nothing else of the scene is needed, so a material is changed, or differentiated, by baking again.

Axes: m receivers of a group, k terms, c channels, d texels (of the cube map that light is given on), f the texels
that were traced: d times the visibility samples of a texel.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Integer, UInt8

from jaxrelight.basis import cubemap, truncation
from jaxrelight.brdf.reflection import Reflection
from jaxrelight.numerics.arrays import as_array
from jaxrelight.operators.contract import Basis

# Receivers of a block, whose rows should stay in cache, and how many of them one step of a loop takes.
_BLOCK, _RECEIVER_BATCH = 8, 4


class Directions(eqx.Module):
    """The directions that visibility is traced in: samples² for every texel of a cube map.

    Attributes:
        vectors: unit vectors of a cube map samples times as fine.
        solid_angles: theirs.
        samples: traced directions along a side of a texel.
    """

    vectors: Float[Array, "f 3"]
    solid_angles: Float[Array, " f"]
    samples: int = eqx.field(static=True)

    def to_texels(self, traced: Float[Array, "... f"]) -> Float[Array, "... d"]:
        """Sums what was traced within each texel."""
        s = self.samples
        if s == 1:
            return traced
        n = round((traced.shape[-1] // 6) ** 0.5) // s
        split = traced.reshape(*traced.shape[:-1], 6, n, s, n, s)
        return split.sum(axis=(-3, -1)).reshape(*traced.shape[:-1], 6 * n * n)

    def to_rays(self, texels: Float[Array, "... d"]) -> Float[Array, "... f"]:
        """Gives what each texel has to all that was traced within it: the transpose of `to_texels`."""
        s = self.samples
        if s == 1:
            return texels
        n = round((texels.shape[-1] // 6) ** 0.5)
        split = texels.reshape(*texels.shape[:-1], 6, n, 1, n, 1)
        spread = jnp.broadcast_to(split, (*texels.shape[:-1], 6, n, s, n, s))
        return spread.reshape(*texels.shape[:-1], len(self.vectors))


def directions_for(resolution: int, samples: int = 1, dtype: DTypeLike = jnp.float32) -> Directions:
    """Directions for a 6×resolution² cube map and samples² rays a texel."""
    fine = resolution * samples
    vectors, angles = cubemap.directions(fine), cubemap.solid_angles(fine)
    return Directions(as_array(np.array(vectors), dtype), as_array(np.array(angles), dtype), samples)


def unpack(bits: UInt8[Array, "... bytes"], dtype: DTypeLike) -> Float[Array, "... f"]:
    """Visibility 0 or 1 from bits, lowest first."""
    digits = jnp.arange(8, dtype=jnp.uint8).reshape((1,) * bits.ndim + (8,))
    spread = (bits[..., None] >> digits) & 1
    return spread.reshape(*bits.shape[:-1], -1).astype(dtype)


def _row(
    bits: UInt8[Array, " bytes"], frame: Float[Array, "3 3"], reflection: Reflection, directions: Directions
) -> Float[Array, "k c d"]:
    """Transport of one receiver over the texels."""
    local = jnp.matmul(frame, directions.vectors.T, precision="highest")
    weight = jnp.maximum(local[2], 0) * directions.solid_angles * unpack(bits, frame.dtype)
    light_side = jax.vmap(reflection.light_side, in_axes=1, out_axes=2)(local)
    return directions.to_texels(light_side * weight[None, None])


def _map_terms(light, bits, frames, reflection, directions, more) -> Float[Array, "m k c"]:
    """Light terms of receivers, each under light(more) [k1, c, f] of the rays; nothing as long as a row is kept."""
    own, shared = eqx.partition(reflection, reflection.per_receiver)

    @jax.checkpoint
    def terms(receiver):
        bits, frame, own, more = receiver
        local = jnp.matmul(frame, directions.vectors.T, precision="highest")
        weight = jnp.maximum(local[2], 0) * directions.solid_angles * unpack(bits, frame.dtype)
        return eqx.combine(own, shared).light_terms(local, light(more) * weight[None, None])

    return jax.lax.map(terms, (bits, frames, own, more), batch_size=_RECEIVER_BATCH)


def _map_blocks(function, bits, frames, reflection, directions, more=()):
    """Applies function(rows, *more) to blocks of b receivers, rows being the stacked [k, c, d].

    The rows are made by a loop of their own, since XLA would fuse, that is repeat, their making into every use.
    Results lead with the axes m/b, b.
    """
    own, shared = eqx.partition(reflection, reflection.per_receiver)

    def row(receiver):
        bits, frame, own = receiver
        return _row(bits, frame, eqx.combine(own, shared), directions)

    @jax.checkpoint
    def block(arguments):
        receivers, more = arguments
        return function(jax.lax.map(row, receivers, batch_size=_RECEIVER_BATCH), *more)

    m = len(bits)
    size = math.gcd(m, _BLOCK)
    blocks = jax.tree.map(lambda x: x.reshape(m // size, size, *x.shape[1:]), ((bits, frames, own), more))
    return jax.lax.map(block, blocks)


def _joined(results):
    """Receivers of all blocks in one axis."""
    return jax.tree.map(lambda x: x.reshape(x.shape[0] * x.shape[1], *x.shape[2:]), results)


def _encoded(basis: Basis, rows: Float[Array, "b k c d"]) -> Float[Array, "b k c d"]:
    """Rows in a basis, by a loop of their own for the same reason."""
    return jax.lax.map(basis.encode, rows, batch_size=_RECEIVER_BATCH)


@jax.jit
def bake_rows(
    bits: UInt8[Array, "m bytes"],
    frames: Float[Array, "m 3 3"],
    reflection: Reflection,
    directions: Directions,
    basis: Basis,
) -> Float[Array, "m k c d"]:
    """Whole rows of a few receivers."""
    return _joined(_map_blocks(lambda rows: _encoded(basis, rows), bits, frames, reflection, directions))


@eqx.filter_jit
def bake_truncated(
    bits: UInt8[Array, "m bytes"],
    frames: Float[Array, "m 3 3"],
    reflection: Reflection,
    directions: Directions,
    basis: Basis,
    count: int,
    deviations: Float[Array, " d"] | None = None,
) -> truncation.Truncated:
    """The `count` coefficients of every row that count most, see `keep_largest`; the result's arrays lead with m, k."""

    def truncate(rows):
        rows = _encoded(basis, rows)
        b, k, c, d = rows.shape
        kept = truncation.keep_largest(rows.reshape(b * k, c, d), count, deviations)
        return jax.tree.map(lambda x: x.reshape(b, k, *x.shape[1:]), kept)

    return _joined(_map_blocks(truncate, bits, frames, reflection, directions))


@jax.jit
def bake_kept(
    bits: UInt8[Array, "m bytes"],
    frames: Float[Array, "m 3 3"],
    reflection: Reflection,
    directions: Directions,
    basis: Basis,
    indices: Integer[Array, "m k n"],
) -> Float[Array, "m k c n"]:
    """The coefficients at given indices: differentiable in the reflection, the kept sets held fixed."""

    def pick(rows, kept):
        return jax.vmap(truncation.gather)(_encoded(basis, rows), kept)

    return _joined(_map_blocks(pick, bits, frames, reflection, directions, (indices.astype(jnp.int32),)))


@jax.jit
def bake_and_apply(
    bits: UInt8[Array, "m bytes"],
    frames: Float[Array, "m 3 3"],
    reflection: Reflection,
    directions: Directions,
    light: Float[Array, "d c"],
) -> Float[Array, "m k c"]:
    """Light terms of exact rows, used as they are made: differentiable in reflection and light."""
    by_channel = directions.to_rays(light.T)[None]
    return _map_terms(lambda _: by_channel, bits, frames, reflection, directions, ())


@jax.jit
def bake_kept_and_apply(
    bits: UInt8[Array, "m bytes"],
    frames: Float[Array, "m 3 3"],
    reflection: Reflection,
    directions: Directions,
    basis: Basis,
    light: Float[Array, "d c"],
    indices: Integer[Array, "m k n"],
) -> Float[Array, "m k c"]:
    """Light terms of the coefficients at given indices, used as they are made: of rows that `bake_kept` writes out.

    Light is decoded from the coefficients that a row keeps, and multiplied with the whole row: nothing that is as long
    as a row is kept, and the derivative in the reflection needs no wavelets. The kept sets are held fixed.
    """
    by_channel = light.T

    def kept_by_terms(kept):
        return directions.to_rays(jax.vmap(lambda of: kept_light(basis, by_channel, of))(kept))

    return _map_terms(kept_by_terms, bits, frames, reflection, directions, indices.astype(jnp.int32))


def kept_light(basis: Basis, by_channel: Float[Array, "c d"], kept: Integer[Array, " n"]) -> Float[Array, "c d"]:
    """The texels of light of some coefficients alone; numbers beyond the last coefficient stand for none."""
    some = by_channel.at[:, kept].get(mode="fill", fill_value=0)
    return basis.decode(jnp.zeros_like(by_channel).at[:, kept].set(some, mode="drop"))


@jax.jit
def bake_and_transpose(
    bits: UInt8[Array, "m bytes"],
    frames: Float[Array, "m 3 3"],
    reflection: Reflection,
    directions: Directions,
    radiance: Float[Array, "m k c"],
) -> Float[Array, "d c"]:
    """The adjoint of `bake_and_apply` in the light."""

    def weighted(rows, y):
        # Receivers b, terms k, channels c, texels d. The blocks' shares stay apart until all are summed at once.
        rows = jnp.broadcast_to(rows, (*y.shape, rows.shape[-1]))
        return jnp.einsum("bkcd,bkc->dc", rows, y, precision="highest")

    return jnp.sum(_map_blocks(weighted, bits, frames, reflection, directions, (radiance,)), axis=0)
