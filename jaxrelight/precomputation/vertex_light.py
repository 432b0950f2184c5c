"""What of a fixed panel of skies reaches vertices, with few rays: enough to tell where light is not linear."""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxrelight.basis import cubemap
from jaxrelight.geometry.enclosed_vertices import enclosed_vertices
from jaxrelight.geometry.mesh import Mesh
from jaxrelight.geometry.morton import morton
from jaxrelight.geometry.occluders import Occluders
from jaxrelight.geometry.receivers import GROUP, Receivers, vertex_receivers
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.lights.sky_panel import SKIES, sky_panel
from jaxrelight.precomputation.groups import Threads
from jaxrelight.progress import Report
from jaxrelight.scene.scene import Scene
from jaxrelight.transport.adaptive_visibility import trace_adaptively


class VertexLight(NamedTuple):
    """What reaches vertices, on both sides where a mesh has two.

    Attributes:
        values: irradiance under every sky, over that of open sky in the mean.
        is_open: whether nothing is hidden from them.
        enclosed: whether they lie inside closed surfaces.
        known: whether they have been lit.
    """

    values: Float[np.ndarray, "_ s"]
    is_open: Bool[np.ndarray, " _"]
    enclosed: Bool[np.ndarray, " _"]
    known: Bool[np.ndarray, " _"]

    def some(self, vertices: Int[np.ndarray, " n"]) -> "VertexLight":
        """Those of some vertices."""
        return VertexLight(*(of[vertices] for of in self))

    def fill(self, vertices: Int[np.ndarray, " n"], light: "VertexLight") -> None:
        """Puts in those of some vertices."""
        for values, own in zip(self, light, strict=True):
            values[vertices] = own

    def beside(self, other: "VertexLight") -> "VertexLight":
        """Those of more vertices."""
        return VertexLight(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))

    def between(self, ends: Int[np.ndarray, "e 2"]) -> "VertexLight":
        """What pictures show in the middle between vertices: what is enclosed takes no part."""
        is_open, enclosed = np.all(self.is_open[ends], axis=1), np.all(self.enclosed[ends], axis=1)
        taking_part = ~self.enclosed[ends] | enclosed[:, None]
        weights = taking_part / taking_part.sum(axis=1, keepdims=True)
        values = np.einsum("eb,ebs->es", weights, self.values[ends])
        return VertexLight(values, is_open, enclosed, np.all(self.known[ends], axis=1))


def unknown(count: int) -> "VertexLight":
    """Of vertices that have not been lit."""
    nothing = np.zeros(count, bool)
    return VertexLight(np.zeros((count, 2 * SKIES)), nothing, nothing.copy(), nothing.copy())


def with_meshes(scene: Scene, meshes: Sequence[Mesh]) -> Scene:
    """The scene with other meshes of its parts."""
    parts = [dataclasses.replace(part, mesh=mesh) for part, mesh in zip(scene.parts, meshes, strict=True)]
    return dataclasses.replace(scene, parts=parts)


class LitVertices:
    """Traces what reaches vertices of the scene's surfaces, through the texels of a cube map.

    Attributes:
        rays: that were cast so far.
    """

    def __init__(self, surfaces: Surfaces, resolution: int, report: Report | None):
        self._surfaces, self._tracer, self._occluders = surfaces, Tracer(surfaces), Occluders(surfaces)
        self._resolution, self._report, self._times, self.rays = resolution, report, 0, 0
        self._directions = cubemap.directions(resolution)
        self._skies = sky_panel(resolution)

    def at(self, scene: Scene, meshes: Sequence[Mesh], vertices: Sequence[Int[np.ndarray, " _"]]) -> list[VertexLight]:
        """What reaches some vertices of every mesh of the scene's."""
        surfaces = with_meshes(scene, meshes).surfaces()
        starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
        chosen = np.concatenate([start + own for start, own in zip(starts, vertices, strict=False)])
        is_chosen = np.zeros(len(surfaces.vertices), bool)
        is_chosen[chosen] = True
        # The faces around a vertex tell where its rays start.
        around = surfaces.faces[is_chosen[surfaces.faces].any(axis=1)]
        surfaces = dataclasses.replace(surfaces, faces=around)
        receivers = vertex_receivers(surfaces, np.zeros(len(surfaces.two_sided), int), self._tracer)
        fronts = self._traced(receivers, receivers.slot_of[chosen])
        has_back = surfaces.back[chosen] >= 0
        values = np.concatenate([fronts.values, np.zeros_like(fronts.values)], axis=1)
        is_open, enclosed = fronts.is_open.copy(), fronts.enclosed.copy()
        if has_back.any():
            backs = self._traced(receivers, receivers.slot_of[surfaces.back[chosen[has_back]]])
            values[has_back, fronts.values.shape[1] :] = backs.values
            is_open[has_back] &= backs.is_open
            enclosed[has_back] &= backs.enclosed
        cuts = np.cumsum([len(own) for own in vertices])[:-1]
        every = values, is_open, enclosed, np.ones_like(enclosed)
        return [VertexLight(*one) for one in zip(*(np.split(of, cuts) for of in every), strict=True)]

    def _traced(self, receivers: Receivers, slots: Int[np.ndarray, " v"]) -> VertexLight:
        every = receivers.origins, receivers.normals, receivers.face_normals
        origins, normals, face_normals = (of.reshape(-1, 3)[slots] for of in every)
        order = np.argsort(morton((origins + 1) / 2), kind="stable")
        blocks = [order[start : start + GROUP] for start in range(0, len(order), GROUP)]
        values, is_open = np.zeros((len(slots), self._skies.shape[1])), np.zeros(len(slots), bool)
        rays = [0] * len(blocks)

        def trace(number: int) -> None:
            block = blocks[number]
            bits, rays[number] = trace_adaptively(
                self._tracer, self._occluders, origins[block], normals[block], self._resolution
            )
            seen = np.unpackbits(bits, axis=1, bitorder="little")
            cosines = np.maximum(normals[block] @ self._directions.T, 0)
            values[block] = (seen * cosines) @ self._skies
            is_open[block] = ((seen > 0) | (cosines < 1e-3)).all(axis=1)

        self._times += 1
        for done, _ in enumerate(Threads().run(trace, range(len(blocks)))):
            if self._report:
                self._report(f"vertices, pass {self._times}", min(GROUP * (done + 1), len(slots)), len(slots))
        self.rays += sum(rays)
        enclosed = enclosed_vertices(self._surfaces, self._tracer, origins, face_normals)
        return VertexLight(values, is_open, enclosed, np.ones_like(enclosed))
