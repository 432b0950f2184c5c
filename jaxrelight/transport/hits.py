"""What receivers see of surfaces: the rays that bounced light is gathered along, none to where the sky is seen.

Visibility that was traced before tells where the sky is: there is no ray where all of its texels around a direction are
open. Elsewhere each direction has its own. Directions between others that hit the same face would need none, but these
are few on most meshes, and to compute where they meet its plane takes half to all of the time of their rays: a table of
`tests/benchmarks/adaptive_rays.py` has both.
"""

import itertools
from collections.abc import Iterable
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int, UInt8

from jaxrelight.basis import cubemap
from jaxrelight.geometry.gbuffer import GBuffer, trace_points
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.transport.adaptive_visibility import ROUNDING, heights_on_faces

# What tells layers of hits that spare rays from those of all rays.
SPARED = "no rays where visibility is open"


class GatherRays(NamedTuple):
    """Rays that bounced light is gathered along.

    Attributes:
        traced: those that were cast.
        above: as many as there are directions above horizons.
    """

    traced: int
    above: int

    @classmethod
    def total(cls, counts: Iterable["GatherRays"]) -> "GatherRays":
        """The sum of several."""
        traced, above = np.sum([NO_RAYS, *counts], axis=0)
        return cls(int(traced), int(above))


NO_RAYS = GatherRays(0, 0)


class Hits(NamedTuple):
    """What the receivers of a group see: a row for each ray that hits something.

    Attributes:
        receiver: in the group.
        texel: of the coarse cube map.
        points: of the rays' whole set, see `GBuffer`.
        rays: how many there were.
    """

    receiver: Int[np.ndarray, " h"]
    texel: Int[np.ndarray, " h"]
    points: GBuffer
    rays: GatherRays


def trace_hits(
    surfaces: Surfaces,
    tracer: Tracer,
    origins: Float[np.ndarray, "m 3"],
    normals: Float[np.ndarray, "m 3"],
    resolution: int,
    visibility: UInt8[np.ndarray, "m bytes"] | None = None,
) -> Hits:
    """Rays through the centres of the texels of a cube map that are above each receiver's horizon.

    Args:
        surfaces: all meshes.
        tracer: of them.
        origins: of the receivers' rays, lifted off the surface.
        normals: theirs.
        resolution: texels along an edge of the cube map.
        visibility: bits of the same receivers, at any resolution; without them all rays are cast.
    """
    directions = cubemap.directions(resolution)
    above = normals @ directions.T > 0
    asked = above if visibility is None else above & may_hit(visibility, normals, resolution)
    receiver, texel = np.divmod(np.flatnonzero(asked), len(directions))
    solid_angles = cubemap.solid_angles(resolution)[texel]
    points = trace_points(surfaces, tracer, origins[receiver], directions[texel], solid_angles)
    rays = GatherRays(len(texel), int(np.count_nonzero(above)))
    return Hits(receiver[points.covered], texel[points.covered], points, rays)


def may_hit(
    visibility: UInt8[np.ndarray, "m bytes"], normals: Float[np.ndarray, "m 3"], resolution: int
) -> Bool[np.ndarray, "m d"]:
    """The texels of a cube map around whose centres visibility is not open.

    Where visibility is of wider texels than these, it tells less: then a receiver that has anything hidden asks for all
    of its texels.

    Args:
        visibility: bits of receivers over the texels of another cube map: 1 where the sky is seen, 0 under horizons.
        normals: of the receivers.
        resolution: texels along an edge.
    """
    bits = np.unpackbits(visibility, axis=1, bitorder="little").view(bool)
    texels = round((bits.shape[1] / 6) ** 0.5)
    bits = bits.reshape(-1, 6, texels, texels)
    columns, rows = (of.transpose(2, 0, 1) for of in heights_on_faces(normals, texels))
    around = [slice(None)] if texels < resolution else _around(resolution, texels)
    hidden = np.zeros(1, bool)
    for row, column in itertools.product(around, repeat=2):
        # Under horizons nothing counts as hidden, nor where rounding decides.
        is_above = columns[:, :, None, column] > rows[:, :, row, None] + ROUNDING
        hidden = hidden | (is_above & ~bits[:, :, row][..., column])
    hidden = hidden.reshape(len(bits), -1)
    if texels < resolution:
        return np.repeat(hidden.any(axis=1, keepdims=True), 6 * resolution**2, axis=1)
    return hidden


def _around(resolution: int, texels: int) -> list[slice] | list[Int[np.ndarray, " n"]]:
    """The rows, or columns, of a finer cube map before and after the centres of another; one where they coincide."""
    wide, more = divmod(texels, resolution)
    if not more:
        return [slice(first, None, wide) for first in sorted({(wide - 1) // 2, wide // 2})]
    before = ((2 * np.arange(resolution) + 1) * texels - resolution) // (2 * resolution)
    return [before, before + 1]
