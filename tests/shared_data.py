"""Where tests find the data that lies beside the project and is not part of it."""

import os
from pathlib import Path

import pytest


def shared(*parts: str) -> Path:
    """Path below the shared folder: `$JAXRELIGHT_SHARED`, else `../shared` beside the repository.

    Skips the test where the file is absent, fails it there on CI.
    """
    root = os.environ.get("JAXRELIGHT_SHARED") or Path(__file__).resolve().parents[2] / "shared"
    path = Path(root, *parts)
    if path.exists():
        return path
    reason = f"{path} is absent; set JAXRELIGHT_SHARED to the shared data folder"
    if os.environ.get("CI"):
        pytest.fail(reason)
    pytest.skip(reason)
