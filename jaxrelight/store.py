"""The store: layers of precomputed arrays on disk, each named by the hash of what it was made from.

    STORE/
      store.json               format, scene, settings, and which layers belong together
      geometry-KEY/            vertices, normals and faces
      visibility-KEY/          one bit for each direction of each receiver
      factors-KEY/             of a BRDF
      texture-KEY/             pixels
      transport-KEY/           kept coefficients, energies

A layer is a zarr group with one chunk for each group of receivers, checked by CRC32C. Zarr writes a chunk under another
name and renames it, but reads a missing one as zeros; so a chunk counts only once its number stands in the layer's
`done` list. A run that was killed finds what is done and goes on. Any layer, or the store, may be deleted at any time.
"""

import hashlib
import json
import pathlib
import shutil
import threading
from collections.abc import Mapping
from typing import Any

import numpy as np

from jaxrelight.errors import InputError

FORMAT = 2


def default_folder(key: str) -> pathlib.Path:
    """Where a store goes that nobody named: the user's cache folder."""
    import platformdirs

    return pathlib.Path(platformdirs.user_cache_dir("jaxrelight", appauthor=False)) / key


def key_of(*parts) -> str:
    """Sixteen hexadecimal digits that identify arrays, texts, numbers and nested lists or tables of them."""
    digest = hashlib.sha256()

    def add(part):
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


class Layer:
    """Named arrays whose first axis counts groups, filled group by group, from several threads if need be."""

    def __init__(self, folder: pathlib.Path, arrays: Mapping[str, tuple[tuple[int, ...], np.dtype]], groups: int):
        """Opens the layer, or makes it. `arrays` gives the shape of one group's part, and the type, by name."""
        self.folder, self.groups = folder, groups
        try:
            self._open(arrays)
        except (ValueError, KeyError, TypeError, IndexError, FileNotFoundError) as error:
            reason = str(error).splitlines()[0] if str(error) else type(error).__name__
            raise InputError(f"{folder}: damaged ({reason}); delete this folder and run again") from None

    def _open(self, arrays: Mapping[str, tuple[tuple[int, ...], np.dtype]]):
        import zarr
        from zarr.codecs import Crc32cCodec, ZstdCodec

        folder, groups = self.folder, self.groups
        self._journal = folder / "done"
        self._lock = threading.Lock()
        for partial in folder.rglob("*.partial"):
            partial.unlink(missing_ok=True)
        if not (folder / "layout.json").exists():
            # Made whole or not at all: the layout is written last.
            shutil.rmtree(folder, ignore_errors=True)
            root = zarr.create_group(folder)
            for name, (shape, dtype) in arrays.items():
                root.create_array(
                    name,
                    shape=(groups, *shape),
                    chunks=(1, *shape),
                    dtype=dtype,
                    compressors=[ZstdCodec(level=1), Crc32cCodec()],
                )
            layout = {name: [list(shape), str(np.dtype(dtype))] for name, (shape, dtype) in arrays.items()}
            write_text(folder / "layout.json", json.dumps({"groups": groups, "arrays": layout}, indent=1))
        # Chunks of nothing but zeros are written too, so that a missing one is a lost one.
        root: Any = zarr.open_group(folder, mode="r+")
        self._arrays = {name: root[name].with_config({"write_empty_chunks": True}) for name in arrays}
        for name, (shape, dtype) in arrays.items():
            found = self._arrays[name]
            if (found.shape, found.chunks, found.dtype) != ((groups, *shape), (1, *shape), np.dtype(dtype)):
                raise ValueError(f"'{name}' has another shape or type than it was made with")
        self.done = self._read_journal()
        lost = [group for group in self.done if not self._has_chunks(group)]
        if lost:
            raise InputError(f"{folder}: {len(lost):,} groups are lost; delete this folder and run again")

    def _has_chunks(self, group: int) -> bool:
        return all(
            (self.folder / name / "c" / "/".join([str(group), *["0"] * (array.ndim - 1)])).exists()
            for name, array in self._arrays.items()
        )

    def _read_journal(self) -> set[int]:
        if not self._journal.exists():
            return set()
        text = self._journal.read_text()
        # A line that a killed run left unfinished has no end, and must not be gone on with.
        lines = text.split("\n")[:-1]
        if not text.endswith("\n") and text:
            write_text(self._journal, "".join(f"{line}\n" for line in lines))
        if lines == ["all"]:
            return set(range(self.groups))
        return {int(line) for line in lines if line.isdigit() and int(line) < self.groups}

    @property
    def missing(self) -> list[int]:
        """Groups that are not written yet."""
        return [group for group in range(self.groups) if group not in self.done]

    def write(self, group: int, **arrays: np.ndarray):
        """Writes all arrays of one group, then records that it is done."""
        try:
            for name, values in arrays.items():
                self._arrays[name][group] = values
            with self._lock, self._journal.open("a") as journal:
                journal.write(f"{group}\n")
                self.done.add(group)
        except OSError as error:
            raise InputError(
                f"{self.folder}: cannot be written: {error.strerror}; what is finished is kept, make room and run again"
            ) from None

    def finish(self):
        """Records that every group is there, in a form that does not depend on the order they came in."""
        if not self.missing:
            write_text(self._journal, "all\n")

    def read(self, name: str, group: int | slice = slice(None)) -> np.ndarray:
        """One group of an array, or all of them.

        Raises:
            InputError: if what is on disk is not what was written.
        """
        try:
            return np.asarray(self._arrays[name][group])
        except (ValueError, RuntimeError, OSError) as error:
            raise InputError(
                f"{self.folder}: '{name}' is damaged ({str(error).splitlines()[0]}); delete this folder and run again"
            ) from None

    @property
    def nbytes(self) -> int:
        """Bytes on disk."""
        return sum(file.stat().st_size for file in self.folder.rglob("*") if file.is_file())


