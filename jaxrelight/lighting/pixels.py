"""Pixels that see one material, as arrays of one of few lengths, so that few shapes are compiled."""

import functools
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.numerics.buckets import bucket, filled_up


class SurfacePixels(eqx.Module):
    """What light and view need of pixels that see one material.

    Attributes:
        pixel: place in the flattened image; past its end for padding.
        uv: surface coordinates.
        footprint: the area in the first set of texture coordinates that the pixel covers.
        omega_o: local direction to the eye.
        frame: rows tangent, binormal, normal.
    """

    pixel: Int[Array, " p"]
    uv: Float[Array, "p u"]
    footprint: Float[Array, " p"]
    omega_o: Float[Array, "p 3"]
    frame: Float[Array, "p 3 3"]


def places(parts: Sequence[SurfacePixels], count: int) -> Int[Array, " n"]:
    """Where `assembled` finds each of an image's pixels, of which every part shows others."""
    total = sum(len(part.pixel) for part in parts)
    place_of_pixel, start = np.full(count, total, np.int32), 0
    for part in parts:
        pixel = np.asarray(part.pixel)
        in_image = np.flatnonzero(pixel < count)
        place_of_pixel[pixel[in_image]] = start + in_image
        start += len(pixel)
    # The owner keeps the array, and may be asked first while something is traced.
    with jax.ensure_compile_time_eval():
        return jax.device_put(place_of_pixel)


@functools.partial(jax.jit, static_argnames="shape")
def assembled(
    parts: Sequence[Float[Array, "_ c"]], place: Int[Array, " n"], shape: tuple[int, int]
) -> Float[Array, "h w c"]:
    """The image of what parts show, and 0 where none does: one look-up for each pixel.

    Adding parts to an image would copy it for every one of them.
    """
    rows = jnp.concatenate([*parts, jnp.zeros((1, parts[0].shape[1]), parts[0].dtype)])
    return rows.at[place].get(mode="promise_in_bounds").reshape(*shape, -1)


def padded(rows: np.ndarray, mine: Int[np.ndarray, " m"], fill: int = 0) -> np.ndarray:
    """Some rows of an array in single precision, followed by rows of `fill` up to the length of a bucket."""
    return filled_up(rows[mine], bucket(len(mine), 1024), fill)
