"""Numbers as colours, for maps of what is not light."""

import numpy as np
from jaxtyping import Array, Bool, Float

from jaxrelight.images.tone import srgb_decode

# sRGB from the least to the most; each is lighter than the one before, so that maps also read in grey.
_RAMP = np.array([[0.03, 0.03, 0.12], [0.28, 0.11, 0.50], [0.73, 0.22, 0.42], [0.97, 0.58, 0.25], [1.0, 0.97, 0.72]])


def false_colour(
    values: Float[np.ndarray, "h w"], shown: Bool[Array | np.ndarray, "h w"], *, octaves: bool = False
) -> tuple[Float[np.ndarray, "h w 4"], tuple[float, float]]:
    """An image with coverage, and what its darkest and lightest colours stand for.

    Args:
        values: any finite numbers.
        shown: the others have no coverage.
        octaves: by logarithm, at most ten octaves down from the largest; for values that are not negative.
    """
    some = values[shown]
    low, high = (float(some.min()), float(some.max())) if some.size else (0.0, 0.0)
    if octaves:
        low = max(low, high * 2.0**-10)
    place = np.clip(values, low, high)
    if octaves and low > 0:
        place, ends = np.log2(np.maximum(place, low)), np.log2([low, high])
    else:
        ends = np.array([low, high])
    share = (place - ends[0]) / max(ends[1] - ends[0], 1e-30)
    steps = np.linspace(0, 1, len(_RAMP))
    colour = np.stack([np.interp(share, steps, _RAMP[:, k]) for k in range(3)], axis=-1)
    alpha = shown[..., None].astype(float)
    return np.concatenate([srgb_decode(colour) * alpha, alpha], axis=-1).astype(np.float32), (low, high)
