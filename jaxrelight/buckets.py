"""Array lengths rounded up to one of few, so that another mesh of about the same size compiles nothing new."""

import numpy as np


def bucket(count: int, least: int) -> int:
    """The next length of the form least·2^e·(8 … 15)/8: at most an eighth of it is padding, above `least`.

    `least` is a multiple of 8.
    """
    size = least
    while size < count:
        steps = (size * step // 8 for step in range(9, 17))
        size = next((step for step in steps if step >= count), size * 2)
    return size


def image_bucket(length: int) -> int:
    """The next number of rows or columns of which images are worked on: a multiple of 32, above 256 one of few."""
    return bucket(length, 256) if length > 256 else -(-length // 32) * 32


def filled_up(rows: np.ndarray, length: int, fill: int = 0) -> np.ndarray:
    """An array in single precision, followed by rows of `fill` up to a length.

    NumPy's, so that nothing is compiled to put them in place.
    """
    wider = np.full((length, *rows.shape[1:]), fill, np.int32 if rows.dtype.kind == "i" else np.float32)
    wider[: len(rows)] = rows
    return wider
