"""NumPy's .npz archives from anywhere: no code is run and no more memory taken than a limit, whatever they claim."""

import math
import pathlib
from collections.abc import Collection

import numpy as np

from jaxrelight.errors import InputError


def read_npz(
    path: pathlib.Path,
    what: str,
    wanted: Collection[str],
    largest: int = 2**30,
    *,
    texts: Collection[str] = (),
    refuse_others: bool = False,
) -> dict[str, np.ndarray]:
    """The arrays of an archive that are wanted, by name; it may lack some, and hold others.

    Args:
        path: the file.
        what: what it should be, as messages call it.
        wanted: names.
        largest: bytes that any array may have.
        texts: those of the wanted ones that may hold text instead of numbers.
        refuse_others: whether arrays of other names are an error.

    Raises:
        InputError: if it cannot be read, is damaged or cut short, an array is larger or does not hold real numbers, or
            has a name that is refused.
    """
    if path.exists() and not path.is_file():  # reading a pipe or a device could go on for ever
        raise InputError(f"{path}: cannot be read as {what}: it is not a regular file; check the path")
    try:
        with path.open("rb") as file, np.load(file, allow_pickle=False) as archive:
            for name in archive.files if refuse_others else ():
                if name not in wanted:
                    raise InputError(f"{path}: '{name}' is not known; known are {', '.join(sorted(wanted))}")
            return {
                name: _member(path, archive, name, largest, "uifbU" if name in texts else "uifb")
                for name in archive.files
                if name in wanted
            }
    except InputError:
        raise
    except OSError as fault:
        raise InputError(f"{path}: cannot be read as {what}: {fault.strerror or fault}; check the path") from None
    except Exception as fault:  # zipfile, zlib and NumPy raise nearly anything for damaged content
        if isinstance(fault, MemoryError):
            raise
        raise InputError(f"{path}: cannot be read as {what}: damaged, cut short or no .npz; write it again") from None


def _member(path: pathlib.Path, archive, name: str, largest: int, kinds: str) -> np.ndarray:
    """One array, refused by its header if it is too large."""
    with archive.zip.open(f"{name}.npy") as file:
        version = np.lib.format.read_magic(file)
        read = np.lib.format.read_array_header_1_0 if version == (1, 0) else np.lib.format.read_array_header_2_0
        shape, _, dtype = read(file)
    if dtype.kind not in kinds:
        raise InputError(f"{path}: '{name}' does not hold real numbers; write the file again")
    if math.prod(shape) * dtype.itemsize > largest:
        raise InputError(f"{path}: '{name}' of shape {shape} is larger than {largest / 2**30:g} GiB; write it smaller")
    return archive[name]
