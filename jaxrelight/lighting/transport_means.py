"""By what means precomputed transport has the direct light of a picture, each of which is measured by itself."""

import dataclasses
from collections.abc import Collection

import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrelight.lighting.exact_pixels import NamedComponent
from jaxrelight.lighting.visible_surfaces import SurfaceMaterial
from jaxrelight.operators.contract import parts_of
from jaxrelight.transport.model import Block, FilteredLobes, PrecomputedTransport

# What makes direct light other than exact, as messages call it: of filtered lobes, of rows of pixels, and of rows of
# vertices of a BRDF that is the same from all sides and of others.
LOBES, COEFFICIENTS = "lobes and their visibility", "coefficients"
_CONSTANT, _FACTORS = "coefficients and interpolation", "coefficients, factors and interpolation"
# What is left of those of vertices without coefficients.
REST = {_CONSTANT: "interpolation", _FACTORS: "factors and interpolation"}


def direct_parts(transport: PrecomputedTransport, material: str) -> list[Block | FilteredLobes]:
    """What has the direct light of a material: filtered lobes whose bounces are a block are the same BRDF."""
    parts = [part for part in (*transport.blocks, *transport.lobes) if part.material == material]
    return [part for part in parts if isinstance(part, FilteredLobes) or part.has_direct]


def named_components(transport: PrecomputedTransport, material: SurfaceMaterial) -> list[NamedComponent]:
    """The components of a relighter's material, by their means."""
    parts = direct_parts(transport, material.name)
    return [
        NamedComponent(_means_of(part, transport.method.receivers), component)
        for part, component in zip(parts, material.components, strict=True)
    ]


def blocks_by_means(transport: PrecomputedTransport) -> dict[str, list[int]]:
    """The numbers of the blocks that have direct light, by their means."""
    numbers: dict[str, list[int]] = {}
    for number, block in enumerate(transport.blocks):
        if block.has_direct:
            numbers.setdefault(_means_of(block, transport.method.receivers), []).append(number)
    return numbers


def without_bounces(transport: PrecomputedTransport) -> PrecomputedTransport:
    """The same with the direct light alone of all blocks that have it."""
    blocks = (
        dataclasses.replace(block, operator=parts_of(block.operator)[0], emitted=None) if block.has_direct else block
        for block in transport.blocks
    )
    return dataclasses.replace(transport, blocks=tuple(blocks))


def terms_alone(
    terms: tuple[Float[Array, "_ _ _"], ...], numbers: Collection[int]
) -> tuple[Float[Array, "_ _ _"], ...]:
    """Light terms of some blocks, and none of the others."""
    return tuple(of if number in numbers else jnp.zeros_like(of) for number, of in enumerate(terms))


def _means_of(part: Block | FilteredLobes, receivers: str) -> str:
    """What makes direct light of one BRDF other than exact, as messages call it."""
    if isinstance(part, FilteredLobes):
        return LOBES
    if receivers == "pixels":
        return COEFFICIENTS
    return _CONSTANT if part.reflection.is_constant else _FACTORS
