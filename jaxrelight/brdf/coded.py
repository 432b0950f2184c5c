"""Compact codes of maps of lobes: half floats, and 8 bits (McAllister 2002 §3 and §4).

A lobe's power multiplies what rounding does to C by n. Both codes therefore keep |C|ⁿ rather than C.
"""

from collections.abc import Callable, Mapping
from typing import Literal

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.errors import InputError
from jaxrelight.numerics.arrays import as_array

Storage = Literal["float", "half", "8bit"]
Planes = Mapping[str, Float[np.ndarray, "h w"]]

_MAX_HALF = 65504.0
# Exponents in 8 bits lie evenly by log(n + 1). The paper's 255·√(n/255) ends at 255, and is coarser below 12
# (`tests/benchmarks/sbrdf_storage.py`).
_MAX_EXPONENT, _LOGARITHM = 1e5, np.log1p(1e5)
# −log|C|ⁿ in 13 bits: even steps of its logarithm beyond the first number; the last step is C = 0.
_LOST, _MAX_LOST, _NOTHING = 0.5, 7e4, 2**13 - 1
_STEP = np.log1p(_MAX_LOST / _LOST) / (_NOTHING - 1)


def encode(lobes: SpatialLobes, storage: Storage) -> dict[str, np.ndarray]:
    """Maps as named planes [h, w]: float32, or float16, of which 8-bit codes are whole numbers.

    Per lobe j, and for the whole texel:

        float   lobe{j}.C.XYZ, .exponent, .scale.RGB; diffuse.RGB; axis.cos2, .sin2
        half    lobe{j}.power.XYZ = sign(C)·(1 − max(n, 1)·log|C|), .exponent, .share.RGB = scale/(n + 2); the others
                as before. Rounding moves no lobe by more than 6e-4 of its peak, whatever n.
        8bit    lobe{j}.code.CDEF = C, of which the largest component is 1: signs, and −log|C|ⁿ of the other two in 13
                bits each; .code.N = 255·log(n + 1)/log(100,001); .code.RGBP = share as three mantissas of 8 bits and a
                power of 2, diffuse.code.RGBP likewise; axis.code.AB: 2φ in two bytes.

    The paper keeps C in three bytes of fixed point, of the length that preserves the ratios of its components best
    (§3): that is many per cent wrong at exponents of 80 and more (`tests/benchmarks/sbrdf_storage.py`).

    Exponents beyond 65,504 in half floats, or 100,000 in 8 bits, are held there, and reflect what they did: lobes half
    a degree wide.

    Raises:
        InputError: if a lobe reflects, or an albedo is, more than half floats can hold: 65,504.
    """
    maps = {name: np.asarray(array, float) for name, array in vars(lobes).items() if name != "coarser"}
    if storage != "float":
        share = maps["scale"] / (maps["exponent"] + 2)[..., None]
        _check("scale/(n + 2)", share, storage)
        _check("diffuse", maps["diffuse"], storage)
        held = np.minimum(maps["exponent"], _MAX_HALF if storage == "half" else _MAX_EXPONENT)
        maps |= {"exponent": held, "scale": share * (held + 2)[..., None]}
    planes = {}
    for j in range(lobes.lobes):
        parameters = maps["C"][:, :, j], maps["exponent"][:, :, j], maps["scale"][:, :, j]
        planes |= {f"lobe{j}.{name}": plane for name, plane in _ENCODE[storage](*parameters).items()}
    if storage == "8bit":
        planes |= {f"diffuse.{name}": plane for name, plane in _mantissas(maps["diffuse"]).items()}
        turn = np.arctan2(maps["axis"][..., 1], maps["axis"][..., 0]) / (2 * np.pi)
        code = np.rint(turn * 2**16) % 2**16
        planes |= {"axis.code.A": code // 256, "axis.code.B": code % 256}
    else:
        planes |= _spread("diffuse.", "RGB", maps["diffuse"])
        planes |= {"axis.cos2": maps["axis"][..., 0], "axis.sin2": maps["axis"][..., 1]}
    return {name: plane.astype(np.float32 if storage == "float" else np.float16) for name, plane in planes.items()}


def decode(planes: Planes, lobes: int) -> SpatialLobes:
    """Maps from the planes that `encode` made, in whichever way.

    Raises:
        KeyError: if a plane is missing, by its name.
        ValueError: if codes of 8 bits are none.
    """
    planes = {name: np.asarray(plane, float) for name, plane in planes.items()}
    for name, plane in planes.items():
        if ".code." in name and not (plane == np.clip(np.rint(plane), 0, 255)).all():
            raise ValueError(f"the channel '{name}' holds other numbers than bytes")
    if lobes:
        parts = [_decoded(planes, f"lobe{j}.") for j in range(lobes)]
        C, exponent, scale = (np.stack(part, axis=2) for part in zip(*parts, strict=True))
    else:
        shape = next(iter(planes.values())).shape
        C, exponent, scale = np.zeros((*shape, 0, 3)), np.zeros((*shape, 0)), np.zeros((*shape, 0, 3))
    if "diffuse.code.R" in planes:
        diffuse = _from_mantissas(planes, "diffuse.")
        angle = (planes["axis.code.A"] * 256 + planes["axis.code.B"]) * (2 * np.pi / 2**16)
        axis = np.stack([np.cos(angle), np.sin(angle)], axis=-1)
    else:
        diffuse = _gathered(planes, "diffuse.", "RGB")
        axis = np.stack([planes["axis.cos2"], planes["axis.sin2"]], axis=-1)
    # No storage holds more than float32.
    return SpatialLobes(*(as_array(a, jnp.float32) for a in (diffuse, C, exponent, scale, axis)))


def _decoded(planes: Planes, prefix: str):
    """C, exponent and scale of one lobe."""
    for sign, decoder in _DECODE.items():
        if prefix + sign in planes:
            return decoder(planes, prefix)
    return _from_float(planes, prefix)


def _as_float(C, exponent, scale) -> dict[str, np.ndarray]:
    return _spread("C.", "XYZ", C) | {"exponent": exponent} | _spread("scale.", "RGB", scale)


def _from_float(planes: Planes, prefix: str):
    return (
        _gathered(planes, prefix + "C.", "XYZ"),
        planes[prefix + "exponent"],
        _gathered(planes, prefix + "scale.", "RGB"),
    )


def _as_half(C, exponent, scale) -> dict[str, np.ndarray]:
    with np.errstate(divide="ignore"):
        power = 1 - np.maximum(exponent, 1)[..., None] * np.log(np.abs(C))
    # Beyond the largest half float a component adds nothing.
    power = np.where(power > _MAX_HALF, np.inf, power)
    share = scale / (exponent + 2)[..., None]
    return _spread("power.", "XYZ", np.copysign(power, C)) | {"exponent": exponent} | _spread("share.", "RGB", share)


def _from_half(planes: Planes, prefix: str):
    power, exponent = _gathered(planes, prefix + "power.", "XYZ"), planes[prefix + "exponent"]
    C = np.copysign(np.exp((1 - np.abs(power)) / np.maximum(exponent, 1)[..., None]), power)
    return C, exponent, _gathered(planes, prefix + "share.", "RGB") * (exponent + 2)[..., None]


def _as_bytes(C, exponent, scale) -> dict[str, np.ndarray]:
    n = np.rint(255 * np.log1p(exponent) / _LOGARITHM)
    bits = _packed(C, exponent)
    planes = {f"code.{name}": bits >> shift & 255 for name, shift in zip("CDEF", (24, 16, 8, 0), strict=True)}
    return planes | {"code.N": n} | _mantissas(scale / (exponent + 2)[..., None])


def _mantissas(values: Float[np.ndarray, "h w 3"]) -> dict[str, np.ndarray]:
    """Three bytes and the power of 2 that they share."""
    largest = values.max(axis=-1)
    e = np.where(largest > 0, np.frexp(largest)[1], -127)
    # The largest mantissa may round up to 256.
    e = np.clip(e + (np.rint(largest * 2.0 ** (8 - e)) > 255), -127, 127)
    mantissa = np.minimum(np.rint(values * 2.0 ** (8 - e)[..., None]), 255)
    return _spread("code.", "RGB", mantissa) | {"code.P": e + 128}


def _from_mantissas(planes: Planes, prefix: str) -> Float[np.ndarray, "h w 3"]:
    mantissa, e = _gathered(planes, prefix + "code.", "RGB"), planes[prefix + "code.P"] - 128
    return mantissa * (2.0 ** (e - 8))[..., None]


def _packed(C: Float[np.ndarray, "*p 3"], exponent: Float[np.ndarray, "*p"]) -> np.ndarray:
    """31 bits: which component is largest, its sign, and sign and −log|C|ⁿ of the two that follow it around."""
    length = np.abs(C)
    first = np.argmax(length, axis=-1)
    with np.errstate(divide="ignore"):
        lost = -np.maximum(exponent, 1)[..., None] * np.log(length)
    step = np.where(lost < _MAX_LOST, np.rint(np.log1p(np.maximum(lost, 0) / _LOST) / _STEP), _NOTHING).astype(int)

    def after(values: np.ndarray, places: int) -> np.ndarray:
        return np.take_along_axis(values, ((first + places) % 3)[..., None], axis=-1)[..., 0]

    negative = (C < 0).astype(int)
    bits = np.where(length.max(axis=-1) > 0, first, 3) << 29 | after(negative, 0) << 28
    return bits | after(negative, 1) << 27 | after(step, 1) << 14 | after(negative, 2) << 13 | after(step, 2)


def _unpacked(bits: np.ndarray, exponent: Float[np.ndarray, "*p"]) -> Float[np.ndarray, "*p 3"]:
    def component(negative: np.ndarray, step: np.ndarray) -> np.ndarray:
        lost = np.where(step < _NOTHING, _LOST * np.expm1(_STEP * step), np.inf)
        return np.where(negative, -1, 1) * np.exp(-lost / np.maximum(exponent, 1))

    three = [
        component(bits >> 28 & 1, 0 * bits),
        component(bits >> 27 & 1, bits >> 14 & _NOTHING),
        component(bits >> 13 & 1, bits & _NOTHING),
    ]
    first = bits >> 29
    around = [np.choose((number - first) % 3, three) for number in range(3)]
    return np.where((first < 3)[..., None], np.stack(around, axis=-1), 0)


def _from_bytes(planes: Planes, prefix: str):
    bits = np.zeros(planes[prefix + "code.N"].shape, int)
    for name in "CDEF":
        bits = bits << 8 | planes[f"{prefix}code.{name}"].astype(int)
    exponent = np.expm1(planes[prefix + "code.N"] * (_LOGARITHM / 255))
    return _unpacked(bits, exponent), exponent, _from_mantissas(planes, prefix) * (exponent + 2)[..., None]


_ENCODE: dict[Storage, Callable] = {"float": _as_float, "half": _as_half, "8bit": _as_bytes}
_DECODE = {"power.X": _from_half, "code.N": _from_bytes}


def _spread(prefix: str, names: str, array: np.ndarray) -> dict[str, np.ndarray]:
    return {prefix + name: array[..., i] for i, name in enumerate(names)}


def _gathered(planes: Planes, prefix: str, names: str) -> Float[np.ndarray, "h w m"]:
    return np.stack([planes[prefix + name] for name in names], axis=-1)


def _check(name: str, values: np.ndarray, storage: Storage):
    if values.size and values.max() > _MAX_HALF:
        raise InputError(
            f"{name} reaches {values.max():,.6g}, and {storage} storage holds {_MAX_HALF:,.0f} at most; "
            "use float storage"
        )
