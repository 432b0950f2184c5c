"""Lat-long maps: directions, rotation, look-up, and resampling by area: to other sizes, to a cube map and from one.

The top row looks to +y, the image centre to +z and u = 0.25 to +x. A pixel is a constant cell: light is the integral
of the map, so resampling weighs every pixel by the solid angle it shares with a texel.
"""

import functools
from typing import overload

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Real
from scipy import sparse

from jaxrelight.basis import cubemap
from jaxrelight.basis.overlaps import overlaps
from jaxrelight.numerics.numbers import Number
from jaxrelight.operators.sparse_matrix import SparseMatrix, sparse_matrix


def directions(u: Number | Real[np.ndarray, "..."], v: Number | Real[np.ndarray, "..."]) -> Float[np.ndarray, "... 3"]:
    """Unit vectors at image coordinates u (rightwards) and v (downwards), both in 0 … 1."""
    longitude, polar = 2 * np.pi * (0.5 - u), np.pi * v
    sine = np.sin(polar)
    return np.stack([sine * np.sin(longitude), np.cos(polar) + 0 * u, sine * np.cos(longitude)], axis=-1)


def coordinates(direction: Float[np.ndarray, "... 3"]) -> tuple[Float[np.ndarray, "..."], Float[np.ndarray, "..."]]:
    """Image coordinates (u, v) in 0 … 1 of unit vectors."""
    x, y, z = np.moveaxis(direction, -1, 0)
    return 0.5 - np.arctan2(x, z) / (2 * np.pi), np.arctan2(np.hypot(x, z), y) / np.pi


@jax.jit
def finite_coordinates(direction: Float[Array, "... 3"]) -> tuple[Float[Array, "..."], Float[Array, "..."]]:
    """`coordinates` in JAX, with finite gradients, also at the poles."""
    x, y, z = direction[..., 0], direction[..., 1], direction[..., 2]
    pole = (x == 0) & (z == 0)
    longitude = jnp.arctan2(jnp.where(pole, 0, x), jnp.where(pole, 1, z))
    across = jnp.where(pole, 0, jnp.hypot(jnp.where(pole, 1, x), z))
    return 0.5 - longitude / (2 * np.pi), jnp.arctan2(across, jnp.where(pole & (y == 0), 1, y)) / np.pi


def solid_angles(height: int, width: int) -> Float[np.ndarray, " h"]:
    """Solid angle of one pixel of each row, in steradians; `width` of them in every row sum to 4π."""
    edge = np.cos(np.linspace(0, np.pi, height + 1))
    return (edge[:-1] - edge[1:]) * (2 * np.pi / width)


@jax.jit
def rotate(pixels: Float[Array, "h w c"], degrees: Float[Array, ""]) -> Float[Array, "h w c"]:
    """The map turned about +y, counter-clockwise seen from +y.

    Rows are shifted, and a shift by part of a pixel shares each constant cell between two by area: every row keeps
    its energy, and the result is differentiable in the angle (one-sided at whole pixels).
    """
    width = pixels.shape[1]
    shift = jnp.asarray(degrees, pixels.dtype) * (width / 360)
    whole = jnp.floor(shift)
    part = shift - whole
    whole = jnp.mod(whole, width).astype(jnp.int32)
    return (1 - part) * jnp.roll(pixels, -whole, axis=1) + part * jnp.roll(pixels, -whole - 1, axis=1)


