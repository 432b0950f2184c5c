"""What a camera sees of a scene: the surface point of every pixel, by material, ready for light."""

import dataclasses
from collections.abc import Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxrelight.basis import latlong
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.material import Material
from jaxrelight.brdf.normal_maps import see
from jaxrelight.brdf.packed_texture import pack_weight
from jaxrelight.brdf.spatial import Minification, PackedLobes, SpatialLobes
from jaxrelight.brdf.texture import PixelWeight, Weight
from jaxrelight.errors import InputError
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.frame import frames_of_points, to_local
from jaxrelight.geometry.gbuffer import GBuffer
from jaxrelight.geometry.morton import morton
from jaxrelight.geometry.ray_origins import ray_origins
from jaxrelight.geometry.sensors import Sensors
from jaxrelight.lighting.pixels import SurfacePixels, assembled, padded, places
from jaxrelight.lighting.shadows import SurfacePoints, surface_points
from jaxrelight.lights.environment import Environment
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.buckets import bucket, filled_up
from jaxrelight.transport.model import SceneGeometry

# Where few pixels are taken of a view, the fewest of a material that are held: as many as are drawn by brightness, so
# that other lights compile nothing new.
_FEW_PIXELS = 64


class SurfaceComponent(eqx.Module):
    """One BRDF of a material and the factor on it; maps of lobes are packed once for all views."""

    brdf: Brdf | PackedLobes
    weight: PixelWeight


class SurfaceMaterial(eqx.Module):
    """A material as pixels ask for it.

    Attributes:
        name: of the material.
        components: what it combines.
        emission: radiance that it emits; None for none.
    """

    name: str = eqx.field(static=True)
    components: tuple[SurfaceComponent, ...]
    emission: Float[Array, "3"] | None = None

    @property
    def is_spatial(self) -> bool:
        """Whether a component has a BRDF for every texel."""
        return any(isinstance(component.brdf, PackedLobes) for component in self.components)


def surface_material(name: str, material: Material, minification: Minification = "levels") -> SurfaceMaterial:
    """A material as pixels ask for it.

    Args:
        name: of the material.
        material: any.
        minification: of SBRDFs whose texels are smaller than pixels: the coarser "levels" that were fitted, as far as
            maps have any; "averaged" parameters; or "none".
    """
    components = tuple(surface_component(one.brdf, one.weight, minification) for one in material.components)
    emission = None if material.emission is None else as_array(material.emission)
    return SurfaceMaterial(name, components, emission)


def surface_component(
    brdf: Brdf | SpatialLobes | PackedLobes, weight: Weight | PixelWeight, minification: Minification = "levels"
) -> SurfaceComponent:
    """One BRDF of a material as pixels ask for it; see `surface_material`."""
    packed = brdf.packed(minification) if isinstance(brdf, SpatialLobes) else brdf
    return SurfaceComponent(packed, pack_weight(weight))


class TakenRows(NamedTuple):
    """The pixels that a part has of another view's.

    Attributes:
        part: number of the other view's part.
        rows: of that, filled up with the first.
    """

    part: int
    rows: Int[np.ndarray, " p"]

    def of(self, arrays: Any) -> Any:
        """Those rows of all arrays of a pytree."""
        return jax.tree.map(lambda of: as_array(np.asarray(of)[self.rows]), arrays)


class SurfacePart(eqx.Module):
    """The pixels that see one material.

    Attributes:
        material: its number among the relighter's materials.
        pixels: that see it.
        start: the first of them among the points that light reaches.
    """

    material: int = eqx.field(static=True)
    pixels: SurfacePixels
    start: Int[Array, ""]

    def positions(self, points: SurfacePoints) -> Float[Array, "p 3"]:
        """Positions of the pixels in world units from the scene's centre; padding has those of other pixels."""
        return jax.lax.dynamic_slice_in_dim(points.positions, self.start, len(self.pixels.pixel))


class Corners(eqx.Module):
    """The receivers between which each pixel of a part lies.

    Attributes:
        receivers: numbers among the material's receivers: one, or the three corners of the face seen.
        weights: theirs.
    """

    receivers: Int[Array, "p b"]
    weights: Float[Array, "p b"]


