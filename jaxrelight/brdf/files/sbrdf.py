"""SBRDF maps: one OpenEXR file of named channels, a part for each level of detail.

Parts are called level0, level1, …; each is half as wide and high as the one before it, rounded up. Row 0 is the top,
v = 1. Channels of every part, all float32:

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

from jaxrelight.brdf.material import Component, Material
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.texture import Texture, halved_shape
from jaxrelight.errors import InputError
from jaxrelight.images.exr import read_channels, write_channels
from jaxrelight.whole_file import write_whole

_LARGEST = 2**26  # texels


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


def write_sbrdf(path: str | pathlib.Path, levels: Sequence[SbrdfLevel]) -> None:
    """Writes the levels, finest first; the file appears whole or not at all.

    Raises:
        InputError: if the file cannot be written.
    """
    path = pathlib.Path(path)
    if path.suffix.lower() != ".exr":
        raise InputError(f"{path}: SBRDF maps are written as .exr; change the name")
    parts = [(f"level{number}", _channels(level)) for number, level in enumerate(levels)]
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
        parts = read_channels(path, _LARGEST)
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
    bumps = Texture(jnp.asarray((level.normals + 1) / 2, jnp.float32)).minified() if bent else None
    lobes = dataclasses.replace(level.lobes, coarser=tuple(other.lobes for other in levels[1:]))
    return Material((Component(lobes),), bumps)


def _channels(level: SbrdfLevel) -> dict[str, np.ndarray]:
    maps = {name: np.asarray(array) for name, array in vars(level.lobes).items() if name != "coarser"}
    found = _spread("diffuse.", "RGB", maps["diffuse"])
    for j in range(level.lobes.lobes):
        found |= _spread(f"lobe{j}.C.", "XYZ", maps["C"][:, :, j])
        found |= {f"lobe{j}.exponent": maps["exponent"][:, :, j]}
        found |= _spread(f"lobe{j}.scale.", "RGB", maps["scale"][:, :, j])
    found |= {"axis.cos2": maps["axis"][..., 0], "axis.sin2": maps["axis"][..., 1]}
    found |= _spread("normal.", "XYZ", level.normals)
    return found | {"flag": level.flag.astype(np.float32), "residual": level.residual}


def _spread(prefix: str, names: str, array: np.ndarray) -> dict[str, np.ndarray]:
    return {prefix + name: array[..., i] for i, name in enumerate(names)}


def _level(path: pathlib.Path, number: int, planes: dict[str, np.ndarray]) -> SbrdfLevel:
    count = 1 + max((int(name[4:].split(".")[0]) for name in planes if re.match(r"lobe\d+\.", name)), default=-1)
    wanted = ["diffuse.R", "axis.cos2", "axis.sin2", "normal.X", "flag", "residual"]
    missing = [name for name in wanted if name not in planes]
    if missing:
        raise InputError(
            f"{path}: level {number} lacks the channel '{missing[0]}'; is it a map of jaxrelight-fit sbrdf?"
        )

    def gathered(prefix: str, names: Sequence[str]) -> np.ndarray:
        lacking = [prefix + name for name in names if prefix + name not in planes]
        if lacking:
            raise InputError(f"{path}: level {number} lacks the channel '{lacking[0]}'; write it again")
        return np.stack([planes[prefix + name] for name in names], axis=-1)

    shape = planes["flag"].shape
    diffuse = gathered("diffuse.", "RGB")
    if count:
        C = np.stack([gathered(f"lobe{j}.C.", "XYZ") for j in range(count)], axis=2)
        exponent = np.concatenate([gathered(f"lobe{j}.", ["exponent"]) for j in range(count)], axis=2)
        scale = np.stack([gathered(f"lobe{j}.scale.", "RGB") for j in range(count)], axis=2)
    else:
        C, exponent, scale = np.zeros((*shape, 0, 3)), np.zeros((*shape, 0)), np.zeros((*shape, 0, 3))
    normals = gathered("normal.", "XYZ").astype(float)
    axis = np.stack([planes["axis.cos2"], planes["axis.sin2"]], axis=-1)
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
    made = SpatialLobes(*(jnp.asarray(a, jnp.float32) for a in (diffuse, C, exponent, scale, axis)))
    return SbrdfLevel(made, normals, planes["flag"].astype(int), planes["residual"])
