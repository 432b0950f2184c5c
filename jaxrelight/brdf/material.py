"""Materials: linear combinations of BRDFs whose weights vary over the surface (Wang 2006 §3.1)."""

import dataclasses
from typing import TypeVar

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.texture import Texture, VertexColours, Weight, constant
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.numbers import Numbers, as_numbers, float_dtype, module_of


class Component(eqx.Module):
    """One BRDF of a material, or one for every texel, and the factor on it, by channel and texture coordinates."""

    brdf: Brdf | SpatialLobes
    weight: Weight = ()


class Material(eqx.Module):
    """Σ_b weight_b(u, v) · f_b(ω_i, ω_o).

    Transport is precomputed for each f_b by itself; weights multiply at the view, in every pixel. So a texture stays as
    sharp as it is, whatever the receivers are, and changing it changes no transport. Like BRDFs, textures and lights a
    material is a pytree: `jax.jit`, `jax.grad` and `jax.vmap` take and return it.

    Attributes:
        components: the BRDFs and their weights.
        normal_map: tangent-space normals as (n + 1)/2, three channels; None for the mesh's own.
        emission: radiance that it emits in all directions above the surface; None for none.
    """

    components: tuple[Component, ...]
    normal_map: Texture | None = None
    emission: Float[Array | np.ndarray, "3"] | None = None

    @property
    def needs_uv(self) -> bool:
        """Whether it can only be put on a mesh that has texture coordinates.

        A normal map needs them even where it is constant: it bends normals along the directions of growing u and v.
        """
        return bool(self.uv_sets)

    @property
    def uv_sets(self) -> set[int]:
        """Numbers of the sets of texture coordinates that it needs."""
        textures = [one for component in self.components for one in component.weight if isinstance(one, Texture)]
        sets = {texture.uv_set for texture in textures if not texture.is_constant}
        sets |= {0} if self.is_spatial else set()
        return sets | ({self.normal_map.uv_set} if self.normal_map is not None else set())

    @property
    def needs_colours(self) -> bool:
        """Whether it can only be put on a mesh whose vertices have colours."""
        return any(isinstance(one, VertexColours) for component in self.components for one in component.weight)

    @property
    def is_spatial(self) -> bool:
        """Whether a component has a BRDF for every texel."""
        return any(isinstance(component.brdf, SpatialLobes) for component in self.components)


def as_material(surface: Brdf | Material) -> Material:
    """A BRDF as the material that is the same everywhere."""
    return surface if isinstance(surface, Material) else Material((Component(surface),))


def white_lambert(dtype: DTypeLike | None = None) -> LobeSum:
    """Albedo 1 in a single channel: what a texture of albedos multiplies. By default of JAX's own dtype."""
    dtype = float_dtype() if dtype is None else dtype
    return LobeSum(*(as_array(x, dtype) for x in (np.ones(1), *map(np.zeros, ((0, 1, 3), (0, 1), (0, 1))))))


def white_phong(exponent: Numbers, dtype: DTypeLike | None = None) -> LobeSum:
    """(n + 2)/(2π)·max(0, cos α)ⁿ, as `phong` of specular 1: in a single channel where the exponent is one number.

    The exponent may be traced. The dtype is by default that of its array, or JAX's own for numbers of Python.
    """
    dtype = float_dtype(exponent) if dtype is None else dtype
    n = as_numbers(exponent)
    n = module_of(n).atleast_1d(n)
    arrays = np.zeros(len(n)), np.tile([-1.0, -1.0, 1.0], (1, len(n), 1)), n[None], ((n + 2) / (2 * np.pi))[None]
    return LobeSum(*(as_array(x, dtype) for x in arrays))


