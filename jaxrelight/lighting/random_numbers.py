"""Numbers from 0 to 1 that fill a square evenly, for samples of pixels that do not depend on each other."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt
from scipy.stats import qmc

# Numbers of the sequence; more would follow in the same order.
MOST = 1 << 14


def even_numbers(index: Int[Array, "*n"], shift: UInt[Array, "*n 2"]) -> Float[Array, "*n 2"]:
    """Numbers `index` of Sobol's sequence, digits shifted.

    Runs of 2^n, from multiples of 2^n on, have one pair in each of 2^n equal parts of the square, whether strips or
    squares or what lies between. Later numbers of the sequence do not pair so well.
    """
    whole = _sobol().at[index].get(mode="promise_in_bounds") ^ shift
    # 24 bits are what single precision holds below 1.
    return (whole >> 8).astype(jnp.float32) * 2.0**-24


@functools.cache
def _sobol() -> UInt[Array, "m 2"]:
    numbers = qmc.Sobol(2, scramble=False).random(MOST)
    with jax.ensure_compile_time_eval():
        return jnp.asarray((numbers * 2**32).astype(np.uint64).astype(np.uint32))


def shifts(of: Int[Array, "*n"], seed) -> UInt[Array, "*n 2"]:
    """Two whole numbers for each of others: the same for the same seed, and as good as random."""
    found = []
    for k in (1, 2):
        x = of.astype(jnp.uint32) * np.uint32(0x9E3779B1) + jnp.asarray(seed).astype(jnp.uint32) * np.uint32(0x85EBCA77)
        x = x + np.uint32(k * 0x27D4EB2F & 0xFFFFFFFF)
        for multiplier in (0x7FEB352D, 0x846CA68B):
            x = (x ^ (x >> 16)) * np.uint32(multiplier)
        found.append(x ^ (x >> 16))
    return jnp.stack(found, axis=-1)