class VisibleSurfaces(eqx.Module):
    """What a camera sees, ready to be lit again and again.

    Attributes:
        parts: the pixels of each material that is seen.
        points: where light arrives, part by part.
        place: see `assembled`.
        covered: which pixels show a surface.
        u: where each pixel's direction lies in a lat-long map, rightwards 0 … 1.
        v: the same, downwards.
        corners: the vertices of each part's pixels, where a method asks for them.
        map_rows: rows of a lat-long map whose cells are about as large as the pixels, a power of two.
        factor: so many along each side are the samples of one pixel of the picture.
    """

    parts: tuple[SurfacePart, ...]
    points: SurfacePoints
    place: Int[Array, " n"]
    covered: Bool[Array, "h w"]
    u: Float[Array, "h w"]
    v: Float[Array, "h w"]
    corners: tuple[Corners, ...] = ()
    map_rows: int = eqx.field(static=True, default=1 << 30)
    factor: int = eqx.field(static=True, default=1)

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)."""
        return self.covered.shape  # pyright: ignore[reportReturnType]

    @property
    def picture_shape(self) -> tuple[int, int]:
        """(height, width) of the picture."""
        return self.shape[0] // self.factor, self.shape[1] // self.factor

    def behind_share(self) -> float:
        """The share of what is seen whose shading normal faces away from the eye: backs of faces, which are black."""
        behind = count = 0
        for part in self.parts:
            real = np.asarray(part.pixels.pixel) < self.covered.size
            behind += np.count_nonzero(np.asarray(part.pixels.omega_o)[real, 2] <= 0)
            count += np.count_nonzero(real)
        return behind / max(count, 1)

    @property
    def pixels(self) -> Int[np.ndarray, " n"]:
        """The places in the flattened picture of those that show a material, ascending."""
        every = [np.asarray(part.pixels.pixel) for part in self.parts]
        joined = np.sort(np.concatenate([np.zeros(0, int), *every]))
        return joined[joined < self.covered.size]

    def taken(self, chosen: Int[np.ndarray, " s"]) -> tuple["VisibleSurfaces", list[TakenRows]]:
        """Some of the pixels alone, as a picture of a single row in their order.

        Args:
            chosen: their places in the flattened picture, of `pixels`.

        Returns:
            The picture of them, and which rows of this one's parts its own have.
        """
        place = np.full(self.covered.size + 1, -1)
        place[chosen] = np.arange(len(chosen))
        parts, corners, rows, starts, end = [], [], [], [], 0
        for number, part in enumerate(self.parts):
            old = np.asarray(part.pixels.pixel)
            new = place[np.minimum(old, self.covered.size)]
            mine = np.flatnonzero(new >= 0)
            if not len(mine):
                continue
            length = bucket(len(mine), _FEW_PIXELS, steps=2)
            filled = np.concatenate([mine, np.full(length - len(mine), mine[0])])
            some = TakenRows(number, filled)
            places_of = filled_up(new[mine].astype(np.int32), length, len(chosen))
            pixels = dataclasses.replace(some.of(part.pixels), pixel=as_array(places_of))
            parts.append(SurfacePart(part.material, pixels, as_array(end, np.int32)))
            if self.corners:
                corners.append(some.of(self.corners[number]))
            rows.append(some)
            starts.append(int(part.start) + filled)
            end += length
        points = self.points.taken(np.concatenate([np.zeros(0, int), *starts]))
        covered, u, v = (as_array(np.asarray(of).reshape(-1)[None, chosen]) for of in (self.covered, self.u, self.v))
        place_of = places([part.pixels for part in parts], len(chosen))
        seen = VisibleSurfaces(tuple(parts), points, place_of, covered, u, v, tuple(corners), self.map_rows)
        return seen, rows

    def image(self, rows: Sequence[Float[Array, "_ c"]]) -> Float[Array, "h w c"]:
        """What the pixels of each part show; 0 where no surface is seen."""
        if not rows:
            return jnp.zeros((*self.shape, 3), self.u.dtype)
        return assembled(rows, self.place, self.shape)

    def emission(self, materials: Sequence[SurfaceMaterial]) -> Float[Array, "h w 3"] | None:
        """Radiance that surfaces emit towards the eye; None where none of those seen does."""
        if all(materials[part.material].emission is None for part in self.parts):
            return None
        return self.image([emitted(materials[part.material].emission, part.pixels) for part in self.parts])

    def background(self, environment: Environment) -> Float[Array, "h w 3"]:
        """The environment in every pixel's direction, between the cells of its map.

        A map with far finer cells than pixels is averaged first, so that it does not flicker from pixel to pixel.
        """
        pixels = environment.pixels
        rows, columns = min(len(pixels), self.map_rows), min(pixels.shape[1], 2 * self.map_rows)
        if len(pixels) >= 2 * rows:
            pixels = latlong.resized(pixels, rows, columns)
        return _background(pixels, environment.rotate_y, environment.scale, self.u, self.v)


@jax.jit
def emitted(emission: Float[Array, "3"] | None, pixels: SurfacePixels) -> Float[Array, "p 3"]:
    """Radiance that pixels' material emits; 0 from below the shading normal."""
    above = pixels.omega_o[:, 2:] > 0
    return jnp.where(above, jnp.zeros(3, pixels.omega_o.dtype) if emission is None else emission, 0)


@jax.jit
def _background(pixels: Float[Array, "h w 3"], rotate_y, scale, u, v):
    return latlong.interpolate(pixels, u + rotate_y / 360, v) * scale


