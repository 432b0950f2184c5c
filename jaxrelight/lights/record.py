"""Local lights as records and arrays, and back: what a store holds of them.

Lights of the package go by short names. Those of a class of one's own go by its module and name, and come back where
that module is imported, or where the class was given to `register`; see `jaxrelight.files.class_record`.
"""

import dataclasses
from collections.abc import Callable, Sequence
from typing import Any

import numpy as np

from jaxrelight.files.class_record import (
    find_class,
    from_fields,
    import_classes,
    qualified_name,
    register,
    restored,
    to_fields,
)
from jaxrelight.lights.area import Area
from jaxrelight.lights.local import Directional, Light, Point, Spot
from jaxrelight.lights.projector import Projector
from jaxrelight.lights.shaped import Shaped
from jaxrelight.lights.sky import Sky

__all__ = ["from_records", "import_classes", "register", "to_records"]

_KINDS = {kind.__name__: kind for kind in (Point, Spot, Directional, Projector, Shaped, Area, Sky)}


def to_records(lights: Sequence[Light], what: str = "the scene's") -> tuple[list[dict], dict[str, np.ndarray]]:
    """Plain records, and arrays by name.

    Args:
        lights: of any classes.
        what: whose lights messages say that they are.

    Raises:
        InputError: if a class of one's own has fields that records and arrays cannot hold.
    """
    records: list[dict] = []
    arrays: dict[str, np.ndarray] = {}
    for number, light in enumerate(lights):
        kind = type(light)
        if _KINDS.get(kind.__name__) is not kind:
            fields, own = to_fields(light, f"{what} light {number + 1}")
            records.append({"type": qualified_name(kind), "fields": fields})
            arrays |= {f"{number}.{name}": array for name, array in own.items()}
            continue
        record = {"type": kind.__name__}
        for field in dataclasses.fields(light):
            value = getattr(light, field.name)
            if field.metadata.get("static"):
                record[field.name] = value
            else:
                arrays[f"{number}.{field.name}"] = np.asarray(value)
        records.append(record)
    return records, arrays


def from_records(
    records: Sequence[dict], read: Callable[[str], np.ndarray], what: str = "the store's"
) -> tuple[Light, ...]:
    """Lights that `to_records` wrote.

    Args:
        records: of the lights.
        read: an array by its name.
        what: whose lights messages say that they are.

    Raises:
        InputError: if a light's class is not known, see `jaxrelight.files.class_record`, or has other fields now.
    """
    lights = []
    for number, record in enumerate(records):

        def own(name: str, number: int = number) -> np.ndarray:
            return read(f"{number}.{name}")

        if record["type"] not in _KINDS:
            called = f"{what} light {number + 1}"
            lights.append(from_fields(find_class(record["type"], Light, called), record["fields"], own, called))
            continue
        kind = _KINDS[record["type"]]
        values: dict[str, Any] = {
            field.name: record[field.name] if field.metadata.get("static") else restored(own(field.name), field)
            for field in dataclasses.fields(kind)
        }
        lights.append(kind(**values))
    return tuple(lights)
