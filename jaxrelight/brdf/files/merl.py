"""MERL's .binary files: isotropic reflectance in a table over half and difference vector (Matusik et al. 2003)."""

from typing import Any

import numpy as np

from jaxrelight.brdf.files.content import Content
from jaxrelight.brdf.tabulated import Tabulated, least_cosine
from jaxrelight.numerics.arrays import as_array

SHAPE = (90, 90, 180)
# What the stored numbers of red, green and blue are to be multiplied by.
SCALE = np.array([1.0, 1.15, 1.66]) / 1500
SIZE = 12 + 24 * SHAPE[0] * SHAPE[1] * SHAPE[2]


def read_merl(content: Content) -> tuple[Tabulated, list[str]]:
    """The table of a file. Entries marked invalid, by negative numbers, are filled from the nearest valid ones.

    Entries with a direction below the surface are always invalid; a note says how many others are.

    Raises:
        InputError: if the dimensions are others than 90 × 90 × 180, the file is shorter or longer than they make it,
            or it holds numbers that are not finite, or nothing valid.
    """
    dimensions = tuple(content.array("<i4", (3,), 0).tolist())
    if dimensions != SHAPE:
        raise content.fault(f"has the dimensions {dimensions}, not {SHAPE} as MERL's files have", "is it such a file?")
    if len(content.data) != SIZE:
        state = "cut short" if len(content.data) < SIZE else "too long"
        raise content.fault(f"is {state}: {len(content.data):,} bytes instead of {SIZE:,}")
    values = np.moveaxis(content.array("<f8", (3, *SHAPE), 12), 0, -1)
    content.check_finite(values, "values")
    values = values * SCALE
    invalid = np.any(values < 0, axis=-1)
    if invalid.all():
        raise content.fault("has no valid value")
    values[invalid] = values[tuple(_nearest_valid(np.asarray(invalid)))]
    odd = int(np.sum(invalid & (least_cosine(SHAPE) > 0.02)))
    notes = [f"{content.path.name}: {odd:,} entries above the surface are invalid; the nearest is taken"] if odd else []
    return Tabulated(as_array(values)), notes


def _nearest_valid(invalid: np.ndarray) -> np.ndarray:
    """For each invalid entry, the place [3] of the nearest valid one."""
    from scipy import ndimage

    # φ_d goes around: a quarter of the table on either side is enough of what lies beyond.
    n = SHAPE[2]
    wrapped = np.pad(invalid, ((0, 0), (0, 0), (n // 4, n // 4)), mode="wrap")
    places: Any = ndimage.distance_transform_edt(wrapped, return_distances=False, return_indices=True)
    nearest = places[:, :, :, n // 4 : n // 4 + n][:, invalid]
    nearest[2] = (nearest[2] - n // 4) % n
    return nearest
