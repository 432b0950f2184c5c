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
        noise: that of samples.
        shadows: whether surfaces hide the environment.
    """

    shape: tuple[int, int] = eqx.field(static=True)
    layers: tuple[LayerPlan, ...]
    interpolation: Float[Array, ""]
    noise: Float[Array, ""]
    shadows: bool = eqx.field(static=True)

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
    counts = _counts([(layer.wanted, layer.hierarchy.shaded) for layer in best.layers], best.budget)
    layers = [
        LayerPlan(
            layer.hierarchy, as_array(layer_counts), estimate.bandwidth, estimate.deviation, as_array(power, np.float32)
        )
        for estimate, layer, layer_counts in zip(estimates, best.layers, counts, strict=True)
    ]
    between, noisy = (float(np.sqrt(of)) for of in (best.error, best.error_of(best.budget)))
    return Plan(shape, tuple(layers), as_array(between, np.float32), as_array(noisy, np.float32), shadows)


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
        apart = max(self.least / RUN / self.shown, 1)
        return self.spread ** (1 + self.power) / (self.pixels * apart) * max(budget, 1) ** -self.power

    @property
    def budget(self) -> float:
        """Samples in all: those given, or what keeps the error within the tolerance, as far as samples reach."""
        if self.given is not None:
            return max(self.given, self.least)
        assert self.tolerance is not None
        left = max(self.tolerance**2 - self.error, 1e-3 * self.tolerance**2)
        return max((self.error_of(1) / left) ** (1 / self.power), self.least)

    @property
    def cost(self) -> float:
        """What is to be as small as possible."""
        if self.given is None:
            return self.budget
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
def _error(hierarchy: Hierarchy, counts, deviation, power):
    noise = deviation**2 * jnp.maximum(counts, 1.0) ** -power
    return jnp.sqrt(hierarchy.propagate_variance(noise) + (_OF_PREDICTED * hierarchy.left) ** 2)
