"""Shadow rays from points to lights, inside differentiable functions: they stand still in derivatives."""

import collections
import hashlib

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer as JaxTracer
from jaxtyping import Array, Bool, Float, Int

from jaxrelight.geometry.tracer import OFFSET, Tracer
from jaxrelight.lights.local import Incident, Punctual
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.threads import in_parts

# Rays of a part.
_EACH = 8192
# Bytes of what was found for lights before, and of what keeping it costs each time: a sky of 256 at a million points.
_KEPT, _EACH_KEPT = 32 << 20, 300


class Shadows:
    """What lights reach of fixed points. A light that comes again from where it was costs no rays.

    Attributes:
        origins: of the rays, in scene space.
        positions: of the points in the world, and padding.
        radius: length of scene space's unit in the world.
    """

    def __init__(
        self,
        tracer: Tracer,
        origins: Float[np.ndarray, "r 3"],
        positions: Float[Array, "p 3"],
        normals: Float[Array, "p 3"],
        radius: float,
    ):
        """Of points, and others that follow them as padding.

        Args:
            tracer: of the scene.
            origins: the points in scene space, lifted off their surfaces.
            positions: theirs in the world.
            normals: rays start where light comes from in front alone.
            radius: length of scene space's unit in the world.
        """
        self.origins = np.ascontiguousarray(origins, np.float32)
        self._tracer, self.radius = tracer, radius
        self.positions, self._normals = positions, normals
        self._kept: collections.OrderedDict[bytes, np.ndarray] = collections.OrderedDict()
        self._held = 0

    def arriving(self, punctual: Punctual, shadows: bool = True) -> tuple[Incident, Float[Array, " p"]]:
        """A light at the points, and 1 where nothing stands between; 0 in shadow, behind, and for padding.

        Without shadows, 1 everywhere.
        """
        # Numbers that are no arrays would be compiled in, for every place of the light anew.
        punctual = jax.tree.map(lambda x: as_array(x, np.float32) if isinstance(x, float) else x, punctual)
        incident, lit = _arriving(punctual, self.positions, self._normals)
        if not shadows:
            return incident, as_array(np.ones(incident.distance.shape, np.float32))
        if not isinstance(incident.distance, JaxTracer):
            # Called back, it would be compiled for every light.
            return incident, as_array(self._traced(incident.omega_i, incident.distance, lit))
        shape = jax.ShapeDtypeStruct(incident.distance.shape, np.float32)
        given = jax.lax.stop_gradient((incident.omega_i, incident.distance))
        return incident, jax.pure_callback(self._traced, shape, *given, lit, vmap_method="sequential")

    def hidden(self, point: Int[np.ndarray, " r"], towards: Float[np.ndarray, "r 3"]) -> Bool[np.ndarray, " r"]:
        """Whether something stands in the way of distant light: of rays from points, by number."""
        return self._on_all_threads(self._tracer.occluded, point, towards)

    def distances(self, point: Int[np.ndarray, " r"], towards: Float[np.ndarray, "r 3"]) -> Float[np.ndarray, " r"]:
        """How far in the world the first thing in the way is, infinite for none."""
        return self.radius * self._on_all_threads(self._tracer.distances, point, towards)

    def _traced(self, omega_i, distance, lit) -> Float[np.ndarray, " p"]:
        count = len(self.origins)
        asked = np.flatnonzero(np.asarray(lit)[:count])
        found = np.zeros(len(distance), np.float32)
        towards, far = np.asarray(omega_i)[asked], np.asarray(distance)[asked]
        key = hashlib.blake2b()
        for array in (asked, towards, far):
            key.update(array.data)
        bits = self._kept.get(key.digest())
        if bits is None:
            # Not as far as the light, so that a lamp's own surface does not hide it.
            bits = np.packbits(~self._blocked(asked, towards, far / self.radius - 2 * OFFSET))
            self._kept[key.digest()] = bits
            self._held += len(bits) + _EACH_KEPT
        self._kept.move_to_end(key.digest())
        while len(self._kept) > 1 and self._held > _KEPT:
            self._held -= len(self._kept.popitem(last=False)[1]) + _EACH_KEPT
        found[asked] = np.unpackbits(bits, count=len(asked))
        return found

    def _blocked(self, asked, towards, near):
        return self._on_all_threads(self._tracer.blocked, asked, towards, near)

    def _on_all_threads(self, query, point, *given):
        def part(rows: slice):
            return query(self.origins[point[rows]], *(x[rows] for x in given))

        return np.concatenate(in_parts(part, len(point), _EACH))


@eqx.filter_jit
def _arriving(punctual: Punctual, positions, normals):
    incident = punctual.at(positions)
    in_front = jnp.sum(incident.omega_i * normals, axis=1) > 0
    return incident, in_front if incident.within is None else in_front & incident.within
