"""Light of a rectangle, by pieces of it: soft shadows (Hašan 2006 §6)."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.errors import InputError
from jaxrelight.lights.local import PLACE, Incident, Light, Place, Punctual, from_point, place, power, vector
from jaxrelight.numerics import safe
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.numbers import Numbers, Vector, float_dtype, holds, module_of

# From and up to which area, over the square of their distance, pieces become more than points.
_POINT, _LARGE = 2.0**-6, 2.0**-4


class Patch(Punctual):
    """A flat piece of a surface that emits the same radiance in all directions in front of it.

    Its light comes from the mean direction of all of it, weighed by radiance, and is all that it has for a surface that
    has the whole piece in front of it.

    Attributes:
        centre: of the surface.
        corners: of the piece, from that, counter-clockwise as seen from its front.
        radiance: in all directions.
    """

    centre: Place = eqx.field(metadata=PLACE)
    corners: Float[Array, "4 3"]
    radiance: Float[Array, "3"]

    @jax.jit
    def at(self, positions: Float[Array, "p 3"]) -> Incident:
        """Nearby it is Lambert's ½ Σ θ Γ over the edges, far away area times cosine over the square of the distance."""
        across = jnp.cross(self.corners[1] - self.corners[0], self.corners[3] - self.corners[0])
        normal, area = safe.normalize(across), safe.norm(across)
        from_centre = jnp.asarray(self.centre)[None] - positions
        far = from_point(jnp.mean(self.corners, axis=0), 1.0, -from_centre)
        height = -jnp.matmul(from_centre + self.corners[:1], normal, precision="highest")
        cosine = -jnp.matmul(far.omega_i, normal, precision="highest")
        t = jnp.clip((area * far.irradiance[:, 0] - _POINT) / (_LARGE - _POINT), 0, 1)
        near = jnp.where(height > 0, t * t * (3 - 2 * t), 0)
        as_point = far.omega_i, far.distance, area * far.irradiance[:, 0] * cosine, cosine

        def as_surface():
            whole = _vector_irradiance(from_centre, self.corners)
            whole = near[:, None] * whole + ((1 - near) * as_point[2])[:, None] * far.omega_i
            omega_i = jnp.where(near[:, None] > 0, safe.normalize(whole), far.omega_i)
            cosine = -jnp.matmul(omega_i, normal, precision="highest")
            distance = jnp.where(near > 0, height / jnp.where(cosine > 1e-6, cosine, 1), far.distance)
            return omega_i, distance, jnp.where(near > 0, safe.norm(whole), as_point[2]), cosine

        omega_i, distance, share, cosine = jax.lax.cond(jnp.any(near > 0), as_surface, lambda: as_point)
        within = (height > 0) & (cosine > 0)
        irradiance = jnp.where(within, share, 0)[:, None] * self.radiance[None]
        return Incident(omega_i, distance, irradiance, within)


def _vector_irradiance(from_centre: Float[Array, "p 3"], corners: Float[Array, "4 3"]) -> Float[Array, "p 3"]:
    """½ Σ θ Γ: of each edge the angle that it covers, times the unit normal of its plane with a point."""
    # Edges that pieces share are the same numbers of both, and cancel. Components are arrays [4, p] of their own, since
    # sums over an innermost axis of three are slow.
    x, y, z = from_centre.T[:, None] + corners.T[:, :, None]
    length = jnp.sqrt(jnp.maximum(x * x + y * y + z * z, 1e-30))
    x, y, z = jax.lax.optimization_barrier((x / length, y / length, z / length))
    a, b, c = (jnp.roll(of, -1, axis=0) for of in (x, y, z))
    turn = b * z - c * y, c * x - a * z, a * y - b * x
    square, cosine = sum(of * of for of in turn), a * x + b * y + c * z
    # An angle over its sine; of small ones it is 1.
    is_wide = square > 1e-8
    sine = jnp.sqrt(jnp.where(is_wide, square, 1))
    ratio = jnp.where(is_wide, jnp.arctan2(sine, cosine) / sine, 1)
    return jnp.stack([jnp.sum(ratio * of, axis=0) for of in turn], axis=1) / 2


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
        steps = np.arange(self.samples + 1) / self.samples - 0.5
        # [a, b, 3]
        u, v = (module_of(self.u, self.v).asarray(edge) for edge in (self.u, self.v))
        points = (steps[:, None, None] * u[None, None] + steps[None, :, None] * v[None, None]).astype(u.dtype)
        cells = [points[:-1, :-1], points[1:, :-1], points[1:, 1:], points[:-1, 1:]]
        corners = module_of(u).stack(cells, axis=2).reshape(-1, 4, 3)
        return [Patch(self.centre, own, self.radiance) for own in corners]


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
    if not holds(_turns, *edges):
        raise InputError("an area light's edges u and v lie along each other, or are 0; give it a surface")
    if not (isinstance(samples, int) and 1 <= samples <= 64):
        raise InputError(f"an area light's samples along an edge must be from 1 to 64, not {samples!r}")
    middle, emitted = place("centre", centre, dtype), power("radiance", radiance, dtype)
    return Area(middle, *(as_array(each) for each in (*edges, emitted)), samples=samples)


def _turns(u: Float[np.ndarray, "3"], v: Float[np.ndarray, "3"]) -> np.bool_:
    """Whether edges span a surface. Squares of squares of large ones are more than single precision holds."""
    u, v = u.astype(float), v.astype(float)
    return np.linalg.norm(np.cross(u, v)) > 1e-6 * np.linalg.norm(u) * np.linalg.norm(v)
