"""Figures that are made of pictures: side by side, and bars."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxrelight.images.tone import srgb_decode

# Linear grey between pictures; sRGB of bars, and of those beyond a limit.
_GROUND = 0.03
_BAR, _BEYOND = np.array([0.97, 0.58, 0.25]), np.array([0.28, 0.11, 0.50])


def side_by_side(pictures: Sequence[Float[np.ndarray, "_ _ _"]], gap: int = 8) -> Float[np.ndarray, "h w 3"]:
    """Pictures of any size in one row, their tops in line.

    Args:
        pictures: of three channels; a fourth is not shown.
        gap: pixels between them.
    """
    height = max(len(picture) for picture in pictures)
    columns = []
    for picture in pictures:
        padded = np.full((height, picture.shape[1], 3), _GROUND, np.float32)
        padded[: len(picture)] = picture[..., :3]
        columns += [np.full((height, gap, 3), _GROUND, np.float32), padded]
    return np.concatenate(columns[1:], axis=1)


def log_bars(
    values: Float[np.ndarray, " n"], limit: float, height: int = 192, decades: float = 6.0
) -> Float[np.ndarray, "h w 3"]:
    """Bars of numbers by logarithm, the largest as high as the figure, in another colour where they are below a limit.

    Args:
        values: not negative.
        limit: drawn as a line, too.
        height: in pixels.
        decades: from the largest down to the foot of the figure.
    """
    largest = max(float(values.max(initial=0)), 1e-30)

    def rows(value):
        share = 1 + np.log10(np.maximum(value, 1e-30) / largest) / decades
        return np.clip(np.rint(share * height), 0, height).astype(int)

    width = max(2, 384 // max(len(values), 1))
    figure = np.full((height, width * len(values), 3), _GROUND, np.float32)
    for number, (value, top) in enumerate(zip(values, rows(values), strict=True)):
        colour = srgb_decode(_BAR if value > limit else _BEYOND)
        figure[height - top :, number * width : (number + 1) * width - 1] = colour
    figure[max(height - 1 - rows(limit), 0)] = 1.0
    return figure
