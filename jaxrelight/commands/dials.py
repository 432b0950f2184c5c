"""The dials of lighting methods as options of commands, and which method a command line asks for."""

import ast
import dataclasses
import functools
import inspect
import pathlib
import tomllib
from collections.abc import Sequence
from typing import Annotated, Any, get_type_hints

import tyro

from jaxrelight.methods import METHODS, Indirect, Method, Transport

ALL_DIALS = "--help-all"


@functools.cache
def documentation(method: type[Method]) -> dict[str, str]:
    """What each dial of a method is for: the texts under the fields of its class."""
    (body,) = ast.parse(inspect.getsource(method)).body
    assert isinstance(body, ast.ClassDef)
    texts, pairs = {}, zip(body.body, body.body[1:], strict=False)
    for field, text in pairs:
        if isinstance(field, ast.AnnAssign) and isinstance(text, ast.Expr) and isinstance(text.value, ast.Constant):
            assert isinstance(field.target, ast.Name)
            texts[field.target.id] = " ".join(str(text.value.value).split())
    return texts


def with_dials(
    command: type, method: type[Method], hidden: Sequence[str] = (), show_all: bool = False, about: str | None = None
) -> type:
    """A command whose options are its own and the dials of a method.

    Args:
        command: a dataclass; its field `method` is filled by `method_of`.
        method: whose dials.
        hidden: dials that the command sets itself.
        about: the command's help text; by default its own.
        show_all: list the advanced dials in the help text, too; they are accepted either way.
    """
    hints, texts, fields = get_type_hints(method, include_extras=True), documentation(method), []
    for field in dataclasses.fields(method):
        if field.name in hidden:
            continue
        options: list[Any] = [tyro.conf.arg(help=texts[field.name])]
        if field.name in method.advanced and not show_all:
            options.append(tyro.conf.Suppress)
        fields.append((field.name, Annotated[hints[field.name], *options], field.default))
    dials = dataclasses.make_dataclass("Dials", fields, frozen=True)
    more = [("dials", tyro.conf.OmitArgPrefixes[dials], dials()), ("kind", tyro.conf.Suppress[str], method.__name__)]
    made = dataclasses.make_dataclass(command.__name__, more, bases=(command,), frozen=True)
    made.__doc__ = about or command.__doc__
    return made


def method_of(command: Any, **others: object) -> Method:
    """The method that a command's options make, with dials that the command sets itself.

    Raises:
        InputError: for a dial outside its range.
    """
    return METHODS[command.kind.lower()](**vars(command.dials), **others)


def chosen_method(arguments: Sequence[str]) -> type[Method]:
    """The lighting method that a command line names; or the default one of the scene that it names."""
    name = _value_of("--lighting", arguments)
    if name in METHODS:
        return METHODS[name]
    for argument in arguments:
        if argument.lower().endswith(".toml") and "--env" not in arguments:
            try:
                scene = tomllib.loads(pathlib.Path(argument).read_text(encoding="utf-8"))
            except (OSError, ValueError):
                return Transport
            return Indirect if "light" in scene and "environment" not in scene else Transport
    return Transport


def _value_of(option: str, arguments: Sequence[str]) -> str | None:
    for argument, following in zip(arguments, [*arguments[1:], ""], strict=True):
        if argument == option:
            return following
        if argument.startswith(f"{option}="):
            return argument.partition("=")[2]
    return None
