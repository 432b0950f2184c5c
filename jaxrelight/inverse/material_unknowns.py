"""What is sought of materials: parameters by name, what they start from, and the coordinates that solvers work in."""

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import Any, Literal

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.material import Component, Material, as_material, white_lambert, without_diffuse
from jaxrelight.brdf.texture import Texture, Weight
from jaxrelight.errors import InputError
from jaxrelight.numerics.arrays import as_array

# Parameters in which pictures are linear, and all there are.
LINEAR = "albedo", "diffuse", "specular"
PARAMETERS = (*LINEAR, "exponent", "C")
# Colours are softplus(s u)/s: above 0, and nearly u from a tenth on.
_SHARPNESS = 20.0
# Least colour and exponent that a search starts from: what is nothing has no derivative in its logarithm.
_MIN_COLOUR, _MIN_EXPONENT = 1e-3, 0.1
# Texels of a texture at most.
_MAX_TEXELS = 2**24

Form = Literal["linear", "softplus", "log"]


@dataclasses.dataclass(frozen=True)
class Unknown:
    """A material of which some parameters are sought.

        Unknown(jr.lambert(0.5))                                  # its albedo
        Unknown(jr.phong(0.3, 0.2, 10), ("specular", "exponent"))  # the diffuse colour is known
        Unknown(jr.lambert(0.5), textures={"albedo": (32, 32)})   # an albedo for every texel

    Attributes:
        start: a sum of lobes, or a material of one with known textures: known parameters, and where the search starts.
        free: which parameters are sought: "albedo" of what is diffuse alone; "diffuse", "specular", "exponent" and "C"
            of others. "specular" is 2π·scale/(n + 2), as `phong` has it; "C" are the ratios |Cy/Cx| and |Cz/Cx|, or the
            latter alone where Cy = Cx, whose signs are known. By default all but "C".
        textures: free colours that vary over the surface, by the rows and columns of their texture, or by the texture
            that is started from.

    Raises:
        InputError: for what is not one of these.
    """

    start: Brdf | Material
    free: Sequence[str] | None = None
    textures: Mapping[str, tuple[int, int] | Texture] = dataclasses.field(default_factory=dict)

    def __post_init__(self) -> None:
        material = as_material(self.start)
        if len(material.components) != 1 or not isinstance(material.components[0].brdf, LobeSum):
            raise InputError("an unknown material starts from one sum of lobes, such as lambert(…) or phong(…)")
        for name in self.names:
            if name not in self._possible:
                raise InputError(
                    f"'{name}' is no parameter of this material; free are some of {', '.join(self._possible)}"
                )
        if not self.names:
            raise InputError("an unknown material has at least one free parameter; leave known materials out")
        for name, size in self.textures.items():
            if name not in self.names or name not in LINEAR:
                raise InputError(f"'{name}' cannot be a texture; free colours can: {', '.join(self._colours)}")
            if name == "specular" and len(self.lobes.scale) != 1:
                raise InputError("a texture of specular colours is for a BRDF of one lobe")
            rows, columns = size.shape if isinstance(size, Texture) else size
            if not (rows >= 1 and columns >= 1 and rows * columns <= _MAX_TEXELS):
                raise InputError(
                    f"a texture of {rows} × {columns} texels cannot be sought; take from 1 to {_MAX_TEXELS:,}"
                )

    @property
    def lobes(self) -> LobeSum:
        """The sum of lobes that is started from."""
        lobes = as_material(self.start).components[0].brdf
        assert isinstance(lobes, LobeSum)
        return lobes

    @property
    def weight(self) -> Weight:
        """Known textures on it."""
        return as_material(self.start).components[0].weight

    @property
    def names(self) -> tuple[str, ...]:
        """The free parameters."""
        return tuple(name for name in self._possible if name != "C") if self.free is None else tuple(self.free)

    @property
    def _possible(self) -> tuple[str, ...]:
        return PARAMETERS[:1] if self.lobes.is_constant else PARAMETERS[1:]

    @property
    def _colours(self) -> list[str]:
        return [name for name in self.names if name in LINEAR]


