"""Every broken scene, and every wrong command, ends with one line that says what to do, and leaves nothing behind."""

import pathlib
import shutil

import pytest

from jaxrelight import load_scene
from tests.faults import scenes


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> pathlib.Path:
    made = tmp_path_factory.mktemp("scenes")
    scenes.prepare(made)
    return made


@pytest.mark.slow
def test_the_sound_scene_is_rendered(folder):
    assert not scenes.wrong_with_sound(folder)
    (folder / "out.exr").unlink()
    shutil.rmtree(folder / "made")


@pytest.mark.parametrize("name", scenes.FAULTS)
def test_fault(folder, name: str):
    assert not scenes.wrong_with(scenes.FAULTS[name], folder)


@pytest.mark.parametrize("line", scenes.WRONG)
def test_wrong_command(folder, line: str):
    assert not scenes.wrong_with_command(line, folder)


def test_what_is_wrong_is_called_so(folder):
    """A scene without a fault, and faults that are told with other words."""
    sound = scenes.Fault("width = 8", "width = 8 ", ("x",))
    assert scenes.wrong_with(sound, folder) == "left made, out.exr"
    (folder / "out.exr").unlink()
    shutil.rmtree(folder / "made")
    other = scenes.FAULTS["width 0"]._replace(says=("height",))
    assert "['height'] is not said in" in scenes.wrong_with(other, folder)


def test_byte_order_marks_are_no_fault(folder):
    (folder / "marked.toml").write_bytes(b"\xef\xbb\xbf" + scenes.SCENE.encode())
    assert load_scene(folder / "marked.toml").camera.width == 8
    (folder / "marked.toml").unlink()
