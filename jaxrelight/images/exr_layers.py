"""Which channels of an OpenEXR file are its picture: of several parts and layers, the beauty pass.

A part has a name and channels; a channel is called `LAYER.R`, or `R` where it is of no layer. A path may name what it
wants: `sky.exr#layer:ViewLayer.Albedo`, `sky.exr#part:left` or `sky.exr#part:left,layer:albedo`.
"""

import dataclasses
import re
from collections.abc import Sequence

from jaxrelight.errors import InputError

_CHANNELS = {"red": "R", "green": "G", "blue": "B", "alpha": "A", "luminance": "Y"}  # what R, G, B … are also called
_BEAUTY = {"combined", "beauty", "rgba", "rgb", "default", "color", "colour", "composite", "final", "main", "picture"}
_BEAUTY |= {"image", "masterlayer", "ci", "c"}
# Words in the names of passes that are not the picture.
_PASS = re.compile(
    r"albedo|normals?|depth|positions?|points?|vectors?|motion|velocity|diffuse|diff|diff(col|dir|ind)|specular|spec|"
    r"gloss|glossy|gloss(col|dir|ind)|transmission|trans|trans(col|dir|ind)|subsurface|sss|volumes?|emission|emit|"
    r"emissive|environment|env|background|shadows?|ao|occlusion|mist|uv|st|ids?|index|crypto|cryptomatte|masks?|mattes?|"
    r"objects?|materials?|assets?|direct|indirect|reflections?|refractions?|coat|sheen|irradiance|lighting|variance|"
    r"noise|denoising|noisy|debug|samples|alpha|opacity|n|p|z"
)


@dataclasses.dataclass(frozen=True)
class Wanted:
    """What a path asks for; None for whatever there is."""

    part: str | None = None
    layer: str | None = None


@dataclasses.dataclass(frozen=True)
class _Candidate:
    """A layer that could be the picture.

    Attributes:
        part: number of its part.
        part_name: what that is called.
        layer: what comes before the last dot of its channels' names; empty for those without one.
        label: the layer's name; without one, that of its part where there are several.
        channels: names of its channels, three of colour and one of alpha where there is one.
        is_grey: whether one channel stands for all colours.
        is_picture: whether it has channels of colours; others, such as normals, are read only where they are named.
    """

    part: int
    part_name: str
    layer: str
    label: str
    channels: tuple[str, ...]
    is_grey: bool
    is_picture: bool = True

    @property
    def rank(self) -> int:
        """0 without a name, 1 with one of a beauty pass, 2 of another name, 3 with one of another pass."""
        if not self.label:
            return 0
        last = self.label.rpartition(".")[2]
        if last.casefold() in _BEAUTY:
            return 1
        # CamelCase, digits and underscores part words.
        words = re.findall(r"[a-z]+", re.sub(r"([a-z])([A-Z])", r"\1 \2", last).casefold())
        return 3 if any(_PASS.fullmatch(word) for word in (last.casefold(), *words)) else 2


def split_choice(text: str) -> tuple[str, Wanted | None]:
    """A path without what it names of a file, and that."""
    found = re.fullmatch(r"(?s)(.+?)#(?:part:(?P<part>.+?))??(?:(?:(?<=#)|,)layer:(?P<layer>.+))?", text)
    if found is None or (found["part"] is None and found["layer"] is None):
        return text, None
    return found[1], Wanted(found["part"], found["layer"])


