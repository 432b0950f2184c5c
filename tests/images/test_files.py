import contextlib
import os
import struct
import zlib

import numpy as np
import pytest
from PIL import Image

from jaxrelight.errors import InputError
from jaxrelight.files import whole_file
from jaxrelight.images import read_image, srgb_decode, tone_map, write_image


def _pixels(channels=3, height=20, width=30):
    return np.random.default_rng(0).random((height, width, channels), np.float32)


@pytest.mark.parametrize(
    ("name", "tolerance"), [("a.exr", 0), ("A.EXR", 0), ("a.hdr", 1 / 256), ("a.pic", 1 / 256), ("a.png", 0.005)]
)
def test_round_trip(tmp_path, name, tolerance):
    pixels = _pixels()
    write_image(tmp_path / name, pixels)
    back = read_image(str(tmp_path / name))
    assert back.dtype == np.float32
    np.testing.assert_allclose(back, pixels, rtol=0, atol=tolerance)


@pytest.mark.parametrize("name", ["sun.exr", "sun.hdr"])
def test_a_hot_pixel_survives(tmp_path, name):
    pixels = np.full((16, 32, 3), 0.5, np.float32)
    pixels[3, 4] = 1e5
    write_image(tmp_path / name, pixels)
    np.testing.assert_allclose(read_image(tmp_path / name), pixels, rtol=1 / 256)


def test_png_is_tone_mapped(tmp_path):
    pixels = _pixels(4)
    write_image(tmp_path / "a.png", pixels, exposure=1.0)
    with Image.open(tmp_path / "a.png") as image:
        assert image.mode == "RGB"
        np.testing.assert_array_equal(image, tone_map(pixels, 1.0))


def test_alpha(tmp_path):
    pixels = _pixels(4)
    pixels[0, 0, 3] = np.nan
    write_image(tmp_path / "a.png", pixels, alpha=True)
    back = read_image(tmp_path / "a.png")
    np.testing.assert_allclose(back[..., 3], np.nan_to_num(pixels[..., 3]), atol=0.5 / 255 + 1e-6)
    write_image(tmp_path / "a.exr", pixels)
    np.testing.assert_array_equal(read_image(tmp_path / "a.exr"), pixels)


@pytest.mark.parametrize(
    ("mode", "channels"), [("L", 3), ("LA", 4), ("P", 3), ("1", 3), ("RGB", 3), ("RGBA", 4), ("I;16", 3)]
)
def test_kinds_of_png(tmp_path, mode, channels):
    white = np.eye(2)[::-1]
    deep = mode == "I;16"
    image = Image.fromarray((white * 65535).astype(np.uint16) if deep else (white * 255).astype(np.uint8))
    (image if deep else image.convert(mode)).save(tmp_path / "a.png")
    back = read_image(tmp_path / "a.png")
    assert back.shape == (2, 2, channels)
    np.testing.assert_array_equal(back[..., 0], [[0, 1], [1, 0]])
    assert back.dtype == np.float32


def test_sixteen_bit_grey_keeps_its_precision(tmp_path):
    levels = np.arange(0, 65536, 97, dtype=np.uint16)[None]
    Image.fromarray(levels).save(tmp_path / "a.png")
    np.testing.assert_allclose(read_image(tmp_path / "a.png")[..., 1], srgb_decode(levels / 65535), rtol=1e-5)


def test_jpeg(tmp_path):
    Image.fromarray(np.full((16, 16, 3), 188, np.uint8)).save(tmp_path / "a.jpg")
    np.testing.assert_allclose(read_image(tmp_path / "a.jpg"), srgb_decode(188 / 255), rtol=0.01)


