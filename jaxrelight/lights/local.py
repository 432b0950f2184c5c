"""Lights with a place or a direction: what arrives at points of the world. No rays are traced here."""

import abc
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Bool, Float

from jaxrelight.errors import InputError
from jaxrelight.numerics import safe
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.numbers import (
    Number,
    Numbers,
    Vector,
    as_numbers,
    float_dtype,
    holds,
    module_of,
    shown,
)


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
        incident = from_point(self.position, self.intensity, positions)
        axis = safe.normalize(self.target - self.position)
        along = -jnp.matmul(incident.omega_i, axis, precision="highest")
        # At the light itself there is no direction.
        along, across = (
            jnp.where(incident.distance > 0, along, 1),
            safe.norm(incident.omega_i + along[:, None] * axis[None]),
        )
        angle = jnp.degrees(jnp.arctan2(across, along))
        width = self.cutoff - self.beam
        soft = (self.cutoff - angle) / jnp.where(width > 0, width, 1)
        share = jnp.where(width > 0, jnp.clip(soft, 0, 1), (angle <= self.cutoff).astype(angle.dtype))
        return incident._replace(irradiance=incident.irradiance * share[:, None], within=share > 0)


class Directional(Punctual):
    """Parallel light that travels along `direction`, with an irradiance on a surface across it."""

    direction: Float[Array, "*l 3"]
    irradiance: Float[Array, "*l 3"]

    @jax.jit
    def at(self, positions: Float[Array, "p 3"]) -> Incident:
        """The same everywhere."""
        towards = jnp.broadcast_to(-safe.normalize(self.direction), positions.shape)
        irradiance = jnp.broadcast_to(self.irradiance, positions.shape)
        return Incident(towards, jnp.full(positions.shape[:1], jnp.inf, positions.dtype), irradiance)


def point(position: Vector, intensity: Numbers) -> Point:
    """A point light. Differentiable; numbers of this and of all other lights may be traced.

    The light has the floating type of the arrays given, or JAX's own for numbers of Python.

    Args:
        position: in world units.
        intensity: in W/sr, one number or one for each channel.

    Raises:
        InputError: for numbers that are not finite, negative intensities, or other shapes.
    """
    dtype = float_dtype(position, intensity)
    return Point(as_array(vector("position", position, dtype)), power("intensity", intensity, dtype))


def spot(position: Vector, target: Vector, intensity: Numbers, cutoff: Number, beam: Number | None = None) -> Spot:
    """A spot light; numbers and their type as of `point`.

    Args:
        position: in world units.
        target: a point that its axis goes through.
        intensity: in W/sr along the axis, one number or one for each channel.
        cutoff: degrees from the axis to where there is no light.
        beam: degrees from the axis up to which there is all of it; by default three quarters of the cutoff.

    Raises:
        InputError: for a target at the position, angles that are not 0 ≤ beam ≤ cutoff ≤ 180 with cutoff > 0, or
            numbers as `point` refuses.
    """
    beam_angle: Any = 0.75 * cutoff if beam is None else beam
    dtype = float_dtype(position, target, intensity, cutoff, beam_angle)
    inner, outer = as_numbers(beam_angle), as_numbers(cutoff)
    sound = inner.ndim == outer.ndim == 0
    sound = sound and holds(lambda inner: inner >= 0, inner)
    sound = sound and holds(lambda outer: (outer > 0) & (outer <= 180), outer)
    if not (sound and holds(lambda inner, outer: inner <= outer, inner, outer)):
        raise InputError(
            f"a spot's angles must be 0 ≤ beam ≤ cutoff ≤ 180, not beam {shown(beam_angle)} and cutoff {shown(cutoff)}"
        )
    place, aim = vector("position", position, dtype), vector("target", target, dtype)
    if not holds(lambda place, aim: (place != aim).any(), place, aim):
        raise InputError("a spot's target is where it stands; give it another")
    placed, angles = (as_array(place), as_array(aim)), (as_array(outer, dtype), as_array(inner, dtype))
    return Spot(*placed, power("intensity", intensity, dtype), *angles)


def directional(direction: Vector, irradiance: Numbers) -> Directional:
    """A distant light; numbers and their type as of `point`.

    Args:
        direction: along which its light travels, of any length.
        irradiance: on a surface across it, one number or one for each channel.

    Raises:
        InputError: for the zero vector, or numbers as `point` refuses.
    """
    dtype = float_dtype(direction, irradiance)
    along = vector("direction", direction, dtype)
    if not holds(lambda along: along.any(), along):
        raise InputError("a directional light's direction is the zero vector; say where its light goes")
    return Directional(as_array(along), power("irradiance", irradiance, dtype))


def from_point(
    place: Float[Array, "3"], intensity: Float[Array, "3"] | float, positions: Float[Array, "p 3"]
) -> Incident:
    """Light of one intensity in all directions: it falls off with the square of the distance."""
    towards = place[None] - positions
    distance = safe.norm(towards)
    # At the light itself the square would be infinite.
    square = jnp.maximum(distance, 1e-6) ** 2
    omega_i = towards / jnp.where(distance > 0, distance, 1)[:, None]
    intensity = jnp.expand_dims(intensity, 0) if jnp.ndim(intensity) else intensity
    return Incident(omega_i, distance, jnp.broadcast_to(intensity / square[:, None], positions.shape))


def frame_towards(place: Float[Array, "3"], target: Float[Array, "3"], up: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Rows right, up and forward of what looks from a place to a target, as a camera does."""
    forward = safe.normalize(target - place)
    right = safe.normalize(jnp.cross(forward, up))
    return jnp.stack([right, jnp.cross(right, forward), forward])


def vector(name: str, values: Vector, dtype: DTypeLike) -> Any:
    """Three finite numbers, on the host where they are known, else of JAX.

    Raises:
        InputError: for anything else, by its name.
    """
    numbers = as_numbers(values)
    if numbers.shape != (3,) or not holds(np.isfinite, numbers):
        raise InputError(f"{name} must be three finite numbers, not {shown(values)}")
    return numbers.astype(dtype)


def power(name: str, values: Numbers, dtype: DTypeLike | None = None) -> Float[Array, "3"]:
    """A number for each channel, finite and not negative, from one or three.

    Raises:
        InputError: for anything else, by its name.
    """
    numbers = as_numbers(values)
    if numbers.shape not in ((), (3,)) or not holds(lambda numbers: np.isfinite(numbers) & (numbers >= 0), numbers):
        raise InputError(f"{name} must be one number or three, finite and not negative, not {shown(values)}")
    return as_array(module_of(numbers).broadcast_to(numbers, (3,)), float_dtype(values) if dtype is None else dtype)
