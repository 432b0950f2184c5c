"""Double precision end to end: pictures of both precisions, made in processes of their own."""

import os
import pathlib
import subprocess
import sys
from collections.abc import Callable

import numpy as np
import pytest

from tests.benchmarks.measuring import ROOT
from tests.extremes.pictures_by_precision import ALBEDO, ANGLE, EXPONENT, scenes
from tests.extremes.scenes import METHODS
from tests.extremes.test_materials import reflected

Pictures = dict[str, np.ndarray]
# What cube maps of 16², 256 directions of a sky and 64 samples a pixel leave of the closed forms, in any precision.
NEAR = {"pixels": 0.012, "vertices": 0.012, "indirect": 0.02, "prefiltered": 0.012, "adaptive": 0.012}
# And of a plain under a constant sky. What pixels see is held in single precision, and so are rows that are compressed.
CONSTANT = {"pixels": 2e-3, "vertices": 2e-3, "indirect": 0.02, "prefiltered": 1e-6, "adaptive": 1e-12}


@pytest.fixture(scope="module")
def pictures(tmp_path_factory) -> Callable[[str], tuple[Pictures, Pictures]]:
    """Of a method, what single and double precision give."""
    folders = [tmp_path_factory.mktemp(f"x64-{enabled}") for enabled in (0, 1)]
    for enabled, folder in enumerate(folders):
        command = [sys.executable, "-m", "tests.extremes.pictures_by_precision", str(folder)]
        environment = os.environ | {"JAX_ENABLE_X64": str(enabled)}
        done = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, check=False)
        assert done.returncode == 0, done.stderr

    def read(folder: pathlib.Path, method: str) -> Pictures:
        with np.load(folder / f"{method}.npz") as file:
            return {name: np.asarray(file[name], float) for name in file.files}

    return lambda method: (read(folders[0], method), read(folders[1], method))


@pytest.mark.slow
@pytest.mark.parametrize("scene", scenes())
@pytest.mark.parametrize("method", METHODS)
def test_both_precisions_give_the_same_picture(holds, pictures, method, scene):
    single, double = (of[scene] for of in pictures(method))
    seen = double > 0
    assert seen.any()
    holds(f"{method}: float32 against float64, {scene}", np.abs(single[seen] / double[seen] - 1).max(), 1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("scene", scenes())
@pytest.mark.parametrize("method", METHODS)
def test_double_precision_shows_what_single_precision_loses(holds, pictures, method, scene):
    single, double = (float(of[f"{scene}: change"]) for of in pictures(method))
    assert single == 0
    holds(f"{method}: a light's change by 2⁻³⁰, {scene}", abs(double - 1), 1e-3)


@pytest.mark.slow
@pytest.mark.parametrize("scene", ["constant", "half", "lobe"])
@pytest.mark.parametrize("method", METHODS)
def test_double_precision_is_no_farther_from_closed_forms(holds, pictures, method, scene):
    """albedo E / π on a plain under a whole sky of 1 and half a sky of 2, and Phong's directional albedo."""
    wanted = reflected(ALBEDO, EXPONENT, ANGLE) if scene == "lobe" else ALBEDO
    single, double = (np.abs(of[scene] / wanted - 1).max() for of in pictures(method))
    assert double <= single + 1e-6
    limit = (CONSTANT if scene == "constant" else NEAR)[method]
    holds(f"{method}: float64 against its closed form, {scene}", double, limit)
