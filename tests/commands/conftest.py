"""A folder with a scene, and a way to run commands there."""

import pathlib

import numpy as np
import pytest

from jaxrelight import write_image
from tests.commands.running import DIALS, LAMP, SCENE, run


@pytest.fixture(autouse=True)
def _cache(monkeypatch, tmp_path):
    """No test writes to the user's own cache."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))


@pytest.fixture
def folder(tmp_path, monkeypatch) -> pathlib.Path:
    """Where commands run: a scene and two skies."""
    pixels = np.random.default_rng(0).gamma(0.5, size=(8, 16, 3))
    write_image(tmp_path / "sky.exr", pixels)
    write_image(tmp_path / "other.hdr", pixels[::-1] + 1)
    (tmp_path / "scene.toml").write_text(SCENE)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture
def lit_scenes(tmp_path, monkeypatch) -> pathlib.Path:
    """Where commands run: the scene under an even sky, a lamp, both of them and neither."""
    write_image(tmp_path / "sky.exr", np.full((8, 16, 3), 0.5, np.float32))
    dark = SCENE.replace('[environment]\nfile = "sky.exr"\n', "")
    for name, text in {"sky": SCENE, "lamp": dark + LAMP, "both": SCENE + LAMP, "dark": dark}.items():
        (tmp_path / f"{name}.toml").write_text(text)
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(name="run")
def _run():
    """Runs a command in this process."""
    return run


@pytest.fixture
def made(folder, run) -> pathlib.Path:
    """A store of the scene, for vertices."""
    assert run("precompute", "scene.toml", "-o", "made", "--receivers", "vertices", *DIALS, "--json")[0] == 0
    return folder / "made"
