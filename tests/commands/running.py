"""What tests of the command line run, and what they expect of its output."""

import contextlib
import io
import json
import sys
from collections.abc import Callable
from unittest import mock

from jaxrelight import cli

SCENE = """
[camera]
origin = [0, 1, 3]
target = [0, 0.1, 0]
width = 12
height = 10
[environment]
file = "sky.exr"
[material.paper]
type = "lambert"
albedo = [0.5, 0.4, 0.3]
[material.gloss]
type = "phong"
diffuse = 0.1
specular = 0.3
exponent = 5
[[mesh]]
primitive = "plane"
size = [2, 2]
resolution = 3
material = "paper"
[[mesh]]
primitive = "sphere"
radius = 0.4
resolution = 3
material = "gloss"
"""
LAMP = '[[light]]\ntype = "spot"\nposition = [1, 1.2, -1.5]\ntarget = [0, 0, 0]\nintensity = 5\ncutoff = 40\n'
NO_BOUNCES = "note: transport lighting leaves out light that surfaces reflect onto each other"
DIALS = (
    "--resolution",
    "8",
    "--receiver-tolerance",
    "0",
    "--coefficients",
    "32",
    "--factor-resolution",
    "8",
    "--terms",
    "2",
)


_MEASURED = {"--json", "--error-samples", "--help", "--help-all", "-h"}


def run(*arguments, main: Callable[[], None] = cli.main) -> tuple[int, str, str]:
    """Runs a command of a program in this process: (exit status, standard output, standard error).

    Errors of pictures are measured, and pixels have several samples, where the summary is read: both compile programs
    of their own.
    """
    if arguments[:1] in (("render",), ("relight",)) and not _MEASURED.intersection(map(str, arguments)):
        arguments = (*arguments, "--error-samples", "0")
        arguments += () if "--antialiasing" in arguments else ("--antialiasing", "1")
    out, err, status = io.StringIO(), io.StringIO(), 0
    with (
        mock.patch.object(sys, "argv", ["program", *map(str, arguments)]),
        contextlib.redirect_stdout(out),
        contextlib.redirect_stderr(err),
    ):
        try:
            main()
        except SystemExit as stop:
            status = stop.code
    assert isinstance(status, int)
    return status, out.getvalue(), err.getvalue()


def summary_of(result: tuple[int, str, str]) -> dict:
    """The one JSON object that a successful command printed."""
    status, out, err = result
    assert status == 0, err
    assert len(out.splitlines()) == 1

    def refuse(constant):
        raise AssertionError(f"{constant} is not JSON")

    return json.loads(out, parse_constant=refuse)


def refusal_of(result: tuple[int, str, str], program: str = "jaxrelight", status: int = 1) -> str:
    """The one line of a command that refused its input, or with status 2 its command line."""
    ended, out, err = result
    assert ended == status
    assert out == ""
    assert err.startswith(f"{program}: ")
    assert len(err.splitlines()) == 1
    return err
