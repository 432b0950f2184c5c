"""Files that say what lamps are to bring about, and what of them may change.

    starts = 4                       # noise and seed, too, where not the defaults

    [[lamp]]
    light = 1                        # the number of a [[light]] of the scene
    free = ["intensity", "position"]
    box = [[-2, 2, -2], [2, 3, 2]]   # ends between which its position lies

    [[target]]
    sensor = "desk"
    mean = 500                       # lux; uniformity, min, max and values, too

In place of targets, `picture = "painted.exr"` names radiance that the scene's camera is to see, and `weight` a picture
of how much each of its pixels counts.
"""

import pathlib
from typing import Any, NamedTuple

import numpy as np

from jaxrelight.errors import InputError
from jaxrelight.files.toml_table import Table, read_toml
from jaxrelight.images.files import read_image
from jaxrelight.inverse.lamp_targets import LuxTarget


class LampTask(NamedTuple):
    """What a file asks of `lamps`.

    Attributes:
        targets: by sensors, or a picture.
        weight: of the picture's pixels; None for all alike.
        free: of lamps by their numbers from 0; None where the file has no [[lamp]].
        boxes: ends of places, by lamps.
        options: of `lamps` by their names, where they are given.
    """

    targets: dict[str, LuxTarget] | np.ndarray
    weight: np.ndarray | None
    free: dict[int, tuple[str, ...]] | None
    boxes: dict[int, np.ndarray]
    options: dict[str, Any]

    @property
    def is_of_sensors(self) -> bool:
        """Whether targets are of lux."""
        return isinstance(self.targets, dict)


def read_lamp_task(path: str | pathlib.Path) -> LampTask:
    """Reads such a file; paths in it are relative to it.

    Raises:
        InputError: for what is unknown, missing or no target, by name.
    """
    path = pathlib.Path(path)
    root = read_toml(path, "targets of lamps")
    options: dict[str, Any] = {name: root.whole(name) for name in ("starts", "seed") if root.has(name)}
    if root.has("noise"):
        options["noise"] = root.number("noise")
    if root.has("target") == root.has("picture"):
        raise InputError(f"{path}: give either [[target]] for sensors or 'picture', a file of radiance")
    weight = None
    if root.has("picture"):
        targets: Any = read_image(path.parent / root.text("picture"))
        if root.has("weight"):
            weight = np.asarray(read_image(path.parent / root.text("weight"))[..., :3].mean(axis=2), float)
    else:
        targets = {}
        for table in root.tables("target"):
            sensor, target = _target(table)
            if sensor in targets:
                raise InputError(f"{table.where}: sensor '{sensor}' has a target already; put both into one table")
            targets[sensor] = target
    free: dict[int, tuple[str, ...]] = {}
    boxes: dict[int, np.ndarray] = {}
    for table in root.tables("lamp"):
        number = table.whole("light") - 1
        if number < 0:
            raise InputError(f"{table.where}: 'light' is the number of a [[light]], from 1, not {number + 1}")
        if number in free:
            raise InputError(f"{table.where}: light {number + 1} is named already; put both into one table")
        names = table.get("free")
        if not isinstance(names, list) or not all(isinstance(name, str) for name in names):
            raise InputError(f"{table.where}: 'free' must be a list of names, such as [\"intensity\"], not {names!r}")
        free[number] = tuple(names)
        if table.has("box"):
            boxes[number] = table.array("box", (2, 3))
        table.finish()
    root.finish()
    return LampTask(targets, weight, free or None, boxes, options)


def _target(table: Table) -> tuple[str, LuxTarget]:
    sensor = table.text("sensor")
    asked: dict[str, Any] = {
        name: table.number(name) for name in ("mean", "uniformity", "min", "max") if table.has(name)
    }
    if table.has("values"):
        values = table.get("values")
        asked["values"] = table.array("values", (len(values),)) if isinstance(values, list) else values
    table.finish()
    try:
        return sensor, LuxTarget(**asked)
    except InputError as error:
        raise table.within(error) from None
