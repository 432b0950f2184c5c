"""Fits of measured reflectance that feed the kernels of jaxrelight.

The public names, each loaded when it is first used:

    one material    fit_lafortune, LafortuneFit, BrdfSamples, Grid, sample, weights
    many items      fit_lobes, Fits
    both            Options, Verdict
    blends          blended, composed, painted, uniform
    scenes          with_lobes
"""

from typing import Any

from jaxrelight.late_names import late_names

_HOMES = {
    "lafortune": ("fit_lafortune", "LafortuneFit"),
    "brdf_samples": ("BrdfSamples", "Grid", "sample"),
    "weights": ("weights",),
    "blend": ("blended", "composed", "painted", "uniform"),
    "scene_lobes": ("with_lobes",),
    "solve": ("fit_lobes", "Fits", "Options", "Verdict"),
}
_load, __all__ = late_names("fitting", _HOMES)  # pyright: ignore[reportUnsupportedDunderAll]


def __getattr__(name: str) -> Any:
    return _load(name)


def __dir__() -> list[str]:
    return __all__
