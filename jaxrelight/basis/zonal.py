"""Means over the sphere weighted by max(0, cos)ⁿ: lat-long maps convolved with the lobes of a cosine power."""

import functools
import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.basis import latlong

# A kernel is followed down to this share of its peak.
_MIN_KERNEL_WEIGHT = 1e-6


def zonal_means(pixels: Float[Array, "h w c"], exponent: float) -> Float[Array, "h w c"]:
    """∫ L(ω) max(0, p·ω)ⁿ dω / ∫ max(0, p·ω)ⁿ dω at p = the centre of every pixel. Linear and differentiable in L.

    The kernel is taken at the centres of pixels, so a map should have at least 4π√(n + 1) rows; its sum is what is
    divided by, so that a constant stays constant and means of what is not negative are not negative. Between two rows
    it depends on the difference of longitudes alone: rows are convolved by their Fourier transforms.

    Raises:
        ValueError: for an odd number of rows.
    """
    height = pixels.shape[0]
    if height % 2:
        raise ValueError(f"zonal means need an even number of rows, not {height}")
    return _means(pixels, jnp.asarray(exponent, pixels.dtype), _reach(exponent, height))


def _reach(exponent: float, height: int) -> int:
    """Rows to either side that the kernel is followed: one of few numbers, each of which is compiled."""
    angle = math.acos(_MIN_KERNEL_WEIGHT ** (1 / exponent)) if exponent > 0 else math.pi / 2
    rows = math.ceil(angle / math.pi * height) + 1
    return height - 1 if 4 * rows >= height else 2 ** math.ceil(math.log2(rows))


@functools.partial(jax.jit, static_argnames="reach")
def _means(pixels: Float[Array, "h w c"], exponent: Float[Array, ""], reach: int) -> Float[Array, "h w c"]:
    height, width, channels = pixels.shape
    dtype = pixels.dtype
    # Kernels of the lower half are those of the upper one upside down, and so serve the map upside down.
    mirrored = jnp.concatenate([pixels, pixels[::-1]], axis=-1)
    solid_angle = jnp.asarray(latlong.solid_angles(height, width), dtype)
    around = [(reach, reach)]
    waves = jnp.pad(jnp.fft.rfft(mirrored * solid_angle[:, None, None], axis=1), [*around, (0, 0), (0, 0)])
    solid_angle = jnp.pad(solid_angle, around)
    polar = (jnp.arange(-reach, height + reach, dtype=dtype) + 0.5) * (np.pi / height)
    turned = 2 * jnp.sin(jnp.arange(width, dtype=dtype) * (np.pi / width)) ** 2

    def row(i):
        def near(rows):
            return jax.lax.dynamic_slice_in_dim(rows, i, 2 * reach + 1)

        # 1 − cos of the angle between two directions, without cancellation where they are close.
        there, here = near(polar), polar[i + reach]
        gap = 2 * jnp.sin((there - here) / 2)[:, None] ** 2 + (jnp.sin(there) * jnp.sin(here))[:, None] * turned[None]
        above = (gap < 1) & (near(solid_angle) > 0)[:, None]
        kernel = jnp.where(above, jnp.exp(exponent * jnp.log1p(-jnp.where(above, gap, 0))), 0)
        # A kernel is even in longitude: its transform is real.
        kernel = jnp.fft.rfft(kernel, axis=1).real
        return jnp.einsum("jm,jmc->mc", kernel, near(waves)) / jnp.sum(kernel[:, 0] * near(solid_angle))

    means = jnp.fft.irfft(jax.lax.map(row, jnp.arange(height // 2)), n=width, axis=1)
    return jnp.concatenate([means[..., :channels], means[::-1, :, channels:]]).astype(dtype)
