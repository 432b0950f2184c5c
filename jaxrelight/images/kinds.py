"""What kind of image some bytes are, found by what they hold, whatever the file is called."""

import struct

# The kinds that are read, and what their files are called.
SUFFIXES = {
    "OpenEXR": (".exr", ".sxr", ".mxr"),
    "Radiance": (".hdr", ".pic", ".rgbe"),
    "PNG": (".png", ".apng"),
    "JPEG": (".jpg", ".jpeg", ".jpe", ".jfif"),
    "WebP": (".webp",),
    "TGA": (".tga", ".targa", ".icb", ".vda", ".vst"),
    "BMP": (".bmp", ".dib"),
}
READABLE = ".exr, .hdr, .png, .jpg, .webp, .tga, .bmp"

_KINDS = {suffix: kind for kind, suffixes in SUFFIXES.items() for suffix in suffixes}
_MAGIC = (
    (b"\x76\x2f\x31\x01", "OpenEXR"),
    (b"#?", "Radiance"),
    (b"\x89PNG\r\n\x1a\n", "PNG"),
    (b"\xff\xd8\xff", "JPEG"),
)
_NOT_READ = (
    (b"GIF8", "GIF"),
    (b"II*\0", "TIFF"),
    (b"MM\0*", "TIFF"),
    (b"DDS ", "DDS"),
    (b"\xabKTX", "KTX"),
    (b"sB", "Basis Universal"),
    (b"8BPS", "Photoshop"),
    (b"\0\0\0\x0cjP  ", "JPEG 2000"),
    (b"\xff\x0a", "JPEG XL"),
    (b"PF\n", "PFM"),
    (b"Pf\n", "PFM"),
)
_TGA_FOOTER = b"TRUEVISION-XFILE.\0"
_TGA_HEADER = struct.Struct("<BBBHHBHHHHBB")


def kind_of(data: bytes) -> str | None:
    """The kind of image that bytes hold, a key of `SUFFIXES`; None where they show none of these.

    Args:
        data: the file's content, whole, or at least its first 64 bytes. TGA has no mark at its start: it is known by
            the footer of its second version, or by a header that no other kind would have.
    """
    for magic, kind in _MAGIC:
        if data.startswith(magic):
            return kind
    if data[:4] == b"RIFF" and data[8:12] == b"WEBP":
        return "WebP"
    if data[:2] == b"BM" and data[6:10] == b"\0\0\0\0":
        return "BMP"
    if data.endswith(_TGA_FOOTER) or _has_tga_header(data):
        return "TGA"
    return None


def kind_of_suffix(suffix: str) -> str | None:
    """The kind that a file is called by its ending."""
    return _KINDS.get(suffix.lower())


def other_kind_of(data: bytes) -> str | None:
    """What bytes hold that is an image, but none that is read; None where nothing is known of them."""
    if data[4:12] in (b"ftypavif", b"ftypheic", b"ftypmif1"):
        return "AVIF or HEIC"
    return next((kind for magic, kind in _NOT_READ if data.startswith(magic)), None)


def _has_tga_header(data: bytes) -> bool:
    if len(data) <= _TGA_HEADER.size:
        return False
    comment, has_map, kind, _, map_length, map_depth, _, _, width, height, depth, flags = _TGA_HEADER.unpack_from(data)
    depths = {1: (8,), 2: (15, 16, 24, 32), 3: (8, 16)}.get(kind & ~8, ())
    has_its_map = map_length > 0 and map_depth in (15, 16, 24, 32) if has_map == 1 else map_length == map_depth == 0
    if has_map > 1 or (kind & ~8 == 1) != (has_map == 1) or not has_its_map or depth not in depths:
        return False
    return width > 0 and height > 0 and flags & 0xC0 == 0 and comment < len(data)
