"""Trials: a few pixels are shaded before the picture is, and compared in displayed values.

Skies, materials and shadows differ in how soon samples meet all there is, and in how straight light lies between
pixels. No prediction knows that; what is measured of some pixels holds for the others.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.brdf.texture import PixelWeight
from jaxrelight.images.tone import srgb_encode, to_unit
from jaxrelight.lighting.adaptive.estimate import Blocked, estimate
from jaxrelight.lighting.adaptive.layer_estimates import looked_up
from jaxrelight.lighting.adaptive.planning import LayerEstimate
from jaxrelight.lighting.adaptive.sampled_brdf import SampledBrdf
from jaxrelight.lighting.adaptive.view import AdaptiveView
from jaxrelight.lighting.pixels import SurfacePixels
from jaxrelight.lights.environment_mipmap import EnvironmentMipmap
from jaxrelight.numerics.arrays import as_array

# How noise falls is tried out on so many pairs of pixels of each part, with few and with more samples, against many.
_PAIRS, _FEW, _MORE, _EXACT = 96, 16, 128, 512
# Error² can fall by these powers of the number of samples: from 1, of random numbers, to that of even ones and of what
# filtered look-ups blur.
_FALLS = 0.9, 2.2
# These are the seeds of trials; users' seeds are others.
_TRIALS = -1, -2, -4


@dataclasses.dataclass(frozen=True)
class Trials:
    """Shades some pixels of a view under an environment, without other lights and its sun.

    Attributes:
        view: whose pixels.
        light: the environment.
        samplers: of the components of each part.
        weights: theirs.
        blocked: casts the shadows of each part.
        white: the radiance that is displayed as 1.
    """

    view: AdaptiveView
    light: EnvironmentMipmap
    samplers: Sequence[Sequence[SampledBrdf]]
    weights: Sequence[Sequence[PixelWeight]]
    blocked: Sequence[Blocked | None]
    white: float

    @property
    def layers(self) -> int:
        """The most components of a part."""
        return max(map(len, self.samplers), default=0)

    def radiance(
        self, number: int, counts: Int[np.ndarray, "h w"], seed: int, *, alike: bool = False
    ) -> Float[np.ndarray, "h w 3"]:
        """What the components with a number reflect, without their weights; 0 where the count is.

        Args:
            number: of the components in their materials.
            counts: samples of each pixel of the padded image.
            seed: of the numbers that samples are drawn with.
            alike: draw with the same numbers in all pixels, so that neighbours differ by what they are alone.
        """
        image = np.zeros((self.view.size, 3), np.float32)
        for part, samplers in enumerate(self.samplers):
            own = self.view.of_part(part, counts)
            if number < len(samplers) and own.any():
                pixels = self.view.surfaces.parts[part].pixels
                if alike:
                    pixels = eqx.tree_at(lambda of: of.pixel, pixels, jnp.zeros_like(pixels.pixel))
                values = estimate(samplers[number], self.light, pixels, own, seed, blocked=self.blocked[part])
                chosen = np.flatnonzero(own)
                image[np.asarray(self.view.places[part])[chosen]] = np.asarray(values)[chosen]
        return image.reshape(*self.view.padded_shape, 3)

    def weight(self, number: int) -> Float[np.ndarray, "h w 3"]:
        """The weights of the components with a number."""
        image = np.zeros((self.view.size + 1, 3), np.float32)
        for part, weights in enumerate(self.weights):
            if number < len(weights):
                place = np.minimum(np.asarray(self.view.places[part]), self.view.size)
                image[place] = np.asarray(_weight(weights[number], self.view.surfaces.parts[part].pixels))
        return image[:-1].reshape(*self.view.padded_shape, 3)

    def seen(self, total: Float[np.ndarray, "*p 3"], change: Float[np.ndarray, "*p 3"]) -> Float[np.ndarray, "*p 3"]:
        """What a change of radiance changes in displayed values."""
        before, after = (srgb_encode(to_unit(of / self.white)) for of in (total, total + change))
        return after - before


class NoiseTrial(NamedTuple):
    """Displayed errors of some pixels of one component, by `_FEW` samples and by `_MORE`.

    Attributes:
        place: of the pixels, in the padded image; neighbours follow each other.
        error: by few samples, and by more.
    """

    place: Int[np.ndarray, " p"]
    error: Float[np.ndarray, "2 p 3"]

    @property
    def square(self) -> Float[np.ndarray, "2 p"]:
        """A mean over channels."""
        return np.mean(self.error**2, axis=2)

    @property
    def alike(self) -> float:
        """The share of error² that neighbours have in common."""
        one, other = self.error[:, :-1:2], self.error[:, 1::2]
        both = np.sum(one**2 + other**2) / 2
        return float(np.clip(np.sum(one * other) / both, 0, 1)) if both > 0 else 0.0


# By the number of a component and that of the part that it belongs to.
NoiseTrials = dict[tuple[int, int], NoiseTrial]


def try_noise(trials: Trials) -> NoiseTrials:
    """How large noise is, and how fast it falls."""
    view, chosen = trials.view, []
    for part in range(len(trials.samplers)):
        facing = np.asarray(view.surfaces.parts[part].pixels.omega_o)[:, 2] > 0
        place = np.asarray(view.places[part])[facing]
        place = place[place < view.size]
        first = np.unique(np.linspace(0, len(place) - 2, _PAIRS).astype(int) // 2 * 2) if len(place) > 1 else []
        chosen.append(place[np.ravel([(k, k + 1) for k in first]).astype(int)])
    at = np.concatenate([np.zeros(0, int), *chosen])
    total, apart = np.zeros((len(at), 3), np.float32), []
    for number in range(trials.layers):
        weight = trials.weight(number).reshape(-1, 3)[at]
        few, more, exact = (
            weight * trials.radiance(number, _counts_at(view, at, count), seed).reshape(-1, 3)[at]
            for count, seed in zip((_FEW, _MORE, _EXACT), _TRIALS, strict=True)
        )
        total = total + exact
        apart.append([few - exact, more - exact])
    tried, start = {}, 0
    for part, place in enumerate(chosen):
        mine = slice(start, start + len(place))
        for number in range(len(trials.samplers[part])):
            error = [trials.seen(total[mine], of[mine]) for of in apart[number]]
            tried[number, part] = NoiseTrial(place, np.asarray(error, float))
        start += len(place)
    return tried


def calibrate(
    view: AdaptiveView, tried: NoiseTrials, layers: Sequence[LayerEstimate]
) -> tuple[list[LayerEstimate], float]:
    """Layers with deviations that trials measured, and the power by which error² falls.

    Args:
        view: whose pixels.
        tried: what was measured.
        layers: as they are predicted.
    """
    predicted = {of.number: np.asarray(of.deviation, float).ravel() for of in layers}
    sums = {
        (number, part): np.asarray([*one.square.sum(axis=1), np.sum(predicted[number][one.place] ** 2)])
        for (number, part), one in tried.items()
    }
    total = np.sum(list(sums.values()), axis=0) if sums else np.zeros(3)
    if total.min() <= 0:
        return list(layers), 1.0
    power = fitted_power(total[0] / total[1])
    # What stands for the truth has noise of its own.
    few, more = (count**-power + _EXACT**-power for count in (_FEW, _MORE))
    calibrated, parts = [], view.part_image()
    for layer in layers:
        scale, alike = np.zeros(parts.shape, np.float32), np.zeros(parts.shape, np.float32)
        for (of_layer, part), measured in sums.items():
            if of_layer == layer.number:
                # Where trials measured nothing, the parts together tell the scale.
                by_few, by_more, expected = measured if measured.min() > 0 else total
                scale[parts == part] = (by_few * by_more / (few * more)) ** 0.25 / np.sqrt(expected)
                alike[parts == part] = tried[of_layer, part].alike
        deviation = np.asarray(layer.deviation) * scale
        calibrated.append(layer._replace(deviation=as_array(deviation), alike=as_array(alike)))
    return calibrated, power


def fitted_power(fall: float) -> float:
    """The power by which error² falls, of how many times as large it is by few samples as by more."""
    low, high = _FALLS
    for _ in range(24):
        power = (low + high) / 2
        reached = (_FEW**-power + _EXACT**-power) / (_MORE**-power + _EXACT**-power)
        low, high = (power, high) if reached < fall else (low, power)
    return float((low + high) / 2)


def _counts_at(view: AdaptiveView, place, count) -> Int[np.ndarray, "h w"]:
    counts = np.zeros(view.size, int)
    counts[place] = count
    return counts.reshape(view.padded_shape)


@jax.jit
def _weight(weight: PixelWeight, pixels: SurfacePixels) -> Float[Array, "p 3"]:
    return jnp.broadcast_to(looked_up(weight, pixels), (len(pixels.pixel), 3))