@pytest.mark.parametrize("name", ["a.exr", "a.hdr", "a.png", "a.jpg"])
def test_cut_anywhere_is_refused_quietly(tmp_path, name, capfd):
    path = tmp_path / name
    if name == "a.jpg":
        Image.fromarray(tone_map(_pixels())).save(path)
    else:
        write_image(path, _pixels())
    whole = path.read_bytes()
    for length in [*np.linspace(0, len(whole) - 1, 60).astype(int), len(whole) - 2]:
        path.write_bytes(whole[:length])
        with pytest.raises(InputError) as caught:
            read_image(path)
        assert str(path) in str(caught.value)
        assert "\n" not in str(caught.value)
    assert capfd.readouterr() == ("", "")


@pytest.mark.parametrize("name", ["a.png", "a.jpg"])
def test_damage_is_refused_or_read_never_worse(tmp_path, name):
    path, random = tmp_path / name, np.random.default_rng(1)
    Image.fromarray(tone_map(_pixels())).save(path)
    whole = path.read_bytes()
    for _ in range(200):
        damaged = bytearray(whole)
        for position in random.integers(0, random.choice([100, len(whole)]), 3):
            damaged[position] = random.integers(256)
        path.write_bytes(damaged)
        with contextlib.suppress(InputError):
            assert read_image(path, 2**20).dtype == np.float32


def test_a_png_with_a_wrong_checksum_is_refused(tmp_path):
    """Pillow would show the pixels up to the damage, and something else after it."""
    path = tmp_path / "a.png"
    Image.fromarray(tone_map(_pixels())).save(path)
    whole = path.read_bytes()
    pixels = whole.index(b"IDAT") + 20
    for damaged in (whole[:pixels] + b"\x55" + whole[pixels:], whole[:pixels] + b"\x55" + whole[pixels + 1 :]):
        path.write_bytes(damaged)
        with pytest.raises(InputError, match=r"a\.png: not a PNG file, or damaged"):
            read_image(path)


def _png_claiming(width, height):
    def chunk(kind, content):
        return struct.pack(">I", len(content)) + kind + content + struct.pack(">I", zlib.crc32(kind + content))

    head = chunk(b"IHDR", struct.pack(">IIBBBBB", width, height, 8, 2, 0, 0, 0))
    return b"\x89PNG\r\n\x1a\n" + head + chunk(b"IDAT", zlib.compress(bytes(100))) + chunk(b"IEND", b"")


@pytest.mark.parametrize("size", [(65536, 65536), (2**31 - 1, 2**31 - 1), (10_000, 10_000)])
def test_a_lying_png_is_refused_before_memory_is_taken(tmp_path, size):
    resource = pytest.importorskip("resource")
    (tmp_path / "a.png").write_bytes(_png_claiming(*size))
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    with pytest.raises(InputError, match=r"a\.png"):
        read_image(tmp_path / "a.png")
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 50_000  # KiB


@pytest.mark.parametrize("name", ["a.exr", "a.hdr", "a.png"])
def test_the_limit_is_the_callers(tmp_path, name):
    write_image(tmp_path / name, _pixels())
    assert read_image(tmp_path / name, max_pixels=600).shape == (20, 30, 3)
    with pytest.raises(InputError, match="30x20"):
        read_image(tmp_path / name, max_pixels=599)


@pytest.mark.parametrize("suffix", [".exr", ".hdr", ".png", ".jpg"])
def test_unreadable_files_are_named(tmp_path, suffix):
    path = tmp_path / f"a{suffix}"
    with pytest.raises(InputError, match="no such file"):
        read_image(path)
    path.write_bytes(b"")
    with pytest.raises(InputError, match="empty"):
        read_image(path)
    path.write_bytes(b"GIF89a, or anything else\n\n")
    with pytest.raises(InputError, match=rf"a{suffix}: .*; "):
        read_image(path)
    path.unlink()
    path.mkdir()
    with pytest.raises(InputError, match="folder"):
        read_image(path)
    if suffix != ".jpg":
        with pytest.raises(InputError, match="not a regular file"):
            write_image(path, _pixels())


