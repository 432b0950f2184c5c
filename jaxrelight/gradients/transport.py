"""Entries of `jaxrelight.transport` and of `jaxrelight.gather`."""

# Examples are arrays of NumPy, which functions of arrays of JAX take.
# pyright: reportArgumentType=false

import functools

import jax
import numpy as np
from jaxtyping import Float

from jaxrelight.basis.haar import HaarFaces
from jaxrelight.brdf.reflection import FixedView
from jaxrelight.geometry.frame import tangent_frame
from jaxrelight.gradients.entry import HOST, PRECOMPUTATION, RAYS, Entries, Entry, Example, Exempt, named
from jaxrelight.gradients.examples import NORMAL, OMEGA_I, OMEGA_O, at_point, numbers, scalar, two_lobes
from jaxrelight.transport import bake
from jaxrelight.transport.filtered_visibility import FilteredVisibility, visibility_distances

_FIXED = "visibility, frames, kept coefficients"
_NORMALS = np.stack([OMEGA_I, OMEGA_O])
# Of two receivers and the 24 texels of a 6×2² cube map: nearly all are visible.
_BITS = np.array([[255, 239, 247], [255, 255, 253]], np.uint8)
_KEPT = np.tile(np.array([0, 4, 9, 17]), (2, 1, 1))
_BASIS = HaarFaces(2)


def _given(brdf):
    """Arrays that all baking takes, of the type of a BRDF."""
    dtype = brdf.diffuse.dtype
    frames = _frames().astype(dtype)
    reflection = FixedView(brdf, np.tile(OMEGA_O, (2, 1)).astype(dtype))
    return _BITS, frames, reflection, bake.directions_for(2, dtype=dtype)


@functools.cache
def _frames() -> Float[np.ndarray, "2 3 3"]:
    # It is kept, so it must not be made of what is being traced.
    with jax.ensure_compile_time_eval():
        return np.asarray(tangent_frame(_NORMALS.astype(np.float32)))


@functools.cache
def _visibility() -> FilteredVisibility:
    with jax.ensure_compile_time_eval():
        return FilteredVisibility(visibility_distances(_BITS, _frames(), bake.directions_for(2)))


def _share(weights, direction, exponent):
    return _visibility().share(np.array([0, 1]), weights, direction, exponent)


