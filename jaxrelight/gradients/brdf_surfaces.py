"""Entries of `jaxrelight.brdf`: materials, textures and maps, and drawing of directions."""

# Examples are arrays of NumPy, which functions of arrays of JAX take.
# pyright: reportArgumentType=false, reportCallIssue=false

import functools

import jax
import numpy as np

from jaxrelight.brdf import material, outgoing, sampling, texture
from jaxrelight.brdf.half_sampling import HalfVectors
from jaxrelight.brdf.lobe_sampling import LobeSampler
from jaxrelight.brdf.packed_texture import PackedTexture, pack
from jaxrelight.brdf.sampling import CellSampler
from jaxrelight.brdf.spatial_factors import SpatialFactors
from jaxrelight.brdf.texture import Texture
from jaxrelight.gradients import examples
from jaxrelight.gradients.entry import CHOICE, CONTRACT, HOST, Entries, Entry, Example, Exempt, named
from jaxrelight.gradients.examples import (
    ALONG_X,
    NORMAL,
    OMEGA_I,
    OMEGA_O,
    at_point,
    lobe_maps,
    numbers,
    scalar,
    two_lobes,
)

# Of four texels a side neither a centre nor an edge, and a footprint between two levels.
_UV, _FOOTPRINT = np.array([0.31, 0.58]), scalar(0.15)
_CENTRE, _RIGHT = np.array([0.375, 0.6]), np.array([1.0, 0.0])
_BETWEEN = "between texels and levels the slope of those ahead; below the finest and above the coarsest level none"
_BLACK = "the exponent of a black lobe has no slope by its scale"


@functools.cache
def _half_vectors() -> HalfVectors:
    """Cubics that grow, and are no BRDF's."""
    steps = np.stack([(np.arange(4.0) + 0.5) / 5, np.full(4, 0.2), np.full(4, 0.02), np.full(4, -0.01)], axis=1)
    roots = np.tile(steps.astype(np.float32), (1, 2, 1, 1))
    turns = np.tile(steps.astype(np.float32) * 4 - 2, (1, 2, 5, 1, 1))
    return HalfVectors(roots, turns)


@functools.cache
def _packed() -> PackedTexture:
    return pack(examples.texture())


@functools.cache
def _spatial_factors() -> SpatialFactors:
    maps = (numbers(2, 1, 4, 4), numbers(2, 2, 4, 4))
    weights = Texture(numbers(4, 4, 6).astype(np.float32)).minified()
    return SpatialFactors(*(one.astype(np.float32) for one in maps), weights)


def _black_lobes():
    return jax.tree.map(lambda leaf: np.asarray(leaf) * (leaf is not lobe_maps().scale), lobe_maps())


