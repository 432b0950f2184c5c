"""A light with the controls of film lighting: its shape, its edges, and how far it reaches (Barzel 1997)."""

import itertools
import math
from collections.abc import Callable, Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.errors import InputError
from jaxrelight.lights.local import PLACE, Incident, Place, Punctual, frame_towards, from_point, place, power, vector
from jaxrelight.lights.projector import check_frame
from jaxrelight.numerics import safe
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.numbers import Number, Numbers, Vector, as_numbers, float_dtype, holds, module_of, shown

# A roundness below which the exponent grows no more: the smaller part counts for nothing then.
_SQUARE = 1e-3
# Two distances.
Pair = Float[Array | np.ndarray, "2"] | Sequence[Number]


class Shaped(Punctual):
    """A spot whose beam is a superellipse, which begins and ends at distances, and falls off by a power of its own.

    Attributes:
        position: of the light.
        target: what its axis goes through.
        up: the direction of the beam's height.
        intensity: in W/sr, whole within the inner shape.
        inner: degrees from the axis to its sides, across and upwards.
        outer: the same of the shape beyond which there is nothing; between them light falls off smoothly.
        roundness: of both shapes: 1 for ellipses, towards 0 for rectangles.
        near: distances at which light begins, and is whole.
        far: distances up to which it is whole, and at which it ends.
        falloff: exponent of the distance: 2 is that of a real light, 0 none.
        reference: distance at which all exponents give the same light.
    """

    position: Place = eqx.field(metadata=PLACE)
    target: Place = eqx.field(metadata=PLACE)
    up: Float[Array, "3"]
    intensity: Float[Array, "3"]
    inner: Float[Array, "2"]
    outer: Float[Array, "2"]
    roundness: Float[Array, ""]
    near: Float[Array, "2"]
    far: Float[Array, "2"]
    falloff: Float[Array, ""]
    reference: Float[Array, ""]

    @jax.jit
    def at(self, positions: Float[Array, "p 3"]) -> Incident:
        """Intensity / reference² · (reference / distance)^falloff, times the shares of shape and distance."""
        incident = from_point(self.position, 1.0, positions)
        frame = frame_towards(self.position, self.target, self.up)
        right, upwards, depth = jnp.matmul(-incident.omega_i, frame.T, precision="highest").T
        in_front = depth > 1e-6
        aside = jnp.abs(jnp.stack([right, upwards], axis=1)) / jnp.where(in_front, depth, 1)[:, None]
        # How many times each shape has to grow to reach the place.
        inner, outer = self._reach(aside, self.inner), self._reach(aside, self.outer)
        width = inner - outer
        edge = jnp.where(width > 0, (inner - 1) * outer / jnp.where(width > 0, width, 1), (inner > 1) * 1.0)
        share = jnp.where(in_front, 1 - _smooth(edge), 0)
        share *= _smooth(_between(incident.distance, self.near)) * (1 - _smooth(_between(incident.distance, self.far)))
        fallen = safe.power(self.reference / jnp.maximum(incident.distance, 1e-6), self.falloff) / self.reference**2
        return incident._replace(irradiance=self.intensity[None] * (share * fallen)[:, None], within=share > 0)

    def _reach(self, aside: Float[Array, "p 2"], angles: Float[Array, "2"]) -> Float[Array, " p"]:
        """(Σ (x/X)^(2/roundness))^(roundness/2): of roundness 0, whose exponent is infinite, the larger of x/X.

        Only the smaller over the larger is raised to the power, so that nothing overflows, however wide the edges are.
        """
        across, along = (aside / jnp.tan(jnp.radians(angles))[None]).T
        larger, smaller = jnp.maximum(across, along), jnp.minimum(across, along)
        part = safe.power(smaller / jnp.where(larger == 0, 1, larger), 2 / safe.clamp(self.roundness, _SQUARE))
        return larger * jnp.exp(0.5 * self.roundness * jnp.log1p(part))


def _smooth(t: Float[Array, " p"]) -> Float[Array, " p"]:
    """From 0 to 1, flat at both ends."""
    t = jnp.clip(t, 0, 1)
    return t * t * (3 - 2 * t)


