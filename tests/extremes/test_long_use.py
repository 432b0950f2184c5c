"""A thousand lights, and a thousand steps of gradients: nothing is compiled anew, and memory stays what it was."""

import numpy as np
import pytest

from tests.benchmarks.measuring import run_child
from tests.extremes.scenes import METHODS

STEPS = 1000
# The allocator gives back what is free: otherwise gaps of tens of megabytes, others in each run, are counted.
ALLOCATOR = {"MALLOC_ARENA_MAX": "1", "MALLOC_MMAP_THRESHOLD_": "65536"}


@pytest.mark.slow
@pytest.mark.parametrize("what", ["lights", "gradients"])
@pytest.mark.parametrize("method", METHODS)
def test_nothing_grows_and_nothing_is_compiled_anew(holds, method, what, tmp_path):
    told = run_child("tests.extremes.long_use", method, str(tmp_path / "store"), str(STEPS), what, variables=ALLOCATOR)
    first, last = told["values"]
    assert np.isfinite([first, last]).all()
    assert last < first if what == "gradients" else last != first
    holds(f"{method}: programs traced or compiled after two of 1,000 {what}", sum(told["counts"].values()), 0)
    early, late = told["held"][0], told["held"][-1]
    more = {of: late[of] - early[of] for of in early}
    holds(f"{method}: bytes of arrays more after 1,000 {what} than after 100", more["arrays"], 0)
    holds(f"{method}: objects more for each of 900 {what}", more["objects"] / 900, 20)
    holds(f"{method}: MB more after 1,000 {what} than after 100", more["resident"] / 1e6, 5)
