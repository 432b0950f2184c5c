"""Exact transport of a few pixels of any view: what pictures are measured against.

Each pixel casts a ray through every texel of a cube map, and its own BRDFs weigh what they meet: rows that take the
light of the texels (Wang 2006 eq. 3), as those of pixel receivers without compression are.
"""

from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, UInt8

from jaxrelight.basis import cubemap, latlong
from jaxrelight.basis.cubemap import Texels
from jaxrelight.brdf.reflection import FixedView
from jaxrelight.brdf.spatial import PackedLobes
from jaxrelight.brdf.texture import Weight, look_up
from jaxrelight.lighting.pixels import SurfacePixels
from jaxrelight.lighting.visible_surfaces import SurfaceComponent, VisibleSurfaces
from jaxrelight.lights.environment import Environment, coarsened
from jaxrelight.numerics.threads import in_parts
from jaxrelight.transport import bake
from jaxrelight.transport.visibility import trace_visibility

# Pixels whose rays a thread traces at a time.
_RAY_CHUNK = 16


class NamedComponent(NamedTuple):
    """A component of a material, and the name of the means by which pictures have it."""

    means: str
    component: SurfaceComponent


class ExactPixels(eqx.Module):
    """Exact transport of the pixels of a picture of a single row.

    Attributes:
        rows: radiance by the light of texels, of each channel, and of each means by which pictures have it; all of
            them add up.
        resolution: side of the cube map's faces.
    """

    rows: dict[str, Float[Array, "3 s d"]]
    resolution: int = eqx.field(static=True)

    def radiance(self, environment: Environment) -> dict[str, Float[np.ndarray, "s 3"]]:
        """What the pixels reflect of an environment, its sun included; of each means."""
        texels = texels_of(environment, self.resolution)
        return {means: np.asarray(_applied(rows, texels)) for means, rows in self.rows.items()}


def texels_of(environment: Environment, resolution: int) -> Float[Array, "d 3"]:
    """Mean radiance of the texels of a cube map."""
    pixels = coarsened(environment.pixels, resolution)
    resampling = latlong.area_resampling(*pixels.shape[:2], resolution)
    return _scaled(resampling.apply(latlong.rotate(pixels, environment.rotate_y)), environment.scale)


def traced_bits(surfaces: VisibleSurfaces, resolution: int) -> UInt8[np.ndarray, "p bytes"]:
    """What the points of a view see of the texels of a cube map. Rays are cast on the host."""
    points, directions = surfaces.points, cubemap.directions(resolution)
    origins, normals = np.asarray(points.origins), np.asarray(points.normals)

    def trace(some: slice) -> np.ndarray:
        lifted = np.zeros_like(origins[some])
        return trace_visibility(points.tracer, origins[some], normals[some], lifted, directions)[0]

    return np.concatenate(in_parts(trace, len(origins), _RAY_CHUNK))


def exact_pixels(
    surfaces: VisibleSurfaces,
    components: Sequence[Sequence[NamedComponent]],
    resolution: int,
    bits: UInt8[np.ndarray, "p bytes"],
) -> ExactPixels:
    """Exact rows of all pixels of a picture of a single row.

    Args:
        surfaces: the picture, of few pixels.
        components: of the material of each part.
        resolution: side of the cube map's faces.
        bits: of its points, from `traced_bits`.
    """
    directions, count = bake.directions_for(resolution), surfaces.covered.size
    rows: dict[str, np.ndarray] = {}
    for part, named in zip(surfaces.parts, components, strict=True):
        length, pixel = len(part.pixels.pixel), np.asarray(part.pixels.pixel)
        mine = slice(int(part.start), int(part.start) + length)
        for means, component in named:
            baked = _rows(jnp.asarray(bits[mine]), component.brdf, component.weight, part.pixels, directions)
            held = rows.setdefault(means, np.zeros((3, count, 6 * resolution**2), np.float32))
            # Without filling.
            real = np.flatnonzero(pixel < count)
            held[:, pixel[real]] += np.asarray(baked)[:, real]
    return ExactPixels({means: jax.device_put(of) for means, of in rows.items()}, resolution)


@jax.jit
def _rows(bits, brdf, weight: Weight, pixels: SurfacePixels, directions) -> Float[Array, "3 p d"]:
    if isinstance(brdf, PackedLobes):
        own = brdf.at(pixels.uv, pixels.footprint)
        reflection = FixedView(jax.tree.map(lambda _: None, own), pixels.omega_o, own)
    else:
        reflection = FixedView(brdf, pixels.omega_o)
    side = round((len(directions.vectors) // 6) ** 0.5)
    rows = bake.bake_rows(bits, pixels.frame, reflection, directions, Texels(side))[:, 0]
    factor = jax.vmap(look_up, in_axes=(None, 0, 0))(weight, pixels.uv, pixels.footprint)
    by_channel = jnp.broadcast_to(rows, (len(rows), 3, rows.shape[-1])).swapaxes(0, 1)
    return by_channel * jnp.broadcast_to(factor, (len(rows), 3)).T[:, :, None]


@jax.jit
def _applied(rows: Float[Array, "3 s d"], texels: Float[Array, "d 3"]) -> Float[Array, "s 3"]:
    # Product by product, as they lie in memory.
    return jnp.stack([jnp.matmul(rows[c], texels[:, c], precision="highest") for c in range(3)], axis=1)


@jax.jit
def _scaled(texels: Float[Array, "d 3"], scale) -> Float[Array, "d 3"]:
    return texels * jnp.asarray(scale, texels.dtype)
