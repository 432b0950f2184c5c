"""Wide cosine lobes as sums of narrower ones.

Light and visibility vary together within a wide lobe, so that the mean of one times the mean of the other is not the
mean of their product. Within narrow lobes both are nearly constant: a wide lobe is the sum of some, each with its own
light and its own visibility.
"""

import functools
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jaxtyping import Array, Float

from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.numerics import safe

# Rings of a hexagonal pattern around the peak, by how many narrower lobes they make, and how many times as large the
# narrower lobes' n + 1 is: as narrow as the pattern covers the wide lobe without gaps.
PATTERNS = {1: (0, 1.0), 7: (1, 2.4), 19: (2, 6.0)}
# In the table n + 1 goes by 2, as far as 2^14.
_DOUBLINGS = 14


class SubLobes(NamedTuple):
    """Lobes that add up to a wider one.

    Attributes:
        peaks: unit vectors.
        exponent: of all of them.
        shares: of the wider lobe's integral; they add up to 1.
    """

    peaks: Float[Array, "j 3"]
    exponent: Float[Array, ""]
    shares: Float[Array, " j"]


def narrower_lobes(lobes: LobeSum | SpatialLobes, tolerance: float) -> int:
    """How many narrower lobes keep the error of lobes' width within a tolerance: the fewest of `PATTERNS`, or the most.

    What a lobe of exponent n loses by one mean of light and one of visibility is near 1/(n + 1), its width squared;
    lobes count by the light that they reflect.
    """
    width, share = _widths(lobes)
    mean = float(np.sum(share * width))
    return next((count for count, (_, ratio) in PATTERNS.items() if mean <= ratio * tolerance), max(PATTERNS))


# Lobes of which 1/(n + 1) is less than this, over the square of a face's side in texels, are narrower than texels.
_NARROWEST = 2.0


def narrowest(lobes: LobeSum | SpatialLobes) -> float:
    """The least 1/(n + 1) of lobes that reflect a hundredth of the light, or more; 1 where none reflects any."""
    width, share = _widths(lobes)
    if not share.any():
        return 1.0
    order = np.argsort(width)
    together = np.cumsum(share[order])
    return float(width[order][np.searchsorted(together, min(0.01, together[-1]))])


def is_narrower_than_texels(lobes: LobeSum | SpatialLobes, resolution: int) -> bool:
    """Whether lobes would fall between the centres of a cube map's texels, and cannot be summed over them.

    Args:
        lobes: of which the narrowest that counts decides.
        resolution: side of the cube map's faces.
    """
    return narrowest(lobes) < _NARROWEST / resolution**2


def _widths(lobes: LobeSum | SpatialLobes) -> tuple[Float[np.ndarray, " n"], Float[np.ndarray, " n"]]:
    """1/(n + 1) of all lobes, and the share of the light that each reflects."""
    exponent = np.asarray(lobes.exponent, float)
    scale = np.abs(np.asarray(lobes.scale, float)).mean(axis=-1, keepdims=isinstance(lobes, LobeSum))
    reflected = np.broadcast_to(scale, exponent.shape) / (exponent + 2)
    return 1 / (exponent + 1).ravel(), (reflected / max(reflected.sum(), np.finfo(float).tiny)).ravel()


def narrower_exponent(exponent: float, count: int) -> float:
    """The exponent of the narrower lobes that one is shaded as."""
    return PATTERNS[count][1] * (exponent + 1) - 1


