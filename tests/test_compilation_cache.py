"""Compiled programs kept between processes: where, when, and that nothing worse than time is lost."""

import os
import pathlib
import subprocess
import sys

import pytest

from jaxrelight.compilation_cache import VARIABLE

ROOT = pathlib.Path(__file__).parents[1]

# Says which folder is used, how many programs were compiled and how many found, and what was computed.
CHILD = """
import sys
import jaxrelight as jr
if "late" in sys.argv:
    import jax
if "own" in sys.argv:
    import jax
    jax.config.update("jax_compilation_cache_dir", sys.argv[1])
if "call" in sys.argv:
    jr.keep_compilations()
import jax, jax.monitoring
counts = {"hits": 0, "misses": 0}
def count(event, **_):
    for kind in counts:
        counts[kind] += event == f"/jax/compilation_cache/cache_{kind}"
jax.monitoring.register_event_listener(count)
print(jax.jit(lambda x: (3 * x).sum())(jax.numpy.arange(5.0)))
jax.jit(lambda x: x + 1)(1.0)
print(jax.config.jax_compilation_cache_dir)
print(counts["hits"], counts["misses"])
"""


def _run(*arguments, **environment) -> tuple[float, str, int, int]:
    """The value, JAX's folder, and how many programs were found and written; anything on standard error fails."""
    kept = {name: value for name, value in os.environ.items() if "CACHE" not in name}
    done = subprocess.run(
        [sys.executable, "-c", CHILD, *map(str, arguments)],
        capture_output=True, text=True, check=True, cwd=ROOT, env={**kept, **environment},
    )  # fmt: skip
    assert done.stderr == ""
    value, folder, counts = done.stdout.splitlines()
    hits, misses = map(int, counts.split())
    return float(value), folder, hits, misses


@pytest.fixture(scope="module")
def filled(tmp_path_factory):
    """A user's cache that one process has written to, and what that process found."""
    folder = tmp_path_factory.mktemp("home")
    return folder, _run("call", XDG_CACHE_HOME=str(folder))


@pytest.fixture(scope="module")
def moved(tmp_path_factory):
    """A folder that the variable names, which a process has written to that called late, and what it found."""
    folder = tmp_path_factory.mktemp("moved") / "a" / "b"
    return folder, _run("call", "late", **{VARIABLE: str(folder)})


def test_first_process_writes_to_the_users_cache(filled):
    home, (value, folder, hits, misses) = filled
    assert (value, hits) == (30, 0)
    assert misses > 0
    if sys.platform == "linux":
        assert pathlib.Path(folder).parent == home / "jaxrelight" / "compiled"


@pytest.mark.parametrize("when", [(), ("late",)], ids=["before jax is imported", "after"])
def test_second_process_compiles_nothing(filled, when):
    home, (value, folder, _, misses) = filled
    assert _run("call", *when, XDG_CACHE_HOME=str(home)) == (value, folder, misses, 0)


def test_library_keeps_nothing_unless_asked(tmp_path):
    assert _run(XDG_CACHE_HOME=str(tmp_path)) == (30, "None", 0, 0)
    assert not list(tmp_path.iterdir())


def test_variable_moves_it(moved):
    wanted, (value, folder, hits, misses) = moved
    assert (value, folder, hits) == (30, str(wanted), 0)
    assert misses > 0
    assert list(wanted.iterdir())


def test_variable_turns_it_off(tmp_path):
    assert _run("call", XDG_CACHE_HOME=str(tmp_path), **{VARIABLE: "off"}) == (30, "None", 0, 0)
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_users_own_choice_stands(tmp_path):
    mine, ours = tmp_path / "mine", tmp_path / "ours"
    assert _run("call", JAX_COMPILATION_CACHE_DIR=str(mine), **{VARIABLE: str(ours)})[1] == str(mine)
    assert _run(mine, "own", "call", **{VARIABLE: str(ours)})[1] == str(mine)
    assert not ours.exists()


def test_folder_that_cannot_be_used_costs_only_time(tmp_path):
    (tmp_path / "file").write_text("mine")
    assert _run("call", **{VARIABLE: str(tmp_path / "file")}) == (30, "None", 0, 0)
    assert _run("call", **{VARIABLE: str(tmp_path / "file" / "below")}) == (30, "None", 0, 0)
    assert (tmp_path / "file").read_text() == "mine"


def test_damaged_programs_cost_only_time(moved):
    """Cut, empty or a folder: they are compiled again, without a word."""
    # In their place: in a copy of the folder none of them would be found.
    folder, (*_, written) = moved
    entries = [path for path in folder.iterdir() if path.name.endswith("-cache")]
    assert len(entries) == written >= 3
    for number, entry in enumerate(entries):
        content = entry.read_bytes()
        entry.unlink()
        if number % 3 == 0:
            entry.mkdir()
        else:
            entry.write_bytes(content[: len(content) // 2] if number % 3 == 1 else b"")
    value, _, hits, _ = _run("call", **{VARIABLE: str(folder)})
    assert (value, hits) == (30, 0)
