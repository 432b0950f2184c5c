import contextlib
import struct

import numpy as np
import OpenEXR
import pytest

from jaxrelight.errors import InputError
from jaxrelight.images import read_image
from jaxrelight.images.exr import read_exr, write_exr
from tests.shared_data import shared

LIMIT = 2**27
WINDOW = b"dataWindow\0box2i\0" + struct.pack("<i", 16)


def _pixels(channels=4, height=20, width=30):
    return np.random.default_rng(0).random((height, width, channels), np.float32)


def _write(path, channels, **header):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage} | header
    OpenEXR.File(header, channels).write(str(path))
    return path


def _planes(pixels, names):
    return {name: np.ascontiguousarray(pixels[..., i]) for i, name in enumerate(names)}


@pytest.fixture
def path(tmp_path):
    return tmp_path / "image.exr"


@pytest.mark.parametrize("channels", [3, 4])
def test_round_trip_is_exact(path, channels):
    pixels = _pixels(channels)
    pixels[0, :6, 0] = [1e5, 3e38, 1e-40, -6.6, np.inf, -np.inf]
    pixels[1, 1, 1] = np.nan
    write_exr(path, pixels)
    back = read_exr(path, LIMIT)
    assert back.dtype == np.float32
    np.testing.assert_array_equal(back, pixels)


def test_strided_and_double_arrays_are_written(path):
    pixels = _pixels(3)
    write_exr(path, pixels[::-1, ::-2].astype(np.float64))
    np.testing.assert_array_equal(read_exr(path, LIMIT), pixels[::-1, ::-2])


@pytest.mark.parametrize(
    "names", ["RGB", "RGBA", ["ViewLayer.Combined." + c for c in "RGBA"], ["left.x." + c for c in "RGB"]]
)
def test_colours_are_found_by_name(path, names):
    pixels = _pixels(len(names))
    _write(path, _planes(pixels, names) | {"Depth.Z": pixels[..., 0].copy()})
    np.testing.assert_array_equal(read_exr(path, LIMIT), pixels)


def test_unnamed_layer_and_combined_come_first(path):
    pixels, other = _pixels(3), np.zeros((20, 30, 3), np.float32)
    albedo = _planes(other, ["A.albedo.R", "A.albedo.G", "A.albedo.B"])
    _write(path, albedo | _planes(pixels, "RGB"))
    np.testing.assert_array_equal(read_exr(path, LIMIT), pixels)
    _write(path, albedo | _planes(pixels, ["A.Combined.R", "A.Combined.G", "A.Combined.B"]))
    np.testing.assert_array_equal(read_exr(path, LIMIT), pixels)


def test_several_layers_are_not_guessed_among(path):
    layers = [f"{layer}.{c}" for layer in ("direct", "indirect") for c in "RGB"]
    with pytest.raises(InputError, match=r"several layers have colours, 'direct', 'indirect'"):
        read_exr(_write(path, _planes(_pixels(6), layers)), LIMIT)


def test_luminance_becomes_grey(path):
    pixels = _pixels(2)
    _write(path, _planes(pixels, "YA"))
    np.testing.assert_array_equal(read_exr(path, LIMIT), pixels[..., [0, 0, 0, 1]])


@pytest.mark.parametrize("names", ["RG", "XYZ", ["Y", "RY", "BY"], "Z", ["N.X", "N.Y", "N.Z"]])
def test_channels_without_colours_are_named(path, names):
    with pytest.raises(InputError, match="no colours among the channels") as caught:
        read_exr(_write(path, _planes(_pixels(len(names)), names)), LIMIT)
    assert all(repr(name) in str(caught.value) for name in names)


def test_half_and_mixed_precision(path):
    pixels = _pixels(3).astype(np.float16)
    planes = _planes(pixels, "RGB")
    planes["G"] = planes["G"].astype(np.float32)
    back = read_exr(_write(path, planes), LIMIT)
    assert back.dtype == np.float32
    np.testing.assert_array_equal(back, pixels.astype(np.float32))


def test_integer_channels_are_refused(path):
    with pytest.raises(InputError, match="channel R holds integers"):
        read_exr(_write(path, _planes((_pixels(3) * 9).astype(np.uint32), "RGB")), LIMIT)


