"""Equinox modules as JSON and named arrays, and back: BRDFs and lights of a class outside of the package.

A record names the class as `module:qualified.name`. A store is data from anywhere, and importing a module runs its
code; so nothing is imported when a record is read. A class is taken from a module that is imported already, else from
those seen in this process: given to `register`, or written into a record. It must derive from what is expected, and
its `__init__` is not called.
"""

import dataclasses
import importlib
import inspect
import sys
import types
from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from jaxrelight.errors import InputError
from jaxrelight.numerics.arrays import as_array

Class = TypeVar("Class", bound=type)

# The registered classes by their qualified names.
_seen: dict[str, type] = {}


def register(cls: Class) -> Class:
    """Makes a class known to records that are read in this process; also a decorator of it.

    Only classes of scripts, notebooks and functions need it: those of modules are known once the module is imported,
    and those of what is precomputed in this process are known, too.

    Raises:
        InputError: if it is no class of Equinox modules, as BRDFs and lights are.
    """
    candidate: Any = cls
    if not (isinstance(candidate, type) and issubclass(candidate, eqx.Module)):
        raise InputError(f"{cls!r} is no class of BRDFs or lights; derive it from Brdf or Light")
    _seen[qualified_name(candidate)] = candidate
    return cls


def import_classes(module: str) -> None:
    """Imports the module that a user names, which runs its code, so that stores may hold objects of its classes.

    Raises:
        InputError: if it cannot be imported.
    """
    try:
        importlib.import_module(module)
    except Exception as error:
        reason = f"the module '{module}' cannot be imported ({error})"
        raise InputError(f"{reason}; mend it, or check its name and PYTHONPATH") from error


def qualified_name(cls: type) -> str:
    """What records call a class."""
    return f"{cls.__module__}:{cls.__qualname__}"


def find_class(name: str, base: type | tuple[type, ...], what: str) -> type:
    """The class of a qualified name.

    Args:
        name: the qualified name.
        base: what the class must derive from.
        what: what messages call the object, as in "the store's light 2".

    Raises:
        InputError: if its module is not imported, has no such class, or its class does not derive from the base.
    """
    module, _, path = name.partition(":")
    candidate: Any = sys.modules.get(module)
    for part in path.split("."):
        # No attribute look-up: a module's or a class's own could run code.
        candidate = vars(candidate).get(part) if isinstance(candidate, types.ModuleType | type) else None
    candidate = _seen.get(name) if candidate is None else candidate
    description = f"{what} is of the class '{path}' of the module '{module}'"
    if not path:
        raise InputError(f"{what} is of the kind '{name}', which is not known; run precompute again")
    if candidate is None and (module == "__main__" or "<locals>" in path):
        raise InputError(
            f"{what} is of the class '{path}', which a script, a notebook or a function defined; define it here, too, "
            "and give it to jaxrelight.brdf.record.register before the store is opened"
        )
    if candidate is None and module in sys.modules:
        raise InputError(f"{description}, which has no such class; restore it, or run precompute again")
    if candidate is None:
        raise InputError(
            f"{description}, which is not imported, and a store does not import modules, since that runs their code; "
            f"import {module} before the store is opened, on the command line by --import {module}"
        )
    if not (isinstance(candidate, type) and issubclass(candidate, base)) or inspect.isabstract(candidate):
        raise InputError(f"{description}, which cannot be one of what a store holds there; run precompute again")
    return candidate


def to_fields(module: eqx.Module, what: str) -> tuple[dict[str, Any], dict[str, np.ndarray]]:
    """A module's fields as JSON, and the arrays in them by the names that they have there. Its class becomes known.

    Args:
        module: whose fields hold arrays, numbers, texts, None, tuples, lists or dictionaries of these, or modules of
            such fields; static ones no arrays.
        what: what messages call the module.

    Raises:
        InputError: for fields that hold anything else.
    """
    arrays: dict[str, np.ndarray] = {}

    def encoded(value: Any, path: str, static: bool) -> Any:
        if value is None or type(value) in (bool, int, float, str):
            return value
        if not static and _is_array(value):
            while path in arrays:  # keys of dictionaries may hold dots
                path += "'"
            arrays[path] = np.asarray(value)
            return {"array": path}
        if type(value) is tuple or type(value) is list:
            return {type(value).__name__: [encoded(item, f"{path}.{i}", static) for i, item in enumerate(value)]}
        if type(value) is dict and all(type(key) is str for key in value):
            return {"dict": {key: encoded(item, f"{path}.{key}", static) for key, item in value.items()}}
        if isinstance(value, eqx.Module):
            return {"class": qualified_name(register(type(value))), "fields": each(value, f"{path}.", static)}
        held = "a function" if callable(value) else f"an object of the type '{type(value).__name__}'"
        raise InputError(
            f"{what} is of the class '{type(module).__qualname__}', which a store cannot hold: its "
            f"{'static ' if static else ''}field '{path}' holds {held}; fields must hold arrays (static ones none), "
            "numbers, texts, None, tuples, lists or dictionaries of these, or Equinox modules of such fields"
        )

    def each(module: eqx.Module, prefix: str, static: bool) -> dict[str, Any]:
        return {
            field.name: encoded(
                getattr(module, field.name), prefix + field.name, static or bool(field.metadata.get("static"))
            )
            for field in dataclasses.fields(module)
        }

    register(type(module))
    return each(module, "", False), arrays


def from_fields(cls: type, fields: dict[str, Any], read: Callable[[str], np.ndarray], what: str) -> Any:
    """The module whose fields `to_fields` wrote; its arrays are as `restored` gives them.

    Args:
        cls: its class, as `find_class` gives it.
        fields: as JSON.
        read: an array by its name.
        what: what messages call the module.

    Raises:
        InputError: if the class has other fields now, or that of a module in a field is not known.
    """

    def decoded(value: Any, field: dataclasses.Field) -> Any:
        if not isinstance(value, dict):
            return value
        if "class" in value:
            return from_fields(find_class(value["class"], eqx.Module, what), value["fields"], read, what)
        ((kind, content),) = value.items()
        if kind == "array":
            return restored(read(content), field)
        if kind == "dict":
            return {key: decoded(item, field) for key, item in content.items()}
        return {"tuple": tuple, "list": list}[kind](decoded(item, field) for item in content)

    now = {field.name: field for field in dataclasses.fields(cls)}
    if sorted(now) != sorted(fields):
        raise InputError(
            f"{what} is of the class '{cls.__qualname__}', which has the fields {', '.join(now) or 'none'}, and had "
            f"{', '.join(fields) or 'none'} when it was stored; run precompute again"
        )
    module = object.__new__(cls)
    for name, value in fields.items():
        # JAX, too, makes modules again like this: they are frozen, and their own `__init__` takes what it likes.
        object.__setattr__(module, name, decoded(value, now[name]))
    return module


def restored(array: np.ndarray, field: dataclasses.Field) -> Any:
    """An array of a field as it was: JAX's, of its type; of positions in the world NumPy's, in double precision."""
    return np.array(array) if field.metadata.get("is_place") else as_array(array)


def _is_array(value: Any) -> bool:
    """Whether it is an array of plain numbers or truth values."""
    if isinstance(value, jax.Array) and jnp.issubdtype(value.dtype, jax.dtypes.extended):
        return False
    return isinstance(value, jax.Array | np.ndarray | np.generic) and np.asarray(value).dtype.kind in "biuf"
