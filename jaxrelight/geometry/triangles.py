"""Areas, normals and edges of triangles."""

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxrelight.numerics.unique_rows import unique_rows


def half_edges(faces: Int[np.ndarray, "f 3"]) -> tuple[Int[np.ndarray, " h"], Bool[np.ndarray, " h"]]:
    """The sides of all faces, three of each: which edge each runs along, and whether towards the larger vertex number.

    Side k of a face runs from its corner k to the next.
    """
    ends = np.stack([faces, np.roll(faces, -1, axis=1)], axis=2).reshape(-1, 2)
    return unique_rows(np.sort(ends, axis=1))[1], ends[:, 0] < ends[:, 1]


def area_vectors(corners: Float[np.ndarray, "f 3 3"]) -> Float[np.ndarray, "f 3"]:
    """Normals as long as twice the area."""
    return np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])


def unit(vectors: Float[np.ndarray, "n 3"], otherwise: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "n 3"]:
    """Vectors scaled to length one, in two steps so that neither tiny nor huge ones are lost; zeros are replaced."""
    largest = np.abs(vectors).max(axis=1, keepdims=True, initial=0)
    scaled = vectors / np.where(largest > 0, largest, 1.0)
    length = np.linalg.norm(scaled, axis=1, keepdims=True)
    return np.where(length > 0, scaled / np.where(length > 0, length, 1.0), otherwise)
