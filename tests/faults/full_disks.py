"""Disks that fill up while a store or a picture is written: small file systems in memory, where they may be mounted."""

import contextlib
import functools
import pathlib
import shutil
import subprocess
import tempfile
from collections.abc import Iterator

from tests.commands.running import run
from tests.faults import stores
from tests.faults.stores import Sound

SHARES = 0.02, 0.2, 0.4, 0.6, 0.8, 0.95
PICTURES = "out.exr", "out.hdr", "out.png"
_PAGE = 4096


@contextlib.contextmanager
def disk(nbytes: int) -> Iterator[pathlib.Path]:
    """A folder that holds so many bytes."""
    with tempfile.TemporaryDirectory() as folder:
        _mount("-t", "tmpfs", "-o", f"size={nbytes}", "tmpfs", folder)
        try:
            yield pathlib.Path(folder)
        finally:
            subprocess.run(["umount", folder], check=True)


def _mount(*arguments: str) -> None:
    subprocess.run(["mount", *arguments], check=True, capture_output=True, text=True)


@functools.cache
def hindrance() -> str:
    """Why no disk can be mounted here; nothing if one can."""
    if shutil.which("mount") is None:
        return "there is no command to mount file systems"
    try:
        with disk(_PAGE):
            return ""
    except subprocess.CalledProcessError as fault:
        return f"file systems cannot be mounted: {fault.stderr.strip()}"


def wrong_with_store(share: float, sound: Sound) -> str:
    """What is wrong when a store is precomputed onto a disk that holds a share of it, and again after room was made."""
    whole = _contents(sound.folder / "store")
    pages = sum(-(-len(content) // _PAGE) for content in whole.values())
    with disk(max(int(share * pages), 1) * _PAGE) as folder:
        precompute = stores.precompute(sound, folder / "store")
        status, out, err = run(*precompute)
        if status != 1 or out or len(err.splitlines()) != 1 or not err.startswith(f"jaxrelight: {folder}"):
            return f"ended with {status}, {out!r}, {err!r}"
        if "No space left on device; what is finished is kept, make room and run again" not in err:
            return f"does not say what to do: {err!r}"
        if not (kept := _contents(folder / "store")).items() <= whole.items():
            return f"left what is not whole: {sorted(name for name in kept if kept[name] != whole.get(name))}"
        _mount("-o", f"remount,size={2 * pages * _PAGE}", str(folder))
        before = {name: (folder / "store" / name).stat().st_ino for name in kept}
        status, _, err = run(*precompute)
        if status:
            return f"did not go on: {err!r}"
        if any((folder / "store" / name).stat().st_ino != number for name, number in before.items()):
            return "what was finished was made again"
        return "" if _contents(folder / "store") == whole else "ended with another store"


def wrong_with_picture(name: str, sound: Sound) -> str:
    """What is wrong when a picture is written onto a full disk, where another one lies."""
    with disk(_PAGE) as folder:
        picture = folder / name
        picture.write_bytes(b"older")
        status, out, err = run("relight", sound.folder / "store", "-o", picture)
        if status != 1 or out or len(err.splitlines()) != 1 or f"{picture}: cannot be written" not in err:
            return f"ended with {status}, {out!r}, {err!r}"
        left = [path.name for path in folder.iterdir()]
        return "" if left == [name] and picture.read_bytes() == b"older" else f"left {left}"


def _contents(folder: pathlib.Path) -> dict[str, bytes]:
    return {str(path.relative_to(folder)): path.read_bytes() for path in folder.rglob("*") if path.is_file()}
