"""The pilot of a plan: what its errors are at a few pixels, over what it predicts.

Noise is measured in shaded pixels, drawn by what they bring to the picture's, against several times the samples, as
filtered look-ups blur those of few. What interpolation leaves is measured in pixels drawn by what is predicted of it,
with all shaded pixels between which they lie, by the same samples in all of them: their noise is nearly alike. It is
taken twice by different samples, and the product of both has no noise in the mean.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

from jaxrelight.lighting.adaptive.estimate import RUN
from jaxrelight.lighting.adaptive.planning import LayerPlan, Plan
from jaxrelight.lighting.adaptive.trials import Trials
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.random_numbers import MAX_POINTS

# Pixels of each layer whose noise is measured, and pixels that lie between others.
_NOISY, _BETWEEN = 192, 512
# Samples of those that lie between others, and of other components than the one whose noise is measured.
_ALIKE, _OTHER = (64, 512), 64
# Of the plan's samples, no more than this share tells what lies between, unless that is the least.
_SHARE = 1 / 16
# The error of what stands for the truth, of what is measured, and the least of its samples: what filtered look-ups blur
# falls slowly, in some pictures by a tenth from 256 samples to 512.
_TRUTH, _MIN_TRUTH = 0.35, 1024
# Without a pilot, factors on error² would be 1, give or take so much; none are outside of these.
_EXPECTED, _NOISE_FACTORS, _BETWEEN_FACTORS = 1.5, (0.25, 64.0), (0.16, 64.0)
# What is rare is met by few pixels: so many standard deviations are added to what is measured of interpolation.
_CAREFUL = 0.5
# This share of the pixels is drawn evenly, whatever is predicted.
_EVEN = 0.3
# The seeds of samples that tell what lies between, and of those that stand for the truth; users' seeds are others.
_SEEDS, _OF_TRUTH = (-5, -6), -7


class Factors(NamedTuple):
    """On errors that are predicted.

    Attributes:
        noise: of each layer.
        between: of what lies between shaded pixels, of all layers together, as it is alike in them.
    """

    noise: list[float]
    between: float


def measure_plan(trials: Trials, plan: Plan, seed: int) -> Factors:
    """The factors on the errors that a plan predicts.

    Args:
        trials: of the plan's view.
        plan: whose errors.
        seed: of its samples.
    """
    if not plan.layers:
        return Factors([], 1.0)
    weights = [trials.weight(number) for number in range(len(plan.layers))]
    return Factors(_noise(trials, plan, weights, seed), _between(trials, plan, weights))


def _noise(trials: Trials, plan: Plan, weights, seed: int) -> list[float]:
    drawn, predicted = [], []
    for layer in plan.layers:
        shaded, counts = np.asarray(layer.hierarchy.shaded), np.maximum(np.asarray(layer.counts, float), 1)
        noise = np.where(shaded, np.asarray(layer.deviation, float) ** 2 * counts ** -float(layer.power), 0)
        brought = noise * np.asarray(layer.hierarchy.influence(layer.alike), float)
        drawn.append(_drawn(brought, _NOISY))
        predicted.append((noise.ravel(), brought.ravel()))
    every = np.unique(np.concatenate([np.zeros(0, int), *(of.pixels for of in drawn)]))
    total, apart = np.zeros((*trials.view.padded_shape, 3), np.float32), []
    for number, (layer, of, weight) in enumerate(zip(plan.layers, drawn, weights, strict=True)):
        counts, asked = np.asarray(layer.counts).ravel(), np.asarray(layer.hierarchy.asked).ravel()
        planned, truth = np.zeros((2, len(counts)), int)
        truth[every] = np.where(asked[every], _OTHER, 0)
        more = np.minimum(counts[of.pixels] * _TRUTH ** (-2 / float(layer.power)), MAX_POINTS - RUN)
        planned[of.pixels], truth[of.pixels] = counts[of.pixels], np.maximum(more.astype(int), _MIN_TRUTH)
        few, many = (
            weight * trials.radiance(number, samples.reshape(weight.shape[:2]), seed)
            for samples, seed in ((planned, seed), (truth, _OF_TRUTH))
        )
        total = total + many
        apart.append((few - many).reshape(-1, 3)[of.pixels])
    factors = []
    for of, change, (noise, brought) in zip(drawn, apart, predicted, strict=True):
        square = np.mean(trials.seen(total.reshape(-1, 3)[of.pixels], change) ** 2, axis=1)
        # The truth's own noise is part of the difference.
        noise, brought = noise[of.pixels] * (1 + _TRUTH**2), brought[of.pixels]
        factors.append(_factor(square * brought / noise / of.likely, brought / of.likely, _NOISE_FACTORS))
    return factors


def _between(trials: Trials, plan: Plan, weights) -> float:
    left = np.sum([(float(of.share) * np.asarray(of.hierarchy.left, float)) ** 2 for of in plan.layers], axis=0)
    drawn, chosen = _drawn(left, _BETWEEN), np.zeros(left.shape, bool)
    if not len(drawn.pixels):
        return 1.0
    chosen.ravel()[drawn.pixels] = True
    total, apart = np.zeros((len(drawn.pixels), 3), np.float32), np.zeros((2, len(drawn.pixels), 3))
    for number, (layer, weight) in enumerate(zip(plan.layers, weights, strict=True)):
        needed = layer.hierarchy.sources(chosen) | (chosen & np.asarray(layer.hierarchy.asked))
        most = _SHARE * plan.samples / max(len(_SEEDS) * len(plan.layers) * np.count_nonzero(needed), 1)
        counts = np.where(needed, _alike(layer, plan.error, most), 0)
        for k, seed in enumerate(_SEEDS):
            image = trials.radiance(number, counts, seed, alike=True)
            between = np.asarray(layer.hierarchy.interpolate(as_array(image)))
            own, other = ((weight * of).reshape(-1, 3)[drawn.pixels] for of in (image, between))
            total, apart[k] = total + own / 2, apart[k] + other - own
    one, other = (trials.seen(total, of) for of in apart)
    return _factor(
        np.mean(one * other, axis=1) / drawn.likely,
        left.ravel()[drawn.pixels] / drawn.likely,
        _BETWEEN_FACTORS,
        _CAREFUL,
    )


def _alike(layer: LayerPlan, error: float, most: float) -> int:
    """The samples that tell what lies between: as many in all pixels, or their noise would not be alike."""
    shaded = np.asarray(layer.hierarchy.shaded)
    typical = np.sqrt(np.mean(np.asarray(layer.deviation, float)[shaded] ** 2)) if shaded.any() else 0.0
    wanted = (typical / max(error, 1e-9)) ** (2 / float(layer.power))
    return int(np.clip(min(wanted, most), *_ALIKE)) // RUN * RUN


def _factor(measured, predicted, limits: tuple[float, float], careful: float = 0.0) -> float:
    """On an error, of error² that is measured and predicted of pixels: the mean, as far as it is certain."""
    if predicted.sum() <= 0:
        return 1.0
    mean = measured.sum() / predicted.sum()
    uncertain = np.sum((measured - mean * predicted) ** 2) / predicted.sum() ** 2
    certain = _EXPECTED**2 / (_EXPECTED**2 + uncertain)
    mean = certain * mean + (1 - certain) + careful * np.sqrt(certain * uncertain)
    return float(np.sqrt(np.clip(mean, *limits)))


class _Drawn(NamedTuple):
    """Pixels, and how likely each was drawn, relative to others."""

    pixels: Int[np.ndarray, " p"]
    likely: Float[np.ndarray, " p"]


def _drawn(brought: Float[np.ndarray, "h w"], count: int) -> _Drawn:
    """Different pixels, the more likely the more each brings."""
    some = np.flatnonzero(brought > 0)
    if len(some) <= count:
        return _Drawn(some, np.ones(len(some)))
    likely = brought.ravel()[some]
    likely = (1 - _EVEN) * likely / likely.sum() + _EVEN / len(some)
    drawn = np.random.default_rng(0).choice(len(some), count, replace=False, p=likely)
    return _Drawn(some[drawn], likely[drawn])
