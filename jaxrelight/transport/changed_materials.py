"""Other materials on precomputed transport: weights where radiance is linear in them, rows from visibility elsewhere.

A material of a scene is several parts of transport: its diffuse colours are weights on rows that know no colour, its
lobes are filtered, or have rows of their own. Here the parts of another material take the places of those.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any, NamedTuple, TypeVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.brdf.albedo import mean_albedo
from jaxrelight.brdf.alternating import refactored
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.factored import Factored
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.material import Material, has_lobes, white_lambert, without_diffuse
from jaxrelight.brdf.packed_texture import pack_weight
from jaxrelight.brdf.reflection import FixedView, Reflection
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.texture import Texture, Weight, constant
from jaxrelight.errors import InputError
from jaxrelight.methods import Transport
from jaxrelight.numerics.arrays import as_array, is_traced
from jaxrelight.operators.contract import Operator, Scaled, Summed, parts_of
from jaxrelight.transport.from_visibility import from_visibility
from jaxrelight.transport.model import Block, FilteredLobes, PrecomputedTransport, fixed_view

PartT = TypeVar("PartT", Block, FilteredLobes)


class DiffusePart(NamedTuple):
    """A diffuse albedo by channel, and the factor on it over the surface."""

    albedo: Float[Array, " c"]
    weight: Weight


class GlossyPart(NamedTuple):
    """A BRDF, or one for every texel, that is not diffuse alone, and the factor on it."""

    brdf: Brdf | SpatialLobes
    weight: Weight


class MaterialParts(NamedTuple):
    """The parts that transport has of a material."""

    diffuse: list[DiffusePart]
    glossy: list[GlossyPart]


def with_materials(transport: PrecomputedTransport, materials: Mapping[str, Material]) -> PrecomputedTransport:
    """The same transport of the same scene, with other materials; see `Relighter.with_materials`.

    Raises:
        InputError: for a material of other parts than the one that was prepared, or one that cannot be changed.
    """
    blocks, lobes = list(transport.blocks), list(transport.lobes)
    for name, material in materials.items():
        own_blocks = [number for number, block in enumerate(blocks) if block.material == name]
        own_lobes = [number for number, part in enumerate(lobes) if part.material == name]
        diffuse = [number for number in own_blocks if blocks[number].reflection.is_constant]
        rows = [number for number in own_blocks if blocks[number].has_direct and number not in diffuse]
        gathered = [number for number in own_blocks if not blocks[number].has_direct and number not in diffuse]
        if not isinstance(transport.method, Transport):
            rows, gathered = gathered or rows, []
        parts = _fitting_parts(transport, name, material, len(diffuse), len(rows), len(own_lobes))
        for number, part in zip(diffuse, parts.diffuse, strict=True):
            blocks[number] = _diffuse_block(transport, blocks[number], part)
        of_rows = [part for part in parts.glossy if not (own_lobes and _is_filtered(part))]
        of_lobes = [part for part in parts.glossy if own_lobes and _is_filtered(part)]
        for number, part in zip(rows, _filled(of_rows, len(rows)), strict=True):
            blocks[number] = _black(blocks[number]) if part is None else _rows_of(transport, blocks[number], part)
        for number, part in zip(own_lobes, _filled(of_lobes, len(own_lobes)), strict=True):
            lobes[number] = _black(lobes[number]) if part is None else _lobes_of(lobes[number], part)
        for number, part in zip(gathered, _filled(of_lobes, len(gathered))[: len(gathered)], strict=True):
            blocks[number] = _black(blocks[number]) if part is None else _gathered(blocks[number], part)
        emission = None if material.emission is None else as_array(material.emission)
        for number in own_blocks:
            blocks[number] = dataclasses.replace(blocks[number], emission=emission)
            emission = None
        for number in own_lobes:
            lobes[number] = dataclasses.replace(lobes[number], emission=emission)
            emission = None
    return dataclasses.replace(transport, blocks=tuple(blocks), lobes=tuple(lobes))


def _fitting_parts(
    transport: PrecomputedTransport, name: str, material: Material, diffuse: int, rows: int, lobes: int
) -> MaterialParts:
    """The parts of a material as the one that was prepared has them, diffuse ones filled up with black."""
    in_pixels = isinstance(transport.method, Transport) and transport.method.receivers == "pixels"
    for split in (False,) if in_pixels and not lobes else (True, False):
        parts = parts_of_material(material, split)
        own = parts.diffuse
        if len(own) > diffuse:
            own = [part for part in own if is_traced(part.albedo) or np.any(np.asarray(part.albedo))]
        filtered = sum(_is_filtered(part) for part in parts.glossy) if lobes else 0
        if len(own) <= diffuse and filtered <= lobes and len(parts.glossy) - filtered <= rows:
            black = DiffusePart(as_array(np.zeros(3), np.float32), ())
            return MaterialParts([*own, *[black] * (diffuse - len(own))], parts.glossy)
    was = f"{diffuse} diffuse and {rows + lobes} glossy BRDFs"
    raise InputError(
        f"material '{name}' was prepared as {was}, which the one given does not fit; prepare the scene with a material "
        "of the same kind (a diffuse albedo above 0 where one is to be changed)"
    )


def parts_of_material(material: Material, split: bool) -> MaterialParts:
    """The parts of a material; its numbers may be traced.

    Args:
        material: any.
        split: take diffuse colours and lobes of a BRDF apart.
    """
    diffuse, glossy = [], []
    for component in material.components:
        brdf, weight = component.brdf, component.weight
        if isinstance(brdf, LobeSum) and (split or brdf.is_constant):
            diffuse.append(DiffusePart(brdf.diffuse, weight))
        elif isinstance(brdf, SpatialLobes) and split:
            white = jnp.ones(1, brdf.diffuse.dtype)
            diffuse.append(DiffusePart(white, (Texture(as_array(brdf.diffuse)).minified(), *weight)))
        if has_lobes(brdf) or not isinstance(brdf, LobeSum):
            lobes: Any = brdf
            is_split = split and isinstance(brdf, LobeSum | SpatialLobes)
            glossy.append(GlossyPart(without_diffuse(lobes) if is_split else brdf, weight))
    return MaterialParts(diffuse, glossy)


def _is_filtered(part: GlossyPart) -> bool:
    return has_lobes(part.brdf)


def _filled(parts: list[GlossyPart], count: int) -> list[GlossyPart | None]:
    return [*parts, *[None] * (count - len(parts))]


def _black(part: PartT) -> PartT:
    return dataclasses.replace(part, weight=(constant(0.0, np.float32),))


def _diffuse_block(transport: PrecomputedTransport, block: Block, part: DiffusePart) -> Block:
    """A diffuse block of another albedo: radiance is linear in it, so that its rows stay what they are."""
    old, albedo, weight = block.brdf, as_array(part.albedo), pack_weight(part.weight)
    assert isinstance(old, LobeSum)
    if is_traced(old.diffuse) or np.all(np.asarray(old.diffuse) != 0):
        before = as_array(old.diffuse)
        # Of a black channel that is traced, nobody knows in time that rows have to be made: only black is right there.
        unknown = jnp.where(albedo == 0, 0, jnp.nan)
        ratio = jnp.where(before == 0, unknown, albedo / jnp.where(before == 0, 1, before))
        return dataclasses.replace(block, weight=(constant(ratio, ratio.dtype), *weight))
    # Rows of a black channel tell nothing of another one: white ones are made in their place.
    white = white_lambert(old.diffuse.dtype)
    weight = (constant(albedo, albedo.dtype), *weight)
    changed = dataclasses.replace(block, brdf=white, weight=weight, remade=True)
    if isinstance(block.reflection, Factored):
        up = jnp.asarray([0.0, 0.0, 1.0], block.reflection.view_maps.dtype)
        reflection = dataclasses.replace(block.reflection, view_maps=white.evaluate(up, up)[None, :, None, None])
        return dataclasses.replace(changed, reflection=reflection)
    assert isinstance(block.reflection, FixedView)
    known = np.asarray(old.diffuse)
    factor = as_array(np.where(known != 0, 1 / np.where(known != 0, known, 1), 0), old.diffuse.dtype)
    return _with_reflection(transport, changed, FixedView(white, block.reflection.omega_o), factor)


def _rows_of(transport: PrecomputedTransport, block: Block, part: GlossyPart) -> Block:
    """A block of rows of another BRDF."""
    old, brdf, weight = block.reflection, part.brdf, part.weight
    if not isinstance(transport.method, Transport):
        return _gathered(dataclasses.replace(block, weight=pack_weight(weight)), part)
    if isinstance(old, Factored):
        if block.bounced:
            raise InputError(
                f"material '{block.material}': what it reflects of bounced light is of the factors of its lobes, which "
                "cannot be changed; prepare with reflection 'filtered', or without bounces"
            )
        if isinstance(brdf, SpatialLobes):
            raise InputError(f"material '{block.material}' was prepared with one BRDF for all texels, not with maps")
        if isinstance(brdf, LobeSum) and brdf.C.shape[0] == brdf.C.shape[1] == 1 and old.channels == 1:
            # A single lobe is grey, times its colour.
            weight = (constant(brdf.scale[0], brdf.scale.dtype), *weight)
            brdf = dataclasses.replace(
                brdf, diffuse=jnp.zeros(1, brdf.scale.dtype), scale=jnp.ones((1, 1), brdf.scale.dtype)
            )
        reflection: Reflection = refactored(brdf, _in_channels(old, brdf.channels))
    elif isinstance(old, FixedView):
        receivers = transport.receivers
        if isinstance(brdf, SpatialLobes):
            reflection = jax.tree.map(as_array, fixed_view(brdf, receivers, block.groups))
        else:
            reflection = FixedView(brdf, old.omega_o)
    else:
        raise InputError(
            f"material '{block.material}': factors that texels share cannot be changed; prepare with reflection "
            "'filtered', or with receivers 'pixels'"
        )
    ratio = _albedo_ratio(block, part) if block.bounced else None
    changed = dataclasses.replace(block, brdf=brdf, weight=pack_weight(weight), remade=True)
    return _with_reflection(transport, changed, reflection, ratio)


def _with_reflection(
    transport: PrecomputedTransport, block: Block, reflection: Reflection, bounced: Float[Array, " c"] | None
) -> Block:
    """A block whose direct light is of another reflection, and whose bounced light is scaled."""
    parts: list[Operator] = [_scaled(one, bounced) for one in block.bounced]
    if block.has_direct and isinstance(transport.method, Transport):
        visibility = transport.stored.visibility
        assert visibility is not None
        given = block, visibility, transport.receivers, transport.method, transport.basis
        parts.insert(0, from_visibility(parts_of(block.operator)[0], reflection, *given))
    operator = parts[0] if len(parts) == 1 else Summed(tuple(parts))
    emitted = block.emitted if block.emitted is None or bounced is None else block.emitted * bounced[None, None]
    return dataclasses.replace(block, reflection=reflection, operator=operator, emitted=emitted)


def _gathered(block: Block, part: GlossyPart) -> Block:
    """A block of gathered light alone: its lobes keep their shape there, and reflect as much as the new ones."""
    ratio = _albedo_ratio(block, part)
    emitted = None if block.emitted is None else block.emitted * ratio[None, None]
    parts = tuple(_scaled(one, ratio) for one in parts_of(block.operator))
    return dataclasses.replace(
        block,
        brdf=part.brdf,
        weight=pack_weight(part.weight),
        operator=parts[0] if len(parts) == 1 else Summed(parts),
        emitted=emitted,
        remade=True,
    )


def _albedo_ratio(block: Block, part: GlossyPart) -> Float[Array, " c"]:
    """How much more of even light the new BRDF reflects than the old one, by channel; 0 where that reflects nothing."""
    old, new = as_array(mean_albedo(block.brdf)), as_array(mean_albedo(part.brdf))
    return jnp.where(old > 0, new / jnp.where(old > 0, old, 1), 0)


def _scaled(operator: Operator, factor: Float[Array, " c"] | None) -> Operator:
    if factor is None:
        return operator
    if isinstance(operator, Scaled):
        return Scaled(operator.operator, operator.factor * factor)
    return Scaled(operator, factor)


def _lobes_of(old: FilteredLobes, part: GlossyPart) -> FilteredLobes:
    brdf = part.brdf.packed() if isinstance(part.brdf, SpatialLobes) else part.brdf
    assert not isinstance(brdf, Brdf) or isinstance(brdf, LobeSum)
    return dataclasses.replace(old, brdf=brdf, weight=pack_weight(part.weight))


def _in_channels(factors: Factored, channels: int) -> Factored:
    """Factors to start from, of as many channels as a BRDF."""

    def spread(maps):
        return jnp.broadcast_to(maps, (maps.shape[0], channels, *maps.shape[2:]))

    return dataclasses.replace(factors, light_maps=spread(factors.light_maps), view_maps=spread(factors.view_maps))
