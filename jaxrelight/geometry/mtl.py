"""MTL libraries: what OBJ files say of materials."""

import dataclasses
import pathlib

import numpy as np

from jaxrelight.geometry.file_materials import FileMaterial, FilePicture, Microfacets
from jaxrelight.geometry.file_references import find_file

# Options of images by how many words follow them at most; those that are passed over change nothing that is looked up.
_PLACING = {"-s": 3, "-o": 3, "-clamp": 1, "-bm": 1}
_HARMLESS = {"-blendu": 1, "-blendv": 1, "-boost": 1, "-texres": 1, "-type": 1, "-colorspace": 1}
_LEFT_OUT = {"-cc": 1, "-mm": 2, "-t": 3, "-imfchan": 1}
_PICTURES = {
    "map_kd": "diffuse_picture",
    "map_ks": "specular_picture",
    "map_ke": "emission_picture",
    "norm": "normal_picture",
    "map_bump": "bump_picture",
    "bump": "bump_picture",
}
# Illumination models without highlights.
_NO_HIGHLIGHTS = 0, 1


@dataclasses.dataclass
class _Statements:
    """A material as it is read, before its statements are put together."""

    material: FileMaterial
    illum: int | None = None
    metallic: float | None = None
    roughness: float | None = None
    opacity_notes: list[str] = dataclasses.field(default_factory=list)


def read_mtl(text: str, folder: pathlib.Path) -> dict[str, FileMaterial]:
    """The materials of an MTL library, by name.

    Read are Kd, Ks, Ns, Ke, illum, the images map_Kd, map_Ks, map_Ke, norm, bump and map_Bump with their options -s,
    -o, -clamp and -bm, and of the extension for physically based materials Pm and Pr. Ks is taken as the share that is
    reflected about the mirror direction; there is no highlight by the illumination models 0 and 1, or where Ns is 0.
    What changes the look and is not read is noted.

    Args:
        text: of the library.
        folder: of the library, from which its images are looked for.
    """
    read: dict[str, _Statements] = {}
    mine = _Statements(FileMaterial())
    for line in text.lstrip("\ufeff").splitlines():
        key, rest = [*line.split(None, 1), "", ""][:2]
        key, rest = key.lower(), rest.strip()
        if not key or key.startswith("#"):
            continue
        try:
            if key == "newmtl":
                mine = read.setdefault(rest, _Statements(FileMaterial((0.8, 0.8, 0.8))))
            elif key in _PICTURES:
                _read_picture(mine.material, _PICTURES[key], rest, folder)
            else:
                _read_numbers(mine, key, rest.split("#", 1)[0].split())
        except (ValueError, IndexError):
            mine.material.notes.append(f"line {line.strip()[:60]!r} of the library is not understood and was left out")
    return {name: _finished(statements) for name, statements in read.items()}


def _read_numbers(mine: _Statements, key: str, words: list[str]) -> None:
    material = mine.material
    if key == "kd":
        material.diffuse = _colour(words, 1.0)
    elif key == "ks":
        material.specular = _colour(words, 1.0)
    elif key == "ke":
        material.emission = _colour(words, np.inf)
    elif key == "ns":
        material.exponent = min(max(_finite(words[0]), 0.0), 1e5)
    elif key == "illum":
        mine.illum = int(words[0])
    elif key == "pm":
        mine.metallic = min(max(_finite(words[0]), 0.0), 1.0)
    elif key == "pr":
        mine.roughness = min(max(_finite(words[0]), 0.0), 1.0)
    elif (
        key in ("map_d", "map_tr")
        or (key == "d" and _finite(words[-1]) < 1)
        or (key == "tr" and _finite(words[-1]) > 0)
    ):
        mine.opacity_notes.append("transparency is left out; it is opaque")
    elif key in ("disp", "map_disp"):
        material.notes.append("displacement maps are left out")
    elif key in ("map_pr", "map_pm", "map_ps", "ps", "pc", "aniso"):
        material.notes.append(f"'{key}' of the library is left out")
    elif key == "map_ns":
        material.notes.append("the image of exponents is left out; Ns holds everywhere")


