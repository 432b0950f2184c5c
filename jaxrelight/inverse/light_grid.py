"""What an unknown environment is made of: texels of a cube map or of a lat-long map, and their wavelets."""

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.basis import cubemap, latlong
from jaxrelight.basis.haar import HaarFaces, levels
from jaxrelight.errors import InputError
from jaxrelight.lights.natural_spectrum import spectrum_of_levels
from jaxrelight.operators.sparse_matrix import SparseMatrix


class LightGrid(eqx.Module):
    """Texels of an unknown environment. Made by `light_grid`.

    Attributes:
        basis: orthonormal Haar wavelets of the texels, on square faces: six of a cube, or two halves of a lat-long map.
        to_pixels: from a cube's texels to the pixels of a lat-long map; None where texels are pixels.
        height: of the lat-long map, whose width is twice that.
    """

    basis: HaarFaces
    to_pixels: SparseMatrix | None
    height: int = eqx.field(static=True)

    @property
    def size(self) -> int:
        """d, the number of texels."""
        return self.basis.size

    @property
    def is_cube(self) -> bool:
        """Whether texels are those of a cube map."""
        return self.to_pixels is not None

    @property
    def spectrum(self) -> Float[np.ndarray, " d"]:
        """Standard deviation of every wavelet coefficient of natural light, of some brightness."""
        n, faces = self.basis.resolution, self.basis.faces
        # Half of a lat-long map is as wide as two faces of a cube.
        return spectrum_of_levels(levels(n, faces) - (0 if self.is_cube else 1))

    @property
    def solid_angles(self) -> Float[np.ndarray, " d"]:
        """Of the texels, in steradians."""
        n = self.basis.resolution
        if self.is_cube:
            return cubemap.solid_angles(n)
        return np.tile(np.repeat(latlong.solid_angles(n, 2 * n), n), 2)

    @property
    def directions(self) -> Float[np.ndarray, "d 3"]:
        """Unit vectors through the texels' centres."""
        n = self.basis.resolution
        if self.is_cube:
            return cubemap.directions(n)
        v, u = np.meshgrid((np.arange(n) + 0.5) / n, (np.arange(2 * n) + 0.5) / (2 * n), indexing="ij")
        vectors = latlong.directions(u, v)
        return np.concatenate([vectors[:, :n].reshape(-1, 3), vectors[:, n:].reshape(-1, 3)])

    def texels(self, coefficients: Float[Array, "d c"]) -> Float[Array, "d c"]:
        """Radiance of the texels, from wavelet coefficients; its transpose is its inverse."""
        return self.basis.decode(coefficients.T).T

    def pixels(self, texels: Float[Array, "d c"]) -> Float[Array, "h w c"]:
        """The lat-long map that has the texels' radiance."""
        channels = texels.shape[1]
        if self.to_pixels is not None:
            return self.to_pixels.apply(texels).reshape(self.height, 2 * self.height, channels)
        left, right = texels.reshape(2, self.height, self.height, channels)
        return jnp.concatenate([left, right], axis=1)

    def on_grid(self, pixels: Float[np.ndarray, "h w c"]) -> Float[np.ndarray, "d c"]:
        """The mean radiance of the texels under a lat-long map of any size."""
        n = self.basis.resolution
        if self.is_cube:
            resampling = latlong.area_resampling(*pixels.shape[:2], n)
            return np.asarray(resampling.apply(np.asarray(pixels, np.float32)))
        resized = np.asarray(latlong.resized(np.asarray(pixels, np.float32), n, 2 * n))
        return np.concatenate([resized[:, :n], resized[:, n:]]).reshape(-1, pixels.shape[-1])


def light_grid(unknowns: int | tuple[int, int]) -> LightGrid:
    """The texels of an unknown environment.

    Args:
        unknowns: n, for the 6×n×n texels of a cube map; or the height and width of a lat-long map.

    Raises:
        InputError: for n or a height that is no power of two from 2 to 256, or a width that is not twice the height.
    """
    if isinstance(unknowns, tuple):
        height, width = unknowns
        _check_side("the height of the unknown map", height)
        if width != 2 * height:
            raise InputError(f"an unknown lat-long map is twice as wide as high, not {height} × {width}")
        return LightGrid(HaarFaces(height, 2), None, height)
    _check_side("the resolution of the unknown cube map", unknowns)
    matrix, height = latlong.cube_to_latlong(unknowns)
    return LightGrid(HaarFaces(unknowns), matrix, height)


def _check_side(name: str, side: int) -> None:
    if not 2 <= side <= 256 or side & (side - 1):
        raise InputError(f"{name} is {side}; it must be a power of two from 2 to 256")
