import os
import pathlib
import subprocess
import sys

import pytest

_FOLDER = pathlib.Path(__file__).parent.parent / "notebooks"


@pytest.mark.slow
@pytest.mark.parametrize("path", sorted(_FOLDER.glob("*.py")), ids=lambda path: path.name)
def test_notebook_runs_as_a_script(path):
    # Notebooks end with assertions of their own. They are of this checkout, whatever is installed; SHORT makes pictures
    # small where a notebook takes long.
    environment = {**os.environ, "PYTHONPATH": str(_FOLDER.parent), "SHORT": "1"}
    subprocess.run([sys.executable, str(path)], check=True, timeout=600, env=environment)
