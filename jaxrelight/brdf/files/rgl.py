"""RGL's .bsdf files: the adaptive parametrisation of Dupuy and Jakob (2018) in a container of named arrays.

The 12 bytes of `MAGIC`, version 1.0, the number of fields; for each its name, dimensions, type, place and shape;
then the arrays, little-endian, one after the other, each starting at a multiple of eight bytes.
"""

import math
import struct

import jax.numpy as jnp
import numpy as np

from jaxrelight.brdf import bilinear_warp
from jaxrelight.brdf.adaptive import Adaptive
from jaxrelight.brdf.files.content import Content
from jaxrelight.numerics.arrays import as_array

MAGIC = b"tensor_file\0"
_TYPES = dict(enumerate(["u1", "i1", "<u2", "<i2", "<u4", "<i4", "<u8", "<i8", "<f2", "<f4", "<f8"], 1))
_MAX_FIELDS, _MAX_DIMENSIONS = 64, 8


def read_fields(content: Content) -> dict[str, np.ndarray]:
    """The named arrays of a file.

    Raises:
        InputError: if the file is of another version, cut short, too long, or its header contradicts itself.
    """
    reader = _Header(content)
    version, count = reader.take("<2B"), reader.take("<I")[0]
    if version != (1, 0):
        raise content.fault(f"is of version {version[0]}.{version[1]}, not 1.0", "use a file of version 1.0")
    if count > _MAX_FIELDS:
        raise content.fault(f"claims {count:,} fields")
    fields, spans = {}, []
    for _ in range(count):
        name = reader.bytes(reader.take("<H")[0]).decode("utf-8", "replace")
        dimensions, kind, offset = reader.take("<HBQ")
        if kind not in _TYPES or dimensions > _MAX_DIMENSIONS or name in fields:
            raise content.fault(f"the header's entry '{name[:40]}' makes no sense")
        shape = reader.take(f"<{dimensions}Q")
        fields[name] = content.array(_TYPES[kind], shape, offset)
        spans.append((offset, offset + math.prod(shape) * np.dtype(_TYPES[kind]).itemsize))
    # What neither overlaps nor leaves holes has the lengths that it claims.
    end = reader.place
    for start, stop in [*sorted(spans), (len(content.data), 0)]:
        if not end <= start < end + 8:
            raise content.fault("the arrays are not where its header says")
        end = stop
    return fields


class _Header:
    """Numbers and texts one after the other."""

    def __init__(self, content: Content):
        self._content, self.place = content, len(MAGIC)

    def bytes(self, count: int) -> bytes:
        if self.place + count > len(self._content.data):
            raise self._content.fault("is cut short")
        self.place += count
        return self._content.data[self.place - count : self.place]

    def take(self, format: str) -> tuple:
        return struct.unpack(format, self.bytes(struct.calcsize(format)))


def read_rgl(content: Content) -> tuple[Adaptive, list[str]]:
    """The BRDF of a file that holds linear Rec.709 reflectance. Negative values are taken as 0, and counted in a note.

    Raises:
        InputError: if it is no such file, or holds numbers that are not finite, or densities that cannot be.
    """
    fields = read_fields(content)
    if "rgb" not in fields and "spectra" in fields:
        raise content.fault("holds spectra", "use the variant of this material whose name ends in _rgb")
    wanted = {"phi_i": 1, "theta_i": 1, "sigma": 2, "ndf": 2, "vndf": 4, "rgb": 5}
    for name, dimensions in wanted.items():
        if name not in fields:
            raise content.fault(f"has no field '{name}'", "is it an RGL material?")
        if fields[name].ndim != dimensions or fields[name].dtype != np.float32:
            raise content.fault(f"the field '{name}' has the wrong dimensions or type", "is it an RGL material?")
        content.check_finite(fields[name], f"numbers of '{name}'")
    phi, theta, area, normals, visible, rgb = (fields[name] for name in wanted)
    incident = len(phi), len(theta)
    if visible.shape[:2] != incident or rgb.shape[:2] != incident or rgb.shape[2] != 3:
        raise content.fault("its arrays do not fit together", "is it an RGL material?")
    if min(area.shape + normals.shape + visible.shape[2:] + rgb.shape[3:]) < 2 or 0 in incident:
        raise content.fault("its arrays are too small", "is it an RGL material?")
    for name, angles, least, most in (("phi_i", phi, -np.pi, np.pi), ("theta_i", theta, 0, np.pi / 2)):
        if (np.diff(angles) <= 0).any() or angles[0] < least - 1e-3 or angles[-1] > most + 1e-3:
            raise content.fault(f"the angles '{name}' do not ascend, or are out of range")
    if area.min() <= 0 or normals.min() < 0 or visible.min() < 0 or not visible.any(axis=(2, 3)).all():
        raise content.fault("a density is negative, or nothing at all")
    jacobian = fields.get("jacobian", np.zeros(0))
    if jacobian.dtype != np.uint8 or jacobian.shape != (1,):
        raise content.fault("the field 'jacobian' is missing or wrong", "is it an RGL material?")
    samples, notes = content.without_negative(rgb, "values")
    if not jacobian[0]:  # the samples are f cosθ itself
        area, normals = np.full((2, 2), 0.25), np.ones((2, 2))
    slices = len(phi) * len(theta)
    warp = bilinear_warp.sums(visible.reshape(slices, *visible.shape[2:]))
    arrays = phi, theta, normals, area, *warp, samples.reshape(slices, *samples.shape[2:])
    # The arrays have the precision of the file.
    return Adaptive(*(as_array(array, jnp.float32) for array in arrays)), notes
