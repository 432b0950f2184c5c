"""How far a picture is from its method's exact reference, measured on a sample of its own pixels."""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int

# As `images.image_error` trims.
TRIM = 0.05
# Samples drawn again, and the share of them that an interval leaves out on each side.
_REDRAWN, _TAIL = 1000, 0.025


@dataclasses.dataclass(frozen=True)
class Estimate:
    """A relative error, and the interval that holds that of the whole picture 95 times in 100."""

    value: float
    low: float
    high: float

    def __str__(self) -> str:
        return f"{_percent(self.value)} % ± {_percent(max(self.high - self.value, self.value - self.low), 1)}"


def _percent(share: float, digits: int = 2) -> str:
    """A share in percent, without exponents; 0 for what rounding leaves."""
    return f"{float(f'{100 * share:.{digits}g}'):g}" if share >= 1e-6 else "0"


@dataclasses.dataclass(frozen=True)
class PictureError:
    """Relative L2 of a picture against its reference, over the pixels that show a surface; 0.01 is one percent.

    Attributes:
        trimmed: without the twentieth of the pixels that differ most, as `image_error` has it.
        untrimmed: of all.
        parts: what each means brings about by itself, trimmed, by name; they add up by squares where they are
            independent.
        reference: what the picture was compared with.
        missing: light that neither the picture's method nor the reference has, or that was taken as it is.
        samples: pixels that were compared.
    """

    trimmed: Estimate
    untrimmed: Estimate
    parts: dict[str, float]
    reference: str
    missing: tuple[str, ...]
    samples: int

    def __str__(self) -> str:
        shares = sorted(self.parts.items(), key=lambda part: -part[1])
        said = ", ".join(f"{name} {_percent(share)}" for name, share in shares if share >= 5e-5)
        without = f"; not measured: {', '.join(self.missing)}" if self.missing else ""
        return f"{self.trimmed} from {self.reference}{': ' + said if said else ''}{without}"


def drawn_pixels(pixels: Int[np.ndarray, " n"], count: int, seed: int = 0) -> Int[np.ndarray, " s"]:
    """A sample of pixels by strata: one of each run of the picture's, drawn at random.

    Args:
        pixels: places in the flattened picture, ascending.
        count: of the sample; all of them where there are no more.
        seed: of the numbers.
    """
    if len(pixels) <= count:
        return pixels
    ends = np.linspace(0, len(pixels), count + 1).astype(int)
    return pixels[np.random.default_rng(seed).integers(ends[:-1], ends[1:])]


def bright_pixels(
    energy: Float[np.ndarray, " n"], count: int, seed: int = 0
) -> tuple[Int[np.ndarray, " s"], Int[np.ndarray, " s"]]:
    """Pixels drawn in proportion to the energy that they have, and how often each was; ascending.

    Args:
        energy: of each pixel, of which some is above 0.
        count: of draws.
        seed: of the numbers.
    """
    ends = np.cumsum(energy) / energy.sum()
    drawn = (np.arange(count) + np.random.default_rng(seed).random()) / count
    return np.unique(np.minimum(np.searchsorted(ends, drawn, side="right"), len(energy) - 1), return_counts=True)


class Pictured(NamedTuple):
    """What a picture has at a sample of its pixels.

    Attributes:
        by_means: radiance that a reference tells, by the means that the picture has it by.
        alike: radiance that is taken as it is, without the picture's own pixels where it can be had without them.
    """

    by_means: dict[str, Float[np.ndarray, "s 3"]]
    alike: Float[np.ndarray, "s 3"]


def joined(
    samples: Sequence[Mapping[str, Float[np.ndarray, "_ 3"]]], counts: Sequence[int]
) -> dict[str, Float[np.ndarray, "s 3"]]:
    """What several samples of so many pixels have, one after the other; of means that one is without, nothing there."""
    names = dict.fromkeys(name for sample in samples for name in sample)
    nothing = [np.zeros((length, 3)) for length in counts]
    return {
        name: np.concatenate([sample.get(name, none) for sample, none in zip(samples, nothing, strict=True)])
        for name in names
    }


class Shared(NamedTuple):
    """A relative error that a picture and its reference have in common, trimmed and not."""

    trimmed: float
    untrimmed: float


def shared_error(apart: Float[np.ndarray, "s 3"], wanted: Float[np.ndarray, "s 3"]) -> Shared:
    """The error of some pixels."""
    distance, size = _squares(apart), _squares(wanted)
    if not size.any():
        return Shared(0.0, 0.0)
    alike = np.ones(len(size))
    return Shared(*(float(np.sqrt(statistic(distance, size, alike))) for statistic in (_trimmed, _untrimmed)))


