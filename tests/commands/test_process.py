"""Commands as processes: typing errors, interruptions, readers that have gone, and output that is no terminal."""

import os
import pathlib
import pty
import select
import signal
import subprocess
import sys

import pytest

from jaxrelight import cli
from jaxrelight import progress as bars
from tests.commands.running import DIALS

# Interrupts are ignored in what a shell started in the background; here they must count.
PROGRAM = """
import signal
signal.signal(signal.SIGINT, signal.default_int_handler)
from jaxrelight.cli import main
main()
"""
COMMAND = [sys.executable, "-c", PROGRAM]
ENVIRONMENT = {**os.environ, "PYTHONPATH": str(pathlib.Path(cli.__file__).parents[1])}


def _process(*arguments, **options) -> subprocess.Popen:
    return subprocess.Popen([*COMMAND, *arguments], text=True, env=ENVIRONMENT, **options)


@pytest.mark.parametrize(
    ("typed", "meant"), [("rendr", "render"), ("precomptue", "precompute"), ("relit", "relight"), ("infos", "info")]
)
def test_misspelt_command_suggests_the_right_one(run, typed: str, meant: str):
    assert run(typed, "x") == (2, "", f"jaxrelight: '{typed}' is not a command; did you mean '{meant}'?\n")


def test_unknown_command_lists_them(run):
    known = "demo, render, precompute, relight, measure, inverse, info"
    assert run("zzz") == (2, "", f"jaxrelight: 'zzz' is not a command; known are {known}\n")


@pytest.mark.parametrize(
    ("typed", "meant"),
    [("--resolutoin", "--resolution"), ("--coeficients", "--coefficients"), ("--rotat-y", "--rotate-y")],
)
def test_misspelt_option_suggests_the_right_one(folder, run, typed: str, meant: str):
    status, out, err = run("render", "scene.toml", "-o", "a.exr", typed, "8")
    assert (status, out) == (2, "")
    assert "Perhaps you meant" in err
    assert meant in err


@pytest.mark.parametrize(
    "arguments",
    [pytest.param(["info", "scene.toml"], marks=pytest.mark.slow), ["info", "scene.toml", "--json"]],
    ids=" ".join,
)
def test_reader_that_has_gone_is_no_fault(folder, arguments):
    process = _process(*arguments, stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    assert process.stdout is not None
    assert process.stderr is not None
    process.stdout.close()
    with process.stderr:
        assert process.stderr.read() == ""
    assert process.wait() == 0


def test_interruption_of_the_process(folder):
    """One line, status 130; the same command goes on and ends as it should."""
    # So many rays that the interruption comes in their midst.
    arguments = "precompute", "scene.toml", "-o", "made", "--resolution", "64", "--visibility-samples", "25"
    process = _process(*arguments, "--coefficients", "16", stdout=subprocess.PIPE, stderr=subprocess.PIPE)
    while not list(folder.glob("made/visibility-*/layout.json")):
        assert process.poll() is None
    process.send_signal(signal.SIGINT)
    out, err = process.communicate()
    assert (process.returncode, out) == (130, "")
    assert err.splitlines()[-1].startswith("jaxrelight: stopped")
    assert err.splitlines()[-1].endswith("what is done is kept, run the same command to go on")
    assert len(err.splitlines()) == 1
    assert not (folder / "made" / "store.json").exists()


def test_lines_where_there_is_no_terminal(capsys, monkeypatch):
    """One every few seconds, with how far it is and how long it will take; none for a short run."""
    now = [0.0]
    monkeypatch.setattr(bars.time, "monotonic", lambda: now[0])
    with bars.progress() as report:
        for done in range(0, 101, 10):
            report("visibility", done * 10, 1000)
            now[0] += 3
    assert capsys.readouterr().err.splitlines() == [
        "visibility: 40 % of 1,000 points, 18 s left",
        "visibility: 80 % of 1,000 points, 6 s left",
    ]
    with bars.progress(quiet=True) as report:
        for done in range(0, 1000, 10):
            report("visibility", done, 1000)
            now[0] += 3
    assert capsys.readouterr().err == ""


@pytest.mark.parametrize("columns", [40, pytest.param(120, marks=pytest.mark.slow)])
def test_terminal_shows_bars_and_wraps_the_summary(folder, columns: int):
    """At a terminal of that width nothing is longer than it."""
    reader, writer = pty.openpty()
    arguments = "render", "scene.toml", "-o", "a.png", "--store", "made", *DIALS
    environment = {**ENVIRONMENT, "COLUMNS": str(columns), "LINES": "40", "TERM": "xterm"}
    process = subprocess.Popen([*COMMAND, *arguments], env=environment, stdin=writer, stdout=writer, stderr=writer)
    os.close(writer)
    shown = b""
    while select.select([reader], [], [], 120)[0]:
        try:
            shown += os.read(reader, 4096)
        except OSError:
            break
    os.close(reader)
    assert process.wait() == 0
    text = shown.decode()
    assert "visibility" in text
    assert "100%" in text
    summary = text[text.index("           store") :].splitlines()
    assert max(map(len, summary)) <= columns
    assert any(line.startswith(" " * 18) for line in summary) or columns > 100
    assert "seconds  imports" in text
