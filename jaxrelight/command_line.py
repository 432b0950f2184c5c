"""What a program of several commands does with its command line. Nothing heavy is imported, so that --help is quick."""

import atexit
import contextlib
import ctypes
import difflib
import gc
import importlib.metadata
import os
import sys
from collections.abc import Mapping
from typing import Any

import tyro

from jaxrelight.compilation_cache import keep_compilations
from jaxrelight.errors import InputError


def versions() -> dict[str, str]:
    """Versions of this package and of those that its numbers depend on."""
    return {name: importlib.metadata.version(name) for name in ("jaxrelight", "jax", "embreex")}


def run_command(prog: str, description: str, commands: Mapping[str, type], smaller: str) -> None:
    """Runs the command that was asked for; exits with 1 and one line for bad input, 2 for a wrong command line.

    130 is the status after an interruption.

    Args:
        prog: the program's name.
        description: a sentence for --help.
        commands: by their names, dataclasses of options whose method `run` takes none.
        smaller: what to do where the memory is used up.
    """
    command = None
    try:
        command = _parsed(prog, description, commands)
        if command is not None:
            _prepare_process()
            command.run()
    except InputError as error:
        print(f"{prog}: {error}", file=sys.stderr)
        sys.exit(1)
    except MemoryError:
        print(f"{prog}: the memory is used up; {smaller}", file=sys.stderr)
        sys.exit(1)
    except BrokenPipeError:
        # Whoever read the summary has gone, as `head` does; what is left of it goes nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except KeyboardInterrupt as stop:
        done = "".join(f" at {note}" for note in getattr(stop, "__notes__", ()))
        # A command says by `keeps` if it has nothing to go on from.
        kept = "what is done is kept, run the same command to go on" if getattr(command, "keeps", True) else ""
        print(f"{prog}: stopped{done}; {kept or 'nothing is written yet, run the same command again'}", file=sys.stderr)
        sys.exit(130)


def _parsed(prog: str, description: str, commands: Mapping[str, type]) -> Any:
    """The command that was asked for, with its options; None where what was asked for is printed already."""
    arguments = sys.argv[1:]
    if arguments == ["--version"]:
        print(importlib.metadata.version("jaxrelight"))
        return None
    named = arguments[0] if arguments and not arguments[0].startswith("-") else None
    if named is not None and named not in commands:
        close = difflib.get_close_matches(named, commands, n=1)
        hint = f"did you mean '{close[0]}'?" if close else f"known are {', '.join(commands)}"
        print(f"{prog}: '{named}' is not a command; {hint}", file=sys.stderr)
        sys.exit(2)
    config = (tyro.conf.FlagCreatePairsOff,)
    if named is None:
        about = f"{description} {prog} --version says which version this is."
        return tyro.extras.subcommand_cli_from_dict({**commands}, prog=prog, description=about, config=config)
    # The others' options need not be read, and nothing else where help is asked for.
    kind: Any = commands[named]
    options = arguments[1:] if {"-h", "--help"}.isdisjoint(arguments) else ["--help"]
    return tyro.cli(kind, prog=f"{prog} {named}", args=options, config=config)


def _prepare_process():
    """Sets up memory and the cache of compiled programs for a command that runs once."""
    _share_freed_memory()
    # Tracing makes many objects that stay: to look through all of them again and again takes a tenth
    # of the time of a picture whose programs are compiled already.
    gc.set_threshold(50_000, 20, 100)
    keep_compilations()
    # At its end the interpreter would look through all objects for cycles, a third of a second for nothing.
    atexit.register(gc.freeze)


def _share_freed_memory():
    """Has glibc, where it is there, keep what threads free in two places instead of eight for each core.

    What one thread freed is of no use to others else: 0.9 of the 3.4 GB of a pass of bounces. It has to come before
    threads start; a program of your own has the environment variable MALLOC_ARENA_MAX=2 for it.
    """
    with contextlib.suppress(AttributeError, OSError, TypeError):
        ctypes.CDLL(None).mallopt(-8, 2)  # M_ARENA_MAX
