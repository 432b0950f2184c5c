"""Drawing directions to the light for any BRDF: by its distribution of half vectors, and by the cosine."""

import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight import safe
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.sampling import directional_albedo, from_disc

# Steps of √(θ_h / 90°), and where between light and eye the distribution is read.
_STEPS = 128
_THETA_D = (0.05, 0.35, 0.7, 1.0)
_PHI_D = (0.0, 0.5 * math.pi, math.pi, 1.5 * math.pi)
_ELEVATIONS = 32
# Of samples, the least that either part takes, so that estimates have no bias where the other is 0.
_LEAST_SHARE = 0.05


class HalfVectors(eqx.Module):
    """What samplers for all ω_o share: a mixture of the cosine and of ω_o mirrored at drawn half vectors.

    Attributes:
        density: of √(θ_h / 90°), constant over equal steps.
        reached: its integral up to the end of each step.
        cosine_share: of samples, by cosθ_o.
    """

    density: Float[Array, " n"]
    reached: Float[Array, " n"]
    cosine_share: Float[Array, " t"]

    def towards(self, omega_o: Float[Array, "3"]) -> "HalfVectorSampler":
        """The sampler for one direction to the eye."""
        place = jnp.clip(omega_o[2], 0, 1) * (len(self.cosine_share) - 1)
        share = self.cosine_share.at[jnp.round(place).astype(jnp.int32)].get(mode="promise_in_bounds")
        return HalfVectorSampler(self, omega_o, share)


class HalfVectorSampler(eqx.Module):
    """ω_i for one ω_o. Directions below the surface reflect nothing, and count as samples all the same."""

    table: HalfVectors
    omega_o: Float[Array, "3"]
    cosine_share: Float[Array, ""]

    def at(self, choice: Float[Array, ""], u: Float[Array, ""], v: Float[Array, ""]) -> Float[Array, "3"]:
        """The direction that three numbers from 0 to 1 stand for: uniform ones, random or not, give its density."""
        n = len(self.table.density)
        step = jnp.minimum(jnp.searchsorted(self.table.reached, u, side="right", method="scan_unrolled"), n - 1)
        density = self.table.density.at[step].get(mode="promise_in_bounds")
        missing = (self.table.reached.at[step].get(mode="promise_in_bounds") - u) / jnp.where(density > 0, density, 1)
        root = jnp.clip((step + 1) / n - missing, 0, 1)
        theta, phi = root**2 * (math.pi / 2), 2 * math.pi * v
        sine = jnp.sin(theta)
        half = jnp.stack([sine * jnp.cos(phi), sine * jnp.sin(phi), jnp.cos(theta)])
        mirrored = 2 * jnp.sum(self.omega_o * half) * half - self.omega_o
        return jnp.where(choice < self.cosine_share, from_disc(u, v), mirrored)

    def pdf(self, omega_i: Float[Array, "3"]) -> Float[Array, ""]:
        """Density of `at` by solid angle, over the whole sphere."""
        n = len(self.table.density)
        half = safe.normalize(omega_i + self.omega_o)
        across = jnp.sqrt(jnp.maximum(half[0] ** 2 + half[1] ** 2, 1e-18))
        theta = jnp.arctan2(across, jnp.abs(half[2]))
        root = jnp.sqrt(theta * (2 / math.pi))
        step = jnp.minimum((root * n).astype(jnp.int32), n - 1)
        density = self.table.density.at[step].get(mode="promise_in_bounds")
        # dω_h = sinθ dθ dφ and dθ = π root d(root); dω_i = 4 (ω_o · h) dω_h.
        around = 2 * math.pi * jnp.maximum(across, 1e-9) * math.pi * jnp.maximum(root, 1e-6)
        mirrored = density / (around * 4 * jnp.maximum(jnp.abs(jnp.sum(self.omega_o * half)), 1e-6))
        cosine = jnp.maximum(omega_i[2], 0) / math.pi
        return self.cosine_share * cosine + (1 - self.cosine_share) * mirrored


def half_vectors(brdf: Brdf) -> HalfVectors:
    """Read off a BRDF: what it reflects more than it does far from the mirror direction, by θ_h."""
    root = (np.arange(_STEPS) + 0.5) / _STEPS
    theta = jnp.asarray(root**2 * (math.pi / 2), jnp.float32)
    values, above = _along(brdf, theta, jnp.asarray(_THETA_D), jnp.asarray(_PHI_D))
    values, above = np.maximum(np.asarray(values, float), 0), np.asarray(above)
    floor = np.min(np.where(above, values, np.inf), axis=0)
    extra = np.where(above, np.maximum(values - np.where(np.isfinite(floor), floor, 0), 0), 0)
    counted = np.maximum(above.sum(axis=(1, 2)), 1)
    mean = extra.sum(axis=(1, 2)) / counted
    # Steps that lie below the surface for all pairs go on with what the last one has.
    mass = mean * np.cos(theta) * np.sin(theta) * root
    mass = mass / mass.sum() if mass.sum() > 0 else np.full(_STEPS, 1 / _STEPS)
    mass = 0.99 * mass + 0.01 / _STEPS
    cosines = np.linspace(0, 1, _ELEVATIONS)
    sines = np.sqrt(1 - cosines**2)
    omega_o = jnp.asarray(np.stack([sines, 0 * sines, np.maximum(cosines, 0.02)], axis=1), jnp.float32)
    albedo = np.asarray(jax.lax.map(lambda one: jnp.sum(directional_albedo(brdf, safe.normalize(one))), omega_o))
    diffuse = math.pi * float(np.mean(np.where(np.isfinite(floor), floor, 0)))
    share = diffuse / np.where(albedo > 0, albedo, 1) if diffuse > 0 else np.zeros(_ELEVATIONS)
    share = np.where(albedo > 0, share, 1)
    dtype = jnp.float32
    return HalfVectors(
        jnp.asarray(mass * _STEPS, dtype),
        jnp.asarray(np.cumsum(mass), dtype),
        jnp.asarray(np.clip(np.nan_to_num(share, nan=0.5), _LEAST_SHARE, 1 - _LEAST_SHARE), dtype),
    )


@eqx.filter_jit
def _along(brdf, theta_h, theta_d, phi_d):
    """Of all pairs, f summed over channels, and whether both directions are above the surface: [h, d, p]."""

    def one(h, d, p):
        half = jnp.stack([jnp.sin(h), jnp.zeros_like(h), jnp.cos(h)])
        tangent = jnp.stack([jnp.cos(h), jnp.zeros_like(h), -jnp.sin(h)])
        aside = jnp.sin(d) * (jnp.cos(p) * tangent + jnp.sin(p) * jnp.asarray([0.0, 1, 0]))
        omega_i, omega_o = jnp.cos(d) * half + aside, jnp.cos(d) * half - aside
        above = (omega_i[2] > 1e-3) & (omega_o[2] > 1e-3)
        up = jnp.asarray([0.0, 0, 1])
        return jnp.sum(brdf.evaluate(jnp.where(above, omega_i, up), jnp.where(above, omega_o, up))), above

    grid = jax.vmap(jax.vmap(jax.vmap(one, (None, None, 0)), (None, 0, None)), (0, None, None))
    return grid(theta_h, theta_d, phi_d)
