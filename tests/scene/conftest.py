"""The folder of a scene file."""

import pathlib

import numpy as np
import pytest

from jaxrelight import write_image


@pytest.fixture
def folder(tmp_path: pathlib.Path) -> pathlib.Path:
    write_image(tmp_path / "sky.exr", np.ones((4, 8, 3)))
    return tmp_path