def _between(distance: Float[Array, " p"], ends: Float[Array, "2"]) -> Float[Array, " p"]:
    """Below 0 before the first, above 1 past the second."""
    width = ends[1] - ends[0]
    finite = jnp.isfinite(ends[1]) & (width > 0)
    soft = (distance - ends[0]) / jnp.where(finite, width, 1)
    return jnp.where(finite, soft, (distance > ends[0]) * 1.0)


def shaped(
    position: Vector,
    target: Vector,
    intensity: Numbers,
    inner: Numbers,
    outer: Numbers | None = None,
    *,
    up: Vector = (0.0, 1.0, 0.0),
    roundness: Number = 1.0,
    near: Pair = (0.0, 0.0),
    far: Pair = (math.inf, math.inf),
    falloff: Number = 2.0,
    reference: Number = 1.0,
) -> Shaped:
    """A shaped light, see `Shaped`; numbers and their type as of `point`.

    Args:
        position: in world units.
        target: a point that its axis goes through.
        intensity: in W/sr, one number or one for each channel.
        inner: degrees from the axis to the sides of the shape that has all the light: one number, or two, across and
            upwards.
        outer: the same of the shape beyond which there is none; by default the inner one, which makes the edge hard.
        up: the direction of the beam's height.
        roundness: 1 for ellipses, towards 0 for rectangles.
        near: distances at which light begins, and is whole.
        far: distances up to which it is whole, and at which it ends.
        falloff: exponent of the distance.
        reference: distance at which all exponents give the same light.

    Raises:
        InputError: for shapes that are not 0 < inner ≤ outer < 90, a roundness outside 0 … 1, distances that do not
            grow, a falloff below 0, a reference that is no distance, or numbers as `point` refuses.
    """
    outer = inner if outer is None else outer
    dtype = float_dtype(position, target, intensity, inner, outer, up, roundness, near, far, falloff, reference)
    shapes = [as_numbers(angles) for angles in (inner, outer)]
    sound = all(angles.shape in ((), (2,)) and holds(_is_positive, angles) for angles in shapes)
    if not (sound and holds(lambda inner, outer: inner <= outer, *shapes)):
        raise InputError(
            f"a shaped light's angles must be 0 < inner ≤ outer < 90, not {shown(inner)} and {shown(outer)}"
        )
    if not holds(lambda outer: outer < 90, shapes[1]):
        raise InputError(f"a shaped light's angles must be below 90 degrees, not {shown(outer)}")
    if not _is_one(roundness, lambda roundness: (roundness >= 0) & (roundness <= 1)):
        raise InputError(
            f"a shaped light's roundness must be from 0, a rectangle, to 1, an ellipse, not {shown(roundness)}"
        )
    distances = [as_numbers(ends) for ends in (near, far)]
    grow = all(ends.shape == (2,) for ends in distances) and all(
        holds(lambda nearer, farther: nearer <= farther, *pair) for pair in itertools.pairwise([0.0, *near, *far])
    )
    if not grow:
        raise InputError(f"a shaped light's distances must grow: near {shown(near)}, then far {shown(far)}")
    if not _is_one(falloff, lambda falloff: (falloff >= 0) & (falloff < np.inf)):
        raise InputError(f"a shaped light's falloff must be 0 or more, not {shown(falloff)}")
    if not _is_one(reference, _is_positive):
        raise InputError(f"a shaped light's reference must be a distance above 0, not {shown(reference)}")
    placed, upwards = (place("position", position, dtype), place("target", target, dtype)), vector("up", up, dtype)
    check_frame("a shaped light", *placed, upwards)
    angle_pairs = [module_of(angles).broadcast_to(angles, (2,)) for angles in shapes]
    emitted = power("intensity", intensity, dtype)
    numbers = (*angle_pairs, as_numbers(roundness), *distances, as_numbers(falloff), as_numbers(reference))
    return Shaped(*placed, *(as_array(each, dtype) for each in (upwards, emitted, *numbers)))


def _is_positive(numbers: np.ndarray) -> np.ndarray | np.bool:
    return (numbers > 0) & (numbers < np.inf)


def _is_one(value: Number, condition: Callable[[np.ndarray], np.ndarray | np.bool]) -> bool:
    """Whether it is a single number, and meets a condition where it is known."""
    number = as_numbers(value)
    return number.ndim == 0 and holds(condition, number)