class Parameter(eqx.Module):
    """Numbers that are sought, in the coordinates of a solver.

    Attributes:
        key: material and parameter, "paint.exponent".
        form: how a coordinate becomes the number.
        is_texture: whether they are texels [h, w, c].
        groups: of C, the entries that vary together, by their ratio to the one that is in none of them.
        start: coordinates where the search starts.
    """

    key: str = eqx.field(static=True)
    form: Form = eqx.field(static=True)
    is_texture: bool = eqx.field(static=True)
    groups: tuple[tuple[int, ...], ...] = eqx.field(static=True)
    start: Float[Array, "..."]

    def values(self, coordinates: Float[Array | np.ndarray, "..."]) -> Float[Array | np.ndarray, "..."]:
        """The numbers of coordinates; each grows with its own."""
        xp = jnp if isinstance(coordinates, jax.Array) else np
        if self.form == "log":
            return xp.exp(coordinates)
        if self.form == "softplus":
            return xp.logaddexp(_SHARPNESS * coordinates, xp.zeros_like(coordinates)) / _SHARPNESS
        return coordinates


# Coordinates by a parameter's key.
Coordinates = dict[str, Float[Array, "..."]]


class _Started(eqx.Module):
    """An unknown material as compiled functions take it."""

    lobes: LobeSum
    weight: Weight
    textures: dict[str, Texture]
    emission: Array | None


class Unknowns(eqx.Module):
    """All unknown materials, from coordinates to materials. A pytree: others of the same kinds compile nothing anew.

    Attributes:
        parameters: of all of them.
        started: where each material starts, by name.
        is_linear: whether pictures are linear in all parameters.
    """

    parameters: tuple[Parameter, ...]
    started: dict[str, _Started]
    is_linear: bool = eqx.field(static=True)

    def start(self) -> Coordinates:
        """Where the search starts."""
        return {one.key: one.start for one in self.parameters}

    def materials(self, coordinates: Coordinates) -> dict[str, Material]:
        """The materials of coordinates; differentiable."""
        parameters = {one.key: one for one in self.parameters}
        values = {key: one.values(coordinates[key]) for key, one in parameters.items()}
        return {name: _material(name, started, parameters, values) for name, started in self.started.items()}


def unknowns_of(given: Mapping[str, Unknown | Brdf | Material], follows_bounces: bool = False) -> Unknowns:
    """What is sought, in coordinates.

    Args:
        given: by the materials' names; a material alone stands for `Unknown` of it.
        follows_bounces: whether light that surfaces reflect onto each other follows, so that nothing is linear.

    Raises:
        InputError: for none, or one that is no unknown material.
    """
    if not given:
        raise InputError("no material is unknown; name at least one")
    unknowns = {name: one if isinstance(one, Unknown) else Unknown(one) for name, one in given.items()}
    is_linear = not follows_bounces and all(part in LINEAR for one in unknowns.values() for part in one.names)
    # Texels are many, and are sought as they are.
    colour: Form = "linear" if is_linear or any(one.textures for one in unknowns.values()) else "softplus"
    parameters = tuple(_parameter(name, one, part, colour) for name, one in unknowns.items() for part in one.names)
    return Unknowns(parameters, {name: _started(one) for name, one in unknowns.items()}, is_linear)


def _started(unknown: Unknown) -> _Started:
    emission = as_material(unknown.start).emission
    textures = {}
    for name, size in unknown.textures.items():
        textures[name] = size if isinstance(size, Texture) else Texture(_texels(unknown, name, size))
    return jax.tree.map(
        as_array, _Started(unknown.lobes, unknown.weight, textures, None if emission is None else as_array(emission))
    )


def _share(lobes: LobeSum) -> np.ndarray:
    """The share of light that each lobe reflects: 2π·scale/(n + 2)."""
    return np.asarray(lobes.scale, float) * 2 * math.pi / (np.asarray(lobes.exponent, float) + 2)


