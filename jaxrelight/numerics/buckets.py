"""Array lengths rounded up to one of few, so that another mesh of about the same size compiles nothing new."""

import numpy as np
from jax.typing import DTypeLike


def bucket(count: int, least: int, steps: int = 8) -> int:
    """The next length of the form least·2^e·(1 + k/steps): at most a `steps`-th of it is padding, above `least`.

    Args:
        count: of what is held.
        least: the smallest length, a multiple of `steps`.
        steps: lengths from one to its double; fewer compile less and compute more.
    """
    size = least
    while size < count:
        between = (size * (steps + k) // steps for k in range(1, steps + 1))
        size = next((length for length in between if length >= count), size * 2)
    return size


def image_bucket(length: int) -> int:
    """The next number of rows or columns that images are worked on in: multiples of 32 from 64 on, few above 256."""
    return bucket(length, 256) if length > 256 else max(64, -(-length // 32) * 32)


def filled_up(rows: np.ndarray, length: int, fill: int = 0, dtype: DTypeLike = np.float32) -> np.ndarray:
    """An array of whole numbers, or of a floating type, followed by rows of `fill` up to a length.

    NumPy's, so that nothing is compiled to put them in place.
    """
    wider = np.full((length, *rows.shape[1:]), fill, np.int32 if rows.dtype.kind == "i" else dtype)
    wider[: len(rows)] = rows
    return wider
