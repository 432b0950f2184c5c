"""--import: modules of a user's own, before a store may need their classes."""

import importlib
import sys

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.files import class_record
from tests.commands.running import refusal_of, summary_of

OWN = "own_brdfs", "own_lights", "dim_lights"
DIM = """
from jaxrelight import Incident, Light, Punctual

class Dim(Punctual):
    lamp: Light

    def at(self, positions) -> Incident:
        incident = self.lamp.at(positions)
        return incident._replace(irradiance=incident.irradiance / 2)
"""
ARGUMENTS = {
    "render": ("none.toml", "-o", "out.exr"),
    "precompute": ("none.toml",),
    "relight": ("none", "-o", "out.exr"),
    "info": ("none",),
}


@pytest.fixture(autouse=True)
def _imports_are_forgotten(monkeypatch):
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])
    monkeypatch.setattr(class_record, "_seen", {})
    for name in OWN:
        sys.modules.pop(name, None)
    yield
    for name in OWN:
        sys.modules.pop(name, None)


def test_modules_are_imported_from_the_current_folder(folder, run):
    for name in OWN[:2]:
        (folder / f"{name}.py").write_text(f"import pathlib\npathlib.Path('{name} was here').touch()\n")
    summary_of(run("info", "scene.toml", "--import", "own_brdfs", "--import", "own_lights", "--json"))
    assert {path.name for path in folder.glob("* was here")} == {"own_brdfs was here", "own_lights was here"}


@pytest.mark.parametrize("command", ARGUMENTS)
def test_what_cannot_be_imported_is_refused_before_anything_is_opened(folder, run, command: str):
    (folder / "broken.py").write_text("import math\nmath.no_such_thing\n")
    for name, why in (
        ("no_such_module", "No module named 'no_such_module'"),
        ("broken", "module 'math' has no attribute 'no_such_thing'"),
    ):
        message = refusal_of(run(command, *ARGUMENTS[command], "--import", name))
        assert f"the module '{name}' cannot be imported ({why}); mend it, or check its name and PYTHONPATH" in message


def test_a_store_with_a_light_of_ones_own_is_relit(folder, run, monkeypatch):
    """Which is half of the light inside of it."""
    (folder / "dim_lights.py").write_text(DIM)
    lamp = '[[light]]\ntype = "point"\nposition = [0.5, 1, 0.5]\nintensity = 2\n'
    (folder / "lamp.toml").write_text(lamp)
    monkeypatch.syspath_prepend(folder)
    dim = importlib.import_module("dim_lights").Dim(jr.point([0.5, 1, 0.5], 2.0))
    camera = jr.Camera((0, 1, 2), (0, 0, 0), width=8, height=6)
    scene = jr.Scene([jr.Part(jr.plane((2, 2), 2), "grey")], {"grey": jr.lambert([0.5, 0.5, 0.5])}, camera, lights=dim)
    jr.prepare(scene, jr.Transport(resolution=4), "made")
    sys.modules.pop("dim_lights")
    class_record._seen.clear()
    arguments = "relight", "made", "-o", "out.exr", "--json"
    assert "on the command line by --import dim_lights" in refusal_of(run(*arguments))
    summary_of(run(*arguments, "--import", "dim_lights"))
    pictures = [jr.read_image("out.exr")]
    summary_of(run(*arguments, "--import", "dim_lights", "--lights", "lamp.toml"))
    pictures.append(jr.read_image("out.exr"))
    np.testing.assert_allclose(pictures[0][..., :3], pictures[1][..., :3] / 2, rtol=1e-5)
    assert pictures[0].max() > 0.1
