"""Files of fitted materials: Lafortune lobes as TOML that people read, separable factors as arrays.

A .toml file holds what a scene's table of type "lafortune" holds, and may be copied there:

    type = "lafortune"
    diffuse = [0.1, 0.2, 0.3]       # albedo
    [[lobes]]                       # any number of them
    C = [-1, -1, 0.9]               # or a list of three for each channel
    exponent = 20                   # or a list
    peak = [0.5, 0.6, 0.7]          # the lobe at its largest, in 1/sr; or `specular`, its factor

A .npz file holds `light_maps` [k, c, r, r] and `view_maps` [k, 3, r, r], Σ_k light_k(ω_i) · view_k(ω_o), with texels in
the order y, x; c is 1 or 3. They are over the disc of Wang 2006 eq. 10, or, where it has an `is_polar` that is true,
polar ones (eq. 11). Other arrays in it are not looked at.
"""

import pathlib
from collections.abc import Sequence

import numpy as np

from jaxrelight.brdf.lobes import LobeSum, lobe, lobe_sum
from jaxrelight.brdf.parametrisation import DISC, POLAR
from jaxrelight.brdf.separable import Separable
from jaxrelight.errors import InputError
from jaxrelight.files.npz import read_npz
from jaxrelight.files.toml_table import Table, read_toml
from jaxrelight.files.whole_file import write_whole
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.numbers import float_dtype


def read_fitted(path: str | pathlib.Path) -> LobeSum | Separable:
    """The material of a .toml or .npz file.

    Raises:
        InputError: if the file cannot be read, is damaged, or holds anything unknown, of a wrong shape or not finite.
    """
    path = pathlib.Path(path)
    if path.suffix.lower() == ".npz":
        return _factors(path)
    if path.suffix.lower() == ".toml":
        table = read_toml(path, "a fitted material")
        if (kind := table.text("type")) != "lafortune":
            raise InputError(f"{path}: 'type' must be \"lafortune\", not {kind!r}")
        lobes = read_lobes(table)
        table.finish()
        return lobes
    raise InputError(f"{path}: a fitted material is a .toml file of lobes or a .npz file of factors")


def read_lobes(table: Table) -> LobeSum:
    """The diffuse albedo and the lobes of a table; the caller finishes it.

    Raises:
        InputError: for what is missing, misspelt, of a wrong shape, negative or not finite.
    """
    return lobe_sum(table.not_negative("diffuse"), [_lobe(entry) for entry in table.tables("lobes")])


def _lobe(table: Table):
    C = table.numbers("C", [(3,), (3, 3)])
    factors = {key: table.not_negative(key) for key in ("specular", "peak") if table.has(key)}
    exponent = table.not_negative("exponent")
    table.finish()
    try:
        return lobe(C, exponent, **factors)
    except InputError as error:
        raise table.within(error) from None


def write_lobes(path: str | pathlib.Path, brdf: LobeSum, remarks: Sequence[str] = ()) -> None:
    """Writes lobes, to the last bit of their dtype, below remarks of a line each; whole or not at all.

    Raises:
        InputError: if the lobes have a direction of anisotropy, which the file has no place for, or numbers that are
            not finite, or the file cannot be written.
    """
    path = pathlib.Path(path)
    if brdf.turn is not None:
        raise InputError(f"{path}: lobes with a direction of anisotropy are kept in SBRDF maps, not in a .toml file")
    if not all(np.isfinite(part).all() for part in (brdf.diffuse, brdf.C, brdf.exponent, brdf.scale)):
        raise InputError(f"{path}: the lobes are not finite and cannot be written; check the samples that were fitted")
    lines = [f"# {_printable(remark)}".rstrip() for remark in remarks]
    lines += ["", 'type = "lafortune"', f"diffuse = {_numbers(brdf.diffuse)}"]
    for C, exponent, scale in zip(brdf.C, brdf.exponent, brdf.scale, strict=True):
        entries = f"C = {_numbers(C)}", f"exponent = {_numbers(exponent)}", f"peak = {_numbers(scale)}"
        lines += ["", "[[lobes]]", *entries]
    text = "\n".join(lines).lstrip() + "\n"
    write_whole(path, lambda partial: partial.write_text(text, encoding="utf-8"))


def _printable(text: str) -> str:
    """The text without line ends and such, which would end a comment or are not allowed in one."""
    return "".join(character if character.isprintable() else "?" for character in text)


def _numbers(values) -> str:
    """The shortest decimal numbers that are these, of their dtype; without a list of one."""
    values = np.asarray(values, float_dtype(values))
    if values.ndim == 0:
        return str(values)
    inner = [_numbers(value) for value in values]
    return inner[0] if len(inner) == 1 else f"[{', '.join(inner)}]"


def write_factors(path: str | pathlib.Path, factors: Separable) -> None:
    """Writes factors; the file appears whole or not at all.

    Raises:
        InputError: if they have numbers that are not finite, or the file cannot be written.
    """
    path = pathlib.Path(path)
    dtype = float_dtype(factors)
    light, view = (np.asarray(maps, dtype) for maps in (factors.light_maps, factors.view_maps))
    if not (np.isfinite(light).all() and np.isfinite(view).all()):
        raise InputError(f"{path}: the factors are not finite and cannot be written; check the BRDF")

    is_polar = np.array(factors.parametrisation == POLAR)

    def write(partial: pathlib.Path) -> None:
        with partial.open("wb") as file:
            np.savez_compressed(file, light_maps=light, view_maps=view, is_polar=is_polar)

    write_whole(path, write)


def _factors(path: pathlib.Path) -> Separable:
    arrays = read_npz(path, "factors", ("light_maps", "view_maps", "is_polar"))
    for name in ("light_maps", "view_maps"):
        if name not in arrays:
            raise InputError(f"{path}: '{name}' is missing; it has {', '.join(sorted(arrays)) or 'nothing'}")
    light, view = (arrays[name] for name in ("light_maps", "view_maps"))
    for name, maps, channels in (("light_maps", light, (1, 3)), ("view_maps", view, (3,))):
        shape = maps.shape
        if maps.ndim != 4 or 0 in shape or shape[1] not in channels or shape[2] != shape[3] or shape[0] != len(view):
            raise InputError(f"{path}: '{name}' of shape {shape} is no [terms, channels, side, side] of both sides")
        if not (np.abs(maps) < np.finfo(np.float32).max).all():
            raise InputError(f"{path}: '{name}' has numbers that are not finite; factor the material again")
    is_polar = arrays.get("is_polar", np.array(False))
    if is_polar.dtype.kind != "b" or is_polar.shape:
        raise InputError(f"{path}: 'is_polar' is neither true nor false; write the file again")
    dtype = float_dtype(light, view)
    return Separable(as_array(light, dtype), as_array(view, dtype), POLAR if is_polar else DISC)
