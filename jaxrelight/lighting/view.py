"""A camera's view of the receivers: which of them each pixel shows, and from where."""

import dataclasses
import functools

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxrelight.basis import latlong
from jaxrelight.buckets import bucket
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.frame import to_local
from jaxrelight.transport.load import Transport
from jaxrelight.transport.normal_maps import see


class MaterialPixels(eqx.Module):
    """Pixels that see a block's material, padded to one of few lengths so that few shapes are compiled.

    Attributes:
        pixel: place in the flattened image; past its end for padding.
        receivers: numbers among the material's receivers: one, or the three corners of the face seen.
        weights: theirs.
        uv: texture coordinates.
        omega_o: local direction to the eye.
    """

    pixel: Int[Array, " p"]
    receivers: Int[Array, "p b"]
    weights: Float[Array, "p b"]
    uv: Float[Array, "p 2"]
    omega_o: Float[Array, "p 3"]


@dataclasses.dataclass(frozen=True)
class View:
    """What is needed to turn light terms into an image.

    Attributes:
        materials: pixels of the transport's blocks, in their order.
        covered: which pixels show a surface.
        directions: unit world direction of every pixel.
    """

    materials: tuple[MaterialPixels, ...]
    covered: Bool[np.ndarray, "h w"]
    directions: Float[np.ndarray, "h w 3"]

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)."""
        return self.covered.shape  # pyright: ignore[reportReturnType]

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
        pad = bucket(len(mine), 1024) - len(mine)

        def padded(rows, fill=0, mine=mine, pad=pad):
            return np.pad(rows[mine], ((0, pad), *[(0, 0)] * (rows.ndim - 1)), constant_values=fill)

        directions = gbuffer.normals, gbuffer.tangents, gbuffer.omega_o
        # Nothing is compiled to put arrays of NumPy in place.
        parts[block.material] = MaterialPixels(
            *jax.device_put(
                (
                    padded(pixel, gbuffer.covered.size).astype(np.int32),
                    padded(receivers - first).astype(np.int32),
                    padded(weights).astype(np.float32),
                    padded(gbuffer.uv).astype(np.float32),
                )
            ),
            omega_o=_local(*(padded(v).astype(np.float32) for v in directions)),
        )
    return View(tuple(parts[name] for name in transport.names), gbuffer.covered, gbuffer.directions)


_local = jax.jit(to_local)
