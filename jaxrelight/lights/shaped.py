"""A light with the controls of film lighting: its shape, its edges, and how far it reaches (Barzel 1997)."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.errors import InputError
from jaxrelight.lights.local import Incident, Punctual, frame_towards, from_point, power, vector
from jaxrelight.lights.projector import check_frame
from jaxrelight.numerics import safe
from jaxrelight.numerics.arrays import as_array


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

    position: Float[Array, "3"]
    target: Float[Array, "3"]
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
        found = from_point(self.position, 1.0, positions)
        frame = frame_towards(self.position, self.target, self.up)
        right, upwards, depth = jnp.matmul(-found.omega_i, frame.T, precision="highest").T
        in_front = depth > 1e-6
        place = jnp.abs(jnp.stack([right, upwards], axis=1)) / jnp.where(in_front, depth, 1)[:, None]
        # How many times each shape has to grow to reach the place.
        inner, outer = self._reach(place, self.inner), self._reach(place, self.outer)
        width = inner - outer
        edge = jnp.where(width > 0, (inner - 1) * outer / jnp.where(width > 0, width, 1), (inner > 1) * 1.0)
        share = jnp.where(in_front, 1 - _smooth(edge), 0)
        share *= _smooth(_between(found.distance, self.near)) * (1 - _smooth(_between(found.distance, self.far)))
        fallen = safe.power(self.reference / jnp.maximum(found.distance, 1e-6), self.falloff) / self.reference**2
        return found._replace(irradiance=self.intensity * (share * fallen)[:, None], within=share > 0)

    def _reach(self, place: Float[Array, "p 2"], angles: Float[Array, "2"]) -> Float[Array, " p"]:
        exponent = 2 / jnp.maximum(self.roundness, 0.05)
        sums = jnp.sum(safe.power(place / jnp.tan(jnp.radians(angles)), exponent), axis=1)
        return safe.power(sums, 1 / exponent)


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
    position,
    target,
    intensity,
    inner,
    outer=None,
    *,
    up=(0.0, 1.0, 0.0),
    roundness: float = 1.0,
    near=(0.0, 0.0),
    far=(np.inf, np.inf),
    falloff: float = 2.0,
    reference: float = 1.0,
) -> Shaped:
    """A shaped light; angles are one number, or two: across and upwards. Without an outer shape the edge is hard.

    Raises:
        InputError: for shapes that are not 0 < inner ≤ outer < 90, a roundness outside 0 … 1, distances that do not
            grow, a falloff below 0, a reference that is no distance, or numbers as `point` refuses.
    """
    outer = inner if outer is None else outer
    shapes = [np.broadcast_to(np.asarray(angles, float), 2) for angles in (inner, outer)]
    if not (np.isfinite(shapes).all() and (shapes[0] > 0).all() and (shapes[0] <= shapes[1]).all()):
        raise InputError(f"a shaped light's angles must be 0 < inner ≤ outer < 90, not {inner} and {outer}")
    if (shapes[1] >= 90).any():
        raise InputError(f"a shaped light's angles must be below 90 degrees, not {outer}")
    if not 0 <= roundness <= 1:
        raise InputError(f"a shaped light's roundness must be from 0, a rectangle, to 1, an ellipse, not {roundness:g}")
    distances = [0.0, *near, *far]
    if len(distances) != 5 or not all(a <= b for a, b in itertools.pairwise(distances)):
        raise InputError(f"a shaped light's distances must grow: near {list(near)}, then far {list(far)}")
    if not (np.isfinite(falloff) and falloff >= 0):
        raise InputError(f"a shaped light's falloff must be 0 or more, not {falloff:g}")
    if not (np.isfinite(reference) and reference > 0):
        raise InputError(f"a shaped light's reference must be a distance above 0, not {reference:g}")
    placed = vector("position", position), vector("target", target), vector("up", up)
    check_frame("a shaped light", *placed)
    numbers = (*shapes, roundness, near, far, falloff, reference)
    return Shaped(*placed, power("intensity", intensity), *(as_array(value, jnp.float32) for value in numbers))
