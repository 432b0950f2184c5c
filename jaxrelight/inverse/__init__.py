"""Inverse problems: which lights or materials make given pictures or measurements.

The public names, each loaded when it is first used, as `jr.inverse.environment`:

    light       environment, InverseLight
    materials   materials, Unknown, InverseMaterials
    lamps       lamps, LuxTarget, InverseLamps
"""

from typing import Any

from jaxrelight.late_names import late_names

_HOMES = {
    "solve_light": ("environment", "InverseLight"),
    "solve_materials": ("materials", "InverseMaterials"),
    "material_unknowns": ("Unknown",),
    "solve_lamps": ("lamps", "InverseLamps"),
    "lamp_targets": ("LuxTarget",),
}
_load, __all__ = late_names("jaxrelight.inverse", _HOMES)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    return _load(name)


def __dir__() -> list[str]:
    return __all__
