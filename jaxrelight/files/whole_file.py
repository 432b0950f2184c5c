"""Files that appear whole or not at all: written beside their place and then moved there."""

import os
import uuid
from collections.abc import Callable, Sequence
from pathlib import Path

from jaxrelight.errors import InputError


def write_whole(path: Path, write: Callable[[Path], object]) -> None:
    """Calls write(partial) with a path beside `path`, and moves what it wrote there.

    Raises:
        InputError: if the file cannot be written; what was there before stays.
    """
    partial = path.with_name(f".{uuid.uuid4().hex}.partial")
    try:
        if not path.parent.is_dir():
            raise InputError(f"{path}: the folder {path.parent} does not exist; create it first")
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: is not a regular file; choose another name to write to")
        try:
            write(partial)
            os.replace(partial, path)
        finally:
            partial.unlink(missing_ok=True)
    except (OSError, ValueError) as fault:  # ValueError: a name that cannot be a path
        reason = getattr(fault, "strerror", None) or fault
        raise InputError(f"{path}: cannot be written, {reason}; check space and rights") from fault


def check_place(path: Path, suffixes: Sequence[str], what: str) -> None:
    """Finds out before long work whether a file could be written.

    Args:
        path: where to.
        suffixes: those that name a format of it.
        what: what it is, as messages call it: "an image".

    Raises:
        InputError: if the extension is unknown, or the folder does not exist or must not be written to.
    """
    if path.suffix.lower() not in suffixes:
        raise InputError(f"{path}: cannot write {what} of kind {path.suffix!r}; use {_either(suffixes)}")
    if path.is_dir():
        raise InputError(f"{path}: is a folder; give the path of {what} file")
    if not path.absolute().parent.is_dir() or not os.access(path.absolute().parent, os.W_OK):
        raise InputError(f"{path}: its folder does not exist or cannot be written to; make it first")


def _either(suffixes: Sequence[str]) -> str:
    return suffixes[0] if len(suffixes) == 1 else f"one of {', '.join(suffixes)}"
