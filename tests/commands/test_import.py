"""--import: modules of a user's own, before a store may need their classes."""

import sys

import pytest

from tests.commands.running import refusal_of, summary_of

OWN = "own_brdfs", "own_lights"
ARGUMENTS = {
    "render": ("none.toml", "-o", "out.exr"),
    "precompute": ("none.toml",),
    "relight": ("none", "-o", "out.exr"),
    "info": ("none",),
}


@pytest.fixture(autouse=True)
def _imports_are_forgotten(monkeypatch):
    monkeypatch.setattr(sys, "path", [path for path in sys.path if path])
    yield
    for name in OWN:
        sys.modules.pop(name, None)


def test_modules_are_imported_from_the_current_folder(folder, run):
    for name in OWN:
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
        assert f"--import {name}: {why}; it takes a Python module here or on PYTHONPATH" in message
