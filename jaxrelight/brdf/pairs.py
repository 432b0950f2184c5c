"""Pairs of directions in which functions of two directions are compared."""

import numpy as np
from jaxtyping import Array, Float

from jaxrelight.numerics.arrays import as_array


def spread_pairs(count: int) -> tuple[Float[Array, "s 3"], Float[Array, "s 3"]]:
    """Pairs of directions above the surface, the same ones every time, of JAX's own dtype.

    Eyes lie over the hemisphere, lights near each eye's mirror direction and far from it: lobes of every width are met.
    """
    index = np.arange(count)
    eye_z = 0.15 + 0.85 * (index + 0.5) / count
    azimuth = 2 * np.pi * ((index * 0.7548776662) % 1)
    sine = np.sqrt(1 - eye_z**2)
    omega_o = np.stack([sine * np.cos(azimuth), sine * np.sin(azimuth), eye_z], axis=-1)
    mirror = omega_o * [-1, -1, 1]
    # Angles from the mirror direction in geometric progression, 1° … 90°.
    away = np.radians(90 ** ((index * 0.5698402909) % 1))
    around = 2 * np.pi * ((index * 0.4301597090) % 1)
    first = np.cross(mirror, [1.0, 0, 0])
    first /= np.linalg.norm(first, axis=-1, keepdims=True)
    second = np.cross(mirror, first)
    tangent = np.cos(around)[:, None] * first + np.sin(around)[:, None] * second
    omega_i = np.cos(away)[:, None] * mirror + np.sin(away)[:, None] * tangent
    omega_i[:, 2] = np.abs(omega_i[:, 2])
    return as_array(omega_i), as_array(omega_o)
