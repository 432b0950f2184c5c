"""Files that mesh files name, as people's machines leave those names: other slashes, other drives, other cases."""

import pathlib
import re
from collections.abc import Sequence

_DRIVE = re.compile(r"^(?:[A-Za-z]:)?/+")


def find_file(name: str, folder: pathlib.Path) -> tuple[pathlib.Path, str | None]:
    """The file that a name in another file means.

    It is looked for as written, with slashes for backslashes; then by the last parts of its path, longest first, as of
    absolute paths of another machine; each also in other upper and lower case.

    Args:
        name: as written.
        folder: of the file that names it.

    Returns:
        The file, and a note if it lies elsewhere or is called otherwise than written. The place where it should be, and
        no note, if there is none.
    """
    written = name.strip().strip('"').replace("\\", "/")
    relative = _DRIVE.sub("", written)
    whole = folder / written
    parts = [part for part in relative.split("/") if part not in ("", ".")]
    tails = ["/".join(parts[start:]) for start in range(len(parts)) if ".." not in parts[start:]]
    for candidate in [written, *tails]:
        try:
            path = _existing(candidate, folder)
        except (OSError, ValueError):
            continue
        if path is not None:
            exact = candidate == written and path == whole
            return path, None if exact else f"'{name.strip()}' is taken from {path.name} in {path.parent.name or '.'}"
    is_absolute = relative != written
    return folder / parts[-1] if is_absolute and parts else whole, None


def find_files(names: str, folder: pathlib.Path, suffix: str) -> list[str]:
    """The names of files on a line: all of it if that is a file's, else what ends with the suffix, else its words.

    Args:
        names: the line; names may contain spaces.
        folder: of the file that it stands in.
        suffix: that names usually have, such as ".mtl".
    """
    whole = names.strip()
    if find_file(whole, folder)[0].is_file():
        return [whole]
    ended: Sequence[str] = [one.strip() for one in re.findall(rf".+?{re.escape(suffix)}(?=\s|$)", whole, re.IGNORECASE)]
    return list(ended) if "".join(ended).replace(" ", "") == whole.replace(" ", "") else whole.split()


def _existing(candidate: str, folder: pathlib.Path) -> pathlib.Path | None:
    """The file of that name, or of the same but for its case."""
    path = folder / candidate
    if path.is_file():
        return path
    place = folder
    for part in pathlib.PurePosixPath(candidate).parts:
        if (place / part).exists():
            place /= part
            continue
        alike = [entry for entry in place.iterdir() if entry.name.lower() == part.lower()] if place.is_dir() else []
        if len(alike) != 1:
            return None
        place = alike[0]
    return place if place.is_file() else None
