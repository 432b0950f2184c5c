"""Points spread over the sphere as the corners of a cube's cells, and bilinear interpolation between them.

Unlike a cube map's texels, points on edges and corners of the cube are shared by its faces, so that what is
interpolated is continuous everywhere. Lines of the grid are equal angles apart, seen from the centre.
"""

import functools

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.basis.cubemap import face_plane


def point_count(cells: int) -> int:
    """How many points a grid of cells × cells on each face has: 6 cells² + 2."""
    return 6 * cells**2 + 2


@functools.lru_cache(maxsize=8)
def directions(cells: int) -> Float[np.ndarray, "s 3"]:
    """Unit vectors to the points; float64, read-only."""
    points, number = _corners(cells)
    unique = np.empty((point_count(cells), 3))
    unique[number] = points
    unique.flags.writeable = False
    return unique


@functools.lru_cache(maxsize=8)
def _corners(cells: int) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]]:
    """Corners of all cells of all faces, by face, row and column, and the number of the point that each is."""
    line = np.tan(np.linspace(-np.pi / 4, np.pi / 4, cells + 1))
    points = face_plane(*np.meshgrid(line, line, indexing="xy")).reshape(-1, 3)
    points /= np.linalg.norm(points, axis=-1, keepdims=True)
    _, number = np.unique(np.rint(points * 1e6).astype(int), axis=0, return_inverse=True)
    return points, number.reshape(-1).astype(np.int32)


def bilinear(direction: Float[Array, "3"], cells: int) -> tuple[Int[Array, "4"], Float[Array, "4"]]:
    """The four points around a direction, by number, and their weights; differentiable in the direction.

    Args:
        direction: of any length but 0.
        cells: along an edge of the cube.
    """
    axis = jnp.argmax(jnp.abs(direction))

    def of_axis(*values):
        # Indexing has a derivative that scatters, which takes several times as long.
        return jnp.where(axis == 0, values[0], jnp.where(axis == 1, values[1], values[2]))

    major = of_axis(*direction)
    x, y, z = direction / jnp.where(major == 0, 1, jnp.abs(major))
    positive = major > 0
    # Face coordinates rightwards and downwards, the inverse of `cubemap.face_plane`.
    across = of_axis(jnp.where(positive, -z, z), x, jnp.where(positive, x, -x))
    down = of_axis(-y, jnp.where(positive, z, -z), -y)
    column, row = ((jnp.arctan(at) * (4 / np.pi) + 1) * (cells / 2) for at in (across, down))
    left, top = (jnp.clip(jnp.floor(at), 0, cells - 1) for at in (column, row))
    face = 2 * axis + jnp.where(positive, 0, 1)
    corner = (face * (cells + 1) + top.astype(jnp.int32)) * (cells + 1) + left.astype(jnp.int32)
    corners = corner + jnp.asarray([0, 1, cells + 1, cells + 2], jnp.int32)
    numbers = jnp.asarray(_corners(cells)[1]).at[corners].get(mode="promise_in_bounds")
    right, below = column - left, row - top
    weights = [(1 - right) * (1 - below), right * (1 - below), (1 - right) * below, right * below]
    return numbers, jnp.stack(weights)
