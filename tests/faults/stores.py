"""Stores with one damage each, and what commands make of them: one line, or the picture of the sound store."""

import os
import pathlib
import re
import shutil
import time
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import dataclass

import numpy as np

from jaxrelight.images import write_image
from tests.commands.running import run
from tests.faults import scenes

_CAMERA = """
[camera]
origin = [0, 1, 3]
target = [0, 0.1, 0]
width = 10
height = 8
[environment]
file = "sky.exr"
"""
# Textured, bumpy, diffuse and glossy, of which one emits: layers of all kinds, two groups in some.
SCENE = (
    _CAMERA
    + """
[material.wood]
type = "lambert"
albedo = "wood.png"
normal_map = "bumps.png"
[material.gloss]
type = "phong"
diffuse = 0.1
specular = 0.3
exponent = 5
emission = 0.1
[[mesh]]
primitive = "plane"
size = [2, 2]
resolution = 12
material = "wood"
[[mesh]]
primitive = "sphere"
radius = 0.4
resolution = 2
material = "gloss"
"""
)
# Every kind of layer has files in it that the other store has not: shapes, numbers of groups and contents differ.
OTHER = (
    SCENE.replace("resolution = 12", "resolution = 3")
    .replace("height = 8", "height = 60")
    .replace("diffuse = 0.1", "diffuse = 0.2\nterms = 3")
    .replace('"sky.exr"', '"small.exr"')
    .replace('"wood.png"', '"small.exr"')
)
_DIALS = ("--resolution", 4, "--coefficients", 8, "--factor-resolution", 8, "--terms", 2)
# Nothing is kept but visibility, from which every light bakes anew.
EXACT = ("--receivers", "pixels", "--coefficients", "all")
BOUNCED = ("--coefficients", "shared", "--bits", 8, "--bounces", 1, "--gather-resolution", 4, "--receiver-tolerance", 0)
# Glossy lobes as rows of factors, or as filtered visibility.
_FACTORS = "--receivers", "vertices", "--receiver-tolerance", 0, "--reflection", "factors"
FILTERED = "--receivers", "vertices", "--receiver-tolerance", 0
# The last groups are of a diffuse material, and are not read.
FILTERED_FILES = "filtered/layout.json", "filtered/first group"
_KINDS = "environment", "factors", "geometry", "texture", "transport", "visibility"
EXACT_FILES = "visibility/layout.json", "visibility/last group"
# Local lights, and points that they light.
INDIRECT = ("--lighting", "indirect", "--gather-samples", 64, "--bounces", 2)
_LAMP = '[[light]]\ntype = "point"\nposition = [0, 1, 0.5]\nintensity = 2'
_OTHER_LAMP = _LAMP.replace("point", "spot") + "\ntarget = [0, 0, 0]\ncutoff = 40"
BOUNCED_FILES = "bounced/layout.json", "bounced/last group", "transport/last group"
_CLOUD_KINDS = "cloud", "albedo", "between", "indirect", "lights"
INDIRECT_FILES = tuple(f"{kind}/{name}" for kind in _CLOUD_KINDS for name in ("layout.json", "last group"))
FILES = ("store.json", *(f"{kind}/{name}" for kind in _KINDS for name in ("layout.json", "last group")))

Harm = Callable[[pathlib.Path, pathlib.Path], object]


@dataclass(frozen=True)
class Sound:
    """Stores that nothing is wrong with.

    Attributes:
        folder: where they lie, `store` and `other`, beside their scenes.
        options: that `store` was made with.
        picture: what it gives.
    """

    folder: pathlib.Path
    options: tuple
    picture: bytes


@dataclass(frozen=True)
class Damage:
    """What is done to a copy of a store, and what is promised of it.

    Attributes:
        name: what is done to which file.
        harm: does it, given the copy and the other store.
        relit: whether the store can still be lit: it reads nothing of what is damaged.
        told: whether `info` ends well, because nothing that belongs to the store is damaged.
        mended: whether precomputing makes it whole; else it says in one line what stands in the way.
    """

    name: str
    harm: Harm
    relit: bool = False
    told: bool = False
    mended: bool = True


