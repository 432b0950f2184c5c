"""What each receiver sees of the environment: one bit a direction, without any material."""

import numpy as np
from jaxtyping import Float, UInt8

from jaxrelight.geometry.tracer import OFFSET, Tracer

# Receivers traced by one call: the rays of a call should stay in cache.
_BATCH = 16


def trace_visibility(
    tracer: Tracer,
    positions: Float[np.ndarray, "m 3"],
    normals: Float[np.ndarray, "m 3"],
    face_normals: Float[np.ndarray, "m 3"],
    directions: Float[np.ndarray, "d 3"],
) -> UInt8[np.ndarray, "m bytes"]:
    """Bits, eight directions a byte, the first one lowest: 1 where the environment is seen above the surface.

    Only directions above the shading normal are traced; all others are 0. Positions are in scene space and are lifted
    along the face normals here.
    """
    directions = np.asarray(directions, np.float32)
    origins = np.asarray(positions + OFFSET * face_normals, np.float32)
    cosines = np.asarray(normals, np.float32) @ directions.T
    visible = np.zeros(cosines.shape, bool)
    for start in range(0, len(origins), _BATCH):
        batch = slice(start, start + _BATCH)
        receiver, direction = np.nonzero(cosines[batch] > 0)
        hit = tracer.occluded(origins[batch][receiver], directions[direction])
        visible[batch][receiver, direction] = ~hit
    return np.packbits(visible, axis=-1, bitorder="little")
