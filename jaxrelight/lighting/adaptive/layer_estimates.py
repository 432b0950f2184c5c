"""From what is predicted at some pixels to what planning needs of all: features, visible deviation, and their trial."""

import functools
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.brdf.texture import Weight, look_up
from jaxrelight.lighting.adaptive.estimate import Blocked, estimate
from jaxrelight.lighting.adaptive.hierarchy import Features, hierarchy
from jaxrelight.lighting.adaptive.planning import LayerEstimate
from jaxrelight.lighting.adaptive.prediction import Prediction
from jaxrelight.lighting.adaptive.sampled_brdf import SampledBrdf
from jaxrelight.lighting.adaptive.view import AdaptiveView, scattered
from jaxrelight.lighting.pixels import SurfacePixels
from jaxrelight.lights.environment_mipmap import EnvironmentMipmap

# How noise falls is tried out on so many pixels of each component, with few and with more samples, against many.
_TRIED, _FEW, _MORE, _EXACT = 384, 32, 256, 512
# Error² can fall by these powers of the number of samples: from 1, of random numbers, to somewhat beyond even ones.
_FALLS = 0.9, 1.6
# These are the seeds of both trials; users' seeds are others.
_TRIALS = -1, -2


def estimate_layer(
    view: AdaptiveView,
    weights: Sequence[Sequence[Weight]],
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
    angular, spatial, contrast, visible, deviation, bandwidth = image
    surfaces = view.surfaces
    mirror = view.image([_mirrored(part.pixels) for part in surfaces.parts])
    position = view.image([part.positions(surfaces.points) for part in surfaces.parts])
    features = Features(jax.device_put(kind), mirror, angular, position, spatial, contrast)
    inside = view.factor.bit_length() - 1
    return LayerEstimate(number, hierarchy(features, inside), visible, deviation, bandwidth)


def calibrate(
    view: AdaptiveView,
    light: EnvironmentMipmap,
    samplers: Sequence[Sequence[SampledBrdf]],
    layers: Sequence[LayerEstimate],
    blocked: Sequence[Blocked | None],
) -> tuple[list[LayerEstimate], float]:
    """Layers with deviations that trials measured, and the power by which error² falls.

    A few pixels are tried, since skies, materials and shadows differ in how soon samples meet all there is.

    Args:
        view: whose pixels.
        light: the environment.
        samplers: of the components of each part.
        layers: as they are predicted.
        blocked: casts the shadows of each part.
    """
    # Measured and expected error² of each layer's parts, with few samples and with more.
    tried: dict[tuple[int, int], np.ndarray] = {}
    for layer in layers:
        for number, (part, part_samplers) in enumerate(zip(view.surfaces.parts, samplers, strict=True)):
            if layer.number < len(part_samplers):
                sums = _try(view, light, part.pixels, part_samplers[layer.number], layer, number, blocked[number])
                tried[layer.number, number] = sums
    total = np.sum(list(tried.values()), axis=0) if tried else np.zeros((2, 2))
    if total.min() <= 0:
        return list(layers), 1.0
    few, more = total[0] / total[1]
    power = float(np.clip(np.log(few / more) / np.log(_MORE / _FEW), *_FALLS))
    calibrated, parts = [], view.part_image()
    for layer in layers:
        scale = np.zeros(parts.shape)
        for (of_layer, number), sums in tried.items():
            if of_layer == layer.number:
                # Where trials measured nothing, the parts together tell the scale.
                few, more = np.divide(*(sums if sums.min() > 0 else total))
                scale[parts == number] = (few * more) ** 0.25 * (_FEW * _MORE) ** (power / 4)
        deviation = np.asarray(layer.deviation)
        calibrated.append(layer._replace(deviation=jax.device_put(deviation * scale.astype(deviation.dtype))))
    return calibrated, power


def _try(
    view: AdaptiveView, light, pixels, part: SampledBrdf, layer: LayerEstimate, number: int, blocked
) -> np.ndarray:
    """Measured and expected error² of some pixels, each with few samples and with more."""
    deviation, visible = (view.of_part(number, np.asarray(of)).astype(float) for of in (layer.deviation, layer.visible))
    real = np.flatnonzero(deviation > 0)
    places = real[np.unique(np.linspace(0, len(real) - 1, 2 * _TRIED).astype(int))] if len(real) else real
    counts = np.zeros(len(deviation), int)
    counts[places[::2]], counts[places[1::2]] = _FEW, _MORE
    many = np.where(counts > 0, _EXACT, 0)
    few, exact = (
        np.asarray(estimate(part, light, pixels, sample_counts, seed, blocked=blocked))
        for sample_counts, seed in zip((counts, many), _TRIALS, strict=True)
    )
    apart = np.mean((few - exact) ** 2, axis=1) * visible**2
    return np.asarray([[float(of[counts == n].sum()) for n in (_FEW, _MORE)] for of in (apart, deviation**2)])


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
        [prediction.angular, prediction.spatial, visible * prediction.contrast, visible, deviation, prediction.image],
        axis=1,
    )


@jax.jit
def _mirrored(pixels: SurfacePixels):
    """Where each pixel mirrors the eye. It is written out, since products of small matrices are slow."""
    x, y, z = (pixels.omega_o[:, k, None] * pixels.frame[:, k] for k in range(3))
    return z - x - y


def looked_up(weight: Weight, pixels: SurfacePixels) -> Float[Array, "p c"]:
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
