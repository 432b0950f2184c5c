"""Signatures are checked at run time at every call, but where a test passes what a user may get wrong."""

import contextlib
import functools
from collections.abc import Callable, Iterator

from beartype import BeartypeConf, beartype

# An int is accepted where a float is asked for, as type checkers have it.
_check = beartype(conf=BeartypeConf(is_pep484_tower=True))
_ignored = False


def checked(function: Callable) -> Callable:
    """The function, which compares arguments and result with its signature; jaxtyping's import hook applies it."""
    strict = None

    @functools.wraps(function)
    def call(*args, **kwargs):
        nonlocal strict
        if _ignored:
            return function(*args, **kwargs)
        # Most functions are not called in a process: a check takes longer to make than to run.
        strict = strict or _check(function)
        return strict(*args, **kwargs)

    return call


@contextlib.contextmanager
def ignored() -> Iterator[None]:
    """Nothing is checked: the function itself has to refuse what is wrong."""
    global _ignored
    _ignored = True
    try:
        yield
    finally:
        _ignored = False
