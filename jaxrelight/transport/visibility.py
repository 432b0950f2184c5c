"""What each receiver sees of the environment: one bit a direction, without any material."""

import numpy as np
from jaxtyping import Float, UInt8

from jaxrelight.geometry.tracer import Tracer


def trace_visibility(
    tracer: Tracer,
    origins: Float[np.ndarray, "m 3"],
    normals: Float[np.ndarray, "m 3"],
    directions: Float[np.ndarray, "d 3"],
) -> tuple[UInt8[np.ndarray, "m bytes"], int]:
    """Bits, eight directions a byte, the first one lowest: 1 where the environment is seen above the surface.

    Only directions above the shading normal are traced; all others are 0. Origins are in scene space, lifted off the
    surface. Also returns the number of rays.
    """
    directions = np.ascontiguousarray(directions, np.float32)
    by_axis = np.ascontiguousarray(directions.T)
    origins = np.asarray(origins, np.float32)
    bits = np.zeros((len(origins), len(directions) // 8), np.uint8)
    visible, rays_traced = np.zeros(len(directions), bool), 0
    # One receiver at a time: its rays stay in cache, and start where the last ones did.
    for receiver, (origin, normal) in enumerate(zip(origins, np.asarray(normals, np.float32), strict=True)):
        above = np.flatnonzero(normal @ by_axis > 0)
        rays = np.take(directions, above, axis=0, mode="clip")
        rays_traced += len(rays)
        visible[:] = False
        visible[above] = ~tracer.occluded(origin, rays)
        bits[receiver] = np.packbits(visible, bitorder="little")
    return bits, rays_traced