def prepare(folder: pathlib.Path, *options) -> Sound:
    """A sound store, another of a like scene, and the first one's picture."""
    scenes.prepare(folder)
    write_image(folder / "small.exr", np.random.default_rng(1).random((4, 8, 3)))
    lamps = (_LAMP, _OTHER_LAMP) if options == INDIRECT else ("", "")
    for name, text, lamp in zip(("store", "other"), (SCENE, OTHER), lamps, strict=True):
        dials = _dials(options)
        if lamp:
            text = re.sub(r"\[environment\]\nfile = .*\n", "", text) + lamp
            # Other shapes of all that has a row for each point.
            dials = tuple(256 if name == "other" and dial == 64 else dial for dial in dials)
        (folder / f"{name}.toml").write_text(text)
        _succeed("precompute", folder / f"{name}.toml", "-o", folder / name, *dials)
    _succeed("relight", folder / "store", "-o", folder / "sound.exr")
    return Sound(folder, options, (folder / "sound.exr").read_bytes())


def damages_to(file: str, sound: Sound) -> Iterator[Damage]:
    """Every damage to one file of a store, one of `FILES`."""
    for name, harm in _HARMS.items():
        # Of visibility, all must be there; it is read by whoever bakes.
        unread = file == "visibility/last group" and sound.options != EXACT and name != "removed"
        yield Damage(f"{file} {name}", _on(file, harm), relit=unread, mended=name != "replaced by a folder")


def wrong(damages: Iterable[Damage], sound: Sound) -> list[str]:
    """Those that do not end as promised, and how."""
    outcomes = ((damage.name, wrong_with(damage, sound)) for damage in damages)
    return [f"{name}: {fault}" for name, fault in outcomes if fault]


def wrong_with(damage: Damage, sound: Sound) -> str:
    """What is wrong about how commands end on a damaged copy; nothing if all is as promised."""
    copy, picture = sound.folder / "copy", sound.folder / "out.exr"
    shutil.copytree(sound.folder / "store", copy, symlinks=True)
    before = _files(copy)
    try:
        damage.harm(copy, sound.folder / "other")
        wrong = _relighting(copy, picture, sound, damage.relit)
        wrong = wrong or _ends(damage.told, copy, "info", copy)
        damaged = _files(copy)
        wrong = wrong or _ends(damage.mended, copy, *precompute(sound, copy))
        if not wrong and damage.mended:
            wrong = _mending(before, damaged, _files(copy)) or _relighting(copy, picture, sound, True)
        return wrong
    except Exception as fault:
        return f"raised {type(fault).__name__}: {fault}"
    finally:
        shutil.rmtree(copy)
        picture.unlink(missing_ok=True)


def precompute(sound: Sound, store: pathlib.Path) -> tuple:
    """The command that makes the sound store at another place."""
    return ("precompute", sound.folder / "store.toml", "-o", store, *_dials(sound.options))


def _dials(options: tuple) -> tuple:
    if options == INDIRECT:
        return options
    return (*_DIALS, *options) if "--receivers" in options else (*_DIALS, *options, *_FACTORS)


def _relighting(copy: pathlib.Path, picture: pathlib.Path, sound: Sound, good: bool) -> str:
    wrong = _ends(good, copy, "relight", copy, "-o", picture)
    if wrong or picture.exists() != good:
        return wrong or "relight: a picture was written, or was not"
    return "relight: another picture" if good and picture.read_bytes() != sound.picture else ""


