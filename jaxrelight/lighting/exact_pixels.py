"""Exact transport of a few pixels of any view: what pictures are measured against.

Each pixel casts a ray through every texel of a cube map, and its own BRDFs weigh what they meet: rows that take the
light of the texels (Wang 2006 eq. 3), as those of pixel receivers without compression are.
"""

import dataclasses
import functools
import itertools
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, UInt8

from jaxrelight.basis import cubemap
from jaxrelight.basis.cubemap import Texels
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.material import has_lobes
from jaxrelight.brdf.reflection import FixedView
from jaxrelight.brdf.spatial import PackedLobes
from jaxrelight.brdf.sub_lobes import is_narrower_than_texels
from jaxrelight.brdf.texture import PixelWeight, look_up
from jaxrelight.lighting.filtered_reflection import exponents_of, filtered_radiance
from jaxrelight.lighting.lobe_rays import traced_shares
from jaxrelight.lighting.pixels import SurfacePixels
from jaxrelight.lighting.visible_surfaces import SurfaceComponent, VisibleSurfaces
from jaxrelight.lights.environment import Environment, texels_of
from jaxrelight.lights.prefiltered import PrefilteredMaps, maps_of
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.threads import in_parts
from jaxrelight.transport import bake
from jaxrelight.transport.model import FilteredLobes
from jaxrelight.transport.visibility import trace_visibility

# Pixels whose rays a thread traces at a time.
_RAY_CHUNK = 16
# Bytes of visibility that are kept for pixels of other lights.
_MAX_KEPT_BYTES = 64 * 2**20
# Rays of a pixel in lobes that are narrower than texels.
_SHARP_RAYS = 512


class NamedComponent(NamedTuple):
    """A component of a material, and the name of the means by which pictures have it."""

    means: str
    component: SurfaceComponent


class SharpLobes(eqx.Module):
    """Lobes of one component that are narrower than texels: light filtered by them, times what their rays see.

    Attributes:
        means: by which pictures have them.
        pixels: that see them.
        lobes: the lobes and the factor on them.
        shares: the visible share of each lobe of each pixel.
    """

    means: str = eqx.field(static=True)
    pixels: SurfacePixels
    lobes: FilteredLobes
    shares: Float[Array, "p l c1 j"]

    def radiance(self, maps: PrefilteredMaps, environment: Environment) -> Float[Array, "p 3"]:
        """What they reflect."""
        count, dtype = len(self.pixels.pixel), self.pixels.omega_o.dtype
        nobody = as_array(np.zeros((count, 1), np.int32)), as_array(np.zeros((count, 1)), dtype)
        others = as_array(np.zeros((count, 3)), dtype)
        turn, scale = environment.rotate_y, environment.scale
        return filtered_radiance(self.lobes, self.pixels, *nobody, self.shares, maps, turn, scale, others)


class ComponentRows(NamedTuple):
    """Exact rows of one component of the pixels of one part.

    Attributes:
        means: by which pictures have it.
        pixel: places in the picture; its length for filling.
        rows: radiance by the light of texels, of each channel.
    """

    means: str
    pixel: Int[np.ndarray, " p"]
    rows: Float[Array, "3 p d"]


class ExactPixels(NamedTuple):
    """Exact transport of the pixels of a picture of a single row.

    Attributes:
        rows: of all components; they add up.
        sharp: what rows do not have of lobes that are narrower than texels.
        count: of pixels.
        resolution: side of the cube map's faces.
    """

    rows: tuple[ComponentRows, ...]
    sharp: tuple[SharpLobes, ...]
    count: int
    resolution: int

    def radiance(self, environment: Environment) -> dict[str, Float[np.ndarray, "s 3"]]:
        """What the pixels reflect of an environment, its sun included; by each means."""
        texels = texels_of(environment, self.resolution)
        radiance = {of.means: np.zeros((self.count, 3), np.float32) for of in self.rows}

        def add(means: str, pixel: Int[np.ndarray, " p"], own: Array) -> None:
            real = np.flatnonzero(pixel < self.count)
            radiance[means][pixel[real]] += np.asarray(own)[real]

        for of in self.rows:
            add(of.means, of.pixel, _applied(of.rows, texels))
        if self.sharp:
            maps = maps_of(environment, between=exponents_of([of.lobes for of in self.sharp]))
            for of in self.sharp:
                add(of.means, np.asarray(of.pixels.pixel), of.radiance(maps, environment))
        return radiance


