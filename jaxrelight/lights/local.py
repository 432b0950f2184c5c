"""Lights with a place or a direction: what arrives at points of the world. No rays are traced here."""

import abc
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float

from jaxrelight.errors import InputError
from jaxrelight.numerics import safe
from jaxrelight.numerics.arrays import as_array


class Incident(NamedTuple):
    """Light that arrives at points.

    Attributes:
        omega_i: unit direction to the light.
        distance: to it in world units; infinite for a distant light.
        irradiance: on a surface that faces it.
        within: where light can arrive, however strong it is; everywhere without. No shadow rays start elsewhere.
    """

    omega_i: Float[Array, "p 3"]
    distance: Float[Array, " p"]
    irradiance: Float[Array, "p 3"]
    within: Bool[Array, " p"] | None = None


class Light(eqx.Module):
    """Any light that is not a whole environment: a sum of punctual ones."""

    @abc.abstractmethod
    def parts(self) -> Sequence["Punctual"]:
        """Lights that together are this one, each with shadows of its own."""


class Punctual(Light):
    """A light that comes from one direction at each point. A light of your own is a class of this kind.

    `at` is pure, compiled, and differentiable in positions and in the light's numbers: it is written in `jax.numpy`.
    """

    @abc.abstractmethod
    def at(self, positions: Float[Array, "p 3"]) -> Incident:
        """What arrives at positions in the world."""

    def parts(self) -> Sequence["Punctual"]:
        """Itself."""
        return (self,)


class Point(Punctual):
    """Intensity in W/sr, the same in all directions, from a position."""

    position: Float[Array, "3"]
    intensity: Float[Array, "3"]

    @jax.jit
    def at(self, positions: Float[Array, "p 3"]) -> Incident:
        """Falls off with the square of the distance."""
        return from_point(self.position, self.intensity, positions)


class Spot(Punctual):
    """A point light with a cone around the direction to `target`.

    Intensity is whole up to `beam` degrees from the axis, nothing beyond `cutoff`, and linear in the angle between.
    """

    position: Float[Array, "3"]
    target: Float[Array, "3"]
    intensity: Float[Array, "3"]
    cutoff: Float[Array, ""]
    beam: Float[Array, ""]

    @jax.jit
    def at(self, positions: Float[Array, "p 3"]) -> Incident:
        """Falls off with the square of the distance and towards the cone's edge."""
        found = from_point(self.position, self.intensity, positions)
        axis = safe.normalize(self.target - self.position)
        along = -jnp.matmul(found.omega_i, axis, precision="highest")
        # At the light itself there is no direction.
        along, across = jnp.where(found.distance > 0, along, 1), safe.norm(found.omega_i + along[:, None] * axis)
        angle = jnp.degrees(jnp.arctan2(across, along))
        width = self.cutoff - self.beam
        soft = (self.cutoff - angle) / jnp.where(width > 0, width, 1)
        share = jnp.where(width > 0, jnp.clip(soft, 0, 1), (angle <= self.cutoff).astype(angle.dtype))
        return found._replace(irradiance=found.irradiance * share[:, None], within=share > 0)


class Directional(Punctual):
    """Parallel light that travels along `direction`, with an irradiance on a surface across it."""

    direction: Float[Array, "3"]
    irradiance: Float[Array, "3"]

    @jax.jit
    def at(self, positions: Float[Array, "p 3"]) -> Incident:
        """The same everywhere."""
        towards = jnp.broadcast_to(-safe.normalize(self.direction), positions.shape)
        irradiance = jnp.broadcast_to(self.irradiance, positions.shape)
        return Incident(towards, jnp.full(positions.shape[:1], jnp.inf, positions.dtype), irradiance)


def point(position, intensity) -> Point:
    """A point light; intensity one number or one for each channel.

    Raises:
        InputError: for numbers that are not finite or negative intensities.
    """
    return Point(vector("position", position), power("intensity", intensity))


def spot(position, target, intensity, cutoff: float, beam: float | None = None) -> Spot:
    """A spot light; without a beam, three quarters of the cutoff.

    Raises:
        InputError: for a target at the position, angles that are not 0 ≤ beam ≤ cutoff ≤ 180 with cutoff > 0, or
            numbers as `point` refuses.
    """
    beam = 0.75 * cutoff if beam is None else beam
    if not (np.isfinite([cutoff, beam]).all() and 0 <= beam <= cutoff <= 180 and cutoff > 0):
        raise InputError(f"a spot's angles must be 0 ≤ beam ≤ cutoff ≤ 180, not beam {beam:g} and cutoff {cutoff:g}")
    position, target = vector("position", position), vector("target", target)
    if (position == target).all():
        raise InputError("a spot's target is where it stands; give it another")
    angles = (as_array(angle, jnp.float32) for angle in (cutoff, beam))
    return Spot(position, target, power("intensity", intensity), *angles)


def directional(direction, irradiance) -> Directional:
    """A distant light that travels along `direction`.

    Raises:
        InputError: for the zero vector, or numbers as `point` refuses.
    """
    direction = vector("direction", direction)
    if not direction.any():
        raise InputError("a directional light's direction is the zero vector; say where its light goes")
    return Directional(direction, power("irradiance", irradiance))


def from_point(
    place: Float[Array, "3"], intensity: Float[Array, "3"] | float, positions: Float[Array, "p 3"]
) -> Incident:
    """Light of one intensity in all directions: it falls off with the square of the distance."""
    towards = place - positions
    distance = safe.norm(towards)
    # At the light itself the square would be infinite.
    square = jnp.maximum(distance, 1e-6) ** 2
    omega_i = towards / jnp.where(distance > 0, distance, 1)[:, None]
    return Incident(omega_i, distance, jnp.broadcast_to(intensity / square[:, None], positions.shape))


def frame_towards(place: Float[Array, "3"], target: Float[Array, "3"], up: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Rows right, up and forward of what looks from a place to a target, as a camera does."""
    forward = safe.normalize(target - place)
    right = safe.normalize(jnp.cross(forward, up))
    return jnp.stack([right, jnp.cross(right, forward), forward])


def vector(name: str, values) -> Float[Array, "3"]:
    """Three finite numbers; anything else is refused by name."""
    array = np.asarray(values, float)
    if array.shape != (3,) or not np.isfinite(array).all():
        raise InputError(f"{name} must be three finite numbers, not {values!r}")
    return as_array(array, jnp.float32)


def power(name: str, values) -> Float[Array, "3"]:
    """A number for each channel, finite and not negative, from one or three."""
    array = np.asarray(values, float)
    if array.shape not in ((), (3,)) or not np.isfinite(array).all() or (array < 0).any():
        raise InputError(f"{name} must be one number or three, finite and not negative, not {values!r}")
    return as_array(np.broadcast_to(array, (3,)), jnp.float32)
