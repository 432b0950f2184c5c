"""Sensors: places at which light is measured, and what takes the place of a camera where they are looked at."""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxrelight.errors import InputError
from jaxrelight.geometry.camera import MAX_PIXELS

Triple = Sequence[float] | Float[np.ndarray, "3"]


@dataclasses.dataclass(frozen=True)
class Sensor:
    """Points that measure the light that arrives on one side of a small plane at each of them.

    No ray hits a sensor, and it casts no shadow.

    Attributes:
        name: what tables and targets call it.
        points: in the world; on a surface, or in the air.
        normal: of the planes, which measure what arrives from this side; of any length.
    """

    name: str
    points: Sequence[Triple] | Float[np.ndarray, "n 3"]
    normal: Triple = (0.0, 1.0, 0.0)

    def __post_init__(self) -> None:
        if not self.name:
            raise InputError("a sensor has no name; give it one")
        points = _numbers(self.name, "points", self.points)
        if points.ndim != 2 or points.shape[1] != 3 or not len(points):
            raise InputError(f"sensor '{self.name}': points must be a list of at least one [x, y, z]")
        normal = _vector(self.name, "normal", self.normal)
        length = np.linalg.norm(normal)
        if not length > 0:
            raise InputError(f"sensor '{self.name}': its normal is the zero vector; say which way it looks")
        # Equal sensors are equal, whatever sequences they were made from.
        object.__setattr__(self, "points", tuple(map(tuple, points.tolist())))
        object.__setattr__(self, "normal", tuple((normal / length).tolist()))

    @property
    def count(self) -> int:
        """The number of its points."""
        return len(self.points)


def sensor_grid(
    name: str,
    origin: Triple,
    u: Triple,
    v: Triple,
    columns: int,
    rows: int,
    normal: Triple = (0.0, 1.0, 0.0),
) -> Sensor:
    """A sensor whose points are the centres of the cells of a parallelogram, row by row.

    Args:
        name: of the sensor.
        origin: a corner of the parallelogram.
        u: its edge along a row.
        v: its other edge.
        columns: cells of a row.
        rows: of cells.
        normal: see `Sensor`.

    Raises:
        InputError: for numbers that are not finite, or no whole numbers of cells.
    """
    for what, cells in (("columns", columns), ("rows", rows)):
        if not isinstance(cells, int) or isinstance(cells, bool) or not 1 <= cells <= MAX_PIXELS:
            raise InputError(f"sensor '{name}': {what} must be a whole number from 1, not {cells!r}")
    if columns * rows > MAX_PIXELS:
        raise InputError(f"sensor '{name}': has {columns * rows:,} points; it may have at most {MAX_PIXELS:,}")
    corner, across, along = (_vector(name, what, one) for what, one in (("origin", origin), ("u", u), ("v", v)))
    x, y = (np.arange(columns) + 0.5) / columns, (np.arange(rows) + 0.5) / rows
    points = corner[None, None] + x[None, :, None] * across[None, None] + y[:, None, None] * along[None, None]
    return Sensor(name, points.reshape(-1, 3), normal)


@dataclasses.dataclass(frozen=True)
class Sensors:
    """All sensors of a scene as what is looked at, in place of a camera: a picture of one row, a pixel for each point.

    Attributes:
        each: at least one, of different names.
    """

    each: tuple[Sensor, ...]

    def __post_init__(self) -> None:
        if not self.each:
            raise InputError("the scene has no sensor; add a [[sensor]], or Scene(…, sensors=[…])")
        names = [sensor.name for sensor in self.each]
        twice = next((name for name in names if names.count(name) > 1), None)
        if twice is not None:
            raise InputError(f"two sensors are called '{twice}'; give them different names")

    @functools.cached_property
    def positions(self) -> Float[np.ndarray, "n 3"]:
        """Of all points in the world, sensor after sensor."""
        return np.concatenate([np.asarray(sensor.points, float) for sensor in self.each])

    @functools.cached_property
    def normals(self) -> Float[np.ndarray, "n 3"]:
        """Unit normals of all points."""
        return np.concatenate([np.broadcast_to(np.asarray(one.normal, float), (one.count, 3)) for one in self.each])

    @functools.cached_property
    def slices(self) -> dict[str, slice]:
        """The points of each sensor among all, by its name."""
        ends = np.cumsum([sensor.count for sensor in self.each])
        return {one.name: slice(int(end) - one.count, int(end)) for one, end in zip(self.each, ends, strict=True)}

    @property
    def width(self) -> int:
        """Points of all sensors."""
        return sum(sensor.count for sensor in self.each)

    @property
    def height(self) -> int:
        """They make a single row."""
        return 1

    def solid_angles(self) -> Float[np.ndarray, "h w"]:
        """Steradians from which each point receives light: a hemisphere."""
        return np.full((1, self.width), 2 * np.pi)


def sensors_of(record: dict) -> Sensors:
    """What `dataclasses.asdict` made a record of.

    Raises:
        InputError: for a damaged one.
    """
    return Sensors(tuple(Sensor(**one) for one in record["each"]))


def _numbers(name: str, what: str, values: Sequence | np.ndarray) -> np.ndarray:
    try:
        numbers = np.asarray(values, float)
    except (TypeError, ValueError):
        raise InputError(f"sensor '{name}': {what} must be numbers, not {values!r}") from None
    if not np.isfinite(numbers).all():
        raise InputError(f"sensor '{name}': {what} must be finite numbers")
    return numbers


def _vector(name: str, what: str, values: Triple) -> Float[np.ndarray, "3"]:
    numbers = _numbers(name, what, values)
    if numbers.shape != (3,):
        raise InputError(f"sensor '{name}': {what} must be three numbers, not {values!r}")
    return numbers
