"""Inverse problems: which lights or materials make given pictures or measurements.

The public names, each loaded when it is first used, as `jr.inverse.environment`:

    light       environment, InverseLight
    materials   materials, Unknown, InverseMaterials
    lamps       lamps, LuxTarget, InverseLamps
"""

import importlib
from typing import Any

_HOMES = {
    "solve_light": ("environment", "InverseLight"),
    "solve_materials": ("materials", "InverseMaterials"),
    "material_unknowns": ("Unknown",),
    "solve_lamps": ("lamps", "InverseLamps"),
    "lamp_targets": ("LuxTarget",),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}
__all__ = sorted(_HOME_OF)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module 'jaxrelight.inverse' has no attribute '{name}'")
    return getattr(importlib.import_module(f"jaxrelight.inverse.{_HOME_OF[name]}"), name)


def __dir__() -> list[str]:
    return __all__