@overload
def resized(pixels: Float[np.ndarray, "h w c"], height: int, width: int) -> Float[np.ndarray, "{height} {width} c"]: ...
@overload
def resized(pixels: Float[Array, "h w c"], height: int, width: int) -> Float[Array, "{height} {width} c"]: ...
def resized(
    pixels: Float[Array | np.ndarray, "h w c"], height: int, width: int
) -> Float[Array | np.ndarray, "{height} {width} c"]:
    """The map with another number of rows and columns: every new pixel is the mean over its solid angle.

    NumPy arrays give NumPy arrays; JAX arrays give JAX arrays, differentiably.
    """
    old_height, old_width, channels = pixels.shape
    if (height, width) == (old_height, old_width):
        return pixels
    if isinstance(pixels, jax.Array) and old_height % height == 0 and old_width % width == 0:
        # Whole pixels are joined: no matrix is needed, and no more memory than for the result, or for the gradient.
        area = -np.diff(np.cos(np.linspace(0, np.pi, old_height + 1))).reshape(height, -1)
        shares = area / area.sum(axis=1, keepdims=True) * (width / old_width)
        return _joined(pixels, shares.astype(pixels.dtype), width)
    by_row = _means(*(-np.cos(np.linspace(0, np.pi, count + 1)) for count in (height, old_height)))
    by_column = _means(*(np.linspace(0, 1, count + 1) for count in (width, old_width)))
    if isinstance(pixels, jax.Array):
        return _by_matrices(pixels, *(side.toarray().astype(pixels.dtype) for side in (by_row, by_column)))
    resampled = by_row.astype(pixels.dtype) @ pixels.reshape(old_height, -1)
    resampled = resampled.reshape(height, old_width, channels).swapaxes(0, 1).reshape(old_width, -1)
    resampled = by_column.astype(pixels.dtype) @ resampled
    return np.ascontiguousarray(resampled.reshape(width, height, channels).swapaxes(0, 1))


@functools.partial(jax.jit, static_argnames="width")
def _joined(pixels: Float[Array, "h w c"], shares: Float[Array, "i k"], width: int) -> Float[Array, "i {width} c"]:
    blocks = pixels.reshape(*shares.shape, width, -1, pixels.shape[2])
    return jnp.sum(blocks * shares[:, :, None, None, None], axis=(1, 3))


@jax.jit
def _by_matrices(
    pixels: Float[Array, "h w c"], by_row: Float[Array, "i h"], by_column: Float[Array, "j w"]
) -> Float[Array, "i j c"]:
    # Rows as they lie: another order would copy the map.
    rows = jnp.matmul(by_row, pixels.reshape(len(pixels), -1), precision="highest")
    return jnp.einsum("jw,iwc->ijc", by_column, rows.reshape(len(by_row), *pixels.shape[1:]), precision="highest")


def _means(new: Float[np.ndarray, " n"], old: Float[np.ndarray, " o"]) -> sparse.csr_array:
    """The matrix from values on the old intervals to means over the new ones; both are given by their edges."""
    edges = np.union1d(new, old)
    middle, length = (edges[1:] + edges[:-1]) / 2, np.diff(edges)
    at = [np.clip(np.searchsorted(side, middle) - 1, 0, len(side) - 2) for side in (new, old)]
    lengths = sparse.csr_array((length, (at[0], at[1])), shape=(len(new) - 1, len(old) - 1))
    return sparse.csr_array(lengths / np.diff(new)[:, None])


def from_cube(faces: Float[np.ndarray, "6 n n c"]) -> Float[np.ndarray, "h w c"]:
    """The lat-long map of a cube map: every pixel is the mean, by solid angle, of the texels that it touches.

    A texel's solid angle is given out whole, so one hot texel keeps its energy, and a constant map stays constant.
    Pixels are as fine as texels where n is 256 or more, and four times as fine up to 64, so that little is spread.
    """
    resolution, channels = faces.shape[1], faces.shape[-1]
    height = _height_of_cube(resolution)
    width = 2 * height
    flat, sums = faces.reshape(-1, channels).astype(float), np.zeros((height * width, channels))
    for texel, pixel, shared in overlaps(height, width, resolution):
        for c in range(channels):
            sums[:, c] += np.bincount(pixel, shared * flat[texel, c], height * width)
    means = sums.reshape(height, width, channels) / solid_angles(height, width)[:, None, None]
    return means.astype(faces.dtype)


def _height_of_cube(resolution: int) -> int:
    return max(2 * resolution, min(8 * resolution, 512))