ENTRIES: Entries = (
    Entry(
        named("jaxrelight.transport.bake", "bake_and_apply Directions.to_texels Directions.to_rays"),
        differentiable_in="reflection, light; linear in light",
        example=lambda: Example(
            lambda brdf, light: bake.bake_and_apply(*_given(brdf), light),
            (two_lobes(), numbers(24, 3)),
            lambda brdf, light, y: bake.bake_and_transpose(*_given(brdf), y),
        ),
        orders=2,
        fixed=_FIXED,
    ),
    Entry(
        named("jaxrelight.transport.bake", "bake_and_transpose"),
        differentiable_in="reflection, radiance; linear in radiance",
        example=lambda: Example(
            lambda brdf, radiance: bake.bake_and_transpose(*_given(brdf), radiance),
            (two_lobes(), numbers(2, 1, 3)),
            lambda brdf, radiance, y: bake.bake_and_apply(*_given(brdf), y),
        ),
        fixed=_FIXED,
    ),
    Entry(
        named("jaxrelight.transport.bake", "bake_kept bake_rows bake_truncated"),
        differentiable_in="reflection",
        example=lambda: Example(
            lambda brdf: (
                bake.bake_kept(*_given(brdf), _BASIS, _KEPT),
                bake.bake_rows(*_given(brdf), _BASIS),
                bake.bake_truncated(*_given(brdf), _BASIS, 20).values,
            ),
            (two_lobes(),),
        ),
        fixed=_FIXED,
    ),
    Entry(
        named("jaxrelight.transport.bake", "bake_kept_and_apply kept_light"),
        differentiable_in="reflection, light; linear in light",
        example=lambda: Example(
            lambda brdf, light: bake.bake_kept_and_apply(*_given(brdf), _BASIS, light, _KEPT),
            (two_lobes(), numbers(24, 3)),
        ),
        fixed=_FIXED,
        nan="coefficients that are not kept do not matter",
    ),
    Entry(
        named("jaxrelight.transport.filtered_visibility", "FilteredVisibility.share"),
        differentiable_in="weights, direction, exponent",
        example=lambda: Example(_share, (np.array([0.7, 0.3]), OMEGA_I, scalar(9.0))),
        fixed="visibility, which is kept in codes of 8 bits",
        kinks="between the directions of its grid the slope of the cell ahead",
        singular=lambda: (
            at_point("exponent 0", (np.array([0.7, 0.3]), OMEGA_I, scalar(0)), 2, scalar(1), "ahead"),
            at_point("a corner of the grid", (np.array([0.7, 0.3]), NORMAL, scalar(9)), 1, OMEGA_I, "finite"),
        ),
    ),
    Exempt(
        (
            *named("jaxrelight.transport.rebake", "exact rebake"),
            *named("jaxrelight.transport.changed_materials", "with_materials parts_of_material"),
            *named("jaxrelight.transport.from_visibility", "from_visibility"),
        ),
        "puts a prepared scene together again: what it gives is differentiable in materials, see "
        "`TransportRelighter.with_materials`",
    ),
    Exempt(
        (
            *named("jaxrelight.transport.model", "StoredScene.lights Block.groups Block.bounced"),
            *named("jaxrelight.transport.model", "PrecomputedTransport.operator PrecomputedTransport.geometry"),
            *named("jaxrelight.transport.model", "PrecomputedTransport.surfaces PrecomputedTransport.tracer"),
            *named("jaxrelight.transport.model", "PrecomputedTransport.receivers PrecomputedTransport.sharded"),
            *named("jaxrelight.transport.model", "PrecomputedIndirect.points PrecomputedIndirect.method"),
            *named("jaxrelight.transport.model", "PrecomputedIndirect.stored frames_of fixed_view streamed"),
        ),
        "parts of a prepared scene, as they are",
    ),
    Exempt(
        (
            *named("jaxrelight.transport.bake", "directions_for unpack"),
            *named("jaxrelight.gather.cloud_spectrum", "cloud_spectrum"),
            *named("jaxrelight.transport.resolution_error", "draw_slots points_of key_of_light light_of radiance"),
            *named("jaxrelight.transport.resolution_error", "resolution_error"),
        ),
        HOST,
    ),
    Exempt(
        (
            *named("jaxrelight.transport.filtered_visibility", "visibility_distances"),
            *named("jaxrelight.transport.visibility", "trace_visibility"),
            *named("jaxrelight.transport.adaptive_visibility", "trace_adaptively cells_of first_cells"),
            *named("jaxrelight.transport.adaptive_visibility", "heights_on_faces"),
            *named("jaxrelight.transport.hits", "trace_hits may_hit"),
            *named("jaxrelight.gather.photons", "shoot"),
        ),
        RAYS,
    ),
    Exempt(
        (
            *named("jaxrelight.gather.final_gather", "FinalGather.links FinalGather.rows FinalGather.channels_of"),
            *named("jaxrelight.gather.gather_cloud", "GatherCloud.of_sky gather_cloud cloud_receivers"),
            *named("jaxrelight.gather.photon_gather", "PhotonGather.rows PhotonGather.channels_of"),
            *named("jaxrelight.transport.bounce", "Gather.rows Gather.channels_of Gather.light Gather.hits"),
            *named("jaxrelight.transport.bounce", "remaining"),
            *named("jaxrelight.transport.compression", "of_cloud bake_compressed Rows.compress Rows.arrays"),
            *named("jaxrelight.transport.compression", "Clusters.rows"),
            *named("jaxrelight.transport.compression", "Rows.open Clusters.compress Clusters.open"),
        ),
        PRECOMPUTATION,
    ),
)
