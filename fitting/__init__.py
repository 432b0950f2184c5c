"""Fits of measured reflectance that feed the kernels of jaxrelight.

The public names, each loaded when it is first used:

    one material    fit_lafortune, LafortuneFit, BrdfSamples, Grid, sample, weights
    many items      fit_lobes, Fits
    both            Options, Verdict
    blends          blended, composed, painted, uniform
    scenes          with_lobes
"""

import importlib
from typing import Any

_HOMES = {
    "lafortune": ("fit_lafortune", "LafortuneFit"),
    "brdf_samples": ("BrdfSamples", "Grid", "sample"),
    "weights": ("weights",),
    "blend": ("blended", "composed", "painted", "uniform"),
    "scene_lobes": ("with_lobes",),
    "solve": ("fit_lobes", "Fits", "Options", "Verdict"),
}
_HOME_OF = {name: home for home, names in _HOMES.items() for name in names}
__all__ = sorted(_HOME_OF)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    if name not in _HOME_OF:
        raise AttributeError(f"module 'fitting' has no attribute '{name}'")
    return getattr(importlib.import_module(f"fitting.{_HOME_OF[name]}"), name)


def __dir__() -> list[str]:
    return __all__
