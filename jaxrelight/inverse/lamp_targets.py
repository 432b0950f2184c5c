"""What lamps are to bring about: illuminance at sensors, or a picture; and how far off they are."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.errors import InputError
from jaxrelight.geometry.sensors import Sensors
from jaxrelight.numerics.arrays import as_array

# Values below this share of a sensor's largest target count as if they were that.
_MIN_SHARE = 0.01


@dataclasses.dataclass(frozen=True)
class LuxTarget:
    """What the illuminance at the points of one sensor is to be, in lux; what is None does not matter.

    Attributes:
        mean: of all points.
        uniformity: the least illuminance over the mean, at least: 0 … 1.
        min: at least, at every point.
        max: at most, at every point.
        values: at each point.
    """

    mean: float | None = None
    uniformity: float | None = None
    min: float | None = None
    max: float | None = None
    values: Sequence[float] | Float[np.ndarray, " n"] | None = None

    def __post_init__(self) -> None:
        asked = {field.name: getattr(self, field.name) for field in dataclasses.fields(self)}
        if all(value is None for value in asked.values()):
            raise InputError("a target of lux asks for nothing; give it mean, uniformity, min, max or values")
        for name in ("mean", "min", "max"):
            if asked[name] is not None and not (_is_number(asked[name]) and asked[name] > 0):
                raise InputError(f"a target's {name} must be a number of lux above 0, not {asked[name]!r}")
        if self.uniformity is not None and not (_is_number(self.uniformity) and 0 < self.uniformity <= 1):
            raise InputError(f"a target's uniformity must lie between 0 and 1, not {self.uniformity!r}")
        for low, high in (("min", "max"), ("min", "mean"), ("mean", "max")):
            if asked[low] is not None and asked[high] is not None and asked[low] > asked[high]:
                raise InputError(f"a target's {low} of {asked[low]:g} lux is above its {high} of {asked[high]:g} lux")


class TargetFit(NamedTuple):
    """One target, and what was found of it.

    Attributes:
        what: the sensor, or "picture", and what is asked of it.
        target: in lux; for uniformity a share; for a picture 0.
        found: of the same; for a picture the relative L2 difference.
        error: how far off it is, relative to the target; 0 where a bound is kept.
    """

    what: str
    target: float
    found: float
    error: float


class LuxTargets(eqx.Module):
    """Targets of all sensors; arrays over the n points of all sensors, or over the s sensors that have targets.

    Attributes:
        share: what each point counts in the mean of each sensor.
        own: which sensor's mean a point belongs to, as rows of ones.
        mean: of sensors; 0 for none.
        uniformity: of each point's sensor; 0 for none.
        low: of each point; 0 for none.
        high: of each point; infinite for none.
        value: of each point; 0 for none.
        scale: lux in which the error of a value is counted.
    """

    share: Float[Array, "s n"]
    own: Float[Array, "n s"]
    mean: Float[Array, " s"]
    uniformity: Float[Array, " n"]
    low: Float[Array, " n"]
    high: Float[Array, " n"]
    value: Float[Array, " n"]
    scale: Float[Array, " n"]

    def residual(self, lux: Float[Array, " n"]) -> Float[Array, " r"]:
        """Relative errors of means and values, and of bounds by how much they are crossed; 0 where nothing is asked."""
        means = jnp.matmul(self.share, lux, precision="highest")
        own = jnp.matmul(self.own, means, precision="highest")
        of_mean = jnp.where(self.mean > 0, means / jnp.where(self.mean > 0, self.mean, 1) - 1, 0)
        of_value = jnp.where(self.value > 0, (lux - self.value) / self.scale, 0)
        below = 1 - lux / jnp.where(self.low > 0, self.low, 1)
        above = lux / jnp.where(jnp.isfinite(self.high), self.high, 1) - 1
        uneven = self.uniformity - lux / jnp.maximum(own, 1e-12)
        crossed = (
            jnp.where((self.low > 0) & (below > 0), below, 0),
            jnp.where(jnp.isfinite(self.high) & (above > 0), above, 0),
            jnp.where((self.uniformity > 0) & (uneven > 0), uneven, 0),
        )
        return jnp.concatenate([of_mean, of_value, *crossed])

    def linear(self) -> tuple[Float[np.ndarray, "r n"], Float[np.ndarray, " r"]]:
        """Rows whose product with the lux of all points is to be given numbers: what brightnesses start from.

        Lower bounds count as targets a fifth above them, upper ones as a fifth below, where a point has no other.
        """
        share, value = np.asarray(self.share, float), np.asarray(self.value, float)
        low, high = np.asarray(self.low, float), np.asarray(self.high, float)
        rows, wanted = [], []
        for number, mean in enumerate(np.asarray(self.mean, float)):
            if mean > 0:
                rows.append(share[number] / mean)
                wanted.append(1.0)
        has_mean = (np.asarray(self.own) * np.asarray(self.mean)).any(axis=1)
        aims = np.where(value > 0, value, np.where(has_mean, 0, np.where(low > 0, 1.2 * low, 0)))
        aims = np.where((aims == 0) & ~has_mean & np.isfinite(high), 0.8 * high, aims)
        for point in np.flatnonzero(aims > 0):
            rows.append(np.eye(len(aims))[point] / aims[point])
            wanted.append(1.0)
        return np.reshape(rows, (-1, len(aims))), np.asarray(wanted)

    def deviation(self, noise: float) -> float:
        """The standard deviation of each residual, where targets are known to a share of themselves."""
        return noise


class PictureTarget(eqx.Module):
    """A picture that is to be met.

    Attributes:
        picture: radiance of every pixel and channel, one after the other.
        weight: of the same, from 0; their squares sum to one over the picture's mean square.
    """

    picture: Float[Array, " m"]
    weight: Float[Array, " m"]

    def residual(self, radiance: Float[Array, " m"]) -> Float[Array, " m"]:
        """Differences, whose length is the relative L2 difference."""
        return self.weight * (radiance - self.picture)

    def linear(self) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, " m"]]:
        """The weights of radiance, and what weighted radiance is to be."""
        weight = np.asarray(self.weight, float)
        return weight, weight * np.asarray(self.picture, float)

    def deviation(self, noise: float) -> float:
        """As of `LuxTargets`: of a share of the picture's root mean square in each pixel."""
        return noise / math.sqrt(max(int(np.count_nonzero(np.asarray(self.weight))), 1))


