"""SBRDF maps: one OpenEXR file of named channels, a part for each level of detail.

Parts are called level0, level1, …; each is half as wide and high as the one before it, rounded up. Row 0 is the top,
v = 1. Channels of every part, all float32 unless storage is compact (`jaxrelight.brdf.coded` has the names then):

    diffuse.R, .G, .B           albedo
    lobeJ.C.X, .Y, .Z           C of lobe J = 0, 1, …, with max|C| = 1
    lobeJ.exponent              n
    lobeJ.scale.R, .G, .B       the lobe at its peak: f = diffuse/π + Σ_J scale · max(0, ω_oᵀ C ω_i)ⁿ
    axis.cos2, axis.sin2        of twice the angle from the tangent (u rightwards) to the direction of anisotropy
    normal.X, .Y, .Z            unit, in the tangent space of the map: X along u, Y along v, Z off the surface
    flag                        what the fit of the texel was worth, a whole number; 0 is good
    residual                    of the fit, relative; NaN where there was nothing to fit
"""

import dataclasses
import itertools
import pathlib
import re
from collections.abc import Sequence

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float, Int

from jaxrelight.brdf.coded import Storage, decode, encode
from jaxrelight.brdf.material import Component, Material
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.texture import Texture, halved_shape
from jaxrelight.errors import InputError
from jaxrelight.files.whole_file import write_whole
from jaxrelight.images.exr import read_channels, write_channels
from jaxrelight.numerics.arrays import as_array

_MAX_TEXELS = 2**26  # texels


@dataclasses.dataclass(frozen=True, eq=False)
class SbrdfLevel:
    """One level of detail.

    Attributes:
        lobes: the maps.
        normals: unit, in tangent space.
        flag: 0 where the fit is good.
        residual: relative, of the fit.
    """

    lobes: SpatialLobes
    normals: Float[np.ndarray, "h w 3"]
    flag: Int[np.ndarray, "h w"]
    residual: Float[np.ndarray, "h w"]


def write_sbrdf(path: str | pathlib.Path, levels: Sequence[SbrdfLevel], storage: Storage = "float") -> None:
    """Writes the levels, finest first; the file appears whole or not at all.

    Args:
        path: ends with .exr.
        levels: what `read_sbrdf` gives back.
        storage: "float", or less bytes a number, see `jaxrelight.brdf.coded`.

    Raises:
        InputError: if the file cannot be written, or the storage has no place for a number.
    """
    path = pathlib.Path(path)
    if path.suffix.lower() != ".exr":
        raise InputError(f"{path}: SBRDF maps are written as .exr; change the name")
    parts = [(f"level{number}", _channels(level, storage)) for number, level in enumerate(levels)]
    write_whole(path, lambda partial: write_channels(partial, parts))


def read_sbrdf(path: str | pathlib.Path) -> list[SbrdfLevel]:
    """Reads the levels, finest first.

    Raises:
        InputError: if the file is missing, damaged, no OpenEXR file, lacks channels or has values out of range.
    """
    path = pathlib.Path(path)
    if not path.is_file():
        raise InputError(f"{path}: no such file; give the .exr that jaxrelight-fit sbrdf wrote")
    try:
        parts = read_channels(path, _MAX_TEXELS)
    except OSError as fault:
        raise InputError(f"{path}: cannot be read ({fault.strerror or fault}); check the path and its rights") from None
    levels = [_level(path, number, planes) for number, planes in enumerate(parts)]
    for number, (finer, level) in enumerate(itertools.pairwise(levels), 1):
        if level.lobes.shape != halved_shape(*finer.lobes.shape) or level.lobes.lobes != finer.lobes.lobes:
            raise InputError(
                f"{path}: level {number} is of {level.lobes.shape} texels and {level.lobes.lobes} lobes; it must be "
                "half as wide and high as the one before it, rounded up, and have as many lobes"
            )
    return levels


def spatial(levels: Sequence[SbrdfLevel]) -> Material:
    """Maps as a material: their lobes, and the finest normals as a normal map where they are not all straight."""
    level = levels[0]
    bent = np.any(np.abs(level.normals - [0, 0, 1]) > 1e-6)
    # Files hold no more than float32.
    bumps = Texture(as_array((level.normals + 1) / 2, jnp.float32)).minified() if bent else None
    lobes = dataclasses.replace(level.lobes, coarser=tuple(other.lobes for other in levels[1:]))
    return Material((Component(lobes),), bumps)


def _channels(level: SbrdfLevel, storage: Storage) -> dict[str, np.ndarray]:
    planes = encode(level.lobes, storage)
    number = np.float32 if storage == "float" else np.float16
    other_planes = {f"normal.{name}": level.normals[..., i] for i, name in enumerate("XYZ")}
    other_planes |= {"flag": level.flag, "residual": level.residual}
    return planes | {name: plane.astype(number) for name, plane in other_planes.items()}


def _level(path: pathlib.Path, number: int, planes: dict[str, np.ndarray]) -> SbrdfLevel:
    count = 1 + max((int(name[4:].split(".")[0]) for name in planes if re.match(r"lobe\d+\.", name)), default=-1)
    for name in ("flag", "residual", "normal.X", "normal.Y", "normal.Z"):
        if name not in planes:
            raise InputError(f"{path}: level {number} lacks the channel '{name}'; is it a map of jaxrelight-fit sbrdf?")
    try:
        lobes = decode(planes, count)
    except KeyError as lacking:
        raise InputError(f"{path}: level {number} lacks the channel {lacking}; write it again") from None
    except ValueError as wrong:
        raise InputError(f"{path}: level {number}: {wrong}; write it again") from None
    normals = np.stack([planes[f"normal.{name}"] for name in "XYZ"], axis=-1).astype(float)
    diffuse, C, exponent, scale, axis = (
        np.asarray(array) for array in (lobes.diffuse, lobes.C, lobes.exponent, lobes.scale, lobes.axis)
    )
    for name, values, least in (
        ("diffuse", diffuse, 0),
        ("C", C, -1.001),
        ("exponent", exponent, 0),
        ("scale", scale, 0),
        ("axis", axis, -1.001),
        ("normal", normals, -1.001),
    ):
        if not (np.isfinite(values).all() and (values >= least).all()):
            raise InputError(f"{path}: level {number} has values of '{name}' that are not finite or out of range")
    if (np.abs(C) > 1.001).any():
        raise InputError(
            f"{path}: level {number} has a C beyond 1; scale it to max|C| = 1, and the lobe's scale with it"
        )
    return SbrdfLevel(lobes, normals, planes["flag"].astype(int), planes["residual"])
