import pathlib
import subprocess
import sys

import pytest

_FOLDER = pathlib.Path(__file__).parent.parent / "notebooks"


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted(_FOLDER.glob("*.py")), ids=lambda path: path.name)
def test_notebook_runs_as_a_script(path):
    # Notebooks end with assertions of their own.
    subprocess.run([sys.executable, str(path)], check=True, timeout=600)