def lux_targets(targets: Mapping[str, LuxTarget], sensors: Sensors) -> LuxTargets:
    """Targets by the names of sensors as arrays.

    Raises:
        InputError: for no target, a sensor that there is not, or values of another number than it has points.
    """
    if not targets:
        raise InputError("no sensor has a target; give at least one")
    count, names = sensors.width, list(targets)
    share, mean = np.zeros((len(names), count)), np.zeros(len(names))
    uniformity, low, value, scale = (np.zeros(count) for _ in range(4))
    high = np.full(count, np.inf)
    for number, (name, target) in enumerate(targets.items()):
        if name not in sensors.slices:
            raise InputError(f"there is no sensor '{name}' for a target; there are {', '.join(sensors.slices)}")
        rows = sensors.slices[name]
        points = rows.stop - rows.start
        share[number, rows] = 1 / points
        mean[number] = target.mean or 0
        uniformity[rows], low[rows] = target.uniformity or 0, target.min or 0
        high[rows] = np.inf if target.max is None else target.max
        if target.values is not None:
            value[rows] = _values(name, target.values, points)
            scale[rows] = np.maximum(value[rows], _MIN_SHARE * value[rows].max())
    arrays = share, (share > 0).T * 1.0, mean, uniformity, low, high, value, np.where(scale > 0, scale, 1)
    return LuxTargets(*(as_array(array, np.float32) for array in arrays))


