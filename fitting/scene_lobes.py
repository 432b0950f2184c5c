"""Lobes in place of a scene's other BRDFs, so that they are lit as lobes are: by filtered light, from any view."""

import dataclasses
import hashlib
import json
import pathlib

import numpy as np

from fitting.lafortune import ALBEDO_TOLERANCE, fit_lafortune
from fitting.solve import Options, Verdict
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.files.fitted import read_fitted, write_lobes
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.material import Material, as_material, has_lobes
from jaxrelight.brdf.record import to_record
from jaxrelight.brdf.separable import Separable
from jaxrelight.errors import InputError
from jaxrelight.files import store
from jaxrelight.progress import Report
from jaxrelight.scene.scene import Scene

# What is fitted: as many lobes as a fit has at most.
_OPTIONS = Options(lobes=3)


def with_lobes(scene: Scene, report: Report | None = None) -> tuple[Scene, tuple[str, ...]]:
    """The scene with Lafortune lobes in place of BRDFs that are neither lobes nor given as factors.

    Measured and Ashikhmin–Shirley BRDFs are fitted by `fit_lafortune`, once: fits are kept in the user's cache folder
    by the content of what they were fitted to.

    Args:
        scene: any.
        report: called with the progress of fits.

    Returns:
        The scene, and a line on each fit with its error and verdict.
    """
    materials, lines = dict(scene.materials), []
    for name in sorted({part.material for part in scene.parts}):
        if name not in materials:
            continue
        material = as_material(materials[name])
        fitted = [_is_fitted(component.brdf) for component in material.components]
        if not any(fitted):
            continue
        components = []
        for component, is_fitted in zip(material.components, fitted, strict=True):
            brdf = component.brdf
            if is_fitted and isinstance(brdf, Brdf):
                if report is not None:
                    report(f"lobes of {name}", 0, 1)
                lobes, account = _lobes(brdf)
                lines.append(f"{name}: {account}")
                component = dataclasses.replace(component, brdf=lobes)
                if report is not None:
                    report(f"lobes of {name}", 1, 1)
            components.append(component)
        materials[name] = dataclasses.replace(material, components=tuple(components))
        if not isinstance(scene.materials[name], Material) and len(components) == 1:
            materials[name] = components[0].brdf
    return dataclasses.replace(scene, materials=materials), tuple(lines)


def _is_fitted(brdf: object) -> bool:
    """Whether lobes are to stand for a BRDF."""
    is_lobes = isinstance(brdf, LobeSum) or has_lobes(brdf)  # pyright: ignore[reportArgumentType]
    return isinstance(brdf, Brdf) and not (is_lobes or brdf.is_constant or isinstance(brdf, Separable))


def _lobes(brdf: Brdf) -> tuple[LobeSum, str]:
    """Lobes of a BRDF and their account, fitted now or before."""

    def digest(array: np.ndarray) -> str:
        return hashlib.sha256(np.ascontiguousarray(array).data).hexdigest()

    # The account holds a verdict: a fit that was kept is judged by the same ones.
    judged = *dataclasses.astuple(_OPTIONS), *(str(verdict) for verdict in Verdict), ALBEDO_TOLERANCE
    key = store.key_of(json.dumps(to_record(brdf, digest), sort_keys=True), judged)
    path = store.default_folder("fits") / f"lobes-{key}.toml"
    try:
        lobes = read_fitted(path)
        assert isinstance(lobes, LobeSum)
        return lobes, path.read_text(encoding="utf-8").splitlines()[0].removeprefix("# ")
    except (InputError, OSError, IndexError):
        fit = fit_lafortune(brdf, _OPTIONS)
    account = (
        f"{_OPTIONS.lobes} fitted lobes stand for its BRDF; they are {fit.residual:.1%} off ({fit.held_out:.1%} where "
        f"not fitted), {str(fit.verdict).replace('_', ' ')}"
    )
    _keep(path, fit.brdf, account)
    return fit.brdf, account


def _keep(path: pathlib.Path, lobes: LobeSum, account: str) -> None:
    """Keeps a fit for the next time, where there is a place for it."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_lobes(path, lobes, [account])
    except (InputError, OSError):
        return
