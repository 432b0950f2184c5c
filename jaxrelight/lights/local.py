"""Lights with a place or a direction: what arrives at points of the world. No rays are traced here."""

import abc
import dataclasses
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
from jaxrelight.numerics.arrays import as_array, is_traced
from jaxrelight.numerics.numbers import (
    Number,
    Numbers,
    Vector,
    as_numbers,
    float_dtype,
    holds,
    is_known,
    module_of,
    shown,
)

# What is a position in the world. One that is known stays on the host in double precision until it is told from a
# scene's centre: in single precision it would be off by 0.03 where it is 1e6 from the origin.
PLACE = {"is_place": True}
Place = Float[Array | np.ndarray, "3"]


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
    Fields that are positions in the world are declared as `eqx.field(metadata=PLACE)`.
    """

    @abc.abstractmethod
    def at(self, positions: Float[Array, "p 3"]) -> Incident:
        """What arrives at positions in the world."""

    def relative_to(self, origin: Float[np.ndarray, "3"]) -> "Punctual":
        """The light where positions count from an origin: near it they are exact in single precision, too.

        Raises:
            InputError: for a target so near its light that single precision does not tell them apart.
        """
        fields = dataclasses.fields(self)
        dtype = float_dtype([getattr(self, field.name) for field in fields if not field.metadata.get("is_place")])
        places = {
            field.name: _from_origin(getattr(self, field.name), origin, dtype)
            for field in fields
            if field.metadata.get("is_place")
        }
        if not places:
            return Displaced(self, origin)
        if {"position", "target"} <= places.keys():
            check_target("a light", places["position"], places["target"])
        return dataclasses.replace(self, **places)

    def parts(self) -> Sequence["Punctual"]:
        """Itself."""
        return (self,)


class Displaced(Punctual):
    """Any light, where positions count from an origin.

    Attributes:
        light: as it is in the world.
        origin: in the world.
    """

    light: Punctual
    origin: Place

    def at(self, positions: Float[Array, "p 3"]) -> Incident:
        """What the light gives there."""
        return self.light.at(positions + jnp.asarray(self.origin, positions.dtype)[None])


class Point(Punctual):
    """Intensity in W/sr, the same in all directions, from a position."""

    position: Place = eqx.field(metadata=PLACE)
    intensity: Float[Array, "3"]

    @jax.jit
    def at(self, positions: Float[Array, "p 3"]) -> Incident:
        """Falls off with the square of the distance."""
        return from_point(self.position, self.intensity, positions)


class Spot(Punctual):
    """A point light with a cone around the direction to `target`.

    Intensity is whole up to `beam` degrees from the axis, nothing beyond `cutoff`, and linear in the angle between.
    """

    position: Place = eqx.field(metadata=PLACE)
    target: Place = eqx.field(metadata=PLACE)
    intensity: Float[Array, "3"]
    cutoff: Float[Array, ""]
    beam: Float[Array, ""]

    @jax.jit
    def at(self, positions: Float[Array, "p 3"]) -> Incident:
        """Falls off with the square of the distance and towards the cone's edge."""
        incident = from_point(self.position, self.intensity, positions)
        axis = safe.normalize(jnp.subtract(self.target, self.position))
        along = -jnp.matmul(incident.omega_i, axis, precision="highest")
        # At the light itself there is no direction.
        along, across = (
            jnp.where(incident.distance > 0, along, 1),
            safe.norm(incident.omega_i + along[:, None] * axis[None]),
        )
        angle = jnp.degrees(jnp.arctan2(across, along))
        width = self.cutoff - self.beam
        soft = (self.cutoff - angle) / jnp.where(width > 0, width, 1)
        share = jnp.where(width > 0, safe.clamp(soft, 0, 1), (angle <= self.cutoff).astype(angle.dtype))
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

    def relative_to(self, origin: Float[np.ndarray, "3"]) -> Punctual:
        """Itself."""
        return self


def point(position: Vector, intensity: Numbers) -> Point:
    """A point light. Differentiable; numbers of this and of all other lights may be traced.

    The light has the floating type of the arrays given, or JAX's own for numbers of Python. Positions that are known
    stay on the host in double precision: pictures of a scene far from the origin are as exact as those of one near it.

    Args:
        position: in world units.
        intensity: in W/sr, one number or one for each channel.

    Raises:
        InputError: for numbers that are not finite, negative intensities, or other shapes.
    """
    dtype = float_dtype(position, intensity)
    return Point(place("position", position, dtype), power("intensity", intensity, dtype))


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
    stands, aim = place("position", position, dtype), place("target", target, dtype)
    check_target("a spot", stands, aim)
    angles = as_array(outer, dtype), as_array(inner, dtype)
    return Spot(stands, aim, power("intensity", intensity, dtype), *angles)


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


def _from_origin(position: Place, origin: Float[np.ndarray, "3"], dtype: np.dtype) -> Place:
    """A position less an origin: in double precision where it is known."""
    if not is_traced(position):
        return (np.asarray(position, float) - origin).astype(dtype)
    # In two steps, of which the first is exact near the origin; XLA would make them one.
    coarse = origin.astype(position.dtype)
    return jax.lax.optimization_barrier(position - coarse) - (origin - coarse).astype(position.dtype)


def check_target(what: str, position: Place, target: Place) -> None:
    """Refuses a light that does not know where it looks, as far as that is known.

    Raises:
        InputError: naming it.
    """
    if not holds(lambda position, target: (target != position).any(), position, target):
        raise InputError(f"{what}'s target is where it stands; give it another")


def from_point(place: Place, intensity: Float[Array, "3"] | float, positions: Float[Array, "p 3"]) -> Incident:
    """Light of one intensity in all directions: it falls off with the square of the distance."""
    towards = jnp.subtract(place[None], positions)
    distance = safe.norm(towards)
    # At the light itself the square would be infinite.
    square = jnp.maximum(distance, 1e-6) ** 2
    omega_i = towards / jnp.where(distance > 0, distance, 1)[:, None]
    intensity = jnp.expand_dims(intensity, 0) if jnp.ndim(intensity) else intensity
    return Incident(omega_i, distance, jnp.broadcast_to(intensity / square[:, None], positions.shape))


def frame_towards(place: Place, target: Place, up: Float[Array, "3"]) -> Float[Array, "3 3"]:
    """Rows right, up and forward of what looks from a place to a target, as a camera does."""
    forward = safe.normalize(jnp.subtract(target, place))
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


def place(name: str, values: Vector, dtype: DTypeLike) -> Place:
    """A position of a light of a floating type, see `PLACE`.

    Raises:
        InputError: for what are not three finite numbers, by its name.
    """
    is_widest = dtype == jax.dtypes.canonicalize_dtype(np.float64)
    return vector(name, values, np.float64 if is_widest and is_known(values) else dtype)


def power(name: str, values: Numbers, dtype: DTypeLike | None = None) -> Float[Array, "3"]:
    """A number for each channel, finite and not negative, from one or three.

    Raises:
        InputError: for anything else, by its name.
    """
    numbers = as_numbers(values)
    if numbers.shape not in ((), (3,)) or not holds(lambda numbers: np.isfinite(numbers) & (numbers >= 0), numbers):
        raise InputError(f"{name} must be one number or three, finite and not negative, not {shown(values)}")
    return as_array(module_of(numbers).broadcast_to(numbers, (3,)), float_dtype(values) if dtype is None else dtype)