def picture_target(
    picture: Any, shape: tuple[int, int], weight: Float[np.ndarray, "h w"] | None = None
) -> PictureTarget:
    """A picture as a target.

    Args:
        picture: radiance, and maybe alpha, which is a weight.
        shape: height and width that it must have.
        weight: of each pixel, from 0; by default the same of all that have alpha.

    Raises:
        InputError: for another shape, numbers that are not finite, or a picture that is black where it counts.
    """
    pixels = np.asarray(picture, float)
    if pixels.ndim != 3 or pixels.shape[:2] != shape or pixels.shape[2] not in (3, 4):
        raise InputError(
            f"the target is a picture of {' × '.join(map(str, pixels.shape))}; it must be {shape[0]} × {shape[1]} × 3, "
            "as the camera's is"
        )
    of_pixels = np.ones(shape) if weight is None else np.asarray(weight, float)
    if of_pixels.shape != shape or not (np.isfinite(of_pixels) & (of_pixels >= 0)).all():
        raise InputError(f"weights of a target must be {shape[0]} × {shape[1]} finite numbers, none negative")
    if pixels.shape[2] == 4:
        of_pixels, pixels = of_pixels * pixels[..., 3], pixels[..., :3]
    counted = np.repeat(of_pixels[..., None], 3, axis=2)
    if not np.isfinite(pixels[counted > 0]).all():
        raise InputError("the target picture has pixels that are not finite; mask them with a weight of 0")
    length = np.linalg.norm(np.where(counted > 0, counted * pixels, 0))
    if not length > 0:
        raise InputError("the target picture is black where it counts; paint what the lamps are to light")
    radiance = np.where(counted > 0, pixels, 0)
    return PictureTarget(as_array(radiance.ravel(), np.float32), as_array((counted / length).ravel(), np.float32))


def fits_of(targets: Mapping[str, LuxTarget], sensors: Sensors, lux: Float[np.ndarray, " n"]) -> tuple[TargetFit, ...]:
    """What was found of every target, one after the other."""
    fits = []
    for name, target in targets.items():
        own = np.asarray(lux, float)[sensors.slices[name]]
        mean = float(own.mean())
        if target.mean is not None:
            fits.append(TargetFit(f"{name}: mean", target.mean, mean, mean / target.mean - 1))
        if target.uniformity is not None:
            found = float(own.min()) / mean if mean > 0 else 0.0
            fits.append(
                TargetFit(f"{name}: uniformity", target.uniformity, found, min(found / target.uniformity - 1, 0))
            )
        if target.min is not None:
            least = float(own.min())
            fits.append(TargetFit(f"{name}: min", target.min, least, min(least / target.min - 1, 0.0)))
        if target.max is not None:
            most = float(own.max())
            fits.append(TargetFit(f"{name}: max", target.max, most, max(most / target.max - 1, 0.0)))
        if target.values is not None:
            values = np.asarray(target.values, float)
            scale = np.maximum(values, _MIN_SHARE * values.max())
            for number, (wanted, found, of) in enumerate(zip(values, own, scale, strict=True), 1):
                point = "" if len(values) == 1 else f" point {number}"
                fits.append(
                    TargetFit(f"{name}{point}: value", float(wanted), float(found), float((found - wanted) / of))
                )
    return tuple(fits)


def _values(name: str, values: Any, points: int) -> Float[np.ndarray, " n"]:
    try:
        numbers = np.asarray(values, float)
    except (TypeError, ValueError):
        raise InputError(f"the target of '{name}': values must be numbers, not {values!r}") from None
    if numbers.shape != (points,) or not (np.isfinite(numbers) & (numbers > 0)).all():
        raise InputError(f"the target of '{name}': values must be {points} numbers of lux above 0, one for each point")
    return numbers


def _is_number(value: Any) -> bool:
    return isinstance(value, int | float | np.number) and not isinstance(value, bool) and math.isfinite(value)
