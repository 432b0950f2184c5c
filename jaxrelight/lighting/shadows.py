"""Shadow rays from points to lights, inside differentiable functions: they stand still in derivatives."""

import jax
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.geometry.tracer import OFFSET, Tracer
from jaxrelight.lights.local import Incident


def reached(tracer: Tracer, origins: Float[np.ndarray, "r 3"], radius: float, incident: Incident) -> Float[Array, " p"]:
    """1 where nothing stands between a point and the light; 0 in shadow, and for points past the origins.

    Args:
        tracer: of the scene.
        origins: the points in scene space, lifted off their surfaces.
        radius: length of scene space's unit in the world.
        incident: the light at the points, and at others that follow them as padding.
    """

    def trace(omega_i, distance):
        count = len(origins)
        found = np.zeros(len(distance), np.float32)
        # Not as far as the light, so that a lamp's own surface does not hide it.
        near = distance[:count] / radius - 2 * OFFSET
        found[:count] = ~tracer.blocked(origins, omega_i[:count], near)
        return found

    shape = jax.ShapeDtypeStruct(incident.distance.shape, np.float32)
    given = jax.lax.stop_gradient((incident.omega_i, incident.distance))
    return jax.pure_callback(trace, shape, *given, vmap_method="sequential")
