"""Isotropic reflectance in a table over half vector and difference vector (Rusinkiewicz 1998), as MERL's files are."""

import functools
import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.brdf.contract import Brdf
from jaxrelight.numerics import safe

# Below this squared length a projected direction has no azimuth; the one along x is taken.
_MIN_SQUARED_LENGTH = 1e-18


class HalfDifference(NamedTuple):
    """Angles of a pair of directions, in radians.

    Attributes:
        theta_h: from the normal to the half vector.
        theta_d: from the half vector to either direction.
        phi_d: of ω_i about the half vector, from the direction of growing θ_h; modulo π, since exchanging the
            directions turns it by π and changes no reciprocal BRDF.
    """

    theta_h: Float[Array, ""]
    theta_d: Float[Array, ""]
    phi_d: Float[Array, ""]


@jax.jit
def half_difference(omega_i: Float[Array, "3"], omega_o: Float[Array, "3"]) -> HalfDifference:
    """The angles; where one is undefined it is 0, with a zero gradient."""
    # The sums are written out: over three components, XLA's take longer than all the rest.
    (sum_x, sum_y, sum_z), (x, y, z) = omega_i + omega_o, omega_i - omega_o
    length, aside = _length(sum_x, sum_y, sum_z), _length(sum_x, sum_y, jnp.zeros_like(sum_z))
    opposite = length == 0
    divisor = jnp.where(opposite, 1, length)
    # Far from one another, the sum has fewer digits than the difference.
    theta_d = jnp.arctan2(_length(x, y, z), jnp.maximum(length, 1e-12))
    sine, cosine = _unit(sum_y / divisor, sum_x / divisor)
    # The parts of the half difference around the half vector, and along growing θ_h.
    around = (y * cosine - x * sine) / 2
    along = ((x * cosine + y * sine) * sum_z - z * aside) / (2 * divisor)
    sine, cosine = _unit(around, along)
    phi_d = jnp.arctan2(sine, cosine)
    phi_d = jnp.where(phi_d < 0, phi_d + math.pi, phi_d)
    return HalfDifference(jnp.arctan2(aside, jnp.where(opposite, 1, sum_z)), theta_d, phi_d)


def _length(x, y, z):
    """0 with a zero gradient at 0."""
    square = x * x + y * y + z * z
    nothing = square == 0
    return jnp.where(nothing, 0, jnp.sqrt(jnp.where(nothing, 1, square)))


def _unit(y, x):
    """(sine, cosine) of an azimuth."""
    square = x * x + y * y
    undefined = square <= _MIN_SQUARED_LENGTH
    length = jnp.sqrt(jnp.where(undefined, 1, square))
    return jnp.where(undefined, 0, y / length), jnp.where(undefined, 1, x / length)


class Tabulated(Brdf):
    """f at θ_h = ((h + ½)/n_h)² π/2, θ_d = (d + ½)/n_d · π/2 and φ_d = (p + ½)/n_p · π, trilinear between them.

    Linear in √θ_h, θ_d and φ_d, periodic in φ_d, constant beyond the first and last entries of the other two.
    Reciprocal and isotropic by its coordinates.
    """

    values: Float[Array, "h d p c"]

    @jax.jit
    def evaluate(self, omega_i: Float[Array, "3"], omega_o: Float[Array, "3"]) -> Float[Array, " c"]:
        """f(ω_i, ω_o) of every channel."""
        entries, weights = corners(half_difference(omega_i, omega_o), self.values.shape[:3])
        flat = self.values.reshape(-1, self.channels)
        # The sum is written out, since products of small matrices are slow.
        contributions = (flat.at[entries[k]].get(mode="promise_in_bounds") * weights[k] for k in range(8))
        return functools.reduce(jnp.add, contributions)

    @property
    def channels(self) -> int:
        """c, the number of colour channels."""
        return self.values.shape[3]

    @property
    def is_constant(self) -> bool:
        """Never."""
        return False


def corners(angles: HalfDifference, shape: tuple[int, ...]) -> tuple[Int[Array, "8"], Float[Array, "8"]]:
    """The eight entries around a pair of directions, numbered in the order h, d, p, and their weights."""
    n_h, n_d, n_p = shape
    # Within half an entry of θ_h = 0 the root has no finite slope, and the table no other entry to go to.
    least = (0.5 / n_h) ** 2
    h, to_h = _between(jnp.sqrt(jnp.maximum(angles.theta_h * (2 / math.pi), least)) * n_h - 0.5, n_h)
    d, to_d = _between(angles.theta_d * (2 / math.pi) * n_d - 0.5, n_d)
    place = angles.phi_d * (n_p / math.pi) - 0.5
    p = jnp.floor(place)
    to_p, p = place - p, p.astype(jnp.int32) % n_p
    entries, weights = [], []
    for row, weight_h in ((h, 1 - to_h), (jnp.minimum(h + 1, n_h - 1), to_h)):
        for column, weight_d in ((d, 1 - to_d), (jnp.minimum(d + 1, n_d - 1), to_d)):
            for layer, weight_p in ((p, 1 - to_p), ((p + 1) % n_p, to_p)):
                entries.append((row * n_d + column) * n_p + layer)
                weights.append(weight_h * weight_d * weight_p)
    return jnp.stack(entries), jnp.stack(weights)


def _between(place, count: int):
    """The entry below a place, and how far it is to the next; clamped at both ends."""
    place = safe.clamp(place, 0, count - 1)
    below = jnp.minimum(jnp.floor(place), max(count - 2, 0))
    return below.astype(jnp.int32), place - below


def entry_angles(shape: tuple[int, int, int]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """θ_h [h], θ_d [d] and φ_d [p] of a table's entries."""
    h, d, p = ((np.arange(count) + 0.5) / count for count in shape)
    return h**2 * (np.pi / 2), d * (np.pi / 2), p * np.pi


def least_cosine(shape: tuple[int, int, int]) -> Float[np.ndarray, "h d p"]:
    """The lower of the cosines of an entry's two directions; it is not positive where one is below the surface."""
    theta_h, theta_d, phi_d = entry_angles(shape)
    upright = np.cos(theta_h)[:, None] * np.cos(theta_d)
    leaning = np.sin(theta_h)[:, None] * np.sin(theta_d)
    return upright[..., None] - np.abs(leaning[..., None] * np.cos(phi_d))
