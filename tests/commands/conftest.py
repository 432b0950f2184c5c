"""A folder with a scene, and a way to run commands there."""

import pathlib
import sys

import numpy as np
import pytest

from jaxrelight import cli, write_image
from tests.commands.running import DIALS, SCENE


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
def run(monkeypatch, capsys):
    """Runs a command in this process: (exit status, standard output, standard error)."""

    def call(*arguments) -> tuple[int, str, str]:
        monkeypatch.setattr(sys, "argv", ["jaxrelight", *map(str, arguments)])
        status = 0
        try:
            cli.main()
        except SystemExit as stop:
            status = stop.code
        captured = capsys.readouterr()
        assert isinstance(status, int)
        return status, captured.out, captured.err

    return call


@pytest.fixture
def made(folder, run) -> pathlib.Path:
    """A store of the scene, for vertices."""
    assert run("precompute", "scene.toml", "-o", "made", *DIALS, "--json")[0] == 0
    return folder / "made"
