"""Local lights as records and arrays, and back: what a store holds of them."""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jaxrelight.lights.area import Area
from jaxrelight.lights.local import Directional, Light, Point, Spot
from jaxrelight.lights.projector import Projector
from jaxrelight.lights.shaped import Shaped
from jaxrelight.lights.sky import Sky
from jaxrelight.numerics.arrays import as_array

_KINDS = {kind.__name__: kind for kind in (Point, Spot, Directional, Projector, Shaped, Area, Sky)}


def to_records(lights: Sequence[Light]) -> tuple[list[dict], dict[str, np.ndarray]]:
    """Plain records, and arrays by name; lights of a class of one's own are left out."""
    records, arrays = [], {}
    for light in (one for one in lights if type(one) in _KINDS.values()):
        record = {"type": type(light).__name__}
        for field in dataclasses.fields(light):
            value = getattr(light, field.name)
            if field.metadata.get("static"):
                record[field.name] = value
            else:
                arrays[f"{len(records)}.{field.name}"] = np.asarray(value, np.float32)
        records.append(record)
    return records, arrays


def from_records(records: Sequence[dict], read: Callable[[str], np.ndarray]) -> tuple[Light, ...]:
    """Lights that `to_records` wrote.

    Args:
        records: of the lights.
        read: an array by its name.

    Raises:
        KeyError: for a kind that is not known.
    """
    found = []
    for number, record in enumerate(records):
        kind = _KINDS[record["type"]]
        values: dict[str, Any] = {
            field.name: record[field.name] if field.metadata.get("static") else as_array(read(f"{number}.{field.name}"))
            for field in dataclasses.fields(kind)
        }
        found.append(kind(**values))
    return tuple(found)