def trace_view(
    geometry: SceneGeometry,
    camera: Camera | Sensors,
    materials: Sequence[SurfaceMaterial],
    gbuffer: GBuffer | None = None,
    *,
    factor: int = 1,
) -> tuple[VisibleSurfaces, GBuffer]:
    """Traces a camera's rays. On the host.

    Args:
        geometry: of the scene.
        camera: any, or sensors in its place.
        materials: of the relighter, in its order; meshes of others are black.
        gbuffer: what is known to be seen already, at the samples of pixels.
        factor: samples along each side of a pixel.

    Returns:
        What is seen, by material, and the surface points behind it.
    """
    surfaces, camera = geometry.surfaces, with_samples(camera, factor)
    if gbuffer is None:
        gbuffer = see(surfaces, geometry.tracer, camera, geometry.normal_maps or [None] * len(surfaces.two_sided))
    names = [material.name for material in materials]
    number_of_mesh = [names.index(name) if name in names else -1 for name in geometry.material_of_mesh]
    seen = np.asarray(number_of_mesh)[gbuffer.mesh]
    pixel = np.flatnonzero(gbuffer.covered)
    parts, order, end = [], [np.zeros(0, int)], 0
    for number, material in enumerate(materials):
        shown = np.flatnonzero(seen == number)
        if not len(shown):
            continue
        if material.is_spatial:
            # Neighbours in the maps follow one another, so that large maps are read a tenth faster.
            shown = shown[np.argsort(morton(gbuffer.uv[shown, :2] % 1), kind="stable")]
        frames = frames_of_points(gbuffer.normals[shown], gbuffer.tangents[shown])
        own, omega_o = np.arange(len(shown)), to_local(frames, gbuffer.omega_o[shown])
        pixels = SurfacePixels(
            pixel=jax.device_put(padded(pixel, shown, gbuffer.covered.size)),
            uv=jax.device_put(padded(gbuffer.uv, shown)),
            footprint=jax.device_put(padded(gbuffer.footprint, shown)),
            omega_o=jax.device_put(padded(omega_o, own)),
            frame=jax.device_put(padded(frames, own)),
        )
        start = sum(map(len, order))
        parts.append(SurfacePart(number, pixels, as_array(start, np.int32)))
        end = start + len(pixels.pixel)
        order.append(shown)
    pixel_order = np.concatenate(order)
    # There are as many points as the padding of the last part asks for.
    points = surface_points(
        geometry.tracer,
        gbuffer.positions[pixel_order],
        ray_origins(surfaces, geometry.tracer, gbuffer)[pixel_order],
        gbuffer.normals[pixel_order],
        surfaces.radius,
        end,
    )
    u, v = latlong.coordinates(gbuffer.directions)
    u, v, covered = jax.device_put((u.astype(np.float32), v.astype(np.float32), gbuffer.covered))
    place = places([part.pixels for part in parts], gbuffer.covered.size)
    # A row of a map is as high as a pixel of the middle of the picture, or lower.
    map_rows = 1 << max(0, int(np.ceil(np.log2(np.pi / np.sqrt(camera.solid_angles().max())))))
    return VisibleSurfaces(tuple(parts), points, place, covered, u, v, map_rows=map_rows, factor=factor), gbuffer


def corners_of(
    surfaces: VisibleSurfaces,
    gbuffer: GBuffer,
    slots: Int[np.ndarray, "n b"],
    weights: Float[np.ndarray, "n b"],
    starts: Sequence[int],
) -> tuple[Corners, ...]:
    """The receivers between which the pixels of each part lie.

    Args:
        surfaces: what a camera sees.
        gbuffer: of it.
        slots: of covered pixels, numbers among all receivers.
        weights: theirs.
        starts: of each part, the first of the receivers that its numbers count from.
    """
    number_of_pixel = np.cumsum(gbuffer.covered.ravel()) - 1
    corners = []
    for part, start in zip(surfaces.parts, starts, strict=True):
        pixel = np.asarray(part.pixels.pixel)
        numbers = number_of_pixel[pixel[pixel < gbuffer.covered.size]]
        own, every = slots[numbers] - start, np.arange(len(numbers))
        corners.append(Corners(jax.device_put(padded(own, every)), jax.device_put(padded(weights[numbers], every))))
    return tuple(corners)


def with_samples(camera: Camera | Sensors, along: int) -> Camera | Sensors:
    """The camera with so many times its rows and columns: samples of each pixel along both sides.

    Raises:
        InputError: for several samples of the points of sensors.
    """
    if isinstance(camera, Sensors):
        if along > 1:
            raise InputError("points of sensors have no samples beside them; leave antialiasing at 1")
        return camera
    return dataclasses.replace(camera, width=along * camera.width, height=along * camera.height)