def choose_layer(
    name: str, parts: Sequence[tuple[str, Sequence[str]]], wanted: Wanted | None
) -> tuple[int, list[str], str]:
    """The part and the channels that are the picture, and a note where that had to be guessed, or an empty line.

    Of layers of colours the one without a name is taken, else one that is called as beauty passes are, else the only
    one that is not called as another pass is (albedo, normals …). Where several parts have no named layers, their own
    names count. Where several are as good, the first part's is taken; of one part, none is. Colours go before grey.

    Args:
        name: what messages call the file.
        parts: name, and names of channels, of every part.
        wanted: what is asked for.

    Raises:
        InputError: there are no colours, nothing is called as wanted, or several layers of a part are as good.
    """
    everything = [layer for number, part in enumerate(parts) for layer in _layers(number, *part, len(parts) > 1)]
    if wanted is not None:
        layer = _named(name, everything, wanted)
        return layer.part, list(layer.channels), ""
    candidates = [layer for layer in everything if layer.is_picture]
    if not candidates:
        channels = [channel for _, names in parts for channel in names]
        if any({"Y", "RY", "BY"} <= {channel.upper() for channel in names} for _, names in parts):
            raise InputError(f"{name}: holds luminance and chroma (Y, RY, BY), which are not supported; export R, G, B")
        raise InputError(f"{name}: no colours among the channels {listed(channels)}; export R, G, B or Y")
    best = min(map(_order, candidates))
    chosen = [layer for layer in candidates if _order(layer) == best]
    first = chosen[0]
    if sum(layer.part == first.part for layer in chosen) > 1:
        names = [layer.label for layer in chosen if layer.part == first.part]
        raise InputError(
            f"{name}: several layers have colours, {listed(names)}, and none is unnamed or called 'Combined'; "
            f"name one as FILE.exr#layer:{names[0]}"
        )
    others = [layer.label or "(unnamed)" for layer in candidates if layer is not first]
    if not others or (first.rank == 0 and len(chosen) == 1):
        return first.part, list(first.channels), ""
    note = f"{name}: the picture is taken to be {first.label or '(unnamed)'!r}, not {listed(others)}"
    return first.part, list(first.channels), f"{note}; FILE.exr#layer:NAME takes another"


def _order(layer: _Candidate) -> tuple[bool, bool, int]:
    return layer.rank == 3, layer.is_grey, layer.rank


def _named(name: str, layers: Sequence[_Candidate], wanted: Wanted) -> _Candidate:
    """The layer that is asked for."""

    def fits(layer: _Candidate) -> list[bool]:
        """By how well it fits: in full, by the last word of its name."""
        part = layer.part_name.casefold()
        if wanted.part is not None and part != wanted.part.casefold():
            return [False, False]
        if wanted.layer is None:
            return [True, True]
        text, own = wanted.layer.casefold(), layer.layer.casefold()
        full = text in (own, f"{part}.{own}") if own else text == part
        return [full, full or own.rpartition(".")[2] == text]

    for level in (0, 1):
        if found := [layer for layer in layers if fits(layer)[level]]:
            if wanted.layer is None:
                return min(found, key=lambda layer: (not layer.is_picture, _order(layer)))
            if len(found) == 1:
                return found[0]
            what = " and ".join(f"{layer.layer or '(unnamed)'} of part {layer.part_name}" for layer in found)
            raise InputError(f"{name}: {what} are called {wanted.layer!r}; name one as FILE.exr#part:NAME,layer:NAME")
    words = [f"{kind} {value!r}" for kind, value in (("part", wanted.part), ("layer", wanted.layer)) if value]
    there = dict.fromkeys(layer.label or "(unnamed)" for layer in layers)
    raise InputError(f"{name}: has no {' with '.join(words)}; it has {listed(list(there))}")


def _layers(number: int, part_name: str, names: Sequence[str], several: bool) -> list[_Candidate]:
    """What a part holds that has colours, and what else can be named: vectors, and single channels."""
    by_layer: dict[str, dict[str, str]] = {}
    for name in sorted(names, reverse=True):  # so that R stands in for r where a layer has both
        layer, _, channel = name.rpartition(".")
        by_layer.setdefault(layer, {})[_CHANNELS.get(channel.lower(), channel.upper())] = name
    layers = []
    for layer, has in sorted(by_layer.items()):
        label = layer or (part_name if several else "")
        alpha = (has["A"],) if "A" in has else ()
        # Y beside X and Z is a vector; beside RY and BY it is the luminance of a colour image.
        if {"R", "G", "B"} <= set(has):
            colours, is_grey, is_picture = tuple(has[c] for c in "RGB"), False, True
        elif "Y" in has and not set(has) & {"X", "Z", "RY", "BY"}:
            colours, is_grey, is_picture = (has["Y"],) * 3, True, True
        elif {"X", "Y", "Z"} <= set(has):
            colours, is_grey, is_picture = tuple(has[c] for c in "XYZ"), False, False
        elif len(set(has) - {"A"}) == 1:
            colours, is_grey, is_picture = (next(has[c] for c in has if c != "A"),) * 3, True, False
        else:
            continue
        layers.append(_Candidate(number, part_name, layer, label, (*colours, *alpha), is_grey, is_picture))
    return layers


def listed(names: Sequence[str], most: int = 12) -> str:
    """Names in quotes, not too many of them."""
    more = f" and {len(names) - most} more" if len(names) > most else ""
    return ", ".join(repr(name) for name in names[:most]) + more
