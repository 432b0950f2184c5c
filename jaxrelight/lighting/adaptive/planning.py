"""From what is predicted to where to shade, and how often: the cheapest way to an error, or the best of a budget.

Every tolerance of what lies between pixels leaves an error, and noise is spread over what is shaded by how many others
depend on it. The best tolerance is found by trying.
"""

import dataclasses
import functools
from collections.abc import Sequence
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxrelight.lighting.adaptive.estimate import RUN
from jaxrelight.lighting.adaptive.hierarchy import Hierarchy
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.random_numbers import MAX_POINTS

# Errors between parents that are tried, and the first of them; 0 shades every pixel.
_TOLERANCES = (*(5.12 * 2.0**-k for k in range(10)), 0.0)
_FIRST = 3
# A tolerance is met up to rounding; the cost of what misses it, in samples.
_MET, _MISSED = 1.01, 1e18
# So many bins of what pixels want are there to twice as much; and so often at most the number of samples that they say
# is changed by a thirtieth.
_BINS, _EXACT = 16, 12
# The most runs of samples of a pixel.
_RUNS = MAX_POINTS // RUN
# The share of the predicted error that is measured, in root mean square, before a pilot says more of it: 0.03 for bumpy
# meshes, 0.1 for smooth ones under edges.
OF_PREDICTED = 0.07
# What is planned for, of the tolerance: what a few pixels measure is up to a fifth off for all of them.
AIM = 0.9


class LayerPlan(eqx.Module):
    """What is shaded of the components with the same number in their materials.

    Images may have more rows and columns than the view, in which nothing is asked for.

    Attributes:
        hierarchy: where to shade, and what lies between.
        counts: samples of each pixel.
        bandwidth: that is predicted in the image, in cycles per pixel.
        deviation: in displayed values; error² of n samples is deviation² / n^power.
        power: even numbers and filtered light do better than 1 / n.
        share: of the error that the hierarchy predicts, how much there is.
        alike: the share of noise² that neighbours have in common, as filtered look-ups blur all of them alike.
    """

    hierarchy: Hierarchy
    counts: Int[Array, "h w"]
    bandwidth: Float[Array, "h w"]
    deviation: Float[Array, "h w"]
    power: Float[Array, ""]
    share: Float[Array, ""]
    alike: Float[Array, "h w"]

    @property
    def error(self) -> Float[Array, "h w"]:
        """The error that is predicted of each pixel, in displayed values."""
        return _error(self)

    @property
    def noise(self) -> Float[Array, "h w"]:
        """Its square alone, of samples."""
        return _noise(self)


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
    """How one layer's pixels hang together, and how noisy they are; see `LayerPlan`."""

    number: int
    hierarchy: Hierarchy
    deviation: Float[Array, "h w"]
    bandwidth: Float[Array, "h w"]
    alike: Float[Array, "h w"]
    share: float = OF_PREDICTED


# What a hierarchy within a tolerance is and brings, by the numbers of the layer and of the tolerance.
KnownHierarchies = dict[tuple[int, int], tuple[Hierarchy, Bool[np.ndarray, "h w"], Float[np.ndarray, " s"], float, int]]