def measured_error(
    radiance: Float[np.ndarray, "s 3"],
    weights: Float[np.ndarray, " s"],
    pictured: Pictured,
    exact: Mapping[str, Float[np.ndarray, "s 3"]],
    further: Mapping[str, Shared],
    divided: Mapping[str, Mapping[str, float]],
    reference: str,
    missing: tuple[str, ...] = (),
) -> PictureError:
    """The error of the whole picture, as a sample tells it.

    Args:
        radiance: of the sample's pixels.
        weights: how many of the picture's pixels each of them stands for.
        pictured: what it consists of.
        exact: radiance of the reference, by the same means.
        further: relative errors that both have, by name, added by squares.
        divided: by means that several things make other than exact, how much each of those does, in any unit.
        reference: what it is.
        missing: what is not measured.
    """
    wanted = pictured.alike + sum(exact.values(), np.zeros_like(pictured.alike))
    apart = {means: of - exact.get(means, 0 * of) for means, of in pictured.by_means.items()}
    distance, size = _squares(radiance - wanted), _squares(wanted)
    also = [sum(getattr(of, name) ** 2 for of in further.values()) for name in Shared._fields]
    keep = _kept(distance, weights) * weights
    parts: dict[str, float] = {}
    for means, of in apart.items():
        error = _ratio(float(_squares(of) @ keep), float(size @ keep))
        for name, share in _shares(divided.get(means, {means: 1.0})).items():
            parts[name] = float(np.hypot(parts.get(name, 0.0), error * share))
    return PictureError(
        trimmed=_estimate(_trimmed, distance, size, weights, also[0]),
        untrimmed=_estimate(_untrimmed, distance, size, weights, also[1]),
        parts=parts | {name: of.trimmed for name, of in further.items()},
        reference=reference,
        missing=missing,
        samples=len(size),
    )


def _shares(lengths: Mapping[str, float]) -> dict[str, float]:
    """Parts of a whole, whose squares add up to 1."""
    whole = float(np.linalg.norm(list(lengths.values())))
    return {name: length / whole if whole > 0 else 0.0 for name, length in lengths.items()}


def _squares(values: Float[np.ndarray, "s 3"]) -> Float[np.ndarray, " s"]:
    return np.sum(np.asarray(values, float) ** 2, axis=1)


def _ratio(apart: float, wanted: float) -> float:
    """A relative error of sums of squares; of nothing, none."""
    if wanted <= 0:
        return 0.0 if apart <= 0 else float("inf")
    return float(np.sqrt(apart / wanted))


def _untrimmed(
    distance: Float[np.ndarray, "*b s"], size: Float[np.ndarray, "*b s"], weights: Float[np.ndarray, "*b s"]
) -> Float[np.ndarray, "*b"]:
    """Of samples in rows, Σ distance² / Σ size²."""
    apart, whole = (np.sum(of * weights, axis=-1) for of in (distance, size))
    return np.asarray(apart / np.maximum(whole, np.finfo(float).tiny))


def _trimmed(
    distance: Float[np.ndarray, "*b s"], size: Float[np.ndarray, "*b s"], weights: Float[np.ndarray, "*b s"]
) -> Float[np.ndarray, "*b"]:
    """The same without the pixels that differ most."""
    return _untrimmed(distance, size, _kept(distance, weights) * weights)


def _kept(distance: Float[np.ndarray, "*b s"], weights: Float[np.ndarray, "*b s"]) -> Float[np.ndarray, "*b s"]:
    """The share of each pixel that is not among those that differ most, by what they stand for."""
    order = np.argsort(distance, axis=-1)
    ascending = np.take_along_axis(weights, order, -1)
    ends = np.cumsum(ascending, axis=-1)
    most = (1 - TRIM) * ends[..., -1:]
    share = np.clip((most - ends + ascending) / np.maximum(ascending, 1e-300), 0, 1)
    kept = np.empty_like(share)
    np.put_along_axis(kept, order, share, -1)
    return kept


def _estimate(statistic, distance, size, weights, also: float) -> Estimate:
    """A statistic of a sample, and its interval by drawing from the sample again (Efron's bootstrap)."""
    if not size.any():
        value = 0.0 if not distance.any() else float("inf")
        return Estimate(value, value, value)
    drawn = np.random.default_rng(0).integers(0, len(size), (_REDRAWN, len(size)))
    again = np.sqrt(statistic(distance[drawn], size[drawn], weights[drawn]) + also)
    low, high = np.quantile(again, [_TAIL, 1 - _TAIL])
    value = float(np.sqrt(statistic(distance, size, weights) + also))
    return Estimate(value, min(float(low), value), max(float(high), value))
