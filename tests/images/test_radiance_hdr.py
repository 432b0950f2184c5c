import contextlib

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from jaxrelight.errors import InputError
from jaxrelight.images.radiance_hdr import decode_radiance, encode_radiance
from tests.images import radiance_writer
from tests.shared_data import shared

LIMIT = 2**27
HEADER = b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n\n"


def _pixels(height=20, width=30):
    random = np.random.default_rng(0)
    return (random.random((height, width, 3)) * np.exp(random.uniform(-20, 20, (height, width, 1)))).astype(np.float32)


def _decode(data, limit=LIMIT):
    return decode_radiance(data, "sky.hdr", limit)[0]


def _flat(rgbe):
    """Bytes of one row of pixels, and their values."""
    rgbe = np.asarray(rgbe, np.uint8)
    return rgbe.tobytes(), rgbe[:, :3] * np.exp2(rgbe[:, 3:].astype(float) - 136)


@pytest.mark.parametrize("width", [1, 7, 8, 30, 300])
def test_round_trip_is_within_half_a_step(width):
    pixels = _pixels(width=width)
    back = _decode(encode_radiance(pixels))
    assert back.dtype == np.float32
    assert np.all(np.abs(back - pixels) <= pixels.max(axis=-1, keepdims=True) / 256 * (1 + 1e-6))


def test_encoding_what_was_decoded_changes_nothing():
    once = _decode(encode_radiance(_pixels()))
    np.testing.assert_array_equal(_decode(encode_radiance(once)), once)


def test_runs_are_coded_and_kept():
    pixels = np.repeat(_pixels(4, 5), [1, 3, 4, 127, 400], axis=1)
    data = encode_radiance(pixels)
    assert len(data) < pixels[..., 0].size * 4 / 5
    np.testing.assert_array_equal(_decode(data)[:, [0, 200]], _decode(encode_radiance(pixels[:, [0, 200]])))


def test_extremes():
    row = [1e5, 3.4e38, np.inf, 0.0, -1.0, np.nan, 1e-45, 0.99999]
    back = _decode(encode_radiance(np.repeat(np.array(row, np.float32)[None, :, None], 3, axis=2)))[0, :, 0]
    np.testing.assert_allclose(back, [1e5, 255 * 2.0**119, 255 * 2.0**119, 0, 0, 0, 0, 1], rtol=1 / 256)


def test_alpha_is_left_out():
    pixels = np.ones((3, 9, 4), np.float32)
    assert _decode(encode_radiance(pixels)).shape == (3, 9, 3)


@pytest.mark.parametrize("first_line", [b"#?RADIANCE\n", b"#?RGBE\n", b"# a comment\n", b"", b"#?RADIANCE\r\n"])
def test_headers_with_and_without_a_first_line(first_line):
    data, values = _flat([[128, 64, 32, 129], [255, 0, 1, 130]])
    np.testing.assert_allclose(_decode(first_line + b"FORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 2\n" + data), [values])


def test_exposure_and_colour_correction_are_divided_out():
    data, values = _flat([[128, 64, 32, 129]])
    header = (
        b"#?RADIANCE\nEXPOSURE=2\nSOFTWARE=x\nEXPOSURE= 4.0 \nCOLORCORR=1 2 0.5\nFORMAT=32-bit_rle_rgbe\n\n-Y 1 +X 1\n"
    )
    np.testing.assert_allclose(_decode(header + data), [values / [8, 16, 4]])


def _bytes_with_runs(height, width, seed=0):
    random = np.random.default_rng(seed)
    pixels = random.integers(2, 256, (height, width, 4)).astype(np.uint8)  # 1, 1, 1 would be a run
    pixels = np.repeat(pixels, random.integers(1, 9, width), axis=1)[:, :width]
    pixels[..., 1] = pixels[:, :1, 1]  # a component of one long run
    pixels[..., 3] = 100 + pixels[..., 3] % 60
    pixels[random.random((height, width)) < 0.1] = 0
    return pixels


@pytest.mark.parametrize("coding", ["flat", "old", "new"])
@pytest.mark.parametrize("orientation", radiance_writer.ORIENTATIONS)
@pytest.mark.parametrize("size", [(9, 31), (31, 9)])
def test_every_coding_in_every_orientation(coding, orientation, size):
    rgbe = _bytes_with_runs(*size)
    data = radiance_writer.picture(rgbe, coding, orientation)
    np.testing.assert_array_equal(_decode(data), radiance_writer.values(rgbe).astype(np.float32))