ENTRIES: Entries = (
    Entry(
        named("jaxrelight.brdf.texture", "Texture.look_up Texture.around"),
        differentiable_in="texture, uv, footprint",
        example=lambda: Example(lambda image, uv, f: image.look_up(uv, f), (examples.texture(), _UV, _FOOTPRINT)),
        kinks=_BETWEEN,
        singular=lambda: (
            at_point("a texel's centre", (examples.texture(), _CENTRE, scalar(0)), 1, _RIGHT, "ahead"),
            at_point("one texel a pixel", (examples.texture(), _UV, scalar(1 / 16)), 2, scalar(1), "ahead"),
            at_point("the coarsest level", (examples.texture(), _UV, scalar(1)), 2, scalar(1), "behind"),
        ),
    ),
    Entry(
        named("jaxrelight.brdf.packed_texture", "PackedTexture.look_up PackedTexture.around"),
        differentiable_in="texture, uv, footprint",
        example=lambda: Example(lambda image, uv, f: image.look_up(uv, f), (_packed(), _UV, _FOOTPRINT)),
        kinks=_BETWEEN,
        singular=lambda: (at_point("a texel's centre", (_packed(), _CENTRE, scalar(0)), 1, _RIGHT, "ahead"),),
    ),
    Entry(
        named("jaxrelight.brdf.texture", "look_up VertexColours.look_up"),
        differentiable_in="weight, uv, footprint",
        example=lambda: Example(
            lambda image, uv, f: texture.look_up((image, texture.VertexColours()), uv, f),
            (examples.texture(), np.array([0.31, 0.58, 0.2, 0.4, 0.6]), _FOOTPRINT),
        ),
        kinks=_BETWEEN,
    ),
    Entry(
        named("jaxrelight.brdf.texture", "Texture.minified"),
        differentiable_in="texture; linear",
        example=lambda: Example(lambda pixels: Texture(pixels).minified(), (numbers(4, 4, 3),)),
        orders=2,
    ),
    Entry(
        named("jaxrelight.brdf.texture", "image_coordinates Texture.coordinates"),
        differentiable_in="uv, placement",
        example=lambda: Example(
            lambda uv, placement: texture.image_coordinates(uv, placement, 0), (_UV, numbers(2, 3))
        ),
        orders=2,
    ),
    Entry(
        named("jaxrelight.brdf.texture", "image_footprint"),
        differentiable_in="uv, footprint, placement",
        example=lambda: Example(
            lambda uv, f, placement: texture.image_footprint(uv, f, placement, 1),
            (np.array([0.31, 0.58, 0.2, 0.4, 0.6]), _FOOTPRINT, numbers(2, 3)),
        ),
        kinks="a placement that squeezes an image to a line: either slope",
    ),
    Entry(
        named("jaxrelight.brdf.texture", "read_texel"),
        differentiable_in="texels; linear",
        example=lambda: Example(lambda texels: texture.read_texel(texels, np.array(2)), (numbers(4, 3),)),
        orders=2,
        nan="of other texels than the one that is read",
    ),
    Entry(
        named("jaxrelight.brdf.texture", "wrapped"),
        differentiable_in="u",
        example=lambda: Example(
            lambda u: [texture.wrapped(u, wrap) for wrap in ("repeat", "clamp", "mirror")], (scalar(0.3),)
        ),
        kinks="clamp: the slope inside at both ends; mirror: none at a whole number; repeat: that of a smooth u",
        singular=lambda: (at_point("the first edge", (scalar(0),), 0, scalar(1), "ahead"),),
    ),
    Entry(
        named("jaxrelight.brdf.texture", "four_texels"),
        differentiable_in="x, y (the weights; the places are numbers)",
        example=lambda: Example(
            lambda x, y: texture.four_texels(x, y, 4, 4, ("repeat", "clamp")), (scalar(1.2), scalar(2.7))
        ),
        kinks=_BETWEEN,
    ),
    Entry(
        named("jaxrelight.brdf.texture", "constant"),
        differentiable_in="values; linear",
        example=lambda: Example(texture.constant, (numbers(3),)),
        orders=2,
        dtypes="as of `lambert`",
    ),
    Entry(
        named("jaxrelight.brdf.material", "textured_lambert textured_phong white_phong"),
        differentiable_in="textures, exponent",
        example=lambda: Example(
            lambda albedo, specular, n: (
                material.textured_lambert(albedo),
                material.textured_phong(albedo, specular, n),
            ),
            (examples.texture(), examples.texture(), scalar(8.0)),
        ),
        orders=2,
        dtypes="as of `lambert`",
    ),
    Entry(
        named("jaxrelight.brdf.material", "as_material without_diffuse"),
        differentiable_in="surface, lobes; linear",
        example=lambda: Example(
            lambda brdf: (material.as_material(brdf), material.without_diffuse(brdf)), (two_lobes(),)
        ),
        orders=2,
    ),
    Entry(
        named("jaxrelight.brdf.outgoing", "outgoing"),
        differentiable_in="reflection, weight, omega_o, uv, footprint",
        example=lambda: Example(
            lambda of, image, o, uv, f: outgoing.outgoing(of, (image,), o, uv, f),
            (_spatial_factors(), examples.texture(), OMEGA_O[None], _UV[None], _FOOTPRINT[None]),
        ),
        kinks=_BETWEEN,
        ends="0, and no slope, at the horizon and below",
    ),
    Entry(
        named("jaxrelight.brdf.spatial", "SpatialLobes.packed SpatialLobes.at"),
        differentiable_in="maps, uv, footprint",
        example=lambda: Example(
            lambda maps, uv, f: maps.packed("averaged").at(uv, f), (lobe_maps(), _UV[None], _FOOTPRINT[None])
        ),
        kinks=f"{_BETWEEN}; {_BLACK}",
        ends="exponents below 1e-6 count as that",
        singular=lambda: (
            at_point("all lobes black", (_black_lobes(), _UV[None], _FOOTPRINT[None]), 0, lobe_maps(), "finite"),
        ),
    ),
    Entry(
        named("jaxrelight.brdf.spatial", "PackedLobes.at PackedLobes.around PackedLobes.texels"),
        differentiable_in="texture, uv, footprint",
        example=lambda: Example(
            lambda maps, uv: (maps.packed("none").around(uv, 0.0), maps.packed("none").texels), (lobe_maps(), _UV)
        ),
        kinks=_BETWEEN,
    ),
    Entry(
        named(
            "jaxrelight.brdf.spatial_factors",
            "SpatialFactors.view_side_at SpatialFactors.view_side SpatialFactors.light_side",
        ),
        differentiable_in="maps, weights, omega, uv, footprint",
        example=lambda: Example(
            lambda of, o, uv, f: (of.view_side_at(o, uv, f), of.light_side(o), of.view_side(o)),
            (_spatial_factors(), OMEGA_O, _UV, _FOOTPRINT),
        ),
        kinks=_BETWEEN,
    ),
    Entry(
        named("jaxrelight.brdf.sampling", "directional_albedo"),
        differentiable_in="brdf, omega_o",
        example=lambda: Example(lambda brdf, o: sampling.directional_albedo(brdf, o, 4, 6), (two_lobes(), OMEGA_O)),
        orders=2,
        fixed="the grid of directions",
    ),
    Entry(
        named("jaxrelight.brdf.sampling", "CellSampler.pdf"),
        differentiable_in="brdf, omega_o, omega_i",
        example=lambda: Example(lambda brdf, o, i: CellSampler(brdf, o, 4, 6).pdf(i), (two_lobes(), OMEGA_O, OMEGA_I)),
        fixed="the cell",
        kinks="at the horizon the slope above it",
    ),
    Entry(
        named("jaxrelight.brdf.sampling", "from_disc"),
        differentiable_in="square, azimuth",
        example=lambda: Example(sampling.from_disc, (scalar(0.3), scalar(0.2))),
        orders=2,
        kinks="no slope by the square at the normal and at the horizon, where it is infinite",
        singular=lambda: (
            at_point("the normal", (scalar(0), scalar(0.2)), 0, scalar(1), "finite"),
            at_point("the horizon", (scalar(1), scalar(0.2)), 0, scalar(1), "finite"),
        ),
    ),
    Entry(
        named("jaxrelight.brdf.sampling", "to_disc"),
        differentiable_in="omega",
        example=lambda: Example(sampling.to_disc, (OMEGA_I,)),
        orders=2,
        kinks="no slope at the normal, where the azimuth is 0",
        singular=lambda: (at_point("the normal", (NORMAL,), 0, ALONG_X, "zero"),),
    ),
    Entry(
        named("jaxrelight.brdf.lobe_sampling", "LobeSampler.at LobeSampler.drawn LobeSampler.pdf"),
        differentiable_in="brdf, omega_o, u, v, omega_i",
        example=lambda: Example(
            lambda brdf, o, u, v, i: (LobeSampler(brdf, o).drawn(u, v), LobeSampler(brdf, o).pdf(i)),
            (two_lobes(), OMEGA_O, scalar(0.7), scalar(0.4), OMEGA_I),
        ),
        fixed="the lobe that is drawn",
        kinks="no slope by u at a lobe's peak, where it is infinite",
        singular=lambda: (
            at_point("u = 0", (two_lobes(), OMEGA_O, scalar(0), scalar(0.4), OMEGA_I), 2, scalar(1), "finite"),
        ),
    ),
    Entry(
        named("jaxrelight.brdf.half_sampling", "HalfVectors.towards HalfVectorSampler.drawn"),
        differentiable_in="table, omega_o, u, v",
        example=lambda: Example(
            lambda table, o, u, v: table.towards(o).drawn(u, v), (_half_vectors(), OMEGA_O, scalar(0.3), scalar(0.6))
        ),
        fixed="which of the table's directions to the eye is used",
    ),
    Exempt(
        (
            *named("jaxrelight.brdf.sampling", "CellSampler.sample"),
            *named("jaxrelight.brdf.lobe_sampling", "LobeSampler.sample"),
        ),
        "a random draw: sample positions are held fixed; `LobeSampler.at` is differentiable in its numbers",
    ),
    Exempt(named("jaxrelight.brdf.texture", "Factor.look_up"), CONTRACT),
    Exempt(
        (
            *named("jaxrelight.brdf.factored", "Factored.per_receiver Symmetric.per_receiver"),
            *named("jaxrelight.brdf.reflection", "Reflection.per_receiver FixedView.per_receiver of_group"),
            *named("jaxrelight.brdf.spatial_factors", "SpatialFactors.per_receiver"),
        ),
        "structure alone: which arrays belong to receivers, and those of a group",
    ),
    Exempt(
        (
            *named("jaxrelight.brdf.material", "has_lobes split_diffuse split_tint white_lambert"),
            *named("jaxrelight.brdf.packed_texture", "pack pack_weight"),
            *named("jaxrelight.brdf.normal_maps", "is_normal_map"),
        ),
        CHOICE,
    ),
    Exempt(
        (
            *named("jaxrelight.brdf.half_sampling", "half_vectors"),
            *named("jaxrelight.brdf.normal_maps", "apply_normal_map at_vertices see"),
            *named("jaxrelight.brdf.spatial_factors", "factor_spatial"),
            *named("jaxrelight.brdf.texture", "Texture.mean VertexColours.mean"),
        ),
        HOST,
    ),
)