def sub_lobes(peak: Float[Array, "3"], exponent: Float[Array, ""], count: int) -> SubLobes:
    """A lobe max(0, p·ω)ⁿ as narrower ones; differentiable in both arguments.

    Args:
        peak: p, a unit vector other than (0, 0, −1).
        exponent: n, from 0.
        count: one of `PATTERNS`.
    """
    if count == 1:
        return SubLobes(peak[None], exponent, jnp.ones(1, peak.dtype))
    rings, ratio = PATTERNS[count]
    place, ring = _pattern(rings)
    row = safe.clamp(jnp.log2(safe.clamp(exponent, 0) + 1), 0, _DOUBLINGS)
    lower = jnp.minimum(jnp.floor(row), _DOUBLINGS - 1)
    part = row - lower
    table = jnp.asarray(_table(count), peak.dtype)
    entry, after = (table.at[lower.astype(jnp.int32) + i].get(mode="promise_in_bounds") for i in (0, 1))
    entry = (1 - part) * entry + part * after
    # Sharper lobes are as far apart as their width.
    spacing = entry[0] / jnp.sqrt(safe.clamp(exponent, 0) + 1)
    x, y = jnp.asarray(place, peak.dtype).T * spacing
    angle = jnp.asarray(np.linalg.norm(place, axis=1), peak.dtype) * spacing
    scale = jnp.sinc(angle / np.pi)
    tangent, binormal = _axes(peak)
    coordinates = jnp.stack([jnp.cos(angle), scale * x, scale * y], axis=1)
    along = jnp.matmul(coordinates, jnp.stack([peak, tangent, binormal]), precision="highest")
    return SubLobes(along, ratio * (exponent + 1) - 1, entry[1:][ring])


def _axes(peak: Float[Array, "3"]) -> tuple[Float[Array, "3"], Float[Array, "3"]]:
    """Two unit vectors across p, smooth but at −z (Duff et al. 2017)."""
    x, y, z = peak
    below = z <= -0.999999
    a = -1 / jnp.where(below, 1, 1 + z)
    b = x * y * a
    tangent = jnp.stack([1 + x * x * a, b, -x])
    binormal = jnp.stack([b, 1 + y * y * a, -y])
    return tangent, binormal


def _pattern(rings: int) -> tuple[Float[np.ndarray, "j 2"], np.ndarray]:
    """Points of a hexagonal grid around one of them, a unit apart, and which are alike by symmetry."""
    steps = np.arange(-rings, rings + 1)
    a, b = (axis.ravel() for axis in np.meshgrid(steps, steps))
    inside = np.abs(a + b) <= rings
    place = np.stack([a + b / 2, b * np.sqrt(3) / 2], axis=1)[inside]
    _, alike = np.unique(np.rint(np.sum(place**2, axis=1) * 1e6), return_inverse=True)
    return place, alike


@functools.cache
def _table(count: int) -> Float[np.ndarray, "n q"]:
    """Spacing times √(n + 1), and the shares of alike points, by doublings of n + 1: least squares over the sphere."""
    rings, ratio = PATTERNS[count]
    place, alike = _pattern(rings)
    rows, start = [], 1.0
    for doubling in range(_DOUBLINGS + 1):
        n = 2.0**doubling - 1
        narrow = ratio * (n + 1) - 1
        # A disc around the peak that the lobe is nothing beyond, by equal areas.
        height = 1 - min(2.0, 18 / (n + 1))
        z = 1 - (1 - height) * (np.arange(1500) + 0.5) / 1500
        azimuth = np.pi * (1 + 5**0.5) * np.arange(1500)
        radius = np.sqrt(1 - z**2)
        points = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), z], axis=1)
        target = np.where(z > 0, np.maximum(z, 0) ** n, 0) * (n + 1)

        def fit(scaled, n=n, narrow=narrow, points=points, target=target):
            at = place * scaled / np.sqrt(n + 1)
            angle = np.linalg.norm(at, axis=1)
            peaks = np.concatenate([at * np.sinc(angle / np.pi)[:, None], np.cos(angle)[:, None]], axis=1)
            each = np.maximum(points @ peaks.T, 0) ** narrow * (narrow + 1)
            grouped = np.stack([each[:, alike == ring].sum(axis=1) for ring in range(alike.max() + 1)], axis=1)
            # Shares add up to 1, exactly after the division.
            sizes = np.bincount(alike)
            heavy = 1e3 * (n + 1)
            shares, _ = scipy.optimize.nnls(np.vstack([grouped, heavy * sizes]), np.append(target, heavy))
            shares /= shares @ sizes
            return shares, float(np.linalg.norm(grouped @ shares - target))

        best: Any = scipy.optimize.minimize_scalar(lambda s, fit=fit: fit(s)[1], bounds=(0.5 * start, 1.6 * start))
        start = float(best.x)
        rows.append([start, *fit(start)[0]])
    return np.array(rows)
