"""What a camera sees of precomputed receivers, at one or several samples a pixel."""

from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.receivers import GROUP
from jaxrelight.geometry.sensors import Sensors
from jaxrelight.lighting.antialiasing import averaged, joined, nearest_pixels, pixel_angle
from jaxrelight.lighting.contract import Image
from jaxrelight.lighting.visible_surfaces import Corners, SurfaceMaterial, VisibleSurfaces, corners_of, trace_view
from jaxrelight.numerics.arrays import as_array
from jaxrelight.transport.model import PrecomputedTransport, SceneGeometry


class TransportView(eqx.Module):
    """What a camera sees of precomputed receivers.

    Attributes:
        surfaces: what it sees.
        corners: the receivers of each part's pixels.
        shares: the visible shares of lobes that were traced, by part and the transport's lobes; None for others.
        samples: of pixels that are receivers, what several in each of them see; None where what is shaded is seen.
        nearest: of every sample the pixel whose radiance it takes; −1 where it shows no surface.
    """

    surfaces: VisibleSurfaces
    corners: tuple[Corners, ...]
    shares: tuple[tuple[Float[Array, "p l c1 j"] | None, ...], ...]
    samples: VisibleSurfaces | None = None
    nearest: Int[Array, "fh fw"] | None = None

    @property
    def shape(self) -> tuple[int, int]:
        """(height, width) of the picture."""
        return self.surfaces.picture_shape

    @property
    def shown(self) -> VisibleSurfaces:
        """What local lights light, and what covers the background."""
        return self.surfaces if self.samples is None else self.samples

    def taken(self, chosen: Int[np.ndarray, " s"]) -> "TransportView":
        """A view of some of the pixels alone; see `VisibleSurfaces.taken`."""
        surfaces, every = self.surfaces.taken(chosen)
        corners = tuple(some.of(self.corners[some.part]) for some in every)
        return TransportView(surfaces, corners, tuple(some.of(self.shares[some.part]) for some in every))


def trace_receivers(
    transport: PrecomputedTransport, materials: tuple[SurfaceMaterial, ...], camera: Camera | Sensors, factor: int
) -> tuple[VisibleSurfaces, tuple[Corners, ...]]:
    """Traces a camera's rays and finds each pixel's receivers; what the camera of pixel receivers sees is known."""
    geometry, receivers = transport.geometry, transport.receivers
    surfaces, gbuffer = trace_view(geometry, camera, materials, geometry.visible, factor=factor)
    if transport.method.receivers == "vertices":
        corners, weights = geometry.corners(gbuffer)
        slots = receivers.slot_of[corners]
    else:
        slots = receivers.slot_of[:, None]
        weights = np.ones((len(slots), 1))
    first = {part.material: part.first_group * GROUP for part in (*transport.blocks, *transport.lobes)}
    starts = [first[materials[part.material].name] for part in surfaces.parts]
    return surfaces, corners_of(surfaces, gbuffer, slots, weights, starts)


def samples_of_pixels(
    geometry: SceneGeometry, camera: Camera | Sensors, materials: tuple[SurfaceMaterial, ...], factor: int
) -> tuple[VisibleSurfaces, Int[Array, "fh fw"]]:
    """What several samples of each pixel see, and of every sample the pixel that it is most like; see `nearest_pixels`.

    Args:
        geometry: whose camera's pixels are known.
        camera: that one, or the sensors, each of whose points is a pixel with one sample.
        materials: of the relighter.
        factor: samples along each side of a pixel.
    """
    assert geometry.visible is not None
    samples, gbuffer = trace_view(geometry, camera, materials, factor=factor)
    if isinstance(camera, Sensors):
        return samples, as_array(np.arange(camera.width)[None])
    eye = geometry.surfaces.to_scene(np.asarray(camera.origin))
    return samples, as_array(nearest_pixels(gbuffer, geometry.visible, eye, pixel_angle(camera)))


def in_picture(radiance: Float[Array, "fh fw c"], view: TransportView) -> Float[Array, "h w c"]:
    """Radiance of what is shaded, as the picture's pixels have it."""
    if view.nearest is not None:
        return joined(jnp.zeros((*view.nearest.shape, radiance.shape[-1]), radiance.dtype), radiance, view.nearest)
    factor = view.surfaces.factor
    return averaged(radiance, factor) if factor > 1 else radiance


@jax.jit
def image_of_samples(
    own: Sequence[Float[Array, "h w 3"] | None],
    direct: Float[Array, "fh fw 3"] | None,
    covered: Bool[Array, "fh fw"],
    nearest: Int[Array, "fh fw"],
) -> Image:
    """The picture of what pixels have of their own, which samples take from them, and of samples' direct light."""
    first, *others = [part for part in own if part is not None]
    radiance = sum(others, first)
    direct = jnp.zeros((*covered.shape, 3), radiance.dtype) if direct is None else direct
    alpha = averaged(covered.astype(radiance.dtype)[..., None], covered.shape[0] // radiance.shape[0])
    return Image(joined(jnp.where(covered[..., None], direct, 0), radiance, nearest), alpha[..., 0])
