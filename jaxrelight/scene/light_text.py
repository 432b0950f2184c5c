"""Local lights as scene files write them: what was found or moved in Python, for commands to read again."""

import json
from collections.abc import Sequence
from typing import Any

import numpy as np

from jaxrelight.errors import InputError
from jaxrelight.lights.area import Area
from jaxrelight.lights.local import Directional, Light, Point, Spot
from jaxrelight.lights.shaped import Shaped

# The fields of each class that files have under the same names.
_FIELDS: dict[type, tuple[str, ...]] = {
    Point: ("position", "intensity"),
    Spot: ("position", "target", "intensity", "cutoff", "beam"),
    Directional: ("direction", "irradiance"),
    Area: ("centre", "u", "v", "radiance", "samples"),
    Shaped: (
        *("position", "target", "up", "intensity", "inner", "outer", "roundness", "near", "far", "falloff"),
        "reference",
    ),
}


def check_writable_lights(lights: Sequence[Light]) -> None:
    """Refuses lights that `lights_text` cannot write.

    Raises:
        InputError: for the first of them, by its number.
    """
    for number, light in enumerate(lights, 1):
        if type(light) not in _FIELDS:
            known = ", ".join(kind.__name__.lower() for kind in _FIELDS)
            raise InputError(
                f"light {number} is a {type(light).__name__}, which a scene file is not written of; known are {known}"
            )


def lights_text(lights: Sequence[Light]) -> str:
    """A [[light]] for each light, as TOML.

    Raises:
        InputError: for a class that it cannot write.
    """
    check_writable_lights(lights)
    tables = []
    for light in lights:
        lines = ["[[light]]", f'type = "{type(light).__name__.lower()}"']
        for name in _FIELDS[type(light)]:
            value = np.asarray(getattr(light, name))
            # Ends that are not given are infinite, which files say by leaving them out.
            if np.isfinite(value).all():
                lines.append(f"{name} = {json.dumps(_plain(value))}")
        tables.append("\n".join(lines) + "\n")
    return "\n".join(tables)


def _plain(value: np.ndarray) -> Any:
    """Numbers with as many digits as single precision has, and positions with twice as many."""
    digits = 9 if value.dtype == np.float32 else 17
    plain = [float(f"{number:.{digits}g}") for number in value.ravel()] if value.dtype.kind == "f" else value.tolist()
    return plain if value.ndim or value.dtype.kind != "f" else plain[0]