def test_first_part_with_colours(path):
    pixels = _pixels(3)
    header = {"type": OpenEXR.scanlineimage}
    depth = OpenEXR.Part(header | {"name": "depth"}, {"Z": pixels[..., 0].copy()})
    OpenEXR.File([depth, OpenEXR.Part(header | {"name": "beauty"}, {"RGB": pixels})]).write(str(path))
    np.testing.assert_array_equal(read_exr(path, LIMIT), pixels)


def test_tiles(path):
    pixels = _pixels(3)
    _write(path, {"RGB": pixels}, type=OpenEXR.tiledimage, tiles=OpenEXR.TileDescription())
    np.testing.assert_array_equal(read_exr(path, LIMIT), pixels)


@pytest.mark.parametrize("corner", [(0, 0), (5, 6), (-4, -3), (-35, 2), (50, 0)])
def test_data_window_is_placed_in_the_display_window(path, corner):
    pixels = _pixels(3)
    x, y = corner
    data_window = (np.array([x, y], np.int32), np.array([x + 29, y + 19], np.int32))
    display_window = (np.array([0, 0], np.int32), np.array([39, 24], np.int32))
    _write(path, {"RGB": pixels}, dataWindow=data_window, displayWindow=display_window)
    everything = np.zeros((200, 200, 3), np.float32)
    everything[100 + y : 120 + y, 100 + x : 130 + x] = pixels
    np.testing.assert_array_equal(read_exr(path, LIMIT), everything[100:125, 100:140])


@pytest.mark.parametrize("tiled", [False, True])
def test_cut_anywhere_is_refused_quietly(path, tiled, capfd):
    _write(
        path, {"RGB": _pixels(3)}, **({"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()} if tiled else {})
    )
    whole = path.read_bytes()
    for length in [0, *np.linspace(1, len(whole) - 1, 40).astype(int)]:
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match=r"image\.exr: .*; "):
            read_exr(path, LIMIT)
    assert capfd.readouterr() == ("", "")


def test_damage_is_refused_or_read_never_worse(path):
    write_exr(path, _pixels())
    whole = path.read_bytes()
    random = np.random.default_rng(1)
    for _ in range(200):
        damaged = bytearray(whole)
        for position in random.integers(0, random.choice([400, len(whole)]), 3):
            damaged[position] = random.integers(256)
        path.write_bytes(damaged)
        with contextlib.suppress(InputError):
            assert read_exr(path, 2**20).dtype == np.float32


@pytest.mark.parametrize("size", [(65536, 65536), (10_000, 10_000), (2**30, 2**30), (2**23, 16), (0, 5)])
def test_a_lying_header_is_refused_before_memory_is_taken(path, size):
    resource = pytest.importorskip("resource")
    write_exr(path, _pixels())
    whole = path.read_bytes()
    at = whole.index(WINDOW) + len(WINDOW)
    path.write_bytes(whole[:at] + struct.pack("<4i", 0, 0, size[0] - 1, size[1] - 1) + whole[at + 16 :])
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError):
        read_exr(path, LIMIT)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # KiB


def test_the_limit_counts_pixels_and_channels(path):
    _write(path, _planes(_pixels(12), [*"RGB", *(f"id.{i}" for i in range(9))]))
    assert read_exr(path, 3 * 600).shape == (20, 30, 3)
    with pytest.raises(InputError, match="12 channels of 30x20 pixels"):
        read_exr(path, 3 * 600 - 1)
    with pytest.raises(InputError, match="30x20 pixels, more than the limit of 599"):
        read_exr(path, 599)


def test_another_kind_of_file_is_named(path):
    path.write_bytes(b"\x89PNG\r\n\x1a\n")
    with pytest.raises(InputError, match="not an OpenEXR file"):
        read_exr(path, LIMIT)


@pytest.mark.parametrize(("name", "brightest"), [("blender_city", 33_952), ("blender_sunset", 6_520)])
def test_published_panoramas_keep_their_suns(name, brightest):
    pixels = read_image(shared("data", "env", f"{name}.exr"))
    assert pixels.shape == (512, 1024, 3)
    assert pixels.max() == pytest.approx(brightest, rel=1e-3)


def test_negative_values_are_passed_on():
    pixels = read_image(shared("data", "env", "pmndrs_lab.exr"))
    assert (pixels < 0).sum() == 2313
    assert pixels.min() == pytest.approx(-6.6, abs=0.05)
