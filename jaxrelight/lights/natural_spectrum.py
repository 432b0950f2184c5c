"""How much natural light varies at each scale: what an approximation of transport should be best for."""

import numpy as np
from jaxtyping import Float, Int

from jaxrelight.basis.haar import levels

# Root-mean-square Haar coefficient of each level over that of the averages: geometric mean over eight photographed
# environments, indoors and out, at resolution 64 (tests/benchmarks/clusters.py prints them).
_MEASURED = (1.0, 0.406, 0.305, 0.186, 0.0911, 0.0519, 0.0262)


def natural_spectrum(resolution: int) -> Float[np.ndarray, " d"]:
    """Standard deviation of every Haar coefficient of a 6×resolution² cube map of natural light; that of averages is 1.

    Levels count from the coarsest, so that a level's does not depend on the resolution.
    """
    return spectrum_of_levels(levels(resolution))


def spectrum_of_levels(level: Int[np.ndarray, " d"]) -> Float[np.ndarray, " d"]:
    """Standard deviation of coefficients of levels, of which 0 is the averages over faces of a cube.

    Past the levels that were measured each is half the one before, as where a picture's power falls with the square of
    its frequency; averages over more than a face count as one of a face.
    """
    beyond = np.maximum(level - (len(_MEASURED) - 1), 0)
    measured = np.array(_MEASURED)[np.clip(level, 0, len(_MEASURED) - 1)]
    return (measured * 0.5**beyond).astype(np.float32)
