"""What a file holds decides how it is read, not what it is called."""

import io
import itertools

import numpy as np
import pytest
from PIL import Image

from jaxrelight.errors import InputError
from jaxrelight.images import decode_image, open_image, read_image, write_image
from jaxrelight.images.kinds import SUFFIXES, kind_of
from tests.shared_data import shared

PIXELS = np.random.default_rng(0).random((9, 14, 3), np.float32)


@pytest.fixture(scope="module")
def contents(tmp_path_factory) -> dict[str, bytes]:
    """A file of every kind."""
    folder = tmp_path_factory.mktemp("kinds")
    files = {}
    for kind, name in (("OpenEXR", "a.exr"), ("Radiance", "a.hdr"), ("PNG", "a.png")):
        write_image(folder / name, PIXELS)
        files[kind] = (folder / name).read_bytes()
    for kind, name in (("JPEG", "JPEG"), ("WebP", "WEBP"), ("TGA", "TGA"), ("BMP", "BMP")):
        file = io.BytesIO()
        Image.fromarray((255 * PIXELS).astype(np.uint8)).save(file, name)
        files[kind] = file.getvalue()
    return files


@pytest.mark.parametrize(("kind", "called"), list(itertools.product(SUFFIXES, repeat=2)))
def test_every_kind_under_every_name(contents, tmp_path, kind, called):
    path = tmp_path / f"a{SUFFIXES[called][0].upper()}"
    path.write_bytes(contents[kind])
    image = open_image(path)
    assert image.kind == kind_of(contents[kind]) == kind
    assert image.is_encoded == (kind not in ("OpenEXR", "Radiance"))
    np.testing.assert_array_equal(image.pixels, decode_image(contents[kind], "b").pixels)
    assert image.notes == (() if kind == called else (f"{path}: read as {kind}, which is what it holds",))


def test_old_tga_files_without_a_footer_are_known_by_their_header(contents):
    data = contents["TGA"]
    assert kind_of(data[:-26]) == kind_of(data) == "TGA"
    for other in (b"", b"\0" * 100, b"hello, this is text and no image", data[:18]):
        assert kind_of(other) is None


def test_other_kinds_have_no_layers(contents, tmp_path):
    (tmp_path / "a.png").write_bytes(contents["PNG"])
    with pytest.raises(InputError, match="only OpenEXR files have parts and layers"):
        read_image(f"{tmp_path / 'a.png'}#layer:albedo")
    # A '#' that is a part of the file's name.
    (tmp_path / "a#layer:b.png").write_bytes(contents["PNG"])
    assert read_image(tmp_path / "a#layer:b.png").shape == PIXELS.shape


def test_reported_files():
    jpeg = next(shared("data", "reported", "o13_jpeg_named_png").glob("*.png"))
    image = open_image(jpeg)
    assert image.kind == "JPEG"
    np.testing.assert_allclose(image.pixels.mean(axis=(0, 1)), [0.578, 0.032, 0.032], atol=0.01)
    sky = open_image(shared("data", "reported", "x1_polyhaven", "sky.hdr"))
    assert "taken as Rec.709" in sky.notes[0]
    picture = open_image(shared("data", "reported", "img", "e3.exr"))
    assert picture.pixels.mean() == pytest.approx(0.5075, abs=1e-4)
    assert "'Combined', not 'albedo'" in picture.notes[0]
