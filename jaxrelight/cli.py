"""The command line: parsing only."""

import difflib
import functools
import operator
import os
import sys

import tyro

from jaxrelight.commands.demo import Demo
from jaxrelight.commands.info import Info
from jaxrelight.commands.precompute import Precompute
from jaxrelight.commands.relight import Relight
from jaxrelight.commands.render import Render
from jaxrelight.compilation_cache import keep_compilations
from jaxrelight.errors import InputError

_COMMANDS = Demo, Render, Precompute, Relight, Info


def main() -> None:
    """Runs the command that was asked for; exits with 1 and one line for bad input, 2 for a wrong command line."""
    names = [kind.__name__.lower() for kind in _COMMANDS]
    if len(sys.argv) > 1 and not sys.argv[1].startswith("-") and sys.argv[1] not in names:
        close = difflib.get_close_matches(sys.argv[1], names, n=1)
        hint = f"did you mean '{close[0]}'?" if close else f"known are {', '.join(names)}"
        print(f"jaxrelight: '{sys.argv[1]}' is not a command; {hint}", file=sys.stderr)
        sys.exit(2)
    command = tyro.cli(
        functools.reduce(operator.or_, _COMMANDS),
        prog="jaxrelight",
        description="Precompute light transport once; relight under any environment, from any view.",
        config=(tyro.conf.FlagCreatePairsOff,),
    )
    keep_compilations()
    try:
        command.run()
    except InputError as error:
        print(f"jaxrelight: {error}", file=sys.stderr)
        sys.exit(1)
    except MemoryError:
        print(
            "jaxrelight: the memory is used up; lower --width, --height, --resolution or --coefficients, or use a "
            "simpler mesh",
            file=sys.stderr,
        )
        sys.exit(1)
    except BrokenPipeError:
        # Whoever read the summary has gone, as `head` does; what is left of it goes nowhere.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
    except KeyboardInterrupt as stop:
        done = "".join(f" at {note}" for note in getattr(stop, "__notes__", ()))
        print(f"jaxrelight: stopped{done}; what is done is kept, run the same command to go on", file=sys.stderr)
        sys.exit(130)
