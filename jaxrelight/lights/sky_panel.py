"""A fixed panel of skies, for what has to hold under any sky: an even one, and six that are brighter around an axis."""

import numpy as np
from jaxtyping import Float

from jaxrelight.basis import cubemap

# How many skies, which are brighter around their axes as this power of the cosine.
SKIES, POWER = 7, 4


def sky_panel(resolution: int) -> Float[np.ndarray, "d s"]:
    """Radiance of the skies, each 1 in the mean over the sphere, times the texels' solid angles over π.

    Summed with cosines over the texels that a receiver sees, they give its irradiance over that of even open sky.

    Args:
        resolution: of the cube map whose texels are meant.
    """
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    lobes = np.maximum(cubemap.directions(resolution) @ axes.T, 0) ** POWER
    skies = np.column_stack([np.ones(len(lobes)), 2 * (POWER + 1) * lobes])
    return skies * cubemap.solid_angles(resolution)[:, None] / np.pi
