import contextlib
import struct

import numpy as np
import OpenEXR
import pytest

from jaxrelight.errors import InputError
from jaxrelight.images import read_image
from jaxrelight.images.exr import open_exr, read_channels, read_exr, write_channels, write_exr
from tests.images import exr_writer
from tests.images.exr_writer import Part
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
    "names",
    [
        "RGB",
        "RGBA",
        "rgb",
        "rgba",
        ["red", "green", "blue"],
        ["Red", "Green", "Blue", "Alpha"],
        ["ViewLayer.Combined." + c for c in "RGBA"],
        ["left.x." + c for c in "RGB"],
        ["diffuse." + c for c in "rgb"],
    ],
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


@pytest.mark.parametrize("names", ["RG", "XYZ", "xyz", "Z", ["N.X", "N.Y", "N.Z"]])
def test_channels_without_colours_are_named(path, names):
    with pytest.raises(InputError, match="no colours among the channels") as caught:
        read_exr(_write(path, _planes(_pixels(len(names)), names)), LIMIT)
    assert all(repr(name) in str(caught.value) for name in names)


def test_capital_names_come_first(path):
    pixels = _pixels(6)
    _write(path, _planes(pixels, "RGBrgb"))
    np.testing.assert_array_equal(read_exr(path, LIMIT), pixels[..., :3])


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


# ---- files of another writer -----------------------------------------------------------------------------------------


def _written(path, *parts: Part):
    path.write_bytes(exr_writer.picture(*parts))
    return path


STORED = {"lines": {}, "tiles": {"tile": 8}, "one tile": {"tile": 64}, "levels": {"tile": 8, "mipmap": True}}


@pytest.mark.parametrize("dtype", [np.float16, np.float32])
@pytest.mark.parametrize("stored", STORED)
def test_scan_lines_and_tiles_of_half_and_float(path, dtype, stored):
    pixels = _pixels(3).astype(dtype)
    back = read_exr(_written(path, Part(exr_writer.planes(pixels, "RGB"), **STORED[stored])), LIMIT)
    assert back.dtype == np.float32
    np.testing.assert_array_equal(back, pixels)


@pytest.mark.parametrize("stored", STORED)
@pytest.mark.parametrize("chunk", [0, 7, -1])
def test_missing_chunks_are_refused(path, stored, chunk):
    part = Part(exr_writer.planes(_pixels(3), "RGB"), **STORED[stored])
    part.missing = [range(len(part.chunks()))[chunk if len(part.chunks()) > 1 else 0]]
    with pytest.raises(InputError, match="cut short"):
        read_exr(_written(path, part), LIMIT)


@pytest.mark.parametrize("second", [{}, {"tile": 4}, {"corner": (10, 5)}])
def test_parts_of_different_kinds(path, second):
    pixels, whole = _pixels(3), (0, 0, 29, 19)
    depth = Part(exr_writer.planes(pixels[5:15, 10:20], "Z"), display=whole, **second)
    beauty = Part(exr_writer.planes(pixels, "RGB"), display=whole)
    later = Part(exr_writer.planes(0 * pixels, "RGB"), display=whole)
    for parts in ([beauty, depth], [depth, beauty], [depth, beauty, later]):
        np.testing.assert_array_equal(read_exr(_written(path, *parts), LIMIT), pixels)
    depth.missing = [1]
    with pytest.raises(InputError, match="cut short"):
        read_exr(_written(path, depth, beauty), LIMIT)


def test_integers_beside_the_colours_are_passed_over(path):
    pixels = _pixels(3)
    channels = exr_writer.planes(pixels, "RGB") | {"id": np.arange(600, dtype=np.uint32).reshape(20, 30)}
    np.testing.assert_array_equal(read_exr(_written(path, Part(channels)), LIMIT), pixels)


def test_luminance_and_chroma_are_refused(path):
    small = _pixels(1, 10, 15)[..., 0]
    part = Part({"Y": _pixels(1)[..., 0], "RY": small, "BY": small}, sampling={"RY": (2, 2), "BY": (2, 2)})
    with pytest.raises(InputError, match=r"luminance and chroma \(Y, RY, BY\)"):
        read_exr(_written(path, part), LIMIT)


def test_subsampled_colours_are_refused(path):
    channels = exr_writer.planes(_pixels(2), "RG") | {"B": _pixels(1, 10, 15)[..., 0]}
    with pytest.raises(InputError, match="channel B holds integers or is subsampled"):
        read_exr(_written(path, Part(channels, sampling={"B": (2, 2)})), LIMIT)


