"""The store: layers of precomputed arrays on disk, each named by the hash of what it was made from.

    STORE/
      store.json               format, scene, method, and which layers belong together
      sensors.json             the same of the scene's sensors, where they were measured
      geometry-KEY/            vertices, normals and faces
      refinement-KEY/          edges that were halved to add vertices
      environment-KEY/         the scene's own light
      visibility-KEY/          one bit for each direction of each receiver
      filtered-KEY/            the same, filtered for lobes
      sample-KEY/              the same of a few receivers, at several resolutions
      resolution-KEY/          how far off each of those is
      factors-KEY/             of a BRDF
      texture-KEY/             pixels
      table-KEY/               a long array of a measured BRDF
      transport-KEY/           kept coefficients of direct light, energies
      bounced-KEY/             the same of bounced light, of each pass
      cloud-KEY/               points that stand for surfaces
      albedo-KEY/              of those points, and what they emit
      lights-KEY/              the numbers of the scene's local lights
      between-KEY/             kept coefficients of what they gather from each other
      indirect-KEY/            the same of what pixels gather from them
        layout.json            names, shapes and types of the arrays
        000000, 000001 …       the arrays of one group of receivers each

Every file appears whole or not at all, and carries a checksum and its own name, so that what is damaged, missing or in
another's place is noticed. A run that was killed, or that found the disk full, is gone on with; several processes may
work on one store; reading one writes nothing. Any file, layer or store may be deleted at any time: what is missing is
made again.
"""

import contextlib
import dataclasses
import errno
import hashlib
import json
import os
import pathlib
import re
import time
import uuid
from collections.abc import Iterable, Iterator, Mapping

import numpy as np
import zstandard

from jaxrelight.errors import InputError
from jaxrelight.files.array_file import check_arrays, decode_arrays, encode_arrays

FORMAT = 7
# Names of headers: of what a camera sees, and of what sensors measure.
HEADER, SENSOR_HEADER = "store.json", "sensors.json"

# Seconds after which a file that was not renamed belongs to nobody any more: writing one takes milliseconds.
_ABANDONED = 60


def default_folder(key: str) -> pathlib.Path:
    """Where a store goes that nobody named: the user's cache folder."""
    import platformdirs

    return pathlib.Path(platformdirs.user_cache_dir("jaxrelight", appauthor=False)) / key


def key_of(*parts: object) -> str:
    """Sixteen hexadecimal digits that identify arrays, texts, numbers and nested lists or tables of them.

    Other formats of the store have other digits.
    """
    digest = hashlib.sha256(f"{FORMAT};".encode())

    def add(part) -> None:
        if isinstance(part, np.ndarray):
            add(["array", str(part.dtype), list(part.shape)])
            digest.update(np.ascontiguousarray(part).data)
        elif isinstance(part, Mapping):
            add(["table", *(item for key in sorted(part) for item in (key, part[key]))])
        elif isinstance(part, (list, tuple)):
            digest.update(f"[{len(part)};".encode())
            for item in part:
                add(item)
        else:
            digest.update(json.dumps(part).encode() + b";")

    add(parts)
    return digest.hexdigest()[:16]


