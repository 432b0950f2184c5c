"""The parts of a scene, and what becomes of those whose texture coordinates do not suffice for their material."""

import dataclasses
from collections.abc import Mapping, Sequence

import jax.numpy as jnp

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.material import Material, as_material
from jaxrelight.brdf.texture import Texture, Weight, constant
from jaxrelight.geometry.mesh import Mesh


@dataclasses.dataclass(frozen=True)
class Part:
    """One mesh and the name of its material."""

    mesh: Mesh
    material: str
    name: str = "mesh"


def missing_sets(material: Material, mesh: Mesh) -> set[int]:
    """Numbers of the sets of texture coordinates that a material needs and a mesh does not have."""
    count = 0 if mesh.uv is None else mesh.uv.shape[1] // 2
    return {number for number in material.uv_sets if number >= count}


def with_plain_materials(
    parts: Sequence[Part], materials: Mapping[str, Brdf | Material]
) -> tuple[tuple[Part, ...], Mapping[str, Brdf | Material], list[str]]:
    """Parts whose materials need no texture coordinates that they lack, their materials, and what was assumed.

    Textures that have no place on a part are replaced by their means, and a normal map is left out. Parts that have
    what the material needs keep it as it is, and so do all where it has a BRDF for every texel.
    """
    lacking: dict[str, list[int]] = {}
    for number, part in enumerate(parts):
        material = as_material(materials[part.material]) if part.material in materials else None
        if material is not None and not material.is_spatial and missing_sets(material, part.mesh):
            lacking.setdefault(part.material, []).append(number)
    if not lacking:
        return tuple(parts), materials, []
    changed, plain_ones, notes = list(parts), dict(materials), []
    for name, numbers in lacking.items():
        plain = as_material(materials[name])
        for number in numbers:
            plain = _plain(plain, missing_sets(plain, parts[number].mesh))
        # Under its own name, where no part is left that has the textures.
        whole = len(numbers) == sum(part.material == name for part in parts)
        other = name if whole else f"{name} without textures"
        plain_ones[other] = plain
        for number in numbers:
            changed[number] = dataclasses.replace(parts[number], material=other)
        which = ", ".join(f"'{parts[number].name}'" for number in numbers)
        notes.append(f"{which}: no texture coordinates, which the material '{name}' needs; its mean colour is taken")
    return tuple(changed), plain_ones, notes


def _plain(material: Material, missing: set[int]) -> Material:
    """The material without the textures that follow some sets of texture coordinates."""

    def plain(weight: Weight) -> Weight:
        return tuple(
            constant(jnp.mean(one.pixels, axis=(0, 1))) if isinstance(one, Texture) and one.uv_set in missing else one
            for one in weight
        )

    components = tuple(dataclasses.replace(part, weight=plain(part.weight)) for part in material.components)
    bumps = material.normal_map
    return dataclasses.replace(
        material, components=components, normal_map=None if bumps is not None and bumps.uv_set in missing else bumps
    )
