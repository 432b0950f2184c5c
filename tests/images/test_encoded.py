"""PNG of 16 bits, TGA, WebP and BMP: every level, and full scale that is exactly 1."""

import io
import struct

import numpy as np
import pytest
from PIL import Image

from jaxrelight.errors import InputError
from jaxrelight.images import decode_image, srgb_decode
from tests.images import png_writer


def _levels(channels: int, height: int = 11, width: int = 13) -> np.ndarray:
    levels = np.random.default_rng(channels).integers(0, 65536, (height, width, channels), dtype=np.uint16)
    levels[0, 0], levels[0, 1] = 0, 65535
    return levels


def _saved(pixels: np.ndarray, kind: str, **options) -> bytes:
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, kind, **options)
    return file.getvalue()


@pytest.mark.parametrize("channels", [1, 2, 3, 4])
def test_sixteen_bits_of_every_kind_keep_all_levels(channels):
    levels = _levels(channels)
    data = png_writer.picture(levels)
    pixels, stored = (decode_image(data, "a.png", stored=stored).pixels for stored in (False, True))
    colours = levels[..., [0, 0, 0]] if channels < 3 else levels[..., :3]
    np.testing.assert_array_equal(np.rint(stored[..., :3].astype(float) * 65535), colours)
    np.testing.assert_allclose(pixels[..., :3], srgb_decode(colours / 65535), rtol=1e-6)
    assert pixels.shape[2] == stored.shape[2] == (3 if channels % 2 else 4)
    if channels % 2 == 0:
        np.testing.assert_array_equal(pixels[..., 3], (levels[..., -1] / 65535).astype(np.float32))
    for image in (pixels, stored):
        assert (image[0, 1] == 1).all()
        assert (image[0, 0, :3] == 0).all()


@pytest.mark.parametrize("channels", [1, 3])
def test_one_colour_of_sixteen_bits_is_transparent(channels):
    levels = _levels(channels)
    key = levels[2, 3].astype(">u2").tobytes()
    pixels = decode_image(png_writer.picture(levels, png_writer.chunk(b"tRNS", key)), "a.png").pixels
    np.testing.assert_array_equal(pixels[..., 3], (levels != levels[2, 3]).any(axis=-1))


@pytest.mark.parametrize("channels", [2, 3, 4])
def test_sixteen_bits_cut_short_are_refused(channels):
    data = png_writer.picture(_levels(channels))
    for length in np.linspace(30, len(data) - 13, 20).astype(int):
        with pytest.raises(InputError, match=r"a\.png: not a PNG file, or damaged or cut short"):
            decode_image(data[:length], "a.png")


def test_eight_bits_end_at_exactly_one():
    levels = np.arange(256, dtype=np.uint8).reshape(16, 16, 1).repeat(3, axis=2)
    for stored in (False, True):
        pixels = decode_image(_saved(levels, "PNG"), "a.png", stored=stored).pixels
        assert pixels.max() == 1
        assert (pixels == 1).sum() == 3


def _rgba() -> np.ndarray:
    return np.random.default_rng(0).integers(0, 256, (12, 17, 4), dtype=np.uint8)


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        ("TGA", {}),
        ("TGA", {"compression": "tga_rle"}),
        ("TGA", {"orientation": 1}),
        ("WEBP", {"lossless": True, "exact": True}),
    ],
)
@pytest.mark.parametrize("channels", [3, 4])
def test_lossless_kinds(kind, options, channels):
    levels = _rgba()[..., :channels]
    image = decode_image(_saved(levels, kind, **options), "a", stored=True)
    assert image.kind.upper() == kind
    np.testing.assert_array_equal(np.rint(image.pixels * 255), levels)


def test_grey_and_palettes_of_tga_and_bmp():
    grey = _rgba()[..., 0]
    for kind in ("TGA", "BMP"):
        np.testing.assert_array_equal(
            np.rint(decode_image(_saved(grey, kind), "a", stored=True).pixels * 255), grey[..., None].repeat(3, axis=2)
        )
        file = io.BytesIO()
        Image.fromarray(_rgba()[..., :3]).quantize(16).save(file, kind)
        wanted = np.asarray(Image.fromarray(_rgba()[..., :3]).quantize(16).convert("RGB"))
        np.testing.assert_array_equal(np.rint(decode_image(file.getvalue(), "a", stored=True).pixels * 255), wanted)


def test_tga_whose_fourth_channel_is_said_to_be_nothing_has_no_alpha():
    data = bytearray(_saved(_rgba(), "TGA"))
    data[17] &= 0xF0
    np.testing.assert_array_equal(
        np.rint(decode_image(bytes(data), "a.tga", stored=True).pixels * 255), _rgba()[..., :3]
    )


@pytest.mark.parametrize("kind", ["TGA", "WEBP", "BMP"])
def test_cut_anywhere_is_refused(kind):
    data = _saved(_rgba()[..., :3], kind)
    for length in np.linspace(1, len(data) - 60, 20).astype(int):
        with pytest.raises(InputError, match=r"a\.\w+: .*; "):
            decode_image(data[:length], f"a.{kind.lower()}", suffix=f".{kind.lower()}")


def test_claims_beyond_the_limit_or_the_file_are_refused():
    tga = struct.pack("<BBBHHBHHHHBB", 0, 0, 10, 0, 0, 0, 0, 0, 12000, 12000, 24, 0) + bytes(100)
    for limit, words in ((2**20, "12000x12000 pixels, more than the limit"), (2**33, "too short for the 12000x12000")):
        with pytest.raises(InputError, match=words):
            decode_image(tga, "a.tga", limit)
    tga = tga[:12] + struct.pack("<HH", 60000, 60000) + tga[16:]
    with pytest.raises(InputError, match="more pixels than any image has"):
        decode_image(tga, "a.tga")