@dataclasses.dataclass
class Layer:
    """Named arrays whose first axis counts groups, a file for each group, written from several threads if need be.

    Made by `make_layer` and `open_layer`.

    Attributes:
        folder: where the files are; its name is part of their labels.
        arrays: shape of one group's part, and type, by name; -1 for a length that differs from group to group.
        groups: how many there are.
        done: those that are there.
    """

    folder: pathlib.Path
    arrays: dict[str, tuple[tuple[int, ...], np.dtype]]
    groups: int
    done: set[int] = dataclasses.field(default_factory=set)

    def _is_whole(self, group: int) -> bool:
        try:
            check_arrays(self._label(group), self._path(group).read_bytes())
        except (OSError, ValueError):
            return False
        return True

    def _label(self, group: int) -> str:
        return f"{self.folder.name}/{group}"

    def _path(self, group: int) -> pathlib.Path:
        return self.folder / f"{group:06}"

    @property
    def missing(self) -> list[int]:
        """Groups that are not written yet."""
        return [group for group in range(self.groups) if group not in self.done]

    def has(self, group: int) -> bool:
        """Whether a group is there by now, perhaps by another process."""
        if group not in self.done and self._is_whole(group):
            self.done.add(group)
        return group in self.done

    def write(self, group: int, **arrays: np.ndarray) -> None:
        """Writes all arrays of one group; what was computed in another floating type is kept in the layer's.

        Raises:
            InputError: if the disk is full or must not be written to; what was written before stays.
        """
        assert arrays.keys() == self.arrays.keys()
        for name, (_, dtype) in self.arrays.items():
            if dtype.kind == arrays[name].dtype.kind == "f":
                arrays[name] = arrays[name].astype(dtype, copy=False)
        assert all(self._fits(name, array) for name, array in arrays.items())
        with _told(self.folder):
            _write(self._path(group), encode_arrays(self._label(group), arrays))
        self.done.add(group)

    def _fits(self, name: str, array: np.ndarray) -> bool:
        shape, dtype = self.arrays[name]
        same = len(shape) == array.ndim and all(n in (-1, m) for n, m in zip(shape, array.shape, strict=True))
        return same and array.dtype == dtype

    def read(self, name: str, group: int | None = None) -> np.ndarray:
        """One group of an array, or all of them; see `read_all`."""
        if group is None:
            return self.read_all([name])[name]
        return self._read(group, [name])[name]

    def read_groups(self) -> Iterator[dict[str, np.ndarray]]:
        """All arrays of one group after the other.

        Raises:
            InputError: as `read_all`.
        """
        for group in range(self.groups):
            yield self._read(group, list(self.arrays))

    def read_all(self, names: Iterable[str] | None = None) -> dict[str, np.ndarray]:
        """Several arrays of all groups, by default all of them, whose lengths are all known; every file is read once.

        Raises:
            InputError: if what is on disk is not what was written.
        """
        names = list(self.arrays) if names is None else list(names)
        contents = {name: np.empty((self.groups, *self.arrays[name][0]), self.arrays[name][1]) for name in names}
        for group in range(self.groups):
            for name, part in self._read(group, names).items():
                contents[name][group] = part
        return contents

    def check(self) -> None:
        """Reads every file, so that damage is found wherever it is.

        Raises:
            InputError: names the first file that is missing or not what was written.
        """
        for group in range(self.groups):
            self._read(group, list(self.arrays))

    def _read(self, group: int, names: list[str]) -> dict[str, np.ndarray]:
        path = self._path(group)
        try:
            arrays = decode_arrays(self._label(group), path.read_bytes(), names, self.arrays)
            for name in names:
                if not self._fits(name, arrays[name]):
                    raise ValueError(f"'{name}' has another shape or type than the layer")
        except FileNotFoundError:
            raise InputError(f"{path} is missing; run precompute again: it makes what is missing") from None
        except OSError as error:
            raise InputError(
                f"{path}: cannot be read: {error.strerror}; mend that or delete it, then run precompute again"
            ) from None
        except (ValueError, KeyError, zstandard.ZstdError) as error:
            raise InputError(f"{path}: damaged, {error}; run precompute again: it makes this file anew") from None
        return arrays

    @property
    def nbytes(self) -> int:
        """Bytes on disk."""
        return bytes_on_disk(self.folder)


def bytes_on_disk(folder: pathlib.Path) -> int:
    """Bytes of a layer's files, damaged or not."""
    total = 0
    with os.scandir(folder) as files:
        for file in files:
            # What another process was writing may have its final name by now.
            with contextlib.suppress(FileNotFoundError):
                total += file.stat(follow_symlinks=False).st_size
    return total


def make_layer(folder: pathlib.Path, arrays: Mapping[str, tuple[tuple[int, ...], np.dtype]], groups: int) -> Layer:
    """A layer to be written, or to be completed: what is damaged counts as missing.

    Args:
        folder: named by the hash of all that the layer follows from, this function's other arguments too.
        arrays: shape of one group's part, and type, by name; -1 for a length that differs from group to group.
        groups: how many.

    Raises:
        InputError: if the folder cannot be written to.
    """
    layer = Layer(folder, {name: (tuple(shape), np.dtype(dtype)) for name, (shape, dtype) in arrays.items()}, groups)
    described = {name: [list(shape), str(dtype)] for name, (shape, dtype) in layer.arrays.items()}
    layout = {"format": FORMAT, "groups": groups, "arrays": described}
    with _told(folder):
        folder.mkdir(exist_ok=True)
        _sweep(folder)
        if _read_sealed(folder / "layout.json") != layout:
            _write_sealed(folder / "layout.json", layout)
    layer.done.update(filter(layer._is_whole, range(groups)))
    return layer


def open_layer(folder: pathlib.Path) -> Layer:
    """A layer that exists already, to be read. Nothing is written, and files are looked into when they are read.

    Raises:
        InputError: if it is missing, damaged or of another format.
    """
    layout = _read_sealed(folder / "layout.json")
    if layout is None or layout["format"] != FORMAT:
        raise InputError(f"{folder}: this layer is missing or damaged; run precompute again")
    arrays = {name: (tuple(shape), np.dtype(dtype)) for name, (shape, dtype) in layout["arrays"].items()}
    layer, there = Layer(folder, arrays, layout["groups"]), set(os.listdir(folder))
    layer.done.update(group for group in range(layer.groups) if layer._path(group).name in there)
    return layer


