"""The lighting method that a command line asks for, and its dials as options of a command."""

import argparse
import dataclasses
import pathlib
import re
import sys
import tomllib
from collections.abc import Collection, Sequence
from typing import Annotated, Any, get_args, get_type_hints

import tyro

from jaxrelight.methods import METHODS, Method, documentation

HELP_ALL = "--help-all"
# Options of commands that only some methods have, that --help-all alone lists, and that are dials as well.
_ONLY_OF = {"store": ("transport", "indirect", "prefiltered"), "layers": ("indirect",), "maps": ("adaptive",)}
_ADVANCED = "modules", "error_samples"
_SHARED = ("exposure",)


def with_dials(command: Any, arguments: Sequence[str]) -> type:
    """A command whose options are its own and the dials of the lighting method that its arguments ask for.

    --help goes without advanced options. An option of another method ends the program with one line and status 2.
    """
    shows_all = HELP_ALL in arguments
    asks_for_help = shows_all or not {"-h", "--help"}.isdisjoint(arguments)
    lighting, why = _chosen_lighting(arguments)
    refused = "" if asks_for_help else _refusal(arguments, lighting, why)
    if lighting not in get_args(get_type_hints(command)["lighting"]):
        cannot = "precomputes nothing; render with it, or precompute transport or indirect"
        refused = f"--lighting {lighting} {getattr(command, 'cannot', cannot)}"
    if refused:
        print(f"jaxrelight: {refused}", file=sys.stderr)
        sys.exit(2)
    method, hides = METHODS[lighting], asks_for_help and not shows_all
    options_of_others = [name for name, methods in _ONLY_OF.items() if lighting not in methods]
    own = _options(command, [*options_of_others, *(_ADVANCED if hides else ())])
    dial_options = _options(method, [*_SHARED, *(method.advanced if hides else ())])
    dials = dataclasses.make_dataclass("Dials", dial_options, frozen=True)
    dials.__doc__ = (method.__doc__ or "").partition("\n")[0]
    more = [("dials", tyro.conf.OmitArgPrefixes[dials], dials()), ("method", tyro.conf.Suppress[str], lighting)]
    extended = dataclasses.make_dataclass(command.__name__, own + more, bases=(command,), frozen=True)
    extended.__doc__ = command.__doc__
    return extended


def method_of(command: Any, **shared: object) -> Method:
    """The method that a command's options make; `shared` are dials, if it has them, that the command has as its own.

    Raises:
        InputError: for a dial outside its range.
    """
    kind, values = METHODS[command.method], {**vars(command.dials), **shared}
    return kind(**{field.name: values[field.name] for field in dataclasses.fields(kind)})


def _options(kind: type, hidden: Collection[str]) -> list[tuple[str, Any, Any]]:
    """Fields of a dataclass as options, or as none where they are hidden.

    Their texts are given to tyro, which by itself breaks lines where those of the source end.
    """
    hints, texts, options = get_type_hints(kind, include_extras=True), documentation(kind), []
    for field in dataclasses.fields(kind):
        option = hints[field.name]
        if field.name in texts:
            text = re.sub(r"\b[a-z]+(_[a-z]+)+\b", lambda name: f"--{name[0].replace('_', '-')}", texts[field.name])
            # The option of what is on by default turns it off.
            text = f"Turns this off: {text[0].lower()}{text[1:]}" if field.default is True else text
            option = Annotated[option, tyro.conf.arg(help=text)]
        option = tyro.conf.Suppress[option] if field.name in hidden else option
        options.append((field.name, option, dataclasses.field(default=field.default)))
    return options


def _chosen_lighting(arguments: Sequence[str]) -> tuple[str, str]:
    """The name of the lighting method that arguments ask for, or that the scene's lights do; and why it is that."""
    parser = argparse.ArgumentParser(add_help=False, allow_abbrev=False)
    parser.add_argument("--lighting", nargs="?")
    parser.add_argument("--env", nargs="?")
    given, others = parser.parse_known_args(arguments)
    if given.lighting in METHODS:
        return given.lighting, f"this is --lighting {given.lighting}"
    path = next((argument for argument in others if argument.lower().endswith(".toml")), None)
    try:
        scene = tomllib.loads(pathlib.Path(path).read_text(encoding="utf-8-sig")) if path else {}
    except (OSError, ValueError, RecursionError):
        return "transport", "as the scene cannot be read, the lighting method is transport"
    if "light" in scene and "environment" not in scene and given.env is None:
        return "indirect", "this scene has local lights alone, so the lighting method is indirect"
    return "transport", "this scene does not have local lights alone, so the lighting method is transport"


def _refusal(arguments: Sequence[str], lighting: str, why: str) -> str:
    """The first option that other lighting methods have and this one has not, in a line; or nothing."""
    for argument in arguments:
        option = argument.partition("=")[0].replace("_", "-")
        name = option.removeprefix("--").removeprefix("no-").replace("-", "_")
        owners = _ONLY_OF.get(name) or [method for method, kind in METHODS.items() if name in documentation(kind)]
        if option.startswith("--") and owners and lighting not in owners and name not in _SHARED:
            *others, last = owners
            named = f"{', '.join(others)} or {last}" if others else last
            return f"{option} is a dial of --lighting {named}; {why}"
    return ""
