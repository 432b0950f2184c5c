"""What hides the environment from vertices, from a few hundred rays each: kept nowhere, and made in seconds."""

import equinox as eqx
import numpy as np
from jaxtyping import Int

from jaxrelight.basis import cubemap
from jaxrelight.geometry.receivers import GROUP, vertex_receivers
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.numerics.arrays import as_array
from jaxrelight.precomputation.groups import Threads
from jaxrelight.progress import Report
from jaxrelight.transport import bake
from jaxrelight.transport.compression import padded_receivers
from jaxrelight.transport.filtered_visibility import FilteredVisibility, visibility_distances
from jaxrelight.transport.model import ByKey, frames_of
from jaxrelight.transport.visibility import trace_visibility


class Slots(ByKey):
    """Where each vertex, or back of one, stands among the receivers."""

    def __init__(self, of_vertex: Int[np.ndarray, " v"], key: str):
        self.of_vertex, self.key = of_vertex, key


class VertexOcclusion(eqx.Module):
    """Filtered visibility of all vertices.

    Attributes:
        visibility: of the receivers.
        slots: where each vertex stands among them.
    """

    visibility: FilteredVisibility
    slots: Slots = eqx.field(static=True)


def vertex_occlusion(
    surfaces: Surfaces, tracer: Tracer, resolution: int, report: Report | None = None
) -> VertexOcclusion:
    """Traces rays from every vertex, and filters what they see.

    Args:
        surfaces: all meshes.
        tracer: of them.
        resolution: side of the faces of the cube map along whose texels rays go.
        report: called with the progress, in vertices.
    """
    receivers = vertex_receivers(surfaces, np.zeros(len(surfaces.two_sided), int))
    groups = len(receivers.filled)
    directions, vectors = bake.directions_for(resolution), cubemap.directions(resolution)
    held = padded_receivers(groups * GROUP) // GROUP
    codes: list[np.ndarray] = [np.zeros(0, np.int8)] * groups
    frames = frames_of(receivers, np.arange(groups)).astype(np.float32)

    def make(group: int) -> None:
        arrays = receivers.positions[group], receivers.normals[group], receivers.face_normals[group]
        bits, _ = trace_visibility(tracer, *arrays, vectors)
        codes[group] = np.asarray(visibility_distances(bits, frames[group], directions))

    done = 0
    for group in Threads().run(make, range(groups)):
        done += int(receivers.filled[group])
        if report is not None:
            report("occlusion", done, receivers.count)
    every = np.concatenate(codes)
    padded = np.pad(every, ((0, held * GROUP - len(every)), (0, 0)))
    return VertexOcclusion(FilteredVisibility(as_array(padded, np.int8)), Slots(receivers.slot_of, tracer.key))
