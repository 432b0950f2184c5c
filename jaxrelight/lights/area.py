"""Light of a rectangle, by samples of it: soft shadows (Hašan 2006 §6)."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.errors import InputError
from jaxrelight.lights.local import PLACE, Incident, Light, Place, Punctual, from_point, place, power, vector
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.numbers import Numbers, Vector, float_dtype, holds


class Patch(Punctual):
    """A small flat piece of a surface that emits the same radiance in all directions in front of it.

    Attributes:
        centre: of the surface.
        offset: of the piece's centre from that.
        normal: of unit length.
        intensity: radiance times area, along the normal.
    """

    centre: Place = eqx.field(metadata=PLACE)
    offset: Float[Array, "3"]
    normal: Float[Array, "3"]
    intensity: Float[Array, "3"]

    @jax.jit
    def at(self, positions: Float[Array, "p 3"]) -> Incident:
        """Falls off with the square of the distance and the cosine of the angle from the normal."""
        incident = from_point(self.centre + self.offset, self.intensity, positions)
        cosine = jnp.maximum(jnp.matmul(-incident.omega_i, self.normal, precision="highest"), 0)
        return incident._replace(irradiance=incident.irradiance * cosine[:, None], within=cosine > 0)


class Area(Light):
    """A parallelogram that emits on the side from which its edges u, v turn counter-clockwise.

    Attributes:
        centre: of it.
        u: one of its edges.
        v: the other.
        radiance: in all directions.
        samples: patches along each edge.
    """

    centre: Place = eqx.field(metadata=PLACE)
    u: Float[Array, "3"]
    v: Float[Array, "3"]
    radiance: Float[Array, "3"]
    samples: int = eqx.field(static=True)

    def parts(self) -> Sequence[Patch]:
        """Patches of equal size."""
        across = jnp.cross(self.u, self.v)
        area = jnp.sqrt(jnp.sum(across**2))
        # Numbers of Python, which leave the type to the arrays.
        steps = ((np.arange(self.samples) + 0.5) / self.samples - 0.5).tolist()
        return [
            Patch(self.centre, a * self.u + b * self.v, across / area, self.radiance * area / self.samples**2)
            for a in steps
            for b in steps
        ]


def area(centre: Vector, u: Vector, v: Vector, radiance: Numbers, samples: int = 4) -> Area:
    """A rectangle, or any parallelogram; numbers and their type as of `point`.

    Args:
        centre: in world units.
        u: one of its edges.
        v: the other.
        radiance: one number or one for each channel.
        samples: its shadows are those of samples² points.

    Raises:
        InputError: for edges along each other, samples outside 1 … 64, or numbers as `point` refuses.
    """
    dtype = float_dtype(centre, u, v, radiance)
    edges = vector("u", u, dtype), vector("v", v, dtype)
    if not holds(lambda u, v: np.linalg.norm(np.cross(u, v)) > 1e-6 * np.linalg.norm(u) * np.linalg.norm(v), *edges):
        raise InputError("an area light's edges u and v lie along each other, or are 0; give it a surface")
    if not (isinstance(samples, int) and 1 <= samples <= 64):
        raise InputError(f"an area light's samples along an edge must be from 1 to 64, not {samples!r}")
    middle, emitted = place("centre", centre, dtype), power("radiance", radiance, dtype)
    return Area(middle, *(as_array(each) for each in (*edges, emitted)), samples=samples)