@functools.lru_cache(maxsize=4)
def cube_to_latlong(resolution: int) -> tuple[SparseMatrix, int]:
    """`from_cube` as a matrix from the 6×resolution² texels to the map's pixels, row by row, and the map's height."""
    height = _height_of_cube(resolution)
    every = list(overlaps(height, 2 * height, resolution))
    texel, pixel, shared = (np.concatenate(of) for of in zip(*every, strict=True))
    weight = shared / solid_angles(height, 2 * height)[pixel // (2 * height)]
    shape = 2 * height**2, 6 * resolution**2
    # Entries of one pixel and texel are added up.
    return sparse_matrix(sparse.coo_array((weight, (pixel, texel)), shape=shape).tocsr()), height


@jax.jit
def look_up(pixels: Float[Array, "h w c"], u: Float[Array, "..."], v: Float[Array, "..."]) -> Float[Array, "... c"]:
    """Radiance of the constant cell at image coordinates (u, v)."""
    height, width = pixels.shape[:2]
    row = jnp.clip(jnp.floor(v * height).astype(jnp.int32), 0, height - 1)
    return pixels[row, jnp.mod(jnp.floor(u * width).astype(jnp.int32), width)]


@jax.jit
def interpolate(pixels: Float[Array, "h w c"], u: Float[Array, "..."], v: Float[Array, "..."]) -> Float[Array, "... c"]:
    """Radiance at image coordinates (u, v), bilinear between the centres of cells, for what is looked at.

    Columns go around. From the centres of the top and bottom rows to the poles, values go to the mean of the row, so
    that they are the same from all sides.
    """
    height, width = pixels.shape[:2]
    x, y = u * width - 0.5, v * height - 0.5
    left, top = jnp.floor(x), jnp.floor(y)
    right, down = (x - left)[..., None], (y - top)[..., None]
    column, row = left.astype(jnp.int32), top.astype(jnp.int32)

    def of_row(row):
        # Rows beyond the poles stand for those before them.
        row = jnp.clip(row, 0, height - 1)
        return (1 - right) * pixels[row, jnp.mod(column, width)] + right * pixels[row, jnp.mod(column + 1, width)]

    between = (1 - down) * of_row(row) + down * of_row(row + 1)
    # At the centres of either row the slope is that downwards.
    for pole, away, is_beyond in ((0, y, y < 0), (height - 1, height - 1 - y, y >= height - 1)):
        share = jnp.where(is_beyond, jnp.minimum(-2 * away, 1), 0)[..., None]
        mean = jnp.broadcast_to(jnp.mean(pixels[pole], axis=0), between.shape)
        between = (1 - share) * between + share * mean
    return between


class AreaResampling(eqx.Module):
    """The linear map from lat-long pixels to the mean radiance of cube-map texels.

    Every weight is the share of a texel's solid angle that lies in a pixel. A texel's weights sum to 1, so a
    constant map stays constant, and a pixel's solid angle is given out whole, so one hot pixel keeps its energy.
    """

    matrix: SparseMatrix

    @jax.jit
    def apply(self, pixels: Float[Array, "h w c"]) -> Float[Array, "d c"]:
        """Mean radiance of every texel, in the order of `cubemap.directions`."""
        return self.matrix.apply(pixels.reshape(-1, pixels.shape[-1]))


@functools.lru_cache(maxsize=4)
def area_resampling(height: int, width: int, resolution: int, dtype: DTypeLike = np.float32) -> AreaResampling:
    """The resampling from a height × width lat-long map to a 6×resolution×resolution cube map, by weights of a type."""
    texel, pixel, shared = (np.concatenate(parts) for parts in zip(*overlaps(height, width, resolution), strict=True))
    shares = sparse.csr_array((shared, (texel, pixel)), shape=(6 * resolution**2, height * width))
    weight = shares.data / np.repeat(cubemap.solid_angles(resolution), np.diff(shares.indptr))
    # The result is kept, so it must not be made of a caller's tracers.
    return AreaResampling(sparse_matrix(sparse.csr_array((weight, shares.indices, shares.indptr), shares.shape), dtype))