def _ends(good: bool, copy: pathlib.Path, command: str, *arguments) -> str:
    """What is wrong about how a command ends: well, or with one line that names the store and what to do."""
    status, out, err = run(command, *arguments)
    told = [line for line in err.splitlines() if not line.startswith("note: ")]
    if good:
        return "" if status == 0 and not told else f"{command}: ended with {status}: {err}"
    if status != 1 or out or len(told) != 1 or not told[0].startswith(f"jaxrelight: {copy}"):
        return f"{command}: ended with {status}, {out!r}, {err!r}"
    return "" if "precompute" in err or "run again" in err else f"{command}: says nothing of what to do: {err!r}"


def _mending(before: Mapping, damaged: Mapping, after: Mapping) -> str:
    """Whether a store is what it was, and nothing was written anew that was sound."""
    if missing := [name for name in before if after.get(name, (b"",))[0] != before[name][0]]:
        return f"precompute: not mended: {', '.join(missing)}"
    anew = [name for name in before if damaged.get(name, (b"",))[0] == before[name][0] and damaged[name] != after[name]]
    return f"precompute: thrown away: {', '.join(anew)}" if [name for name in anew if name != "store.json"] else ""


def _files(folder: pathlib.Path) -> dict[str, tuple[bytes, int]]:
    """The content of every file that can be read, and which file it is on the disk."""
    paths = (path for path in folder.rglob("*") if path.is_file() and os.access(path, os.R_OK))
    return {str(path.relative_to(folder)): (path.read_bytes(), path.stat().st_ino) for path in paths}


def _succeed(*arguments) -> None:
    status, _, err = run(*arguments)
    assert status == 0, err


# ---- damage to one file ----------------------------------------------------------------------------------------------


def _layer(store: pathlib.Path, kind: str) -> pathlib.Path:
    """The layer of a kind that has most groups."""
    return max(sorted(store.glob(f"{kind}-*")), key=lambda layer: len(list(layer.iterdir())))


def _on(file: str, harm: Harm) -> Harm:
    def apply(copy: pathlib.Path, other: pathlib.Path):
        kind, _, name = file.partition("/")
        if not name:
            return harm(copy / file, other / file)
        chosen = {"last group": max, "first group": min}.get(name)
        victim = _layer(copy, kind) / name if chosen is None else chosen(_layer(copy, kind).glob("0*"))
        names = name if chosen is None else "0*"
        like = (path for layer in other.glob(f"{kind}-*") for path in layer.glob(names))
        return harm(victim, next(path for path in like if path.read_bytes() != victim.read_bytes()))

    return apply


def _change(change: Callable[[bytes], bytes]) -> Harm:
    def harm(path: pathlib.Path, _):
        path.write_bytes(change(path.read_bytes()))

    return harm


def _flip(share: float) -> Harm:
    def flipped(content: bytes) -> bytes:
        at = int(share * (len(content) - 1))
        return content[:at] + bytes([content[at] ^ 4]) + content[at + 1 :]

    return _change(flipped)


def _fold(path: pathlib.Path, _):
    path.unlink()
    path.mkdir()


def _link_to_itself(path: pathlib.Path, _):
    path.unlink()
    path.symlink_to(path.name)


