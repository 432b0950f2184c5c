"""Every benchmark program runs to its end: small trials, whose figures are not looked at."""

import subprocess
import sys

import pytest

from tests.benchmarks.all import PROGRAMS
from tests.benchmarks.measuring import ROOT
from tests.shared_data import shared


@pytest.mark.slow
@pytest.mark.parametrize("name", PROGRAMS)
def test_a_trial_ends_well(name):
    shared("data")
    command = [sys.executable, "-m", f"tests.benchmarks.{name}", "--quick"]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
    assert "|" in done.stdout