@pytest.mark.usefixtures("wrong_types")
def test_primaries_are_converted(path):
    pixels = _pixels(4)
    for chromaticities, matrix in (
        ((0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.3127, 0.329), np.eye(3)),
        (
            (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290),
            np.array([[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]]),
        ),
    ):
        attribute = {"chromaticities": ("chromaticities", struct.pack("<8f", *chromaticities))}
        back = read_exr(_written(path, Part(exr_writer.planes(pixels, "RGBA"), attributes=attribute)), LIMIT)
        np.testing.assert_allclose(back[..., :3], pixels[..., :3] @ matrix.T, atol=2e-4)
        np.testing.assert_array_equal(back[..., 3], pixels[..., 3])
    attribute = {"chromaticities": ("chromaticities", struct.pack("<8f", *[0.3] * 8))}
    picture = open_exr(_written(path, Part(exr_writer.planes(pixels, "RGBA"), attributes=attribute)), LIMIT)
    np.testing.assert_array_equal(picture.pixels, pixels)
    assert "chromaticities are not usable" in picture.notes[0]
    assert "taken as Rec.709" in picture.notes[0]


def _with_window(data: bytes, name: bytes, width: int, height: int) -> bytes:
    at = data.index(name + b"\0box2i\0") + len(name) + 11
    return data[:at] + struct.pack("<4i", 0, 0, width - 1, height - 1) + data[at + 16 :]


@pytest.mark.parametrize("stored", [{}, {"tile": 8}])
def test_a_window_with_too_few_rows_is_refused(path, stored):
    whole = exr_writer.picture(Part(exr_writer.planes(_pixels(3), "RGB"), **stored))
    for rows in (4, 8, 12):
        path.write_bytes(_with_window(whole, b"dataWindow", 30, rows))
        with pytest.raises(InputError, match="claims fewer pixels than the file holds"):
            read_exr(path, LIMIT)


@pytest.mark.parametrize("name", ["channels", "compression", "dataWindow", "displayWindow", "lineOrder"])
def test_attributes_that_say_what_the_pixels_are_must_be_there(path, name):
    """The library would take a display window of 64 × 64 pixels for a lost one."""
    whole = exr_writer.picture(Part(exr_writer.planes(_pixels(3), "RGB")))
    for old, new in ((name, name[:-1] + "_"), (name + "\0", name + "\0x")):
        path.write_bytes(whole.replace(old.encode(), new.encode(), 1))
        with pytest.raises(InputError, match=f"lacks '{name}'|damaged or cut-short"):
            read_exr(path, LIMIT)


def test_an_empty_border_must_not_be_most_of_the_picture(path):
    whole = exr_writer.picture(Part(exr_writer.planes(_pixels(3), "RGB")))
    path.write_bytes(_with_window(whole, b"displayWindow", 2000, 1000))
    assert read_exr(path, LIMIT).shape == (1000, 2000, 3)
    path.write_bytes(_with_window(whole, b"displayWindow", 10_000, 10_000))
    with pytest.raises(InputError, match="display window has 100,000,000 pixels, but only 600 are stored"):
        read_exr(path, LIMIT)


COMPRESSIONS = {
    "NO": 0, "RLE": 0, "ZIPS": 0, "ZIP": 0, "PIZ": 0, "PXR24": 1e-4, "B44": 0.05, "B44A": 0.05, "DWAA": 0.02,
    "DWAB": 0.02, "HTJ2K32": 0, "HTJ2K256": 0, "ZSTD": 0,
}  # fmt: skip


@pytest.mark.parametrize("tiled", [False, True])
@pytest.mark.parametrize("dtype", [np.float16, np.float32])
@pytest.mark.parametrize("name", COMPRESSIONS)
def test_every_compression(path, name, dtype, tiled):
    kind = getattr(OpenEXR, f"{name}_COMPRESSION", None)
    if kind is None:
        pytest.skip(f"this OpenEXR has no {name}")
    v, u = np.mgrid[0:40, 0:50] / 50
    pixels = np.stack([u, v, 1 + u * v, 0 * u], axis=-1).astype(dtype)
    header = {"type": OpenEXR.tiledimage, "tiles": OpenEXR.TileDescription()} if tiled else {}
    back = read_exr(_write(path, _planes(pixels, "RGBA"), compression=kind, **header), LIMIT)
    np.testing.assert_allclose(back, pixels, rtol=0, atol=COMPRESSIONS[name])
    whole = path.read_bytes()
    for length in np.linspace(0, len(whole) - 1, 20).astype(int):
        path.write_bytes(whole[:length])
        with pytest.raises(InputError, match="; "):
            read_exr(path, LIMIT)


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


def test_parts_of_several_sizes_come_back_by_name(path):
    random = np.random.default_rng(0)
    sizes = (5, 6), (3, 3), (1, 7)
    parts = [
        (f"level{i}", {"diffuse.R": random.random(size, np.float32), "flag": np.full(size, np.nan, np.float32)})
        for i, size in enumerate(sizes)
    ]
    write_channels(path, parts)
    restored = read_channels(path, 100)
    for (_, written), back in zip(parts, restored, strict=True):
        assert back.keys() == written.keys()
        for name, plane in written.items():
            np.testing.assert_array_equal(back[name], plane)
