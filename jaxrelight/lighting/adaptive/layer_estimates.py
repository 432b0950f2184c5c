"""From what is predicted at some pixels to what planning needs of all: features, and how much noise is seen."""

import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.brdf.texture import PixelWeight, look_up
from jaxrelight.lighting.adaptive.hierarchy import Features, hierarchy
from jaxrelight.lighting.adaptive.planning import LayerEstimate
from jaxrelight.lighting.adaptive.prediction import Prediction
from jaxrelight.lighting.adaptive.view import AdaptiveView, scattered
from jaxrelight.lighting.pixels import SurfacePixels


def estimate_layer(
    view: AdaptiveView,
    weights: Sequence[Sequence[PixelWeight]],
    predicted: Sequence[Sequence[Prediction]],
    number: int,
    white: float,
) -> LayerEstimate:
    """What the light of the components with one number is predicted to depend on, the largest around each pixel.

    Args:
        view: whose pixels.
        weights: of the components of each part.
        predicted: of them, at the view's probes.
        number: of the components in their materials.
        white: the radiance that is displayed as 1.
    """
    rows, kind, parts = [], np.full(view.padded_shape, -1, np.int32), view.part_image()
    for part, (probe, of_part, part_weights) in enumerate(zip(view.probes, predicted, weights, strict=True)):
        if number < len(of_part):
            rows.append((probe.pixels.pixel, _depends_on(part_weights, probe.pixels, of_part, number, white)))
            kind[parts == part] = part
    image = largest_around(scattered(rows, view.padded_shape), 2 * view.factor + 1)
    angular, spatial, contrast, deviation, bandwidth = image
    surfaces = view.surfaces
    mirror = view.image([_mirrored(part.pixels) for part in surfaces.parts])
    position = view.image([part.positions(surfaces.points) for part in surfaces.parts])
    features = Features(jax.device_put(kind), mirror, angular, position, spatial, contrast)
    inside = view.factor.bit_length() - 1
    return LayerEstimate(number, hierarchy(features, inside), deviation, bandwidth, jnp.zeros_like(deviation))


def display_slope(value: Float[Array, "*p"]) -> Float[Array, "*p"]:
    """How fast the displayed value, in sRGB and clipped at 1, grows with the linear one.

    Above 1 nothing is seen of it; as the value is predicted roughly, its square is what takes over.
    """
    inside = jnp.clip(value, 0.0031308, 1)
    slope = jnp.where(value <= 0.0031308, 12.92, 1.055 / 2.4 * inside ** (1 / 2.4 - 1))
    return slope / jnp.maximum(value, 1) ** 2


@functools.partial(jax.jit, static_argnames="k")
def _depends_on(weights, pixels: SurfacePixels, predicted: tuple[Prediction, ...], k: int, white):
    """What `Features` and `LayerEstimate` tell of component k at each pixel, from the predictions of all components."""
    shares = [jnp.mean(looked_up(weight, pixels), axis=1) for weight in weights]
    total = sum(share * prediction.radiance for share, prediction in zip(shares, predicted, strict=True))
    visible = shares[k] * display_slope(total / white) / white
    prediction = predicted[k]
    # Filtered look-ups take off the more the larger it is: of what is left, the root goes by it.
    deviation = visible * (white**2 * prediction.variance) ** 0.25
    return jnp.stack(
        [prediction.angular, prediction.spatial, visible * prediction.contrast, deviation, prediction.image],
        axis=1,
    )


@jax.jit
def _mirrored(pixels: SurfacePixels):
    """Where each pixel mirrors the eye. It is written out, since products of small matrices are slow."""
    x, y, z = (pixels.omega_o[:, k, None] * pixels.frame[:, k] for k in range(3))
    return z - x - y


def looked_up(weight: PixelWeight, pixels: SurfacePixels) -> Float[Array, "p c"]:
    """The weight of a component at each pixel."""
    return jax.vmap(look_up, in_axes=(None, 0, 0))(weight, pixels.uv, pixels.footprint)


@functools.partial(jax.jit, static_argnames="window")
def largest_around(image: Float[Array, "h w c"], window: int) -> tuple[Float[Array, "h w"], ...]:
    """The largest value around each pixel; channels then come first."""
    half_window, reach, steps = window // 2, 0, []
    while reach < half_window:
        # The largest of three pixels so far apart, each of which is the largest around.
        steps.append(min(2 * reach + 1, half_window - reach))
        reach += steps[-1]
    for axis in (0, 1):
        image = jnp.pad(image, [(half_window * (k == axis),) * 2 for k in range(3)], constant_values=-jnp.inf)
        for step in steps:
            three, apart = ([value if k == axis else 1 for k in range(3)] for value in (3, step))
            image = jax.lax.reduce_window(
                image, -jnp.inf, jax.lax.max, three, (1, 1, 1), "VALID", window_dilation=apart
            )
    return tuple(jnp.moveaxis(image, -1, 0))