def _finished(mine: _Statements) -> FileMaterial:
    """The material that the statements make together."""
    material = mine.material
    if mine.roughness is not None or mine.metallic is not None:
        roughness = 0.5 if mine.roughness is None else mine.roughness
        microfacets = Microfacets(material.diffuse, mine.metallic or 0.0, roughness, material.diffuse_picture)
        material = microfacets.applied_to(material)
    elif max(material.specular) > 0 and mine.illum in _NO_HIGHLIGHTS:
        material.specular, material.specular_picture = (0.0, 0.0, 0.0), None
    elif max(material.specular) > 0 and material.exponent <= 0:
        material.specular, material.specular_picture = (0.0, 0.0, 0.0), None
        material.notes.append("its highlight has no exponent (Ns 0) and is left out")
    if material.emission_picture is not None and max(material.emission) <= 0:
        material.emission = (1.0, 1.0, 1.0)
    material.notes += dict.fromkeys(mine.opacity_notes)
    return material


def _read_picture(material: FileMaterial, name: str, rest: str, folder: pathlib.Path) -> None:
    """An image with its options, which may stand before or after its name."""
    options, file = _split_options(rest)
    if not file:
        raise ValueError("no file")
    path, note = find_file(file, folder)
    material.notes += [note] if note else []
    ignored = [option for option in options if option in _LEFT_OUT or option not in {**_PLACING, **_HARMLESS}]
    if ignored:
        material.notes.append(f"options {' '.join(ignored)} of the image {path.name} are left out")
    su, sv = _pair(options.get("-s", []), 1.0)
    ou, ov = _pair(options.get("-o", []), 0.0)
    placed = (su, sv, ou, ov) != (1.0, 1.0, 0.0, 0.0)
    clamped = options.get("-clamp", ["off"])[:1] == ["on"]
    picture = FilePicture(
        path,
        placement=((su, 0.0, ou), (0.0, sv, ov)) if placed else None,
        wrap=("clamp", "clamp") if clamped else ("repeat", "repeat"),
    )
    if name in ("bump_picture", "normal_picture") and "-bm" in options:
        material.normal_scale = _finite(options["-bm"][0])
    setattr(material, name, picture)


def _split_options(rest: str) -> tuple[dict[str, list[str]], str]:
    """Options with their words, and the name of the file, which may contain spaces."""
    words, options, name = rest.split(" "), {}, []
    at = 0
    counts = {**_PLACING, **_HARMLESS, **_LEFT_OUT}
    while at < len(words):
        word = words[at]
        at += 1
        known = word.lower() in counts
        if not word and not name:
            continue
        if not known and (name or not word.startswith("-")):
            name.append(word)
            continue
        values: list[str] = []
        while at < len(words) and len(values) < counts.get(word.lower(), 3):
            if words[at] and not (_is_setting(words[at]) or (word.lower() in ("-imfchan", "-type", "-colorspace"))):
                break
            values += [words[at]] if words[at] else []
            at += 1
        options[word.lower()] = values
    return options, " ".join(name).strip()


def _pair(words: list[str], otherwise: float) -> tuple[float, float]:
    """The first two of up to three numbers, of which any may be left out from the end."""
    numbers = [_finite(word) for word in words]
    if not numbers:
        return otherwise, otherwise
    return numbers[0], numbers[1] if len(numbers) > 1 else otherwise


def _is_setting(word: str) -> bool:
    try:
        float(word)
    except ValueError:
        return word.lower() in ("on", "off")
    return True


def _finite(word: str) -> float:
    number = float(word)
    if not np.isfinite(number):
        raise ValueError("not finite")
    return number


def _colour(words: list[str], most: float) -> tuple[float, float, float]:
    numbers = [min(max(_finite(word), 0.0), most) for word in words[:3]]
    red, green, blue = numbers * 3 if len(numbers) == 1 else numbers
    return red, green, blue