def open_layer(folder: pathlib.Path) -> Layer:
    """A layer that exists already."""
    try:
        layout = json.loads((folder / "layout.json").read_text())
        arrays = {name: (tuple(shape), np.dtype(dtype)) for name, (shape, dtype) in layout["arrays"].items()}
        return Layer(folder, arrays, layout["groups"])
    except (OSError, ValueError, KeyError, TypeError):
        raise InputError(f"{folder}: this layer is missing or damaged; run precompute again") from None


def layers_of(material: Mapping) -> list[str]:
    """The names of the layers that a material's record in the header refers to."""
    named = [material.get("factors"), material.get("transport"), material.get("normal_map"), *material["weight"]]
    return [name for name in named if isinstance(name, str)]


def write_text(path: pathlib.Path, text: str):
    """Replaces a file's content at once or not at all."""
    partial = path.with_name(path.name + ".partial")
    partial.write_text(text, encoding="utf-8")
    partial.replace(path)


def write_header(folder: pathlib.Path, header: Mapping):
    """Writes what belongs together into `store.json`."""
    write_text(folder / "store.json", json.dumps({"format": FORMAT, **header}, indent=1))


def read_header(folder: pathlib.Path) -> dict:
    """The content of `store.json`.

    Raises:
        InputError: if there is none, it is damaged, or its format is another one.
    """
    path = folder / "store.json"
    try:
        header = json.loads(path.read_text(encoding="utf-8"))
    except OSError:
        raise InputError(f"{folder}: not a store, or its precomputation was not finished; run precompute") from None
    except ValueError:
        raise InputError(f"{path}: damaged; run precompute again, finished layers will be reused") from None
    if not isinstance(header, dict) or header.get("format") != FORMAT:
        found = header.get("format") if isinstance(header, dict) else None
        raise InputError(f"{path}: format {found} is not format {FORMAT}, which this version reads; precompute again")
    return header
