"""From what is predicted to where to shade, and how often: the cheapest way to an error, or the best of a budget.

Every tolerance of what lies between pixels leaves an error, and noise is spread over what is shaded by how many others
depend on it. The best tolerance is found by trying.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from jaxrelight.lighting.adaptive.estimate import RUN
from jaxrelight.lighting.adaptive.hierarchy import Hierarchy
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.random_numbers import MAX_POINTS

# Errors between parents that are tried, and the first of them; 0 shades every pixel.
_TOLERANCES = (*(5.12 * 2 ** (-k / 2) for k in range(20)), 0.0)
_FIRST = 8
# A tolerance is met up to rounding; the cost of what misses it, in samples.
_MET, _MISSED = 1.01, 1e18
# How often samples are added where runs of them leave more noise than was reckoned.
_MORE_SAMPLES = 6
# The share of the predicted error that is measured, in root mean square: 0.03 for bumpy meshes, 0.1 for smooth ones
# under edges.
_OF_PREDICTED = 0.07


class LayerPlan(eqx.Module):
    """What is shaded of the components with the same number in their materials.

    Images may have more rows and columns than the view, in which nothing is asked for.

    Attributes:
        hierarchy: where to shade, and what lies between.
        counts: samples of each pixel.
        bandwidth: that is predicted in the image, in cycles per pixel.
        deviation: in displayed values; error² of n samples is deviation² / n^power.
        power: even numbers and filtered light do better than 1 / n.
    """

    hierarchy: Hierarchy
    counts: Int[Array, "h w"]
    bandwidth: Float[Array, "h w"]
    deviation: Float[Array, "h w"]
    power: Float[Array, ""]

    @property
    def error(self) -> Float[Array, "h w"]:
        """The error that is predicted of each pixel, in displayed values."""
        return _error(self.hierarchy, self.counts, self.deviation, self.power)


class Plan(eqx.Module):
    """Where to shade, and how well.

    Attributes:
        shape: rows and columns of the view.
        layers: of components; none where no surface is seen.
        interpolation: root-mean-square error of displayed values that is predicted for what lies between.
        noise: that of samples, as many as are taken.
        tolerance: error of displayed values that was asked for; None where a number of samples was.
        shadows: whether surfaces hide the environment.
    """

    shape: tuple[int, int] = eqx.field(static=True)
    layers: tuple[LayerPlan, ...]
    interpolation: Float[Array, ""]
    noise: Float[Array, ""]
    tolerance: Float[Array, ""] | None
    shadows: bool = eqx.field(static=True)

    @property
    def error(self) -> float:
        """Root-mean-square error of displayed values that is predicted of the picture."""
        return float(np.hypot(self.interpolation, self.noise))

    @property
    def is_met(self) -> bool:
        """Whether no more than the tolerance is predicted; true of a number of samples."""
        return self.tolerance is None or self.error <= _MET * float(self.tolerance)

    @property
    def samples(self) -> int:
        """The number of samples of all pixels and components."""
        return sum(int(np.asarray(layer.counts).sum()) for layer in self.layers)

    @property
    def shaded(self) -> int:
        """How many pixels are, each component counted."""
        return sum(int(np.count_nonzero(np.asarray(layer.counts))) for layer in self.layers)

    def maps(self) -> dict[str, Float[np.ndarray, "h w"]]:
        """Pictures of the plan, of all layers together.

        Bandwidth in cycles per pixel; the level of each pixel's parents, 0 where it is shaded; samples; and the error
        that is predicted, in displayed values.
        """
        if not self.layers:
            return {name: np.zeros(self.shape) for name in ("bandwidth", "level", "samples", "error")}
        layers, (rows, columns) = self.layers, self.shape
        maps = {
            "bandwidth": np.max([np.asarray(layer.bandwidth) for layer in layers], axis=0),
            "level": np.min([layer.hierarchy.levels() for layer in layers], axis=0).astype(float),
            "samples": np.sum([np.asarray(layer.counts) for layer in layers], axis=0).astype(float),
            "error": np.sqrt(np.sum([np.asarray(layer.error, float) ** 2 for layer in layers], axis=0)),
        }
        return {name: image[:rows, :columns] for name, image in maps.items()}


class LayerEstimate(NamedTuple):
    """How one layer's pixels hang together, and how much of an error is seen; see `LayerPlan` for the others."""

    number: int
    hierarchy: Hierarchy
    visible: Float[Array, "h w"]
    deviation: Float[Array, "h w"]
    bandwidth: Float[Array, "h w"]


