"""Pixels that see one material, as arrays of one of few lengths, so that few shapes are compiled."""

import equinox as eqx
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.buckets import bucket, filled_up


class Pixels(eqx.Module):
    """What every way to light needs of them.

    Attributes:
        pixel: place in the flattened image; past its end for padding.
        uv: texture coordinates.
        footprint: the area of them that the pixel covers.
        omega_o: local direction to the eye.
    """

    pixel: Int[Array, " p"]
    uv: Float[Array, "p 2"]
    footprint: Float[Array, " p"]
    omega_o: Float[Array, "p 3"]


def padded(rows: np.ndarray, mine: Int[np.ndarray, " m"], fill: int = 0) -> np.ndarray:
    """Some rows of an array in single precision, followed by rows of `fill` up to the length of a bucket."""
    return filled_up(rows[mine], bucket(len(mine), 1024), fill)