@pytest.mark.parametrize(
    ("coding", "width"),
    [("flat", 1), ("old", 1), ("flat", 7), ("old", 7), ("new", 8), ("new", 32767), ("flat", 32768), ("old", 40_000)],
)
def test_narrow_and_wide_pictures(coding, width):
    rgbe = _bytes_with_runs(2, width)
    expected = radiance_writer.values(rgbe).astype(np.float32)
    np.testing.assert_array_equal(_decode(radiance_writer.picture(rgbe, coding)), expected)


@given(
    first=st.sampled_from(["#?RADIANCE", "#?RGBE", "#?AUTOPANO", None]),
    newline=st.sampled_from(["\n", "\r\n"]),
    coding=st.sampled_from(["flat", "old", "new"]),
    orientation=st.sampled_from(radiance_writer.ORIENTATIONS),
    exposures=st.lists(st.sampled_from([0.5, 2.0, 1e-3, 12.5]), max_size=3),
    corrections=st.lists(st.sampled_from([(1, 2, 4), (0.5, 1, 3)]), max_size=2),
    others=st.lists(
        st.sampled_from(
            ["# a comment", "VIEW=-vtl -vh 90", "rpict -x 8 scene.oct", "PIXASPECT=1", "GAMMA=1", "\tpcomb -x"]
        ),
        max_size=3,
    ),
    chance=st.randoms(use_true_random=False),
)
def test_every_header_that_people_have(first, newline, coding, orientation, exposures, corrections, others, chance):
    lines = [f"EXPOSURE={value}" for value in exposures]
    lines += ["COLORCORR= {} {} {}".format(*value) for value in corrections]
    lines += ["FORMAT=32-bit_rle_rgbe", *others]
    chance.shuffle(lines)
    rgbe = _bytes_with_runs(9, 12)
    data = radiance_writer.picture(rgbe, coding, orientation, first, lines, newline)
    scale = np.prod(exposures) * np.prod(np.array(corrections).reshape(-1, 3), axis=0)
    np.testing.assert_allclose(_decode(data), radiance_writer.values(rgbe) / scale, rtol=1e-6)


def test_primaries_are_converted_or_known_to_be_the_same():
    rgbe = _bytes_with_runs(4, 9)
    plain = _decode(radiance_writer.picture(rgbe))

    def read(primaries):
        return _decode(radiance_writer.picture(rgbe, lines=["FORMAT=32-bit_rle_rgbe", f"PRIMARIES= {primaries}"]))

    for usual in (".640 .330 .290 .600 .150 .060 .333 .333", ".64 .33 .30 .60 .15 .06 .3127 .3290"):
        np.testing.assert_array_equal(read(usual), plain)
    wide = read(".708 .292 .170 .797 .131 .046 .3127 .3290")  # Rec.2020, whose matrix ITU-R BT.2087 prints
    matrix = np.array([[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]])
    np.testing.assert_allclose(wide, plain @ matrix.T, rtol=0, atol=2e-4 * plain.max())


def test_old_run_length_coding():
    pixel, other = [128, 64, 32, 129], [200, 0, 0, 128]
    coded, _ = _flat([pixel, [1, 1, 1, 2], [1, 1, 1, 1], other])  # 2 + 1·256 repeats
    _, values = _flat([pixel] * 259 + [other])
    np.testing.assert_allclose(_decode(HEADER + b"-Y 1 +X 260\n" + coded), [values])


def test_flat_scanlines_beside_coded_ones():
    pixels = _decode(encode_radiance(_pixels(1, 30)))
    data = encode_radiance(pixels)
    body = data[data.index(b"+X 30\n") + 6 :]
    flat, values = _flat([[128 + i, i, 0, 120] for i in range(30)])
    np.testing.assert_allclose(_decode(HEADER + b"-Y 3 +X 30\n" + body + flat + body), [pixels[0], values, pixels[0]])


@pytest.mark.parametrize("width", [5, 30])
def test_cut_anywhere_is_refused(width):
    whole = encode_radiance(_pixels(4, width))
    for length in range(len(whole)):
        with pytest.raises(InputError, match=r"sky\.hdr: .*; "):
            _decode(whole[:length])


def test_damage_is_refused_or_read_never_worse():
    whole, random = encode_radiance(_pixels()), np.random.default_rng(1)
    for _ in range(200):
        damaged = bytearray(whole)
        for position in random.integers(0, random.choice([60, len(whole)]), 3):
            damaged[position] = random.integers(256)
        with contextlib.suppress(InputError):
            assert _decode(bytes(damaged), 2**20).dtype == np.float32