def split_diffuse(material: Material, lobe_sums: bool = False) -> Material:
    """The same material with diffuse parts of spatial BRDFs as components of their own: white, times the map.

    Args:
        material: any.
        lobe_sums: do so with sums of lobes, too.
    """
    parts = []
    for component in material.components:
        brdf, weight = component.brdf, component.weight
        if isinstance(brdf, SpatialLobes):
            white = white_lambert(float_dtype(brdf))
            parts.append(Component(white, (Texture(brdf.diffuse).minified(), *weight)))
            if not (brdf.lobes and np.any(np.asarray(brdf.scale) > 0)):
                continue
            brdf = without_diffuse(brdf)
        elif lobe_sums and isinstance(brdf, LobeSum) and not brdf.is_constant:
            if np.any(np.asarray(brdf.diffuse)):
                parts.append(_white_times(brdf.diffuse, weight))
            brdf = without_diffuse(brdf)
        parts.append(Component(brdf, weight))
    return dataclasses.replace(material, components=tuple(parts))


LobesT = TypeVar("LobesT", LobeSum, SpatialLobes)


def without_diffuse(lobes: LobesT) -> LobesT:
    """The lobes alone, on all levels of detail."""
    black = dataclasses.replace(lobes, diffuse=jnp.zeros_like(lobes.diffuse))
    if isinstance(black, SpatialLobes):
        return dataclasses.replace(black, coarser=tuple(map(without_diffuse, black.coarser)))
    return black


def has_lobes(brdf: Brdf | SpatialLobes) -> bool:
    """Whether a BRDF is a sum of lobes, in all texels or in each, and has any."""
    return isinstance(brdf, SpatialLobes) or (isinstance(brdf, LobeSum) and not brdf.is_constant)


def split_tint(material: Material, diffuse: bool = False) -> Material:
    """The same material, with lobes that are the same in all channels but for a tint as grey ones, times the tint.

    What they add to is a component of its own then: white, times the albedo. Transport of such parts has one channel.
    So has that of what is diffuse alone where it is factored; where it is not, `diffuse` has it white, too.
    """
    parts = []
    for component in material.components:
        brdf = component.brdf
        if diffuse and isinstance(brdf, LobeSum) and brdf.is_constant:
            parts.append(_white_times(brdf.diffuse, component.weight))
            continue
        tint = _tint(brdf) if isinstance(brdf, LobeSum) else None
        if tint is None:
            parts.append(component)
            continue
        assert isinstance(brdf, LobeSum)
        if np.any(np.asarray(brdf.diffuse)):
            parts.append(_white_times(brdf.diffuse, component.weight))
        strongest = int(np.argmax(np.abs(tint)))
        scale, dtype = np.asarray(brdf.scale)[:, strongest, None] / tint[strongest], brdf.scale.dtype
        grey = LobeSum(as_array(np.zeros(1), dtype), brdf.C, brdf.exponent, as_array(scale, dtype), brdf.turn)
        parts.append(Component(grey, (constant(tint, brdf.scale.dtype), *component.weight)))
    return dataclasses.replace(material, components=tuple(parts))


def _white_times(albedo: Float[Array, " c"], weight: Weight) -> Component:
    """A diffuse component as a white one, times its albedo."""
    return Component(white_lambert(albedo.dtype), (constant(albedo, albedo.dtype), *weight))


def _tint(brdf: LobeSum) -> Float[np.ndarray, " c"] | None:
    """What the lobes' scales by channel are all multiples of; None where there are no lobes or nothing is."""
    scale = np.asarray(brdf.scale, float)
    if brdf.C.shape[-2] > 1 or scale.shape[-1] == 1 or not scale.any():
        return None
    tint = scale[np.argmax(np.abs(scale).sum(axis=1))]
    # Lobe by lobe, across the channels: rank one.
    along = scale @ tint / (tint @ tint)
    same = np.abs(scale - along[:, None] * tint).max() <= 1e-6 * np.abs(scale).max()
    return tint if same else None


def textured_lambert(albedo: Texture) -> Material:
    """A texture of albedos over π."""
    return Material((Component(white_lambert(float_dtype(albedo)), (albedo,)),))


def textured_phong(diffuse: Texture, specular: Texture, exponent: Numbers) -> Material:
    """`phong` with a texture for either colour; the exponent one number or one per channel, traced or not."""
    dtype = float_dtype(diffuse, specular, exponent)
    shine = Component(white_phong(exponent, dtype), (specular,))
    return Material((Component(white_lambert(dtype), (diffuse,)), shine))