def _texels(unknown: Unknown, name: str, size: tuple[int, int]) -> Float[Array, "h w c"]:
    colour = _share(unknown.lobes)[0] if name == "specular" else np.asarray(unknown.lobes.diffuse, float)
    return as_array(np.tile(colour, (*size, 3 // len(colour))), np.float32)


def _parameter(name: str, unknown: Unknown, part: str, colour: Form) -> Parameter:
    lobes, key = unknown.lobes, f"{name}.{part}"
    texture = unknown.textures.get(part)
    groups: tuple[tuple[int, ...], ...] = ()
    form: Form = "log"
    if texture is not None:
        form, start = "linear", texture.pixels if isinstance(texture, Texture) else _texels(unknown, part, texture)
    elif part in LINEAR:
        form, start = colour, _share(lobes) if part == "specular" else np.asarray(lobes.diffuse, float)
    elif part == "exponent":
        start = np.log(np.maximum(np.asarray(lobes.exponent, float), _MIN_EXPONENT))
    else:
        groups, start = _log_ratios(name, np.asarray(lobes.C, float))
    if form == "softplus":
        start = np.maximum(start, _MIN_COLOUR)
        start = start + np.log(-np.expm1(-_SHARPNESS * start)) / _SHARPNESS
    return Parameter(key, form, texture is not None, groups, as_array(start, np.float32))


def _log_ratios(name: str, C: np.ndarray) -> tuple[tuple[tuple[int, ...], ...], np.ndarray]:
    """Entries of C that vary together, and the logarithms [l, c1, groups] of their ratios to the one that is left."""
    if np.any(C == 0):
        raise InputError(f"'{name}.C' starts from an entry that is 0, whose sign is not known; start from others")
    if np.all(C[..., 0] == C[..., 1]):
        groups: tuple[tuple[int, ...], ...] = ((2,),)
    else:
        groups = (1,), (2,)
    return groups, np.stack([np.log(np.abs(C[..., group[0]] / C[..., 0])) for group in groups], axis=-1)


def _entries(C: Float[Array, "l c1 3"], ratios: Float[Array, "l c1 q"], groups: tuple) -> Float[Array, "l c1 3"]:
    """C with max|C| = 1, of the signs that it starts with and of the ratios of its entries to others."""
    columns = [jnp.ones_like(ratios[..., 0])] * 3
    for number, group in enumerate(groups):
        for axis in group:
            columns[axis] = ratios[..., number]
    sizes = jnp.stack(columns, axis=-1)
    return jnp.sign(C) * sizes / jnp.max(sizes, axis=-1, keepdims=True)


def _material(name: str, started: _Started, parameters: dict[str, Parameter], values: dict[str, Any]) -> Material:
    """One material of its parameters' values."""
    lobes, textures = started.lobes, started.textures

    def value(part: str, otherwise: Array) -> Array:
        return values.get(f"{name}.{part}", otherwise)

    def component(brdf: LobeSum, part: str) -> Component:
        if part not in textures:
            return Component(brdf, started.weight)
        image = dataclasses.replace(textures[part], pixels=values[f"{name}.{part}"], coarser=None).minified()
        return Component(brdf, (image, *started.weight))

    if lobes.is_constant:
        if "albedo" in textures:
            return Material((component(white_lambert(lobes.diffuse.dtype), "albedo"),), emission=started.emission)
        brdf = dataclasses.replace(lobes, diffuse=value("albedo", lobes.diffuse))
        return Material((component(brdf, ""),), emission=started.emission)
    n = value("exponent", lobes.exponent)
    share = jnp.ones_like(lobes.scale)
    if "specular" not in textures:
        share = value("specular", lobes.scale * (2 * math.pi) / (lobes.exponent + 2))
    C = lobes.C
    if f"{name}.C" in values:
        C = _entries(C, values[f"{name}.C"], parameters[f"{name}.C"].groups)
    diffuse = lobes.diffuse if "diffuse" in textures else value("diffuse", lobes.diffuse)
    brdf = LobeSum(diffuse, C, n, share * (n + 2) / (2 * math.pi), lobes.turn)
    if not textures:
        return Material((component(brdf, ""),), emission=started.emission)
    white = white_lambert(diffuse.dtype)
    plain = white if "diffuse" in textures else dataclasses.replace(white, diffuse=diffuse)
    parts = component(plain, "diffuse"), component(without_diffuse(brdf), "specular")
    return Material(parts, emission=started.emission)