@pytest.mark.parametrize(
    ("data", "complaint"),
    [
        (b"#?RADIANCE\nFORMAT=32-bit_rle_xyze\n\n-Y 1 +X 1\n\0\0\0\0", "32-bit_rle_xyze"),
        (b"\x89PNG\r\n\x1a\n\0\0\0", "does not start like one"),
        (b"hello\n\n-Y 1 +X 1\n\0\0\0\0", "neither"),
        (b"#?RADIANCE\nEXPOSURE=bright\n\n-Y 1 +X 1\n\0\0\0\0", "EXPOSURE"),
        (b"#?RADIANCE\nEXPOSURE=-1\n\n-Y 1 +X 1\n\0\0\0\0", "not a positive number"),
        (b"#?RADIANCE\nCOLORCORR=1 2\n\n-Y 1 +X 1\n\0\0\0\0", "COLORCORR"),
        (b"#?RADIANCE\nGAMMA=2.2\n\n-Y 1 +X 1\n\0\0\0\0", "GAMMA other than 1"),
        (HEADER + b"-Y 1 +X 1\n\2\2\2\x80\3\3\3\x80", "4 bytes after the last of its 1 scanlines"),
        (HEADER + b"-Y 1 +Y 1\n\0\0\0\0", "resolution"),
        (HEADER + b"-Y 0 +X 1\n", "0 pixels|1x0 pixels"),
        (HEADER + b"-Y 65536 +X 65536\n", "65536x65536"),
        (HEADER + b"-Y 999999999 +X 999999999\n", "999999999x999999999"),
        (HEADER + b"-Y 10000 +X 10000\n" + b"\2\2\x27\x10", "scanline 1 of 10000"),
        (HEADER + b"-Y 1 +X 8\n" + b"\2\2\0\x09" + bytes(64), "scanline 1 of 1"),
        (HEADER + b"-Y 1 +X 8\n" + b"\2\2\0\x08" + b"\x89\0" * 4, "scanline 1 of 1"),
        (HEADER + b"-Y 1 +X 8\n" + b"\2\2\0\x08" + bytes(64), "scanline 1 of 1"),
        (HEADER + b"-Y 1 +X 8\n" + b"\1\1\1\2" + bytes(64), "scanline 1 of 1"),
        (HEADER + b"-Y 1 +X 8\n" + b"\5\5\5\x80\1\1\1\x09" + bytes(64), "scanline 1 of 1"),
    ],
)
def test_what_is_wrong_is_named(data, complaint):
    with pytest.raises(InputError, match=complaint):
        _decode(data)


def test_published_pictures():
    for name, shape in (("probulator_uffizi", (128, 256, 3)), ("mitsuba_principled_envmap", (512, 1024, 3))):
        pixels = _decode(shared("data", "env", f"{name}.hdr").read_bytes())
        assert pixels.shape == shape
        assert np.isfinite(pixels).all()
        assert pixels.min() >= 0
        np.testing.assert_array_equal(_decode(encode_radiance(pixels)), pixels)


@pytest.mark.parametrize(
    ("header", "note"),
    [
        (b"#?RADIANCE\nPRIMARIES=0 0 0 0 0 0 0 0\nFORMAT=32-bit_rle_rgbe\n\n", "PRIMARIES=0 0 0 0 0 0 0 0 are none"),
        (b"#?RADIANCE\nPRIMARIES=1 2 3\n\n", "taken as Rec.709"),
        (b"#?RGBE\nPRIMARIES=none\n\n", "PRIMARIES=none are none"),
        (b"#?RADIANCE\nEXPOSURE=0\n\n", "its EXPOSURE is 0, taken as 1"),
        (b"#?RADIANCE\nCOLORCORR=0 0 0\n\n", "its COLORCORR is 0, taken as 1"),
        (b"#?RADIANCE\n# no FORMAT line\n\n", ""),
        (b"#?AUTOPANO\n  Format = 32-bit_RLE_rgbe  \r\n gamma = 1\r\n\r\n", ""),
        (b"#?RADIANCE\nFORMAT=32-bit_rle_rgbe\n", ""),  # no empty line before the size
    ],
)
@pytest.mark.parametrize("size", [b"-Y 1 +X 2\n", b"-y 1  +x 2 \r\n"])
def test_odd_headers_are_read_with_a_note(header, note, size):
    pixels, notes = decode_radiance(header + size + b"\x80\x40\x20\x81" * 2, "sky.hdr", LIMIT)
    np.testing.assert_array_equal(pixels, [[[1, 0.5, 0.25]] * 2])
    assert len(notes) == bool(note)
    assert all(note in line and line.startswith("sky.hdr: ") for line in notes)


def test_exposure_and_colour_correction_are_both_divided_out():
    header = b"#?RADIANCE\nexposure = 2\nCOLORCORR=1 2 4\nEXPOSURE=0.5\n\n-Y 1 +X 1\n"
    pixels, notes = decode_radiance(header + b"\x80\x80\x80\x81", "sky.hdr", LIMIT)
    np.testing.assert_allclose(pixels, [[[1, 0.5, 0.25]]])
    assert notes == ()
