"""A camera's view of the receivers: which of them each pixel shows, and from where."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.basis import latlong
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.frame import tangent_frame
from jaxrelight.geometry.gbuffer import GBuffer, trace_gbuffer
from jaxrelight.transport.load import Transport


class MaterialPixels(eqx.Module):
    """Pixels of one material, padded to one of few lengths so that few shapes are compiled.

    Attributes:
        pixel: place in the flattened image; past its end for padding.
        receivers: numbers among the material's receivers: one, or the three corners of the face seen.
        weights: theirs.
        omega_o: local direction to the eye.
    """

    pixel: Int[Array, " p"]
    receivers: Int[Array, "p b"]
    weights: Float[Array, "p b"]
    omega_o: Float[Array, "p 3"]


@dataclasses.dataclass(frozen=True)
class View:
    """What is needed to turn light terms into an image.

    Attributes:
        materials: pixels by material, in the transport's order.
        covered: which pixels show a surface.
        u: where each pixel's direction lies in a lat-long map, rightwards 0 … 1.
        v: the same downwards.
    """

    materials: tuple[MaterialPixels, ...]
    covered: np.ndarray
    u: Float[Array, "h w"]
    v: Float[Array, "h w"]

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width)."""
        return self.covered.shape  # pyright: ignore[reportReturnType]


def make_view(transport: Transport, camera: Camera) -> View:
    """Traces a camera's G-buffer and finds each pixel's receivers.

    Where receivers are pixels, the camera must be the transport's own.
    """
    gbuffer = trace_gbuffer(transport.surfaces, transport.tracer, camera)
    vertices = transport.settings.receivers == "vertices"
    slot = transport.receivers.slot_of
    receivers = slot[gbuffer.corners] if vertices else slot[:, None]
    weights = gbuffer.barycentric if vertices else np.ones((len(slot), 1))
    material = transport.receivers.material_of_group[receivers[:, 0] // transport.receivers.positions.shape[1]]
    omega_o = _local(gbuffer)
    pixel = np.flatnonzero(gbuffer.covered)
    parts = []
    for groups in transport.groups:
        mine = np.flatnonzero(material == transport.receivers.material_of_group[groups[0]])
        first = groups[0] * transport.receivers.positions.shape[1]
        pad = _bucket(len(mine)) - len(mine)
        parts.append(
            MaterialPixels(
                pixel=jnp.asarray(np.pad(pixel[mine], (0, pad), constant_values=gbuffer.covered.size)),
                receivers=jnp.asarray(np.pad(receivers[mine] - first, ((0, pad), (0, 0)))),
                weights=jnp.asarray(np.pad(weights[mine], ((0, pad), (0, 0))), jnp.float32),
                omega_o=jnp.asarray(np.pad(omega_o[mine], ((0, pad), (0, 0)))),
            )
        )
    u, v = latlong.coordinates(gbuffer.directions)
    return View(tuple(parts), gbuffer.covered, jnp.asarray(u, jnp.float32), jnp.asarray(v, jnp.float32))


def _local(gbuffer: GBuffer) -> np.ndarray:
    """Directions to the eye in the tangent frames of the interpolated normals."""
    frames = np.asarray(tangent_frame(jnp.asarray(gbuffer.normals, jnp.float32)))
    return np.einsum("pxy,py->px", frames, gbuffer.omega_o.astype(np.float32))


def _bucket(count: int) -> int:
    """The next length of the form 2^e·(4 … 7)/4, at least 1,024: at most a quarter is padding."""
    size = 1024
    while size < count:
        size = next((size * step // 4 for step in (5, 6, 7, 8) if size * step // 4 >= count), size * 2)
    return size
