"""Pairs of numbers from 0 to 1 that fill a disc evenly, for samples of pixels that do not depend on each other."""

import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike
from jaxtyping import Array, Float, Int, Real, UInt

# Single precision tells this many points apart in a run.
MAX_POINTS = 1 << 14
# (√5 − 1)/2 as a part of 2³².
_GOLDEN = np.uint32(2654435769)


def vogel_points(
    index: Int[Array, "*n"], count: Real[Array, ""] | int, rotation: UInt[Array, "2"]
) -> Float[Array, "*n 2"]:
    """Pairs `index` of `count`: the first number goes in equal steps, the second by the golden section of the circle.

    Where the first is a radius and the second an angle, they are a sunflower's seeds (Vogel 1979), each as far from
    its neighbours as any. A rotation, from `random_rotation`, turns the circle, and moves all the first ones within
    their steps.
    """
    along = (index.astype(jnp.float32) + _part_of_one(rotation[0])) / jnp.asarray(count, jnp.float32)
    around = _part_of_one(index.astype(jnp.uint32) * _GOLDEN + rotation[1])
    return jnp.stack([jnp.minimum(along, 1 - 2.0**-24), around], axis=-1)


def _part_of_one(whole):
    """The number as a fraction of 2³²; 24 bits are what single precision holds below 1."""
    return (whole >> 8).astype(jnp.float32) * 2.0**-24


def random_rotation(of: Int[Array, "*n"], seed: ArrayLike) -> UInt[Array, "*n 2"]:
    """Two whole numbers for each of others: the same for the same seed, and as good as random."""
    pair = []
    for k in (1, 2):
        x = of.astype(jnp.uint32) * np.uint32(0x9E3779B1) + jnp.asarray(seed).astype(jnp.uint32) * np.uint32(0x85EBCA77)
        x = x + np.uint32(k * 0x27D4EB2F & 0xFFFFFFFF)
        for multiplier in (0x7FEB352D, 0x846CA68B):
            x = (x ^ (x >> 16)) * np.uint32(multiplier)
        pair.append(x ^ (x >> 16))
    return jnp.stack(pair, axis=-1)