def make_plan(
    estimates: Sequence[LayerEstimate],
    power: float,
    shape: tuple[int, int],
    pixels: int,
    factor: int,
    samples: float | None,
    tolerance: float | None,
    shadows: bool,
    known: KnownHierarchies | None = None,
    even: bool = False,
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
        known: what earlier plans of the same hierarchies tried; filled.
        even: shade every pixel, rather than as few as are best.
    """
    known = {} if known is None else known
    shown = pixels / factor**2
    budget = None if samples is None else samples * shown
    aim = None if samples is not None or tolerance is None else AIM * tolerance
    tried: dict[int, _Candidate] = {}

    def cost(step: int) -> float:
        """The error of a budget, or the samples of an error."""
        if step not in tried:
            layers = [_candidate(estimate, step, factor, pixels, power, known) for estimate in estimates]
            tried[step] = _Candidate(layers, power, budget, aim)
        return tried[step].cost

    step = len(_TOLERANCES) - 1 if even else _FIRST
    for way in () if even else (-1, 1):
        while 0 <= step + way < len(_TOLERANCES) and cost(step + way) < cost(step):
            step += way
    cost(step)
    best = tried[step]
    layers, start = [], 0
    for estimate, own in zip(estimates, best.layers, strict=True):
        counts = np.zeros(own.where.shape, np.int32)
        counts[own.where] = RUN * best.runs[start : start + len(own.brought)]
        start += len(own.brought)
        power_of, share = as_array(power, np.float32), as_array(estimate.share, np.float32)
        given = own.hierarchy, as_array(counts), estimate.bandwidth, estimate.deviation
        layers.append(LayerPlan(*given, power_of, share, estimate.alike))
    between, noisy = (as_array(np.sqrt(of), np.float32) for of in (best.between, best.noise))
    wanted = None if samples is not None or tolerance is None else as_array(tolerance, np.float32)
    return Plan(shape, tuple(layers), between, noisy, wanted, shadows)


class _CandidateLayer(NamedTuple):
    """Where to shade, and what that leaves.

    Attributes:
        hierarchy: of the layer.
        where: to shade.
        brought: by each of those to the mean error² of the picture, by a single sample.
        between: mean error² of what lies between.
    """

    hierarchy: Hierarchy
    where: Bool[np.ndarray, "h w"]
    brought: Float[np.ndarray, " s"]
    between: float


@dataclasses.dataclass(frozen=True)
class _Candidate:
    """One way to plan.

    Attributes:
        layers: where to shade.
        power: of the number of samples, by which error² falls.
        budget: of samples, or None for a
        aim: the error.
    """

    layers: list[_CandidateLayer]
    power: float
    budget: float | None
    aim: float | None

    @functools.cached_property
    def between(self) -> float:
        """Mean error² of what lies between."""
        return sum(layer.between for layer in self.layers)

    @functools.cached_property
    def noise(self) -> float:
        """Mean error² of samples."""
        return float(np.dot(self._brought, self._falls[self.runs]))

    @functools.cached_property
    def runs(self) -> Int[np.ndarray, " s"]:
        """Runs of samples of what is shaded, at least one for each: as many as there are, or as few as do."""
        runs, scale = _runs_of(self._wanted, self._scale), self._scale
        for _ in range(_EXACT):
            # Pixels of a bin are not rounded alike.
            if self.aim is not None:
                good = np.dot(self._brought, self._falls[runs]) <= max(self.aim**2 - self.between, 0)
            else:
                good = RUN * runs.sum() <= max(self.budget or 0, RUN * len(runs))
            if good or (runs == _RUNS).all():
                break
            scale += np.log(1.03) if self.aim is not None else -np.log(1.03)
            runs = _runs_of(self._wanted, scale)
        return runs

    @functools.cached_property
    def cost(self) -> float:
        """What is to be as small as possible."""
        runs = _runs_of(self._bins.wanted, self._scale)
        error = self.between + self._noise(runs)
        if self.budget is None:
            assert self.aim is not None
            share = error / self.aim**2
            # What misses the tolerance costs more than all that meet it, and the more the farther it is off.
            return RUN * float(np.dot(self._bins.count, runs)) if share <= _MET**2 else _MISSED * share
        # The best of those that do not fit has the fewest samples.
        least = RUN * len(self._brought)
        return error if least <= self.budget else 1e6 + least

    @functools.cached_property
    def _scale(self) -> float:
        """The logarithm of runs over what is wanted."""
        bins = self._bins
        if not len(bins.wanted):
            return 0.0

        def enough(scale: float) -> bool:
            runs = _runs_of(bins.wanted, scale)
            if self.budget is not None:
                return bool(RUN * np.dot(bins.count, runs) > self.budget)
            assert self.aim is not None
            return self._noise(runs) <= self.aim**2 - self.between

        # From those that leave one run for each to the most.
        low, high = -1 - np.log(bins.wanted.max()), np.log(_RUNS + 1) - np.log(bins.wanted.min())
        for _ in range(20):
            middle = (low + high) / 2
            low, high = (low, middle) if enough(middle) else (middle, high)
        return high if self.budget is None else low

    @functools.cached_property
    def _brought(self) -> Float[np.ndarray, " s"]:
        return np.concatenate([np.zeros(0), *(layer.brought for layer in self.layers)])

    @functools.cached_property
    def _wanted(self) -> Float[np.ndarray, " s"]:
        """What samples go by: error² brought / n^power falls as fast everywhere."""
        return self._brought ** (1 / (1 + self.power))

    @functools.cached_property
    def _bins(self) -> "_Bins":
        """Pixels that want nearly as many samples, together: each of a hundred thousand would be tried otherwise."""
        some = self._wanted > 0
        wanted, brought = self._wanted[some], self._brought[some]
        number = np.rint(_BINS * np.log2(wanted)).astype(int)
        number -= number.min(initial=0)
        count = np.bincount(number)
        some = count > 0
        wanted, brought = (np.bincount(number, of)[some] for of in (wanted, brought))
        return _Bins(count[some], wanted / count[some], brought)

    def _noise(self, runs: Int[np.ndarray, " b"]) -> float:
        return float(np.dot(self._bins.brought, self._falls[runs]))

    @functools.cached_property
    def _falls(self) -> Float[np.ndarray, " r"]:
        """Error² of so many runs, over that of a single sample."""
        return np.maximum(RUN * np.arange(_RUNS + 1.0), 1) ** -self.power


class _Bins(NamedTuple):
    """Shaded pixels by what they want: how many, what each wants, and error² that all of them bring."""

    count: Int[np.ndarray, " b"]
    wanted: Float[np.ndarray, " b"]
    brought: Float[np.ndarray, " b"]


def _runs_of(wanted: Float[np.ndarray, " s"], scale: float) -> Int[np.ndarray, " s"]:
    return np.clip(np.rint(np.exp(scale) * wanted), 1, _RUNS).astype(int)


def _candidate(
    estimate: LayerEstimate, step: int, factor: int, pixels: int, power: float, known: KnownHierarchies
) -> _CandidateLayer:
    key = estimate.number, step
    if key not in known:
        within = estimate.hierarchy.within(_TOLERANCES[step])
        left, asked = _sums(within)
        where = np.asarray(within.shaded)
        known[key] = within, where, np.asarray(within.influence(estimate.alike), float)[where], float(left), int(asked)
    hierarchy, where, influence, left, asked = known[key]
    # A pixel of the picture is a mean over as many of the view as it has: their noise is their own where they are
    # shaded, and the same where they lie between others.
    apart = max(len(influence) * factor**2 / max(asked, 1), 1) if factor > 1 else 1
    brought = influence * np.asarray(estimate.deviation, float)[where] ** 2 / (apart * pixels)
    return _CandidateLayer(hierarchy, where, brought, estimate.share**2 * left / pixels)


@jax.jit
def _sums(hierarchy: Hierarchy):
    return jnp.sum(hierarchy.left**2), jnp.sum(hierarchy.asked)


@jax.jit
def _noise(layer: LayerPlan):
    """Error² of samples, as many as there are, in what is shaded and in what lies between."""
    noise = layer.deviation**2 * jnp.maximum(layer.counts, 1.0) ** -layer.power
    return layer.hierarchy.propagate_variance(noise, layer.alike)


@jax.jit
def _error(layer: LayerPlan):
    return jnp.sqrt(_noise(layer) + (layer.share * layer.hierarchy.left) ** 2)
