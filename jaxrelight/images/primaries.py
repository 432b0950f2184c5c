"""Colours of other primaries as linear Rec.709."""

from collections.abc import Sequence

import numpy as np

# CIE 1931 x and y of red, green, blue and white.
REC709 = (0.64, 0.33, 0.30, 0.60, 0.15, 0.06, 0.3127, 0.3290)

# Lindbloom's table of Bradford's cone responses.
_BRADFORD = np.array([[0.8951, 0.2664, -0.1614], [-0.7502, 1.7135, 0.0367], [0.0389, -0.0685, 1.0296]])
_SAME = 0.01  # primaries are often written with two digits, and white points of one standard differ by less


def to_rec709(chromaticities: Sequence[float] | np.ndarray) -> np.ndarray | None:
    """The matrix `[3, 3]` that takes linear colours of the given primaries to linear Rec.709, white to white.

    White points are adapted by Bradford's transform, so (1, 1, 1) stays (1, 1, 1).

    Args:
        chromaticities: x and y of red, green, blue and white: eight numbers.

    Returns:
        The matrix, or None where it would change no colour by more than 1 %.

    Raises:
        ValueError: These are no primaries: not finite, on one line, or a white that has no luminance.
    """
    values = np.asarray(chromaticities, float)
    if values.shape != (8,) or not np.isfinite(values).all() or np.abs(values).max() > 10:
        raise ValueError("eight numbers are needed")
    ours, theirs = to_xyz(np.array(REC709)), to_xyz(values)
    cones = [_BRADFORD @ matrix.sum(axis=1) for matrix in (ours, theirs)]
    if not (np.abs(cones[1]) > 1e-6).all():
        raise ValueError("white has no luminance")
    adaptation = np.linalg.solve(_BRADFORD, (cones[0] / cones[1])[:, None] * _BRADFORD)
    matrix = np.linalg.solve(ours, adaptation @ theirs)
    return None if np.abs(matrix - np.eye(3)).max() < _SAME else matrix


def to_xyz(values: np.ndarray) -> np.ndarray:
    """Columns are X, Y, Z of red, green and blue, so scaled that they add up to white with Y = 1."""
    x, y = values.reshape(4, 2).T
    colours = np.stack([x, y, 1 - x - y])
    primaries, white = colours[:, :3], colours[:, 3]
    if abs(white[1]) < 1e-6 or abs(np.linalg.det(primaries)) < 1e-6:
        raise ValueError("primaries on one line")
    return primaries * np.linalg.solve(primaries, white / white[1])
