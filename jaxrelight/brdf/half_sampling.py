"""Drawing directions to the light for any BRDF, by half vectors: a table of where f · cosθ_i lies for each ω_o.

Two even numbers become a half vector by smooth functions that put as many where as much is reflected, so that evenly
spread numbers stay so, and every sample weighs about the same.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int
from scipy import interpolate

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.isotropy import is_isotropic
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.numbers import float_dtype

# ω_o of the table: steps of its cosine, and of its azimuth for BRDFs that it matters to.
_ELEVATIONS, _AZIMUTHS = 16, 16
# Steps of both numbers, and cells along √(θ_h / 90°) and around that the BRDF is evaluated in. With half the first
# steps and cells 240 samples of measured paints are off by 1 dB more; with twice the others by 0.2 dB less.
_STEPS, _AROUND, _FINE, _FINE_AROUND = 512, 64, 512, 64
# This part of the shares goes to all cells alike, so that estimates have no bias where the BRDF was thought to be 0.
_EVEN_SHARE = 0.01


class HalfVectors(eqx.Module):
    """What samplers for all ω_o share: functions of even numbers, cubics in each of equal steps.

    Attributes:
        roots: coefficients of √(θ_h / 90°) by the first number, for azimuths and elevations of ω_o.
        turns: the azimuth of the half vector from that of ω_o by the second, at every end of the first one's steps.
    """

    roots: Float[Array, "a e n 4"]
    turns: Float[Array, "a e n1 m 4"]

    def towards(self, omega_o: Float[Array, "3"]) -> "HalfVectorSampler":
        """The sampler for one direction to the eye."""
        azimuths, elevations = self.roots.shape[:2]
        across = jnp.hypot(omega_o[0], omega_o[1])
        some = across > 1e-6
        along = jnp.stack([jnp.where(some, omega_o[k] / jnp.where(some, across, 1), 1.0 - k) for k in (0, 1)])
        elevation = jnp.clip((omega_o[2] * elevations).astype(jnp.int32), 0, elevations - 1)
        azimuth = jnp.zeros((), jnp.int32)
        if azimuths > 1:
            turn = jnp.arctan2(along[1], along[0]) * (azimuths / (2 * math.pi))
            azimuth = jnp.round(turn).astype(jnp.int32) % azimuths
        return HalfVectorSampler(self, omega_o, along, azimuth * elevations + elevation)


class HalfVectorSampler(eqx.Module):
    """ω_i for one ω_o. Directions below the surface reflect nothing, and count as samples all the same."""

    table: HalfVectors
    omega_o: Float[Array, "3"]
    along: Float[Array, "2"]
    row: Int[Array, ""]

    def drawn(self, u: Float[Array, ""], v: Float[Array, ""]) -> tuple[Float[Array, "3"], Float[Array, ""]]:
        """The direction that numbers from 0 to 1 stand for, and its density by solid angle."""
        n, m = self.table.roots.shape[2], self.table.turns.shape[3]
        step, part = _step(u, n)
        root, wide = _smooth(self.table.roots, self.row * n + step, part)
        first = self.row * (n + 1) + step
        step, place = _step(v, m)
        (phi, round_), (other, wider) = (_smooth(self.table.turns, row * m + step, place) for row in (first, first + 1))
        phi, round_ = (1 - part) * phi + part * other, (1 - part) * round_ + part * wider
        theta = root * root * (math.pi / 2)
        sine, x, y = jnp.sin(theta), jnp.cos(phi), jnp.sin(phi)
        a, b = self.along
        half = jnp.stack([sine * (x * a - y * b), sine * (x * b + y * a), jnp.cos(theta)])
        dot = self.omega_o[0] * half[0] + self.omega_o[1] * half[1] + self.omega_o[2] * half[2]
        # dω_h = sinθ dθ dφ and dθ = π root d(root); dω_i = 4 (ω_o · h) dω_h.
        spread = math.pi * jnp.maximum(root * sine, 1e-12) * 4 * jnp.maximum(jnp.abs(dot), 1e-6)
        return 2 * dot * half - self.omega_o, 1 / (n * m * wide * round_ * spread)


def _step(number, steps: int):
    """The step of a number from 0 to 1, and the place in it."""
    step = jnp.minimum((number * steps).astype(jnp.int32), steps - 1)
    return step, number * steps - step


def _smooth(table, row, t):
    """A cubic, and its slope."""
    a, b, c, d = table.reshape(-1, 4).at[row].get(mode="promise_in_bounds")
    return a + t * (b + t * (c + t * d)), jnp.maximum(b + t * (2 * c + t * 3 * d), 1e-9)


def half_vectors(brdf: Brdf) -> HalfVectors:
    """Made from a BRDF by evaluating it half a million times, and 16 times as often where its azimuth matters.

    Tables are of the BRDF's dtype.
    """
    azimuths = 1 if is_isotropic(brdf) else _AZIMUTHS
    root, phi = (np.arange(_FINE) + 0.5) / _FINE, ((np.arange(_FINE_AROUND) + 0.5) / _FINE_AROUND * 2 - 1) * math.pi
    cosine = (np.arange(_ELEVATIONS) + 0.5) / _ELEVATIONS
    roots = np.zeros((azimuths, _ELEVATIONS, _STEPS, 4))
    turns = np.zeros((azimuths, _ELEVATIONS, _STEPS + 1, _AROUND, 4))
    dtype = float_dtype(brdf)
    theta, phi = (as_array(x, dtype) for x in (root**2 * (math.pi / 2), phi))
    for a in range(azimuths):
        turn = 2 * math.pi * a / azimuths
        for e, c in enumerate(cosine):
            s = math.sqrt(1 - c * c)
            omega_o = as_array([s * math.cos(turn), s * math.sin(turn), c], dtype)
            mass = np.asarray(_reflected(brdf, omega_o, theta, phi + turn), float) * root[:, None]
            mass = np.where(np.isfinite(mass), np.maximum(mass, 0), 0)
            roots[a, e], turns[a, e] = _equal_shares(mass)
    return HalfVectors(as_array(roots, dtype), as_array(turns, dtype))


def _equal_shares(mass: Float[np.ndarray, "f g"]) -> tuple[np.ndarray, np.ndarray]:
    """Functions whose equal steps hold the same."""
    even = 1 / mass.size
    mass = (1 - _EVEN_SHARE) * mass / mass.sum() + _EVEN_SHARE * even if mass.sum() > 0 else np.full(mass.shape, even)
    # Above each edge along θ_h, of every part around.
    above = np.concatenate([np.zeros((1, mass.shape[1])), np.cumsum(mass, axis=0)])
    edges = np.linspace(0, 1, len(mass) + 1)
    halves = np.interp(np.linspace(0, 1, 2 * _STEPS + 1), above.sum(axis=1) / above[-1].sum(), edges)
    at = np.clip(halves[np.append(0, np.arange(1, 2 * _STEPS + 2, 2)).clip(max=2 * _STEPS)] * len(mass), 0, len(mass))
    below = np.minimum(at.astype(int), len(mass) - 1)
    reached = above[below] + (at - below)[:, None] * (above[below + 1] - above[below])
    around = np.linspace(-math.pi, math.pi, mass.shape[1] + 1)
    turns = []
    for row in np.diff(reached, axis=0):
        share = np.concatenate([[0], np.cumsum(row)])
        turns.append(np.interp(np.linspace(0, 1, _AROUND + 1), share / share[-1], around))
    return _cubics(halves[::2]), _cubics(np.stack(turns))


def _cubics(values: Float[np.ndarray, "... n1"]) -> Float[np.ndarray, "... n 4"]:
    """Cubics between values that fall nowhere (Fritsch and Butland), by powers of the way from one to the next."""
    coefficients = interpolate.PchipInterpolator(np.arange(values.shape[-1]), values, axis=-1).c
    return np.moveaxis(coefficients[::-1], (0, 1), (-1, -2))


@eqx.filter_jit
def _reflected(brdf, omega_o, theta, phi):
    """The products f cosθ_i, summed over channels, at every √θ_h (but for the root itself) and φ_h."""
    up = jnp.asarray([0.0, 0, 1], omega_o.dtype)

    def one(theta, phi):
        half = jnp.stack([jnp.sin(theta) * jnp.cos(phi), jnp.sin(theta) * jnp.sin(phi), jnp.cos(theta)])
        dot = jnp.sum(omega_o * half)
        omega_i = 2 * dot * half - omega_o
        above = (omega_i[2] > 0) & (dot > 0)
        value = jnp.sum(brdf.evaluate(jnp.where(above, omega_i, up), omega_o))
        return jnp.where(above, value * omega_i[2] * dot * jnp.sin(theta), 0)

    return jax.lax.map(lambda t: jax.vmap(lambda p: one(t, p))(phi), theta, batch_size=16)
