"""What a camera sees, as adaptive shading needs it: images of one of few sizes, and pixels at which is predicted."""

import functools
import math
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int
from scipy import ndimage

from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.curvature import curvature
from jaxrelight.lighting.pixels import SurfacePixels, padded
from jaxrelight.lighting.visible_surfaces import SurfaceMaterial, VisibleSurfaces, trace_view, with_samples
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.buckets import filled_up, image_bucket
from jaxrelight.transport.model import SceneGeometry


class Probe(eqx.Module):
    """Pixels of one part at which bandwidth and noise are predicted.

    Attributes:
        pixels: every fourth of the picture's, and those that see another material than all of them around; their
            numbers are those in an image of the padded size.
        curvature: radians per metre, see `geometry.curvature`.
        distance: to the eye, in metres.
        point: the point from which each sees light; −1 for padding.
    """

    pixels: SurfacePixels
    curvature: Float[Array, " p"]
    distance: Float[Array, " p"]
    point: Int[Array, " p"]

    def known_points(self) -> Int[np.ndarray, " r"]:
        """The points of pixels that are not padding, on the host."""
        point = np.asarray(self.point)
        return point[point >= 0]


class AdaptiveView(eqx.Module):
    """What a camera sees, with `factor` samples of the surface along each side of a picture's pixel.

    Attributes:
        surfaces: what it sees, with so many times the rows and columns.
        probes: of each part of the surfaces.
        places: of each part, the numbers of its pixels in an image of the padded size; past its end for padding.
        pixel_angle: that a pixel covers along a side, in radians.
        factor: samples along a side.
        padded_shape: rows and columns in which pictures of about this size are worked on.
    """

    surfaces: VisibleSurfaces
    probes: tuple[Probe, ...]
    places: tuple[Int[Array, " _"], ...]
    pixel_angle: Float[Array, ""]
    factor: int = eqx.field(static=True)
    padded_shape: tuple[int, int] = eqx.field(static=True)

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of the picture."""
        h, w = self.surfaces.shape
        return h // self.factor, w // self.factor

    @property
    def size(self) -> int:
        """Pixels of an image of the padded size."""
        return math.prod(self.padded_shape)

    def covered_count(self) -> int:
        """Pixels that show a surface."""
        return int(np.asarray(self.surfaces.covered).sum())

    def part_image(self) -> Int[np.ndarray, "h w"]:
        """The number of the part that each pixel shows from above; −1 for none."""
        return _part_image([part.pixels for part in self.surfaces.parts], self.places, self.padded_shape)

    def image(self, rows: Sequence[Float[Array, "_ c"]]) -> Float[Array, "h w c"]:
        """The padded image of what the pixels of each part have; 0 elsewhere."""
        return scattered(list(zip(self.places, rows, strict=True)), self.padded_shape)

    def of_part(self, number: int, image: np.ndarray) -> np.ndarray:
        """What the pixels of a part have of a padded image; 0 for padding. On the host."""
        place = np.asarray(self.places[number])
        return np.where(place < self.size, image.ravel()[np.minimum(place, self.size - 1)], 0)


def make_view(
    geometry: SceneGeometry, camera: Camera, materials: Sequence[SurfaceMaterial], factor: int
) -> AdaptiveView:
    """Traces a camera's rays and chooses the pixels at which is predicted. On the host.

    Args:
        geometry: of the scene.
        camera: of the picture.
        materials: of the relighter.
        factor: samples of the surface along each side of a pixel.
    """
    surfaces, gbuffer = trace_view(geometry, camera, materials, factor=factor)
    shape = image_bucket(surfaces.shape[0]), image_bucket(surfaces.shape[1])
    size, (rows, columns) = math.prod(shape), surfaces.shape
    places = []
    for part in surfaces.parts:
        row, column = np.divmod(np.asarray(part.pixels.pixel), columns)
        places.append(jax.device_put(np.where(row < rows, row * shape[1] + column, size).astype(np.int32)))
    shown = _part_image([part.pixels for part in surfaces.parts], places, shape)
    every = np.zeros(shape, bool)
    every[:: 2 * factor, :: 2 * factor] = True
    covered, probes = np.flatnonzero(gbuffer.covered), []
    eye = np.asarray(camera.origin) - geometry.surfaces.centre
    for number, (part, place) in enumerate(zip(surfaces.parts, map(np.asarray, places), strict=True)):
        real = np.flatnonzero(place < size)
        chosen = real[_is_probed(shown == number, every, factor)[place[real]]]
        # Curvature is known of the points of the G-buffer, light of those of the parts.
        point = np.searchsorted(covered, np.asarray(part.pixels.pixel)[chosen])
        bend = curvature(gbuffer, geometry.surfaces.radius, point)
        positions = np.asarray(part.positions(surfaces.points))[chosen]
        distance = np.linalg.norm(positions - eye, axis=1)
        pixels = jax.tree.map(lambda x, chosen=chosen: jax.device_put(padded(np.asarray(x), chosen)), part.pixels)
        pixels = eqx.tree_at(lambda of: of.pixel, pixels, jax.device_put(padded(place, chosen, size)))
        length = len(pixels.pixel)
        bend, distance = (jax.device_put(filled_up(x, length)) for x in (bend, distance))
        lit = jax.device_put(filled_up(int(part.start) + chosen, length, -1))
        probes.append(Probe(pixels, bend, distance, lit))
    angle = as_array(np.sqrt(with_samples(camera, factor).solid_angles().max()), np.float32)
    return AdaptiveView(surfaces, tuple(probes), tuple(places), angle, factor, shape)


def _is_probed(of_part: Bool[np.ndarray, "h w"], every: Bool[np.ndarray, "h w"], factor: int) -> Bool[np.ndarray, " p"]:
    """Whether each pixel of an image is on the lattice, or of a part that has none of these pixels around."""
    near = np.asarray(ndimage.maximum_filter(of_part & every, 2 * factor + 1, mode="constant"), bool)
    return (of_part & (every | ~near)).ravel()


def _part_image(pixels: Sequence[SurfacePixels], places, shape: tuple[int, int]) -> Int[np.ndarray, "h w"]:
    parts = np.full(math.prod(shape) + 1, -1, np.int32)
    for number, (part_pixels, place) in enumerate(zip(pixels, places, strict=True)):
        parts[np.asarray(place)[np.asarray(part_pixels.omega_o)[:, 2] > 0]] = number
    return parts[:-1].reshape(shape)


@functools.partial(jax.jit, static_argnames="shape")
def scattered(
    rows: Sequence[tuple[Int[Array, " _"], Float[Array, "_ c"]]], shape: tuple[int, int]
) -> Float[Array, "h w c"]:
    """The image of what pixels have, whose numbers come with it; 0 elsewhere."""
    image = jnp.zeros((math.prod(shape), rows[0][1].shape[1]), rows[0][1].dtype)
    for place, row in rows:
        image = image.at[place].set(row, mode="drop")
    return image.reshape(*shape, -1)


@jax.jit
def taken_from(image: Float[Array, "h w c"], place: Int[Array, " p"]) -> Float[Array, "p c"]:
    """What pixels have of an image; 0 for padding."""
    return image.reshape(-1, image.shape[-1]).at[place].get(mode="fill", fill_value=0)
