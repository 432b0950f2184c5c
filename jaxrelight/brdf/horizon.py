"""A cosine lobe cut by the horizon and weighed by the cosine, as one cosine lobe that stands elsewhere.

max(0, p·ω)ⁿ max(0, N·ω) is no function of p and n alone, so no map of an environment can hold its integrals. A lobe
with the same integral, mean direction and mean length is one, and is exact where p = N.
"""

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.numerics import safe

# In the table n + 1 goes by √2, as far as 2^14, and the cosine evenly.
_PER_DOUBLING, _DOUBLINGS, _COSINES = 2, 14, 257


class ClippedLobe(NamedTuple):
    """What stands for the product.

    Attributes:
        share: ∫ max(0, p·ω)ⁿ max(0, N·ω) dω over ∫ max(0, p·ω)ⁿ dω = 2π/(n + 1).
        peak: unit direction of its mean; the zero vector for p = −N, of which nothing is left.
        exponent: that of a cosine lobe whose mean is as long.
    """

    share: Float[Array, "..."]
    peak: Float[Array, "... 3"]
    exponent: Float[Array, "..."]


@jax.jit
def clip_lobe(peak: Float[Array, "... 3"], exponent: Float[Array, "..."]) -> ClippedLobe:
    """The lobe of a unit direction p and an exponent n in the local frame, cut at z = 0 and weighed by z.

    From a table over n and p·N; finite and differentiable everywhere. p may lie below the horizon.
    """
    rows, columns = _PER_DOUBLING * _DOUBLINGS, _COSINES - 1
    row = safe.clamp(jnp.log2(safe.clamp(exponent, 0) + 1) * _PER_DOUBLING, 0, rows)
    column = safe.clamp((peak[..., 2] + 1) / 2 * columns, 0, columns)
    top, left = jnp.minimum(jnp.floor(row), rows - 1), jnp.minimum(jnp.floor(column), columns - 1)
    down, right = (row - top)[..., None], (column - left)[..., None]
    table = jnp.asarray(_table(), peak.dtype).reshape(-1, 4)

    def entry(i, j):
        return table.at[((top + i) * _COSINES + left + j).astype(jnp.int32)].get(mode="promise_in_bounds")

    upper = (1 - right) * entry(0, 0) + right * entry(0, 1)
    lower = (1 - right) * entry(1, 0) + right * entry(1, 1)
    entries = (1 - down) * upper + down * lower
    moved = entries[..., 1:2] * peak + entries[..., 2:3] * _upwards(peak)
    return ClippedLobe(jnp.exp(entries[..., 0]), safe.normalize(moved), 2 ** (entries[..., 3] / _PER_DOUBLING) - 1)


def clipped_exponents(lowest: float, highest: float) -> tuple[float, float]:
    """The range of exponents that lobes have after clipping, of those that reflect a thousandth of what they might."""
    table = _table()
    rows = [np.clip(math.log2(max(n, 0) + 1) * _PER_DOUBLING, 0, _PER_DOUBLING * _DOUBLINGS) for n in (lowest, highest)]
    within = table[math.floor(rows[0]) : math.ceil(rows[1]) + 1]
    reflects = within[..., 0] > within[..., 0].max() - math.log(1000)
    sharpness = 2 ** (within[..., 3][reflects] / _PER_DOUBLING) - 1
    return float(sharpness.min()), float(sharpness.max())


def _upwards(peak: Float[Array, "... 3"]) -> Float[Array, "... 3"]:
    """The unit vector across p towards N; the zero vector where p lies along it."""
    x, y, z = peak[..., 0], peak[..., 1], peak[..., 2]
    square = x**2 + y**2
    pole = square < 1e-12
    sine = jnp.sqrt(jnp.where(pole, 1, square))
    over = jnp.where(pole, 0, -z / sine)
    return jnp.stack([over * x, over * y, jnp.where(pole, 0, sine)], axis=-1)


@functools.cache
def _table() -> Float[np.ndarray, "n c 4"]:
    """Logarithm of the share, mean along p and across it over its length, and n' by steps of n, by n and p·N.

    The lobe weighs u = cos^{n+1} of the angle to p alike from 0 to 1, and integrals around p are closed forms.
    """
    exponent = 2 ** (np.arange(_PER_DOUBLING * _DOUBLINGS + 1)[:, None, None] / _PER_DOUBLING) - 1
    height = np.linspace(-1, 1, _COSINES)[None, :, None]
    place, weight = np.polynomial.legendre.leggauss(256)
    cosine = ((place + 1) / 2) ** (1 / (exponent + 1))
    weight = weight / 2
    sine = np.sqrt(np.maximum(1 - cosine**2, 0))
    # N·ω = A + B cos b at the azimuth b around p; positive within ±reach.
    A, B = height * cosine, np.sqrt(np.maximum(1 - height**2, 0)) * sine
    reach = np.arccos(np.clip(-A / np.maximum(B, 1e-300), -1, 1))
    mass = (A * reach + B * np.sin(reach)) / np.pi
    across = sine * (2 * A * np.sin(reach) + B * (reach + np.sin(reach) * np.cos(reach))) / (2 * np.pi)
    share, along, up = (np.sum(weight * part, axis=-1) for part in (mass, cosine * mass, across))
    seen = share > 1e-12
    # Below the horizon a sharp lobe gives nothing: where it stands does not matter.
    along, up = (np.where(seen, part / np.where(seen, share, 1), rest) for part, rest in ((along, 0.0), (up, 0.5)))
    length = np.hypot(along, up)
    exponent = np.clip((2 * length - 1) / (1 - length), 0, 2**_DOUBLINGS - 1)
    # Beyond the horizon the share falls as a power does.
    share = np.log(np.maximum(share, 1e-30))
    return np.stack([share, along / length, up / length, np.log2(exponent + 1) * _PER_DOUBLING], axis=-1)