_HARMS: dict[str, Harm] = {
    "removed": lambda path, _: path.unlink(),
    "emptied": _change(lambda _: b""),
    "cut in half": _change(lambda content: content[: len(content) // 2]),
    "cut by a byte": _change(lambda content: content[:-1]),
    "longer by a byte": _change(lambda content: content + b"\0"),
    "zeroed": _change(lambda content: bytes(len(content))),
    "with a bit flipped at its start": _flip(0),
    "with a bit flipped in its middle": _flip(0.5),
    "with a bit flipped at its end": _flip(1),
    "replaced by a folder": _fold,
    "a link to itself": _link_to_itself,
    "of another store": lambda path, other: path.write_bytes(other.read_bytes()),
}
if hasattr(os, "geteuid") and os.geteuid() != 0:  # whom nothing is forbidden
    _HARMS["without permission"] = lambda path, _: path.chmod(0)


# ---- damage to the store as a whole ----------------------------------------------------------------------------------


def _header(**changed) -> Harm:
    """A header that is whole, but says something else."""

    def harm(copy: pathlib.Path, _):
        from jaxrelight.files import store

        header = store.read_header(copy)
        store._write_sealed(copy / "store.json", header | changed)

    return harm


def _swap_groups(copy: pathlib.Path, _):
    one, other = sorted(_layer(copy, "transport").glob("0*"))[:2]
    one.rename(copy / "kept")
    other.rename(one)
    (copy / "kept").rename(other)


def _leave_half(old: bool, lost: bool) -> Harm:
    """As a killed run does: half of a group under another name, and the group itself not there if it is `lost`."""

    def harm(copy: pathlib.Path, _):
        group = max(_layer(copy, "visibility").glob("0*"))
        for path in (group, copy / "store.json"):
            half = path.with_name(f".{path.name}.0123")
            half.write_bytes(path.read_bytes()[: path.stat().st_size // 2])
            if old:
                os.utime(half, (time.time() - 1000, time.time() - 1000))
        if lost:
            group.unlink()

    return harm


def _replace_layer(copy: pathlib.Path, _):
    layer = _layer(copy, "transport")
    shutil.rmtree(layer)
    layer.write_text("a layer\n")


def _exchange_layers(copy: pathlib.Path, _):
    """Two materials' transport under each other's name."""
    one, other = sorted(copy.glob("transport-*"))[:2]
    one.rename(copy / "kept")
    other.rename(one)
    (copy / "kept").rename(other)


def _outside(copy: pathlib.Path, other: pathlib.Path):
    """A header that leads out of the store."""
    _header(geometry=f"../other/{_layer(other, 'geometry').name}")(copy, other)


def _add_strangers(copy: pathlib.Path, other: pathlib.Path):
    (copy / "notes.txt").write_text("mine")
    (_layer(copy, "transport") / "999999").write_bytes(b"a group too many")
    shutil.copytree(_layer(other, "transport"), copy / "transport-copied")


WHOLE = (
    *(Damage(f"{kind} removed", lambda copy, _, kind=kind: shutil.rmtree(_layer(copy, kind))) for kind in _KINDS),
    Damage("header of format 2", _header(format=2)),
    Damage("header of a later format", _header(format=99)),
    Damage("header without a format", lambda copy, _: (copy / "store.json").write_text("{}")),
    Damage("header that is a list", lambda copy, _: (copy / "store.json").write_text("[]")),
    Damage("header without materials", _header(materials=[])),
    Damage("header of unknown dials", _header(method={"name": "transport", "dials": {"unknown": 1}})),
    Damage("header of dials out of range", _header(method={"name": "transport", "dials": {"resolution": 7}})),
    Damage("header of an unknown method", _header(method={"name": "unknown", "dials": {}})),
    Damage("header of a method without stores", _header(method={"name": "adaptive", "dials": {}})),
    Damage("header of another method", _header(method={"name": "indirect", "dials": {}})),
    Damage("header without a camera", _header(camera=None)),
    Damage("header that names no layer there is", _header(geometry=f"geometry-{'0' * 16}")),
    Damage("header that names another kind", _header(visibility=f"geometry-{'0' * 16}")),
    Damage("header that leads out of the store", _outside),
    Damage("header that leads to the root", _header(geometry="/")),
    Damage("groups exchanged", _swap_groups),
    Damage("layers exchanged", _exchange_layers),
    Damage("layer that is a file", _replace_layer, mended=False),
    Damage("halves of a run killed just now", _leave_half(False, False), relit=True, told=True),
    Damage("halves of a run killed long ago", _leave_half(True, False), relit=True, told=True),
    Damage("half of a group, and no group", _leave_half(False, True)),
    Damage("files and folders of others", _add_strangers, relit=True, told=True),
)