def make_plan(
    estimates: Sequence[LayerEstimate],
    power: float,
    shape: tuple[int, int],
    pixels: int,
    factor: int,
    samples: float | None,
    tolerance: float | None,
    shadows: bool,
) -> Plan:
    """The plan of a budget or of a quality.

    Args:
        estimates: of each layer.
        power: of the number of samples, by which error² falls.
        shape: rows and columns of the view.
        pixels: of those, how many show a surface.
        factor: squared, so many pixels of the view are one of the picture.
        samples: a mean over the picture's, or None for a
        tolerance: root-mean-square error of displayed values.
        shadows: whether surfaces hide the environment.
    """
    tried: dict[int, _Candidate] = {}

    def cost(step: int) -> float:
        """The error of a budget, or the budget of an error."""
        if step not in tried:
            layers = [_candidate(estimate, _TOLERANCES[step], power) for estimate in estimates]
            tried[step] = _Candidate(
                layers,
                sum(layer.error for layer in layers) / pixels,
                sum(layer.spread for layer in layers),
                sum(layer.shaded for layer in layers) * RUN,
                samples and samples * pixels / factor**2,
                tolerance,
                pixels,
                pixels / factor**2,
                power,
            )
        return tried[step].cost

    step = _FIRST
    for way in (-1, 1):
        while 0 <= step + way < len(_TOLERANCES) and cost(step + way) < cost(step):
            step += way
    best = tried[step]
    layers, noise = _planned(estimates, best, best.budget)
    budget = best.budget
    for _ in range(_MORE_SAMPLES):
        # Samples come in runs, and a pixel has one at least: some have fewer than they should.
        if tolerance is None or samples is not None or best.error + noise <= tolerance**2 or budget >= best.most:
            break
        left = max(tolerance**2 - best.error, 1e-3 * tolerance**2)
        budget = min(budget * max((noise / left) ** (1 / power), 1.02), best.most)
        layers, noise = _planned(estimates, best, budget)
    between, noisy = (as_array(np.sqrt(of), np.float32) for of in (best.error, noise))
    wanted = None if samples is not None or tolerance is None else as_array(tolerance, np.float32)
    return Plan(shape, tuple(layers), between, noisy, wanted, shadows)


def _planned(estimates: Sequence[LayerEstimate], best: "_Candidate", budget: float) -> tuple[list[LayerPlan], float]:
    """The layers of a plan with so many samples, and mean error² that they leave."""
    counts = _counts([(layer.wanted, layer.hierarchy.shaded) for layer in best.layers], budget)
    power = as_array(best.power, np.float32)
    layers = [
        LayerPlan(layer.hierarchy, as_array(own), estimate.bandwidth, estimate.deviation, power)
        for estimate, layer, own in zip(estimates, best.layers, counts, strict=True)
    ]
    total = sum(float(_noise(layer.hierarchy, layer.counts, layer.deviation, power)) for layer in layers)
    return layers, total / (best.pixels * best.apart)


class _CandidateLayer(NamedTuple):
    """Where to shade, and what that leaves: Σ error² between, and what samples go by, pixel by pixel and in all."""

    hierarchy: Hierarchy
    wanted: Float[Array, "h w"]
    error: float
    spread: float
    shaded: int


