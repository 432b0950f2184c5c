"""Orthonormal two-dimensional Haar wavelets on each face of a cube map (Wang 2006 §4.1.1), or on one square image.

The square ("non-standard") transform: rows and columns are halved together, level by level. A face of n×n texels
becomes n×n coefficients in the usual pyramid: the average at [0, 0], then for every level of side m its horizontal
details at [:m, m:2m], vertical at [m:2m, :m] and diagonal at [m:2m, m:2m].
"""

from collections.abc import Callable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.operators.contract import Basis


@jax.jit
def forward(faces: Float[Array, "... n n"]) -> Float[Array, "... n n"]:
    """Haar coefficients of each face; n is a power of two. The transform is orthonormal, so energy is kept."""
    average, details = faces, []
    while average.shape[-1] > 1:
        a, b = average[..., 0::2, 0::2], average[..., 0::2, 1::2]
        c, d = average[..., 1::2, 0::2], average[..., 1::2, 1::2]
        details.append(((a - b + c - d) / 2, (a + b - c - d) / 2, (a - b - c + d) / 2))
        average = (a + b + c + d) / 2
    for horizontal, vertical, diagonal in reversed(details):
        top = jnp.concatenate([average, horizontal], axis=-1)
        average = jnp.concatenate([top, jnp.concatenate([vertical, diagonal], axis=-1)], axis=-2)
    return average


@jax.jit
def inverse(coefficients: Float[Array, "... n n"]) -> Float[Array, "... n n"]:
    """Faces from their Haar coefficients: the transpose of `forward`, which is its inverse."""
    n = coefficients.shape[-1]
    average, m = coefficients[..., :1, :1], 1
    while m < n:
        horizontal = coefficients[..., :m, m : 2 * m]
        vertical = coefficients[..., m : 2 * m, :m]
        diagonal = coefficients[..., m : 2 * m, m : 2 * m]
        left = jnp.stack([average + horizontal + vertical + diagonal, average - horizontal + vertical - diagonal], -1)
        right = jnp.stack([average + horizontal - vertical - diagonal, average - horizontal - vertical + diagonal], -1)
        average = jnp.stack([left, right], axis=-3).reshape(*average.shape[:-2], 2 * m, 2 * m) / 2
        m *= 2
    return average


def levels(resolution: int, faces: int = 6) -> Int[np.ndarray, " d"]:
    """The level of every coefficient of faces×resolution² texels: 0 for averages, then from coarse to fine."""
    place = np.arange(resolution)
    side = np.maximum(place[:, None], place)
    # The number of binary digits: 0 at 0, l from 2^(l−1) on.
    level = np.frexp(side.astype(np.float64))[1]
    return np.tile(level.reshape(-1), faces)


class HaarFaces(Basis):
    """The basis of Haar coefficients on the 6×n×n texels of a cube map, or on as many faces as are asked for.

    Functions on them are vectors of d = 6·n² numbers.
    """

    resolution: int = eqx.field(static=True)
    faces: int = eqx.field(static=True, default=6)

    @property
    def size(self) -> int:
        """The number of coefficients: n² for each face."""
        return self.faces * self.resolution**2

    def _encode(self, texels: Float[Array, "... d"]) -> Float[Array, "... d"]:
        return self._on_faces(forward, texels)

    def _decode(self, coefficients: Float[Array, "... d"]) -> Float[Array, "... d"]:
        return self._on_faces(inverse, coefficients)

    def _on_faces(self, transform: Callable[[Array], Array], vector: Float[Array, "... d"]) -> Float[Array, "... d"]:
        n = self.resolution
        return transform(vector.reshape(*vector.shape[:-1], self.faces, n, n)).reshape(vector.shape)