class PixelVisibility:
    """What pixels of a view see of the texels of a cube map: rays are cast once, on the host, and their bits kept."""

    def __init__(self, resolution: int):
        self.resolution = resolution
        self._bits: dict[int, UInt8[np.ndarray, " bytes"]] = {}

    def of(self, surfaces: VisibleSurfaces, pixels: Int[np.ndarray, " s"]) -> UInt8[np.ndarray, "p bytes"]:
        """Bits of the points of some pixels; none of filling.

        Args:
            surfaces: of the pixels alone, as a picture of a single row.
            pixels: their places in the picture that all of them are from.
        """
        points = surfaces.points
        origins, normals = np.asarray(points.origins), np.asarray(points.normals)
        pixel_of = np.full(len(origins), -1)
        for part in surfaces.parts:
            own = np.asarray(part.pixels.pixel)
            mine = pixel_of[int(part.start) :][: len(own)]
            mine[own < len(pixels)] = pixels[own[own < len(pixels)]]
        known = np.isin(pixel_of, [-1, *self._bits])
        new, directions = np.flatnonzero(~known), cubemap.directions(self.resolution)

        def trace(some: slice) -> np.ndarray:
            return trace_visibility(points.tracer, origins[new[some]], normals[new[some]], directions)[0]

        traced = in_parts(trace, len(new), _RAY_CHUNK)
        if (len(self._bits) + len(new)) * len(directions) > 8 * _MAX_KEPT_BYTES:
            self._bits = {number: self._bits[number] for number in pixel_of[known] if number >= 0}
        self._bits |= dict(zip(pixel_of[new].tolist(), itertools.chain(*traced), strict=True))
        bits = np.zeros((len(origins), len(directions) // 8), np.uint8)
        for point in np.flatnonzero(pixel_of >= 0):
            bits[point] = self._bits[pixel_of[point]]
        return bits


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
        bits: of its points, from `PixelVisibility`.
    """
    directions, count = bake.directions_for(resolution), surfaces.covered.size
    rows: list[ComponentRows] = []
    sharp: list[SharpLobes] = []
    for part, named in zip(surfaces.parts, components, strict=True):
        length, pixel = len(part.pixels.pixel), np.asarray(part.pixels.pixel)
        mine = slice(int(part.start), int(part.start) + length)
        for means, component in named:
            brdf, weight, pixels = component.brdf, component.weight, part.pixels
            is_sharp = False
            if isinstance(brdf, LobeSum | PackedLobes):
                every = brdf.texels if isinstance(brdf, PackedLobes) else brdf
                is_sharp = has_lobes(every) and is_narrower_than_texels(every, resolution)
            if is_sharp:
                assert isinstance(brdf, LobeSum | PackedLobes)
                shares = traced_shares(brdf, pixels, surfaces.points, int(part.start), _SHARP_RAYS)
                sharp.append(SharpLobes(means, pixels, FilteredLobes("", brdf, weight, None, 1, 0), shares))
            baked = _rows(jnp.asarray(bits[mine]), brdf, weight, pixels, directions, is_sharp)
            rows.append(ComponentRows(means, pixel, baked))
    return ExactPixels(tuple(rows), tuple(sharp), count, resolution)


@functools.partial(jax.jit, static_argnames="without_lobes")
def _rows(
    bits, brdf, weight: PixelWeight, pixels: SurfacePixels, directions, without_lobes: bool
) -> Float[Array, "3 p d"]:
    if isinstance(brdf, LobeSum) and without_lobes:
        brdf = dataclasses.replace(brdf, scale=jnp.zeros_like(brdf.scale))
    if isinstance(brdf, PackedLobes):
        own = brdf.at(pixels.uv, pixels.footprint)
        own = dataclasses.replace(own, scale=jnp.zeros_like(own.scale)) if without_lobes else own
        reflection = FixedView(jax.tree.map(lambda _: None, own), pixels.omega_o, own)
    else:
        reflection = FixedView(brdf, pixels.omega_o)
    side = round((len(directions.vectors) // 6) ** 0.5)
    rows = bake.bake_rows(bits, pixels.frame, reflection, directions, Texels(side))[:, 0]
    factor = jax.vmap(look_up, in_axes=(None, 0, 0))(weight, pixels.uv, pixels.footprint)
    by_channel = jnp.broadcast_to(rows, (len(rows), 3, rows.shape[-1])).swapaxes(0, 1)
    return by_channel * jnp.broadcast_to(factor, (len(rows), 3)).T[:, :, None]


@jax.jit
def _applied(rows: Float[Array, "3 p d"], texels: Float[Array, "d 3"]) -> Float[Array, "p 3"]:
    # As one product: three of matrices by vectors take ten times as long.
    return jnp.einsum("cpd,dc->pc", rows, texels, precision="highest")