@dataclasses.dataclass(frozen=True)
class _Candidate:
    """One way to plan.

    Attributes:
        layers: where to shade.
        error: mean error² of what lies between.
        spread: what samples go by.
        least: the fewest samples there can be.
        given: samples in all, or None for a
        tolerance: of the error.
        pixels: of the view.
        shown: of the picture, each of one or more of those.
        power: of the number of samples, by which error² falls.
    """

    layers: list[_CandidateLayer]
    error: float
    spread: float
    least: int
    given: float | None
    tolerance: float | None
    pixels: int
    shown: float
    power: float

    def error_of(self, budget: float) -> float:
        """Mean error² of so many samples in the picture's pixels.

        Each of those is a mean over as many samples of the surface as it has, whose noise is their own where they are
        shaded, and the same where they lie between others.
        """
        return self.spread ** (1 + self.power) / (self.pixels * self.apart) * max(budget, 1) ** -self.power

    @property
    def apart(self) -> float:
        """Pixels of the view whose noise is their own, of one of the picture."""
        return max(self.least / RUN / self.shown, 1)

    @property
    def budget(self) -> float:
        """Samples in all: those given, or what keeps the error within the tolerance, as far as samples reach."""
        if self.given is not None:
            return max(self.given, self.least)
        assert self.tolerance is not None
        left = self.tolerance**2 - self.error
        if left <= 0:
            return self.most
        return min(max((self.error_of(1) / left) ** (1 / self.power), self.least), self.most)

    @property
    def most(self) -> float:
        """The most samples that there can be."""
        return self.least / RUN * MAX_POINTS

    @property
    def cost(self) -> float:
        """What is to be as small as possible."""
        if self.given is None:
            assert self.tolerance is not None
            share = (self.error + self.error_of(self.budget)) / self.tolerance**2
            # What misses the tolerance costs more than all that meet it, and the more the farther it is off.
            return self.budget if share <= _MET**2 else _MISSED * share
        # The best of those that do not fit has the fewest samples.
        return self.error + self.error_of(self.budget) if self.least <= self.given else 1e6 + self.least


def _candidate(estimate: LayerEstimate, tolerance: float, power: float) -> _CandidateLayer:
    hierarchy = estimate.hierarchy.within(tolerance)
    wanted, error, spread, shaded = _work(hierarchy, hierarchy.influence(), estimate.deviation, power)
    return _CandidateLayer(hierarchy, wanted, float(error), float(spread), int(shaded))


def _counts(layers, budget: float) -> list[Int[np.ndarray, "h w"]]:
    """Runs of samples in proportion to what is wanted, at least one for each shaded pixel, up to a budget."""
    shaded = [np.asarray(of) for _, of in layers]
    wanted = [np.asarray(of)[where].astype(float) / RUN for (of, _), where in zip(layers, shaded, strict=True)]

    def at(scale: float):
        return [np.round(np.clip(scale * of_layer, 1, MAX_POINTS // RUN)) * RUN for of_layer in wanted]

    low, high = 0.0, 2 * budget / max(sum(float(of_layer.sum()) for of_layer in wanted), 1e-30)
    for _ in range(16):
        middle = (low + high) / 2
        low, high = (low, middle) if sum(layer_counts.sum() for layer_counts in at(middle)) > budget else (middle, high)
    counts = [np.zeros(where.shape, np.int32) for where in shaded]
    for image, where, layer_counts in zip(counts, shaded, at(low), strict=True):
        image[where] = layer_counts
    return counts


@jax.jit
def _work(hierarchy, influence, deviation, power):
    wanted = (influence * deviation**2) ** (1 / (1 + power))
    error = _OF_PREDICTED**2 * jnp.sum(hierarchy.left**2)
    return wanted, error, jnp.sum(wanted), jnp.sum(hierarchy.shaded)


@jax.jit
def _noise(hierarchy: Hierarchy, counts, deviation, power):
    """Σ error² of samples, as many as there are, in what is shaded and in what lies between."""
    return jnp.sum(hierarchy.propagate_variance(deviation**2 * jnp.maximum(counts, 1.0) ** -power))


@jax.jit
def _error(hierarchy: Hierarchy, counts, deviation, power):
    noise = deviation**2 * jnp.maximum(counts, 1.0) ** -power
    return jnp.sqrt(hierarchy.propagate_variance(noise) + (_OF_PREDICTED * hierarchy.left) ** 2)
