"""PNG, JPEG, WebP, TGA and BMP: numbers of 8 or 16 bits, encoded by the sRGB curve, through Pillow."""

import io
import struct
import warnings
import zlib

import numpy as np

from jaxrelight.errors import InputError
from jaxrelight.images.tone import srgb_decode

FORMATS = {"PNG": "PNG", "JPEG": "JPEG", "WebP": "WEBP", "TGA": "TGA", "BMP": "BMP"}  # what Pillow calls the kinds
# By how much a byte of the file can shrink, at most: deflate 1032-fold, with at least a bit a pixel.
_MAX_COMPRESSION = {"PNG": 1032 * 8, "JPEG": 1032 * 8, "TGA": 128, "BMP": 255}
_GREY, _GREY_ALPHA, _COLOUR_ALPHA = 0, 4, 6  # colour types of PNG


def decode_encoded(data: bytes, kind: str, name: str, max_pixels: int, *, stored: bool = False) -> np.ndarray:
    """Decode an image of a kind of `FORMATS` to float32 `[h, w, 3]`, or `[h, w, 4]` if it has alpha.

    Colours are decoded from sRGB to [0, 1], unless they are asked for as `stored`: from 0 to 1 where the file's numbers
    run from 0 to their largest. Full scale is exactly 1 either way. Colour profiles are not applied, and alpha is not
    multiplied in.

    Raises:
        InputError: The bytes are of another kind, damaged, cut short, or claim more than `max_pixels`.
    """
    from PIL import Image

    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of large images, and of palettes with transparency
            with Image.open(io.BytesIO(data), formats=[FORMATS[kind]]) as image:
                _check_claimed_size(name, image.size, kind, len(data), max_pixels)
                if kind == "PNG":
                    _check_png_chunks(data)
                if kind == "PNG" and data[24] == 16:
                    levels, numbers = 65535, _sixteen_bits(data)
                else:
                    image.load()
                    has_alpha = image.has_transparency_data and not (kind == "TGA" and data[17] & 15 == 0)
                    levels, numbers = 255, np.asarray(image.convert("RGBA" if has_alpha else "RGB"))
    except (InputError, MemoryError):
        raise
    except Image.DecompressionBombError as fault:  # far beyond what it takes for an image
        raise InputError(f"{name}: the header claims more pixels than any image has; shrink the image") from fault
    except Exception as fault:  # a broken file can raise nearly anything in Pillow's many decoders
        raise InputError(f"{name}: not a {kind} file, or damaged or cut short; export or copy it again") from fault
    encoded = np.arange(levels + 1) / levels
    colours = encoded if stored else srgb_decode(encoded)
    pixels = colours.astype(np.float32)[numbers]
    if pixels.shape[2] == 4:
        pixels[..., 3] = encoded[numbers[..., 3]]
    return pixels


def _sixteen_bits(data: bytes) -> np.ndarray:
    """uint16 `[h, w, 3 or 4]` of a PNG of 16 bits, which Pillow gives in full for grey without alpha alone.

    Colours are decoded twice, once to their high bytes and once to their low ones: Pillow's raw modes 16B and 16L take
    the first and the second byte of each number. Two numbers of grey and alpha are four bytes of one pixel of 8 bits.
    """
    from PIL import Image

    kind = data[25]

    def decoded(content: bytes, mode: str | None = None) -> tuple[np.ndarray, object]:
        with Image.open(io.BytesIO(content), formats=["PNG"]) as image:
            if mode is not None:
                image.tile = [tile._replace(args=mode) for tile in image.tile]
            image.load()
            return np.asarray(image), image.info.get("transparency")

    if kind == _GREY:
        grey, clear = decoded(data)
        numbers = np.repeat(grey.astype(np.uint16)[..., None], 3, axis=-1)
    elif kind == _GREY_ALPHA:
        header = data[12:24] + bytes((8, _COLOUR_ALPHA)) + data[26:29]
        pairs, _ = decoded(data[:12] + header + struct.pack(">I", zlib.crc32(header)) + data[33:])
        both, clear = pairs[..., 0::2].astype(np.uint16) * 256 + pairs[..., 1::2], None
        numbers = both[..., [0, 0, 0, 1]]
    else:
        mode = "RGBA" if kind == _COLOUR_ALPHA else "RGB"
        (high, clear), (low, _) = (decoded(data, f"{mode};16{order}") for order in "BL")
        numbers = high.astype(np.uint16) * 256 + low
    if clear is None:
        return numbers
    # One colour, in full precision, stands for what is transparent.
    alpha = np.where((numbers == np.asarray(clear, np.uint16)).all(axis=-1), 0, 65535).astype(np.uint16)
    return np.concatenate([numbers, alpha[..., None]], axis=-1)


def _check_png_chunks(data: bytes) -> None:
    """Raise ValueError unless every chunk up to the end marker has its checksum; Pillow leaves that of pixels out."""
    at, name = 8, b""
    while name != b"IEND":
        length, name = struct.unpack_from(">I4s", data, at)
        (checksum,) = struct.unpack_from(">I", data, at + 8 + length)
        if zlib.crc32(data[at + 4 : at + 8 + length]) != checksum:
            raise ValueError("a chunk is damaged")
        at += 12 + length


def _check_claimed_size(name: str, size: tuple[int, int], kind: str, length: int, max_pixels: int) -> None:
    width, height = size
    if width * height > max_pixels:
        raise InputError(
            f"{name}: the header claims {width}x{height} pixels, more than the limit of {max_pixels}; shrink the image"
        )
    if width * height > length * _MAX_COMPRESSION.get(kind, max_pixels):
        raise InputError(f"{name}: too short for the {width}x{height} pixels it claims; export or copy it again")
