"""How fast a BRDF varies with the direction to the light, for every pair of directions (Bagher 2011 §2.4)."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.basis.local_frequency import local_frequency, mirrored
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.isotropy import is_isotropic
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.spatial import PackedLobes
from jaxrelight.brdf.texture import Texture
from jaxrelight.numerics import safe

_GRID = 16
# This share of the energy of a lobe's spectrum may lie beyond its bandwidth, as with the threshold of
# `local_frequency`.
_BEYOND = 0.01
_MIXED = 4


class BandwidthTable(eqx.Module):
    """Angular bandwidth at pairs of directions, in cycles per radian.

    Both lie on a grid of the hemisphere, see `to_square`; of an isotropic BRDF ω_o lies at azimuth 0.

    Attributes:
        values: of ω_o [n, n], or [n] by elevation where it is isotropic, then ω_i; all of them side by side.
        isotropic: whether azimuths count from that of ω_o.
    """

    values: Float[Array, "o i"]
    isotropic: bool = eqx.field(static=True)

    def look_up(self, omega_i: Float[Array, "3"], omega_o: Float[Array, "3"]) -> Float[Array, ""]:
        """The bandwidth at a pair of directions."""
        n = math.isqrt(self.values.shape[1])
        if self.isotropic:
            across = jnp.hypot(omega_o[0], omega_o[1])
            some = across > 0
            cosine = jnp.where(some, omega_o[0] / jnp.where(some, across, 1), 1)
            sine = jnp.where(some, omega_o[1] / jnp.where(some, across, 1), 0)
            x, y = cosine * omega_i[0] + sine * omega_i[1], cosine * omega_i[1] - sine * omega_i[0]
            omega_i = jnp.stack([x, y, omega_i[2]])
            elevation = jnp.arctan2(across, jnp.maximum(omega_o[2], 0)) * (2 / math.pi)
            row = _step(elevation, n)
        else:
            a, b = to_square(omega_o)
            row = _step(a, n) * n + _step(b, n)
        a, b = to_square(omega_i)
        return self.values.at[row, _step(a, n) * n + _step(b, n)].get(mode="promise_in_bounds")


class CompressedBandwidth(eqx.Module):
    """A table as a mean row and principal components (Bagher 2011 figure 8)."""

    mean: Float[Array, " i"]
    weights: Float[Array, "o k"]
    components: Float[Array, "k i"]
    isotropic: bool = eqx.field(static=True)

    def table(self) -> BandwidthTable:
        """What is left of the table."""
        return BandwidthTable(jnp.maximum(self.mean[None] + self.weights @ self.components, 0), self.isotropic)


def lobe_bandwidth(brdf: LobeSum, omega_i: Float[Array, "3"], omega_o: Float[Array, "3"]) -> Float[Array, ""]:
    """The angular bandwidth of a sum of lobes in closed form: that of each at its peak, by what each gives.

    A lobe cosⁿ is near to exp(−n θ²/2), whose spectrum is exp(−2π²f²/n): less than ε of its height is left beyond
    f = √(n ln(1/ε) / 2) / π. Its slope by n, infinite at n = 0, is 0 there.
    """
    if brdf.is_constant:
        return jnp.zeros((), omega_i.dtype)
    powers = safe.power(brdf.cosines(omega_i, omega_o), brdf.exponent)
    given = jnp.mean(jnp.abs(brdf.scale) * powers, axis=1, keepdims=True)
    own = safe.root(brdf.exponent * (0.5 * math.log(1 / _BEYOND))) / math.pi
    total = jnp.mean(brdf.diffuse) / math.pi + jnp.sum(given)
    return jnp.sum(given * own) / jnp.where(total > 0, total, 1) / own.shape[1]


def with_cosine(bandwidth: Float[Array, "*p"]) -> Float[Array, "*p"]:
    """The bandwidth of the BRDF times the cosine, which is a lobe of exponent 1."""
    return jnp.hypot(bandwidth, math.sqrt(0.5 * math.log(1 / _BEYOND)) / math.pi)


def to_square(omega: Float[Array, "3"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """The upper hemisphere on the unit square, by an octahedron: it stretches nothing by more than √3."""
    total = jnp.maximum(jnp.abs(omega[0]) + jnp.abs(omega[1]) + jnp.abs(omega[2]), 1e-30)
    x, y = omega[0] / total, omega[1] / total
    return 0.5 + 0.5 * (x + y), 0.5 + 0.5 * (x - y)


def from_square(a: Float[np.ndarray, "..."], b: Float[np.ndarray, "..."]) -> Float[np.ndarray, "... 3"]:
    """The unit vectors that `to_square` takes there."""
    s, d = 2 * a - 1, 2 * b - 1
    x, y = (s + d) / 2, (s - d) / 2
    omega = np.stack([x, y, np.maximum(1 - np.abs(x) - np.abs(y), 0)], axis=-1)
    return omega / np.linalg.norm(omega, axis=-1, keepdims=True)


def bandwidth_table(brdf: Brdf, resolution: int = 256, grid: int = _GRID) -> BandwidthTable:
    """The bandwidth of any BRDF, largest in each cell of the grid, measured on finer slices.

    It is float32 whatever the BRDF's type is: bandwidths choose how many samples are taken, not what these are.

    Args:
        brdf: any.
        resolution: of a slice's side, a power of two: nothing above resolution/5 cycles per radian is seen.
        grid: directions along each side.
    """
    isotropic = is_isotropic(brdf)
    if isotropic:
        elevation = (np.arange(grid) + 0.5) / grid * (np.pi / 2)
        omega_o = np.stack([np.sin(elevation), 0 * elevation, np.cos(elevation)], axis=1)
    else:
        a, b = np.meshgrid(*[(np.arange(grid) + 0.5) / grid] * 2, indexing="ij")
        omega_o = from_square(a, b).reshape(-1, 3)
    a, b = np.meshgrid(*[(np.arange(resolution) + 0.5) / resolution] * 2, indexing="ij")
    omega_i = jnp.asarray(from_square(a, b).reshape(-1, 3), jnp.float32)
    cell = math.sqrt(2 * math.pi) / resolution
    bandwidths = []
    for direction in omega_o:
        values = np.asarray(_slice(brdf, omega_i, jnp.asarray(direction, jnp.float32)))
        values = np.where(np.isfinite(values), values, 0).reshape(resolution, resolution, -1)
        frequency = local_frequency(mirrored(values))[:resolution, :resolution] / cell
        step = resolution // grid
        bandwidths.append(frequency.reshape(grid, step, grid, step).max(axis=(1, 3)).reshape(-1))
    return BandwidthTable(jnp.asarray(np.stack(bandwidths), jnp.float32), isotropic)


def compressed(table: BandwidthTable, components: int) -> tuple[CompressedBandwidth, float]:
    """A table by its principal components, and its root-mean-square error relative to the table."""
    values = np.asarray(table.values, float)
    mean = values.mean(axis=0)
    left, sizes, right = np.linalg.svd(values - mean, full_matrices=False)
    kept = left[:, :components] * sizes[:components]
    approximation = CompressedBandwidth(
        jnp.asarray(mean), jnp.asarray(kept), jnp.asarray(right[:components]), table.isotropic
    )
    error = np.linalg.norm(np.asarray(approximation.table().values) - values) / max(np.linalg.norm(values), 1e-30)
    return approximation, float(error)


@eqx.filter_jit
def _slice(brdf, omega_i, omega_o):
    return jax.lax.map(lambda one: brdf.evaluate(one, omega_o), omega_i, batch_size=4096)


def texture_bandwidth(packed: PackedLobes) -> Texture:
    """How fast a spatial BRDF varies over its map, in cycles per texel (Bagher 2011 §2.4 for textures).

    Its parameters, each as large as the others, are mixed to a few channels by random numbers: a frequency of any of
    them is one of nearly every mixture, and three lobes have thirty.
    """
    flat = np.asarray(packed.texture.pixels, np.float32)
    largest = np.abs(flat).max(axis=(0, 1))
    mixed = (flat / np.where(largest > 0, largest, 1)) @ np.random.default_rng(0).normal(size=(flat.shape[2], _MIXED))
    h, w = flat.shape[:2]
    ends = [(0, max(1 << (n - 1).bit_length(), _GRID) - n) for n in (h, w)]
    frequency = local_frequency(np.pad(mixed, (*ends, (0, 0)), mode="wrap"))[:h, :w]
    return Texture(jnp.asarray(frequency[..., None], jnp.float32))


def _step(place, n):
    return jnp.clip((place * n).astype(jnp.int32), 0, n - 1)