def test_strange_paths(tmp_path):
    for name in ("x" * 300 + ".exr", "a\0b.exr"):
        with pytest.raises(InputError):
            read_image(tmp_path / name)
        with pytest.raises(InputError):
            write_image(tmp_path / name, _pixels())
    for name in ("ümläut 图.exr", "ümläut 图.png"):
        write_image(tmp_path / name, _pixels())
        assert read_image(tmp_path / name).shape == (20, 30, 3)


def test_unknown_extensions(tmp_path):
    for content, name, words in (
        (b"II*\0", "a.tiff", r"holds TIFF, which is not read; convert it to one of \.exr"),
        (b"GIF89a", "a.png", "holds GIF"),
        (b"\0\0\0\x1cftypavif", "a.jpg", "holds AVIF"),
        (b"nothing known", "a.xyz", r"unknown kind of image '\.xyz'; use one of \.exr"),
        (b"nothing known", "a", "unknown kind of image ''"),
    ):
        (tmp_path / name).write_bytes(content)
        with pytest.raises(InputError, match=words):
            read_image(tmp_path / name)
    for name in ("a.tiff", "a.jpg", "a"):
        with pytest.raises(InputError, match="cannot write"):
            write_image(tmp_path / name, _pixels())


@pytest.mark.parametrize(
    "pixels",
    [
        np.ones((3, 3)),
        np.ones((3, 3, 2)),
        np.ones((0, 3, 3)),
        np.ones((3, 3, 3), np.uint8),
        np.ones((3, 3, 3), complex),
    ],
)
def test_only_images_are_written(tmp_path, pixels):
    with pytest.raises(InputError, match=r"a\.exr: "):
        write_image(tmp_path / "a.exr", pixels)
    assert not list(tmp_path.iterdir())


def test_doubles_beyond_single_precision_become_infinite(tmp_path):
    write_image(tmp_path / "a.exr", np.full((2, 2, 3), 1e300))
    assert np.isinf(read_image(tmp_path / "a.exr")).all()


@pytest.mark.parametrize("name", ["a.exr", "a.hdr", "a.png"])
def test_a_failed_write_leaves_the_earlier_file(tmp_path, name, monkeypatch):
    path = tmp_path / name
    write_image(path, _pixels())
    earlier = path.read_bytes()

    def full_disk(*_):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(whole_file.os, "replace", full_disk)
    with pytest.raises(InputError, match="No space left on device"):
        write_image(path, 2 * _pixels())
    assert path.read_bytes() == earlier
    assert os.listdir(tmp_path) == [name]


@pytest.mark.skipif(not os.path.exists("/dev/full"), reason="needs /dev/full")
@pytest.mark.parametrize("name", ["a.exr", "a.hdr", "a.png"])
def test_a_full_disk_is_told(tmp_path, name, monkeypatch, capfd):
    class Full:
        hex = "full"

    (tmp_path / ".full.partial").symlink_to("/dev/full")
    monkeypatch.setattr(whole_file.uuid, "uuid4", Full)
    with pytest.raises(InputError, match=rf"{name}: cannot be written, .*No space left on device"):
        write_image(tmp_path / name, _pixels())
    assert not list(tmp_path.iterdir())
    assert capfd.readouterr() == ("", "")


def test_a_missing_folder_is_named(tmp_path):
    with pytest.raises(InputError, match="does not exist; create it first"):
        write_image(tmp_path / "none" / "a.exr", _pixels())


@pytest.mark.skipif(not os.path.exists("/dev/null"), reason="needs devices")
def test_devices_are_neither_read_nor_replaced(tmp_path):
    for name in ("a.exr", "a.png", "a.hdr"):
        (tmp_path / name).symlink_to("/dev/null")
        with pytest.raises(InputError, match="not a regular file"):
            read_image(tmp_path / name)
        with pytest.raises(InputError, match="not a regular file"):
            write_image(tmp_path / name, _pixels())
