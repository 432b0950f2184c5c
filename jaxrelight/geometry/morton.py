"""Order along a Z-shaped curve, which keeps neighbours in space close to each other in memory."""

import numpy as np
from jaxtyping import Float, Int

_BITS = 10


def morton(points: Float[np.ndarray, "p d"]) -> Int[np.ndarray, " p"]:
    """Place along the curve through the unit cube of d dimensions, in 1,024 steps a side; points beyond are clipped."""
    cell = (points * 2**_BITS).astype(np.int64).clip(0, 2**_BITS - 1)
    dimensions = points.shape[1]
    code = np.zeros(len(cell), np.int64)
    for bit in range(_BITS):
        for axis in range(dimensions):
            code |= ((cell[:, axis] >> bit) & 1) << (dimensions * bit + axis)
    return code