def write_header(folder: pathlib.Path, header: Mapping, name: str = HEADER) -> None:
    """Writes what belongs together into `store.json`, or a header of another name."""
    with _told(folder):
        _sweep(folder)
        _write_sealed(folder / name, {"format": FORMAT, **header})


_KINDS = "geometry", "refinement", "visibility", "filtered", "cloud", "albedo", "between"


def layers_of(header: Mapping) -> list[str]:
    """The names of the layers that a header refers to.

    Raises:
        ValueError: if one is no name of a layer of its kind.
    """
    named = [(kind, header.get(kind)) for kind in _KINDS]
    named.append(("environment", (header["environment"] or {}).get("pixels")))
    named.append(("lights", (header.get("lights") or {}).get("layer")))
    chosen = header.get("chosen_resolution") or {}
    named += [("sample", chosen.get("sample")), ("resolution", chosen.get("layer"))]
    for material in header["materials"]:
        named += [(kind, material.get(kind)) for kind in ("factors", "transport", "bounced", "indirect")]
        named += [("texture", entry) for entry in (material["normal_map"], *material["weight"])]
        named += [("table", entry.get("layer")) for entry in material["brdf"]["arrays"].values()]
    named += [(name.partition("-")[0], name) for one in header.get("passes", []) for name in one]
    names = [(kind, name) for kind, name in named if isinstance(name, str)]
    for kind, name in names:
        if not re.fullmatch(f"{kind}-[0-9a-f]{{16}}", name):
            raise ValueError(f"'{name}' is no name of a layer of {kind}")
    return [name for _, name in names]


def read_header(folder: pathlib.Path, name: str = HEADER) -> dict:
    """The content of `store.json`, or of a header of another name.

    Raises:
        InputError: if there is none, it is damaged, or its format is another one.
    """
    path = folder / name
    if name == SENSOR_HEADER and not path.is_file() and (folder / HEADER).is_file():
        raise InputError(
            f"{folder}: no sensors were precomputed there; measure a scene file that has some, with --store {folder}"
        )
    if not path.is_file():
        raise InputError(f"{folder}: not a store, or its precomputation was not finished; run precompute")
    header = _read_sealed(path)
    if header is not None and header["format"] == FORMAT:
        return header
    with contextlib.suppress(OSError, ValueError, AttributeError):
        stored_format = json.loads(path.read_bytes()).get("format")
        if stored_format != FORMAT:
            raise InputError(
                f"{path}: format {stored_format} is not format {FORMAT}, which this version reads; precompute again"
            )
    raise InputError(f"{path}: damaged; run precompute again, finished layers will be reused")


def _write_sealed(path: pathlib.Path, content: Mapping):
    """A JSON file that ends with the checksum of the rest."""
    _write(path, _sealed(content))


def _sealed(content: Mapping) -> bytes:
    checksum = hashlib.sha256(json.dumps(content).encode()).hexdigest()
    return json.dumps({**content, "sha256": checksum}, indent=1).encode()


def _read_sealed(path: pathlib.Path) -> dict | None:
    """What `_write_sealed` wrote; None if that is not what is there, to the last byte."""
    try:
        text = path.read_bytes()
        content = json.loads(text)
        del content["sha256"]
    except (OSError, ValueError, KeyError, TypeError):
        return None
    return content if _sealed(content) == text else None


def _write(path: pathlib.Path, content: bytes):
    """Replaces a file's content at once or not at all, whoever else does the same."""
    partial = path.with_name(f".{path.name}.{uuid.uuid4().hex}")
    try:
        partial.write_bytes(content)
        partial.replace(path)
    finally:
        partial.unlink(missing_ok=True)


def _sweep(folder: pathlib.Path):
    """Removes what killed processes left half-written."""
    for partial in folder.glob(".*"):
        with contextlib.suppress(OSError):
            if time.time() - partial.stat().st_mtime > _ABANDONED:
                partial.unlink()


@contextlib.contextmanager
def _told(folder: pathlib.Path):
    """Says in one line why a folder cannot be written to."""
    try:
        yield
    except OSError as error:
        full = error.errno in (errno.ENOSPC, errno.EDQUOT, errno.EFBIG)
        # Files are renamed to the place that they are meant for.
        place = error.filename2 or folder
        raise InputError(
            f"{place}: cannot be written: {error.strerror}; what is finished is kept, "
            f"{'make room' if full else 'mend that or delete it'} and run again"
        ) from None
