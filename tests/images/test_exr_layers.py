"""Which part and layer of an OpenEXR file is its picture, and how another one is named."""

import numpy as np
import pytest

from jaxrelight.errors import InputError
from jaxrelight.images import open_image, read_image
from jaxrelight.images.exr_layers import Wanted, choose_layer, split_choice
from tests.images import exr_writer
from tests.images.exr_writer import Part


def _names(*layers: str) -> list[str]:
    """Channels of layers, each given as its name and its channels: "diffuse:RGB", or ":RGB"."""
    return [
        f"{name}.{channel}" if name else channel
        for name, _, channels in (layer.rpartition(":") for layer in layers)
        for channel in channels
    ]


def _chosen(*parts: tuple[str, list[str]], wanted: Wanted | None = None) -> tuple[str, list[str], bool]:
    number, channels, note = choose_layer("a.exr", parts, wanted)
    return parts[number][0], channels, bool(note)


@pytest.mark.parametrize(
    ("layers", "picture"),
    [
        ((":RGB", "albedo:RGB", "Combined:RGB"), ""),
        (("albedo:RGB", "View.Combined:RGB", "View.Depth:Z"), "View.Combined"),
        (("Beauty:RGBA", "normal:XYZ", "diffuse:RGB"), "Beauty"),
        (("a_first:RGB", "rgba:RGBA"), "rgba"),
        (("DiffCol:RGB", "shot:RGB", "N:XYZ"), "shot"),
        (("diffuse_albedo:RGB", "main:RGB"), "main"),
        (("albedo:RGB", ":Y"), ""),
        (("sum:RGB", ":Y"), "sum"),
        (("albedo:RGB",), "albedo"),
    ],
)
def test_the_layer_that_is_the_picture(layers, picture):
    _, channels, _ = _chosen(("", _names(*layers)))
    assert channels[0].rpartition(".")[0] == picture


@pytest.mark.parametrize("last", [False, True])
@pytest.mark.parametrize(
    ("picture", "passes"),
    [
        ("Combined", ["albedo"]),
        ("beauty", ["normal", "position", "depth"]),
        ("", ["albedo", "N"]),
        ("rgba", ["shadow", "something"]),
        ("left", ["left.depth", "left.albedo"]),
    ],
)
def test_the_part_that_is_the_picture(picture, passes, last):
    parts = [(name, list("RGB")) for name in (*([] if last else [picture]), *passes, *([picture] if last else []))]
    assert _chosen(*parts) == (picture, list("RGB"), picture != "")


def test_parts_that_are_as_good_give_the_first():
    parts = [("left", list("RGB")), ("right", list("RGB"))]
    assert _chosen(*parts) == ("left", list("RGB"), True)


@pytest.mark.parametrize(
    "layers", [("one:RGB", "two:RGB"), ("diffuse:RGB", "specular:RGB"), ("A.Combined:RGB", "B.Combined:RGB")]
)
def test_layers_that_are_as_good_are_not_guessed_among(layers):
    with pytest.raises(InputError, match=r"several layers have colours, .*name one as FILE\.exr#layer:") as caught:
        _chosen(("", _names(*layers)))
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("choice", "part", "channels"),
    [
        ("layer:albedo", "one", "albedo.R albedo.G albedo.B"),
        ("layer:ALBEDO", "one", "albedo.R albedo.G albedo.B"),
        ("layer:View.Normal", "one", "View.Normal.X View.Normal.Y View.Normal.Z"),
        ("layer:normal", "one", "View.Normal.X View.Normal.Y View.Normal.Z"),
        ("layer:depth", "depth", "Z Z Z"),
        ("part:depth", "depth", "Z Z Z"),
        ("part:two", "two", "R G B A"),
        ("part:two,layer:coat", "two", "coat.R coat.G coat.B"),
        ("layer:two.coat", "two", "coat.R coat.G coat.B"),
        ("layer:two", "two", "R G B A"),
    ],
)
def test_layers_by_name(choice, part, channels):
    parts = [
        ("one", _names(":RGB", "albedo:RGB", "View.Normal:XYZ", "coat:RGB")),
        ("two", _names(":RGBA", "coat:RGB")),
        ("depth", ["Z"]),
    ]
    path, wanted = split_choice(f"sky.exr#{choice}")
    assert path == "sky.exr"
    assert _chosen(*parts, wanted=wanted) == (part, channels.split(), False)
    with pytest.raises(InputError, match=r"coat of part one and coat of part two .*#part:NAME,layer:NAME"):
        _chosen(*parts, wanted=Wanted(layer="coat"))
    with pytest.raises(InputError, match=r"no layer 'glow'; it has 'one', 'View.Normal', 'albedo', 'coat', 'two'"):
        _chosen(*parts, wanted=Wanted(layer="glow"))
    with pytest.raises(InputError, match="no part 'two' with layer 'albedo'"):
        _chosen(*parts, wanted=Wanted("two", "albedo"))


@pytest.mark.parametrize("path", ["a.exr", "a#b.exr", "a.exr#layer:", "a.exr#", "#layer:x"])
def test_paths_that_name_no_layer(path):
    assert split_choice(path) == (path, None)


def test_files(tmp_path):
    """A file of another writer, whose first part is a pass."""
    pixels = np.random.default_rng(0).random((5, 7, 6), np.float32)
    channels = exr_writer.planes(pixels[..., :3], "RGB")
    albedo = {f"albedo.{name}": pixels[..., 3 + i] for i, name in enumerate("RGB")}
    path = tmp_path / "a.exr"
    path.write_bytes(exr_writer.picture(Part(channels | albedo)))
    np.testing.assert_array_equal(read_image(path), pixels[..., :3])
    np.testing.assert_array_equal(read_image(f"{path}#layer:albedo"), pixels[..., 3:])
    assert open_image(path).envmap is None
    with pytest.raises(InputError, match=r"a\.exr: has no layer 'depth'; it has '\(unnamed\)', 'albedo'"):
        read_image(f"{path}#layer:depth")
    for value, layout in ((0, "latlong"), (1, "cube")):
        path.write_bytes(exr_writer.picture(Part(channels, attributes={"envmap": ("envmap", bytes([value]))})))
        assert open_image(path).envmap == layout
