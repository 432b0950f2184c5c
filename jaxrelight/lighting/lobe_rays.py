"""The visible share of each pixel's lobes by rays: shadows in reflections as sharp as pixels, of one view."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.spatial import PackedLobes
from jaxrelight.geometry.frame import tangent_frame
from jaxrelight.lighting.filtered_lobes import reflected_lobes
from jaxrelight.lighting.pixels import SurfacePixels
from jaxrelight.lighting.shadows import SurfacePoints
from jaxrelight.numerics.random_numbers import random_rotation, vogel_points

# Pixels whose rays are made at a time.
_PIXEL_BATCH = 4096


def traced_shares(
    brdf: LobeSum | PackedLobes,
    pixels: SurfacePixels,
    points: SurfacePoints,
    start: int,
    rays: int,
    narrower: int = 1,
) -> Float[Array, "p l c1 j"]:
    """The share of each lobe that nothing blocks, of its rays above the horizon. On the host.

    Rays are spread evenly over each lobe, turned at every pixel. The lobes of a pixel share its rays; each has one at
    least.

    Args:
        brdf: lobes, the same everywhere or for every texel.
        pixels: that see them.
        points: where rays start.
        start: the first of the pixels among them.
        rays: of a pixel.
        narrower: lobes that each is divided into, see `brdf.sub_lobes`.
    """
    count, parts = len(pixels.pixel), []
    normals = np.asarray(points.normals)
    for first in range(0, count, _PIXEL_BATCH):
        # The last batch begins earlier, so that all are of one shape.
        begin = max(0, min(first, count - _PIXEL_BATCH))
        batch = jax.tree.map(lambda of, i=begin: of[i : i + _PIXEL_BATCH], pixels)
        towards = np.asarray(_rays(brdf, batch, np.int32(begin), rays=rays, narrower=narrower))
        size, each = len(towards), towards.shape[-2]
        flat = towards.reshape(-1, 3)
        point = np.repeat(start + begin + np.arange(size), len(flat) // size)
        above = np.einsum("rx,rx->r", flat, normals[point]) > 0
        visible = above.copy()
        visible[above] = ~points.is_occluded(point[above], np.ascontiguousarray(flat[above]))
        visible, above = (np.sum(values.reshape(-1, each), axis=1) for values in (visible, above))
        shares = np.where(above > 0, visible / np.maximum(above, 1), 1).astype(np.float32)
        parts.append(shares.reshape(towards.shape[:-2])[first - begin :])
    return jax.device_put(np.concatenate(parts))


@functools.partial(jax.jit, static_argnames=("rays", "narrower"))
def _rays(
    brdf: LobeSum | PackedLobes, pixels: SurfacePixels, first: Int[Array, ""], rays: int, narrower: int
) -> Float[Array, "p l c1 j r 3"]:
    """Directions that are spread as the lobes of each pixel."""

    def one(row):
        number, frame, omega_o, uv, footprint = row
        lobes = brdf.at(uv, footprint) if isinstance(brdf, PackedLobes) else brdf
        reflected = reflected_lobes(lobes, omega_o, frame, narrower=narrower)
        shape = reflected.exponents.shape
        flat = reflected.directions.reshape(-1, 3), reflected.exponents.reshape(-1)
        total = flat[1].shape[0]
        seeds = number * total + jnp.arange(total, dtype=jnp.int32)
        return jax.vmap(spread, in_axes=(0, 0, 0))(*flat, seeds).reshape(*shape, each, 3)

    count = brdf.lobes if isinstance(brdf, PackedLobes) else brdf.exponent.size
    each = max(1, rays // (count * narrower))

    def spread(direction, exponent, seed):
        """Rays distributed as the lobe max(0, p·ω)ⁿ."""
        u, around = vogel_points(jnp.arange(each), each, random_rotation(seed, 0)).T
        log_cosine = jnp.log1p(-u) / (exponent + 1)
        cosine, sine = jnp.exp(log_cosine), jnp.sqrt(-jnp.expm1(2 * log_cosine))
        azimuth = 2 * np.pi * around
        local = jnp.stack([sine * jnp.cos(azimuth), sine * jnp.sin(azimuth), cosine], axis=1)
        return jnp.matmul(local, tangent_frame(direction), precision="highest")

    numbers = first + jnp.arange(len(pixels.pixel), dtype=jnp.int32)
    rows = numbers, pixels.frame, pixels.omega_o, pixels.uv, pixels.footprint
    return jax.vmap(lambda *row: one(row))(*rows)
