"""A camera's view of the receivers: which of them each pixel shows, and from where."""

import dataclasses
import functools

import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxrelight.basis import latlong
from jaxrelight.brdf.normal_maps import see
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.frame import frames_of_points, to_local
from jaxrelight.lighting.pixels import Pixels, padded, places
from jaxrelight.transport.model import Transport


class MaterialPixels(Pixels):
    """Pixels that see a block's material.

    Attributes:
        receivers: numbers among the material's receivers: one, or the three corners of the face seen.
        weights: theirs.
    """

    receivers: Int[Array, "p b"]
    weights: Float[Array, "p b"]


@dataclasses.dataclass(frozen=True)
class View:
    """What is needed to turn light terms into an image.

    Attributes:
        parts: pixels of every material.
        part_of_block: number of the material of each of the transport's blocks.
        covered: which pixels show a surface.
        directions: unit world direction of every pixel.
    """

    parts: tuple[MaterialPixels, ...]
    part_of_block: tuple[int, ...]
    covered: Bool[np.ndarray, "h w"]
    directions: Float[np.ndarray, "h w 3"]

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)."""
        return self.covered.shape  # pyright: ignore[reportReturnType]

    @property
    def materials(self) -> tuple[MaterialPixels, ...]:
        """Pixels of the transport's blocks, in their order."""
        return tuple(self.parts[number] for number in self.part_of_block)

    @functools.cached_property
    def place(self) -> Int[Array, " hw"]:
        """See `assembled`."""
        return places(self.parts, self.covered.size)

    @functools.cached_property
    def image_coordinates(self) -> tuple[Float[Array, "h w"], Float[Array, "h w"]]:
        """Where each pixel's direction lies in a lat-long map, rightwards and downwards 0 … 1."""
        u, v = latlong.coordinates(self.directions)
        return jax.device_put((u.astype(np.float32), v.astype(np.float32)))


def make_view(transport: Transport, camera: Camera) -> View:
    """Traces a camera's G-buffer and finds each pixel's receivers.

    Where receivers are pixels, the camera must be the transport's own, and what it sees is known.
    """
    gbuffer = transport.seen or see(transport.surfaces, transport.tracer, camera, transport.normal_maps)
    vertices = transport.settings.receivers == "vertices"
    slot = transport.receivers.slot_of
    corners = np.where(gbuffer.back[:, None], transport.surfaces.back[gbuffer.corners], gbuffer.corners)
    receivers = slot[corners] if vertices else slot[:, None]
    weights = gbuffer.barycentric if vertices else np.ones((len(slot), 1))
    material = transport.receivers.material_of_group[receivers[:, 0] // transport.receivers.positions.shape[1]]
    pixel = np.flatnonzero(gbuffer.covered)
    parts = {}
    for block in transport.blocks:
        if block.material in parts:
            continue
        groups = block.groups
        mine = np.flatnonzero(material == transport.receivers.material_of_group[groups[0]])
        first = groups[0] * transport.receivers.positions.shape[1]
        frames = frames_of_points(gbuffer.normals[mine], gbuffer.tangents[mine])
        omega_o = to_local(frames, gbuffer.omega_o[mine])
        parts[block.material] = MaterialPixels(
            pixel=jax.device_put(padded(pixel, mine, gbuffer.covered.size)),
            uv=jax.device_put(padded(gbuffer.uv, mine)),
            footprint=jax.device_put(padded(gbuffer.footprint, mine)),
            omega_o=jax.device_put(padded(omega_o, np.arange(len(mine)))),
            receivers=jax.device_put(padded(receivers - first, mine)),
            weights=jax.device_put(padded(weights, mine)),
        )
    number = [[*parts].index(name) for name in transport.names]
    return View(tuple(parts.values()), tuple(number), gbuffer.covered, gbuffer.directions)
