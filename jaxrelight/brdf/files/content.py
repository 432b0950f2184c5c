"""What the readers of BRDF files share: the content of a file, its arrays, and what is wrong with them."""

import math
import pathlib

import numpy as np
from jaxtyping import Float

from jaxrelight.errors import InputError


class Content:
    """The bytes of a file, and its name for messages.

    Raises:
        InputError: if it cannot be read, or is larger than any file of these formats.
    """

    def __init__(self, path: str | pathlib.Path, largest: int = 2**30):
        self.path = pathlib.Path(path)
        try:
            if self.path.exists() and not self.path.is_file():  # reading a pipe or a device could go on for ever
                raise OSError("it is not a regular file")
            size = self.path.stat().st_size
            if size > largest:
                raise InputError(f"{path}: has {size:,} bytes, more than any BRDF file; check that it is one")
            self.data = self.path.read_bytes()
        except MemoryError as fault:
            raise InputError(f"{path}: is larger than the free memory; free some") from fault
        except (OSError, ValueError) as fault:
            reason = getattr(fault, "strerror", None) or fault
            raise InputError(f"{path}: cannot be read ({reason}); check the path") from None

    def fault(self, what: str, remedy: str = "get the file again") -> InputError:
        """The error that says what is wrong with this file."""
        return InputError(f"{self.path}: {what}; {remedy}")

    def array(self, dtype: str, shape: tuple[int, ...], offset: int) -> np.ndarray:
        """Numbers at a place, which must lie inside the file."""
        count = math.prod(shape)
        # An array of nothing may claim other lengths beyond all reason.
        if max([offset + count * np.dtype(dtype).itemsize, *shape]) > len(self.data):
            raise self.fault("is cut short")
        return np.frombuffer(self.data, dtype, count, offset).reshape(shape)

    def check_finite(self, values: Float[np.ndarray, "..."], what: str) -> None:
        """Refuses numbers that are no numbers, also as float32."""
        wrong = int(np.sum(~(np.abs(values) < np.finfo(np.float32).max)))
        if wrong:
            raise self.fault(f"{wrong:,} of {values.size:,} {what} are not finite")

    def without_negative(self, values: Float[np.ndarray, "..."], what: str) -> tuple[np.ndarray, list[str]]:
        """Negative reflectance set to 0, and a note of how much that was."""
        negative = values < 0
        if not negative.any():
            return values, []
        note = (
            f"{self.path.name}: {negative.sum():,} of {values.size:,} {what} were negative, "
            f"down to {values.min():.2g}, and are taken as 0"
        )
        return np.where(negative, 0, values), [note]
