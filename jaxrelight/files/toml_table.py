"""TOML files that people write: read key by key, so that what is misspelt is told by name and place."""

import difflib
import pathlib
import tomllib
from typing import Any

import numpy as np

from jaxrelight.errors import InputError


def read_toml(path: pathlib.Path, what: str) -> "Table":
    """The whole file as a table.

    Args:
        path: the file.
        what: what it should be, as messages call it: "a scene".

    Raises:
        InputError: if it cannot be read, or is no TOML.
    """
    try:
        text = path.read_text(encoding="utf-8-sig")
    except UnicodeDecodeError:
        raise InputError(f"{path}: cannot be read as {what}: it is not UTF-8 text; save it as that") from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        raise InputError(f"{path}: cannot be read as {what}: {reason}; check the path") from None
    try:
        content = tomllib.loads(text)
    except (ValueError, RecursionError) as error:  # also of numbers and lists without end
        raise InputError(f"{path}: not a TOML file: {error}; correct it there") from None
    return Table(content, str(path))


class Table:
    """A TOML table that is read key by key; what is left at the end was misspelt or is not supported.

    Every reader raises `InputError` for what is missing or of another kind, by its key and `where` it stands.
    """

    def __init__(self, content: object, where: str):
        if not isinstance(content, dict):
            raise InputError(f"{where} must be a table")
        self._content, self.where, self._asked = content, where, set()

    def has(self, key: str) -> bool:
        """Whether a key is given."""
        self._asked.add(key)
        return key in self._content

    def names(self) -> list[str]:
        """All keys."""
        return list(self._content)

    def get(self, key: str, *default: Any) -> Any:
        """A value of any kind; without a default it must be given."""
        if self.has(key):
            return self._content[key]
        if default:
            return default[0]
        unread = [name for name in self._content if name not in self._asked]
        close = difflib.get_close_matches(key, unread, n=1)
        fault = f"'{close[0]}' is not known; did you mean '{key}'?" if close else f"'{key}' is missing"
        raise InputError(f"{self.where}: {fault}")

    def table(self, key: str, *default: Any) -> "Table":
        """A table in this one."""
        return Table(self.get(key, *default), f"{self.where}: [{key}]")

    def tables(self, key: str) -> list["Table"]:
        """A list of tables; empty if it is not given."""
        entries = self.get(key, [])
        if not isinstance(entries, list):
            raise InputError(f"{self.where}: '{key}' must be written as [[{key}]]")
        return [Table(entry, f"{self.where}: [[{key}]] number {i + 1}") for i, entry in enumerate(entries)]

    def text(self, key: str, *default: Any) -> str:
        """Text."""
        value = self.get(key, *default)
        if not isinstance(value, str):
            raise InputError(f"{self.where}: '{key}' must be text, not {value!r}")
        return value

    def number(self, key: str, *default: Any) -> float:
        """One number."""
        return float(self.array(key, (), *default))

    def whole(self, key: str, *default: Any) -> int:
        """One whole number."""
        value = self.get(key, *default)
        if not isinstance(value, int) or isinstance(value, bool):
            raise InputError(f"{self.where}: '{key}' must be a whole number, not {value!r}")
        return value

    def truth(self, key: str) -> bool:
        """True or false."""
        value = self.get(key)
        if not isinstance(value, bool):
            raise InputError(f"{self.where}: '{key}' must be true or false, not {value!r}")
        return value

    def array(self, key: str, shape: tuple[int, ...], *default: Any) -> np.ndarray:
        """Numbers of a given shape."""
        return self.numbers(key, [shape], *default)

    def channels(self, key: str, *default: Any) -> np.ndarray:
        """One number, or one for each channel."""
        return self.numbers(key, [(), (3,)], *default)

    def numbers(self, key: str, shapes: list[tuple[int, ...]], *default: Any) -> np.ndarray:
        """Numbers of one of several shapes, finite."""
        value = self.get(key, *default)
        try:
            array = np.asarray(value, float)
            plain = all(type(item) in (int, float) for item in np.asarray(value, object).ravel())
        except (TypeError, ValueError, OverflowError):
            array, plain = None, False
        if array is None or not plain or array.shape not in shapes:
            wanted = " or ".join(
                "a number" if not shape else " × ".join(map(str, shape)) + " numbers" for shape in shapes
            )
            raise InputError(f"{self.where}: '{key}' must be {wanted}, not {value!r}")
        if not (np.abs(array) < np.finfo(np.float32).max).all():
            raise InputError(f"{self.where}: '{key}' must be finite, also as float32, not {value!r}")
        return array

    def not_negative(self, key: str) -> np.ndarray:
        """One number, or one for each channel; none negative."""
        value = self.channels(key)
        if (value < 0).any():
            raise InputError(f"{self.where}: '{key}' must not be negative")
        return value

    def finish(self) -> None:
        """Refuses what nobody asked for."""
        for key in self._content:
            if key not in self._asked:
                close = difflib.get_close_matches(key, self._asked, n=1)
                hint = f"; did you mean '{close[0]}'?" if close else f"; known are {', '.join(sorted(self._asked))}"
                raise InputError(f"{self.where}: '{key}' is not known{hint}")

    def within(self, error: InputError) -> InputError:
        """The error, told with the place in the file that it comes from."""
        message = str(error)
        return InputError(message if message.startswith(self.where) else f"{self.where}: {message}")
