"""The pilot of a plan: a few pixels are shaded as it says, and show how far its errors are from what it predicts.

Pixels are drawn by the error that is predicted of them, and with each come all shaded pixels between which it lies.
What lies between is compared twice by different samples: products of both differences have no noise of those in the
mean. What stands for the truth has several times the samples of the plan, as filtered look-ups blur those of few.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxrelight.lighting.adaptive.estimate import RUN
from jaxrelight.lighting.adaptive.planning import Plan
from jaxrelight.lighting.adaptive.trials import Trials
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.random_numbers import MAX_POINTS

# Pixels that are compared: those whose noise is measured, and those that lie between others, with so many samples each.
_NOISY, _BETWEEN, _ALIKE = 192, 512, 64
# The error of those that stand for the truth, of what is predicted; and the least number of them.
_TRUTH, _LEAST_TRUTH = 0.35, 64
# As if so many more pixels had been as they were predicted; and factors on error² lie within these.
_AS_PREDICTED, _FACTORS = 4, (1 / 64, 64.0)
# That of what lies between is no smaller: a few pixels hardly meet what is rare.
_LEAST_BETWEEN = 0.4
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
    noises = [np.asarray(layer.noise, float) for layer in plan.layers]
    left = np.sum([(float(of.share) * np.asarray(of.hierarchy.left, float)) ** 2 for of in plan.layers], axis=0)
    noisy, between = _drawn(trials, np.sum(noises, axis=0), _NOISY), _drawn(trials, left, _BETWEEN)
    chosen, allowed = noisy.chosen | between.chosen, _TRUTH**2 * plan.error**2 / max(len(plan.layers), 1)
    light = trials.other_light()
    total, total_between, own, together = noisy.of(light), between.of(light), [], np.zeros((2, *between.shape))
    for number, layer in enumerate(plan.layers):
        weight, asked = trials.weight(number), np.asarray(layer.hierarchy.asked)

        def interpolated(counts, weight=weight, layer=layer, number=number, **given):
            image = trials.radiance(number, counts, **given)
            return weight * np.asarray(layer.hierarchy.interpolate(as_array(image))), weight * image

        counts = np.where(layer.hierarchy.sources(noisy.chosen), layer.counts, 0)
        planned = noisy.of(interpolated(counts, seed=seed)[0])
        needed = (np.asarray(layer.deviation, float) ** 2 / max(allowed, 1e-20)) ** (1 / float(layer.power))
        truth = np.where(noisy.chosen & asked, np.clip(needed, _LEAST_TRUTH, MAX_POINTS - RUN).astype(int), 0)
        alike = np.where(layer.hierarchy.sources(chosen) | (chosen & asked), _ALIKE, 0)
        exact, apart = noisy.of(weight * trials.radiance(number, truth, _OF_TRUTH)), []
        for k, other in enumerate(_SEEDS):
            lying, image = interpolated(alike, seed=other, alike=True)
            together[k] += between.of(lying - image)
            # Without what lies between, as far as it is known of the same pixels.
            apart.append(planned - exact - noisy.of(lying - image))
            total_between = total_between + between.of(image) / 2
        total = total + exact
        own.append(apart)
    # The truth's own noise is part of the differences.
    noise = [
        noisy.factor(trials, total, pair, (1 + _TRUTH**2) * of) for pair, of in zip(own, noises, strict=True)
    ]
    return Factors(noise, max(between.factor(trials, total_between, together, left, careful=True), _LEAST_BETWEEN))


class _Drawn(NamedTuple):
    """Pixels, and how likely each was drawn, relative to others."""

    pixels: Int[np.ndarray, " p"]
    likely: Float[np.ndarray, " p"]
    chosen: Bool[np.ndarray, "h w"]

    @property
    def shape(self) -> tuple[int, int]:
        """Of their radiance."""
        return len(self.pixels), 3

    def of(self, image: Float[np.ndarray, "h w 3"]) -> Float[np.ndarray, "p 3"]:
        """What they have of an image."""
        return image.reshape(-1, image.shape[-1])[self.pixels]

    def factor(self, trials: Trials, total, apart, predicted, *, careful: bool = False) -> float:
        """On an error, by the differences to two truths, over error² that is predicted.

        Args:
            trials: of the pixels.
            total: their radiance.
            apart: both differences in it.
            predicted: error² of all pixels.
            careful: what is rare has hardly been met, so that a standard deviation is added.
        """
        one, other = (trials.seen(total, of) for of in apart)
        square = np.mean(one * other, axis=1)
        expected = predicted.ravel()[self.pixels] / self.likely
        if expected.sum() <= 0:
            return 1.0
        square, count = square / self.likely, len(square)
        mean = square.sum() / expected.sum()
        if careful:
            mean += np.sqrt(np.sum((square - mean * expected) ** 2)) / expected.sum()
        share = _AS_PREDICTED / (count + _AS_PREDICTED)
        return float(np.sqrt(np.clip((1 - share) * mean + share, *_FACTORS)))


def _drawn(trials: Trials, brought: Float[np.ndarray, "h w"], count: int) -> _Drawn:
    """Different pixels, the more likely the more each brings."""
    some, chosen = np.flatnonzero(brought > 0), np.zeros(trials.view.padded_shape, bool)
    likely = np.ones(len(some))
    if len(some) > count:
        likely = brought.ravel()[some]
        likely = (1 - _EVEN) * likely / likely.sum() + _EVEN / len(some)
        drawn = np.random.default_rng(0).choice(len(some), count, replace=False, p=likely)
        some, likely = some[drawn], likely[drawn]
    chosen.ravel()[some] = True
    return _Drawn(some, likely, chosen)
