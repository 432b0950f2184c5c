"""Shading of every pixel, with as many samples in all that see a material: where planning costs more than it saves.

Small pictures and loose tolerances take few samples however they are spread. What a trial measures of noise says how
many, before anything else is predicted.
"""

import numpy as np

from jaxrelight.lighting.adaptive.estimate import RUN
from jaxrelight.lighting.adaptive.hierarchy import shade_all
from jaxrelight.lighting.adaptive.planning import AIM, LayerEstimate
from jaxrelight.lighting.adaptive.trials import NoiseTrials, calibrate
from jaxrelight.lighting.adaptive.view import AdaptiveView
from jaxrelight.numerics.arrays import as_array

# Samples that take as long as prediction, planning and pilot: of any picture, and of each of its pixels and layers;
# with shadows, whose rays take longer than the samples.
_PLANNING = {False: (1_000_000, 24), True: (600_000, 16)}


def even_layers(view: AdaptiveView, tried: NoiseTrials, count: int) -> tuple[list[LayerEstimate], float]:
    """Layers of which every pixel is shaded, as noisy as trials measured, and the power by which error² falls.

    Args:
        view: whose pixels.
        tried: what was measured.
        count: of layers.
    """
    layers, parts = [], view.part_image()
    for number in range(count):
        asked = np.isin(parts, [part for of_layer, part in tried if of_layer == number])
        one, none = (as_array(of.astype(np.float32)) for of in (asked, np.zeros_like(asked)))
        layers.append(LayerEstimate(number, shade_all(as_array(asked)), one, none, none))
    return calibrate(view, tried, layers)


def even_samples(layers: list[LayerEstimate], power: float, pixels: int, tolerance: float) -> float:
    """About how many samples reach a tolerance in layers of `even_layers`."""
    noise, number = [], []
    for layer in layers:
        values, counts = np.unique(np.asarray(layer.deviation)[np.asarray(layer.hierarchy.asked)], return_counts=True)
        noise.append(values.astype(float) ** 2)
        number.append(counts)
    squares, counts = np.concatenate([np.zeros(0), *noise]), np.concatenate([np.zeros(0), *number])
    wanted = squares ** (1 / (1 + power))
    scale = (np.dot(counts, wanted) / (pixels * (AIM * tolerance) ** 2)) ** (1 / power)
    return float(np.dot(counts, np.maximum(scale * wanted, RUN)))


def planning_pays(view: AdaptiveView, layers: list[LayerEstimate], samples: float, *, shadows: bool) -> bool:
    """Whether planning takes less time than the samples of every pixel.

    Args:
        view: the picture.
        layers: of it.
        samples: in all, without a plan.
        shadows: whether each sample casts a ray.
    """
    least, of_pixel = _PLANNING[shadows]
    return samples > least + of_pixel * view.size * len(layers)
