"""Images: reading, writing, tone mapping and comparing them.

Everywhere in this package an image is `[h, w, c]`, row 0 at the top, linear Rec.709, with three channels or a fourth
that holds coverage.
"""

from jaxrelight.images.files import ImageFile, check_writable, decode_image, open_image, read_image, write_image
from jaxrelight.images.metric import ImageError, image_error
from jaxrelight.images.tone import auto_exposure, srgb_decode, srgb_encode, tone_map

__all__ = [
    "ImageError",
    "ImageFile",
    "auto_exposure",
    "check_writable",
    "decode_image",
    "image_error",
    "open_image",
    "read_image",
    "srgb_decode",
    "srgb_encode",
    "tone_map",
    "write_image",
]
