"""A thousand lights, and a thousand steps of gradients: nothing is compiled anew, and memory stays what it was."""

import numpy as np
import pytest

from tests.benchmarks.measuring import run_child
from tests.extremes.scenes import METHODS

STEPS = 1000


@pytest.mark.slow
@pytest.mark.parametrize("what", ["lights", "gradients"])
@pytest.mark.parametrize("method", METHODS)
def test_nothing_grows_and_nothing_is_compiled_anew(holds, method, what, tmp_path):
    told = run_child("tests.extremes.long_use", method, str(tmp_path / "store"), str(STEPS), what)
    first, last = told["values"]
    assert np.isfinite([first, last]).all()
    assert last < first if what == "gradients" else last != first
    holds(f"{method}: programs traced or compiled after two of 1,000 {what}", sum(told["counts"].values()), 0)
    held = np.array(told["held"]) / 1e6
    holds(f"{method}: MB more after 1,000 {what} than after 100", held[-1] - held[0], 5.0)
