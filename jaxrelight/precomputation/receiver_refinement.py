"""Meshes with vertices where light needs them: edges are halved where it is not linear along them.

What is compared is the light of a fixed panel of skies that reaches the middle of an edge with what lies between its
ends, so that another environment, or another material, asks for no other vertices. Faces are halved in their planes:
what rays meet stays the same surface.
"""

import dataclasses
import pathlib
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxrelight.basis import cubemap
from jaxrelight.files import store
from jaxrelight.geometry.enclosed_vertices import enclosed_vertices
from jaxrelight.geometry.mesh import Mesh
from jaxrelight.geometry.morton import morton
from jaxrelight.geometry.occluders import Occluders
from jaxrelight.geometry.receivers import GROUP, Receivers, vertex_receivers
from jaxrelight.geometry.subdivision import Edges, edges_of, halved
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.precomputation.groups import Threads
from jaxrelight.progress import Report
from jaxrelight.scene.scene import Scene
from jaxrelight.transport.adaptive_visibility import trace_adaptively

# Side of the cube map through which light reaches vertices here.
_RESOLUTION = 16
# In scene space, which is 2 wide: edges that are longer are halved wherever anything is hidden from them, and shorter
# ones are left as they are.
_LONGEST, _SHORTEST = 1 / 4, 1 / 64
# Of the skies of the panel, all but one are brighter around an axis, as a power of the cosine.
_POWER = 4
# Two of them halve a face in both directions: these are many more than lead from the scene's size to the shortest edge.
_MOST_ROUNDS = 32
# Middles of edges in the same place, as those of two parts at their border, differ by less.
_SAME_PLACE = 1e-6
# Of layers: what a mesh is halved by, apart from the scene and the tolerance.
DIALS = _RESOLUTION, _LONGEST, _SHORTEST, _POWER


def refined(
    scene: Scene, tolerance: float, folder: pathlib.Path, key: str, report: Report | None = None
) -> tuple[Scene, str]:
    """The scene with more vertices in its meshes, and the name of the store's layer that tells which edges were halved.

    What that layer tells is not traced again.

    Args:
        scene: any.
        tolerance: by how much irradiance may be off in the middle of an edge, of that under open sky.
        folder: the store.
        key: of all that rays depend on.
        report: called with the progress.
    """
    name = f"refinement-{store.key_of(key, tolerance, DIALS)}"
    layout = {"edges": ((-1,), np.dtype(np.int64)), "counts": ((-1,), np.dtype(np.int64))}
    layer = store.make_layer(folder / name, layout, 1)
    if layer.missing:
        rounds = _rounds(scene, tolerance, report)
        chosen = [np.flatnonzero(of) for one in rounds for of in one]
        edges = np.concatenate([np.zeros(0, np.int64), *chosen])
        layer.write(0, edges=edges, counts=np.array([len(one) for one in chosen], np.int64))
    counts, edges = layer.read("counts", 0), layer.read("edges", 0)
    each = np.split(edges, np.cumsum(counts)[:-1]) if len(counts) else []
    meshes, parts = [part.mesh for part in scene.parts], len(scene.parts)
    for number, chosen in enumerate(each):
        mesh = meshes[number % parts]
        if len(chosen):
            edges = edges_of(mesh)
            mask = np.zeros(len(edges.ends), bool)
            mask[chosen] = True
            meshes[number % parts] = halved(mesh, edges, mask)
    return _with_meshes(scene, meshes), name


def _with_meshes(scene: Scene, meshes: Sequence[Mesh]) -> Scene:
    parts = [dataclasses.replace(part, mesh=mesh) for part, mesh in zip(scene.parts, meshes, strict=True)]
    return dataclasses.replace(scene, parts=parts)


class _Light(NamedTuple):
    """What reaches vertices, on both sides where a mesh has two.

    Attributes:
        values: irradiance under every sky, over that of open sky in the mean.
        is_open: whether nothing is hidden from them.
        enclosed: whether they lie inside closed surfaces.
    """

    values: Float[np.ndarray, "_ s"]
    is_open: Bool[np.ndarray, " _"]
    enclosed: Bool[np.ndarray, " _"]

    def beside(self, other: "_Light") -> "_Light":
        """Those of more vertices."""
        return _Light(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))

    def between(self, ends: Int[np.ndarray, "e 2"]) -> "_Light":
        """What pictures show in the middle between vertices: what is enclosed takes no part."""
        is_open, enclosed = np.all(self.is_open[ends], axis=1), np.all(self.enclosed[ends], axis=1)
        taking_part = ~self.enclosed[ends] | enclosed[:, None]
        weights = taking_part / taking_part.sum(axis=1, keepdims=True)
        return _Light(np.einsum("eb,ebs->es", weights, self.values[ends]), is_open, enclosed)


def _rounds(scene: Scene, tolerance: float, report: Report | None) -> list[list[Bool[np.ndarray, " _"]]]:
    """Which edges of each part are halved, one time after the other."""
    surfaces = scene.surfaces()
    meshes = [part.mesh for part in scene.parts]
    edges = [edges_of(mesh) for mesh in meshes]
    lengths = _lengths(meshes, edges, surfaces.radius)
    if not any((length > _SHORTEST).any() for length in lengths):
        return []
    lit = _LitVertices(surfaces, report)
    # No edge that comes to be is longer than those of its face, so that its ends are among these, or new.
    ends = [np.unique(of.ends[length > _SHORTEST]) for of, length in zip(edges, lengths, strict=True)]
    light = lit.at(scene, meshes, ends)
    light = [_spread(one, own, len(mesh.vertices)) for one, own, mesh in zip(light, ends, meshes, strict=True)]
    settled = [np.zeros(0, np.int64) for _ in meshes]
    rounds: list[list[Bool[np.ndarray, " _"]]] = []
    for _ in range(_MOST_ROUNDS):
        long = [length > _SHORTEST for length in lengths]
        asked = [one & ~np.isin(_names(of), known) for one, of, known in zip(long, edges, settled, strict=True)]
        if not any(one.any() for one in asked):
            break
        tried = [halved(*given) for given in zip(meshes, edges, asked, strict=True)]
        new = [np.arange(len(mesh.vertices), len(more.vertices)) for mesh, more in zip(meshes, tried, strict=True)]
        middles = lit.at(scene, tried, new)
        chosen = [_needed(*given, tolerance) for given in zip(edges, asked, lengths, light, middles, strict=True)]
        chosen = _completed(meshes, edges, lengths, long, chosen, surfaces.radius)
        if not any(one.any() for one in chosen):
            break
        more_light = []
        for number, (of, ask, take) in enumerate(zip(edges, asked, chosen, strict=True)):
            settled[number] = np.union1d(settled[number], _names(of)[ask & ~take])
            # An edge that another part's edge asks for has no light of its own yet: what lies between its ends.
            added, place, own = light[number].between(of.ends[take]), np.cumsum(ask) - 1, ask[take]
            for values, measured in zip(added, middles[number], strict=True):
                values[own] = measured[place[take & ask]]
            more_light.append(light[number].beside(added))
        meshes = [halved(*given) for given in zip(meshes, edges, chosen, strict=True)]
        light, rounds = more_light, [*rounds, chosen]
        edges = [edges_of(mesh) for mesh in meshes]
        lengths = _lengths(meshes, edges, surfaces.radius)
    return rounds


def _lengths(meshes, edges, radius: float) -> list[Float[np.ndarray, " _"]]:
    """Of edges, in scene space."""
    ends = [mesh.vertices[of.ends] for mesh, of in zip(meshes, edges, strict=True)]
    return [np.linalg.norm(one[:, 1] - one[:, 0], axis=-1) / radius for one in ends]


def _spread(light: _Light, vertices: Int[np.ndarray, " n"], count: int) -> _Light:
    """Light of some of a mesh's vertices among all of them."""
    every = _Light(*(np.zeros((count, *of.shape[1:]), of.dtype) for of in light))
    for values, own in zip(every, light, strict=True):
        values[vertices] = own
    return every


def _names(edges: Edges) -> Int[np.ndarray, " e"]:
    """A number for each pair of ends, which stays what it is where vertices are added."""
    return edges.ends[:, 0] << 32 | edges.ends[:, 1]


def _needed(edges: Edges, asked, lengths, light: _Light, middles: _Light, tolerance: float) -> Bool[np.ndarray, " e"]:
    shown = light.between(edges.ends[asked])
    off = np.abs(middles.values - shown.values).max(axis=1, initial=0)
    partly_hidden = ~(middles.is_open & shown.is_open)
    needed = np.zeros(len(asked), bool)
    needed[asked] = ~middles.enclosed & (off > tolerance) | partly_hidden & (lengths[asked] > _LONGEST)
    # Nobody sees an edge that is enclosed.
    needed[asked] &= ~(middles.enclosed & shown.enclosed)
    return needed


def _completed(meshes, edges, lengths, long, chosen, radius: float) -> list[Bool[np.ndarray, " _"]]:
    """The same with what else has to be halved.

    That is the longest side of every face of which another one is, or faces would become needles whose sides never get
    shorter (Rivara 1984), and what lies in the same place in another part.
    """
    while True:
        count = sum(one.sum() for one in chosen)
        chosen = [one.copy() for one in _shared(meshes, edges, long, chosen, radius)]
        for one, of, length in zip(chosen, edges, lengths, strict=True):
            touched = of.of_sides[one[of.of_sides].any(axis=1)]
            one[np.take_along_axis(touched, length[touched].argmax(axis=1)[:, None], axis=1)] = True
        if sum(one.sum() for one in chosen) == count:
            return chosen


def _shared(meshes, edges, long, chosen, radius: float) -> list[Bool[np.ndarray, " _"]]:
    """The same with edges in the same place as one that is halved, so that no vertex lies inside another's edge."""
    middles = [mesh.vertices[of.ends[one]].mean(axis=1) for mesh, of, one in zip(meshes, edges, long, strict=True)]
    place = np.rint(np.concatenate(middles) / (radius * _SAME_PLACE)).astype(np.int64)
    _, same = np.unique(place, axis=0, return_inverse=True)
    same = same.ravel()
    wanted = np.zeros(same.max(initial=-1) + 1, bool)
    wanted[same[np.concatenate([take[one] for take, one in zip(chosen, long, strict=True)])]] = True
    ends = np.cumsum([one.sum() for one in long])
    shared = []
    for one, own in zip(long, np.split(wanted[same], ends[:-1]), strict=True):
        mask = np.zeros(len(one), bool)
        mask[one] = own
        shared.append(mask)
    return shared


class _LitVertices:
    """Traces what reaches vertices of the scene's surfaces."""

    def __init__(self, surfaces: Surfaces, report: Report | None):
        self._surfaces, self._tracer, self._occluders = surfaces, Tracer(surfaces), Occluders(surfaces)
        self._report, self._times = report, 0
        self._directions = cubemap.directions(_RESOLUTION)
        axes = np.concatenate([np.eye(3), -np.eye(3)])
        lobes = np.maximum(self._directions @ axes.T, 0) ** _POWER
        # Their mean over the sphere is 1, so that half of open sky has the irradiance π in the mean.
        skies = np.column_stack([np.ones(len(lobes)), 2 * (_POWER + 1) * lobes])
        self._skies = skies * cubemap.solid_angles(_RESOLUTION)[:, None] / np.pi

    def at(self, scene: Scene, meshes: Sequence[Mesh], vertices: Sequence[Int[np.ndarray, " _"]]) -> list[_Light]:
        """What reaches some vertices of every mesh of the scene's."""
        surfaces = _with_meshes(scene, meshes).surfaces()
        receivers = vertex_receivers(surfaces, np.zeros(len(surfaces.two_sided), int))
        starts = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes)])
        chosen = np.concatenate([start + own for start, own in zip(starts, vertices, strict=False)])
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
        return [_Light(*one) for one in zip(*(np.split(of, cuts) for of in (values, is_open, enclosed)), strict=True)]

    def _traced(self, receivers: Receivers, slots: Int[np.ndarray, " v"]) -> _Light:
        every = receivers.origins, receivers.normals, receivers.face_normals
        origins, normals, face_normals = (of.reshape(-1, 3)[slots] for of in every)
        order = np.argsort(morton((origins + 1) / 2), kind="stable")
        blocks = [order[start : start + GROUP] for start in range(0, len(order), GROUP)]
        values, is_open = np.zeros((len(slots), self._skies.shape[1])), np.zeros(len(slots), bool)

        def trace(number: int) -> None:
            block = blocks[number]
            bits, _ = trace_adaptively(self._tracer, self._occluders, origins[block], normals[block], _RESOLUTION)
            seen = np.unpackbits(bits, axis=1, bitorder="little")
            cosines = np.maximum(normals[block] @ self._directions.T, 0)
            values[block] = (seen * cosines) @ self._skies
            is_open[block] = ((seen > 0) | (cosines < 1e-3)).all(axis=1)

        self._times += 1
        for done, _ in enumerate(Threads().run(trace, range(len(blocks)))):
            if self._report:
                self._report(f"vertices, pass {self._times}", min(GROUP * (done + 1), len(slots)), len(slots))
        return _Light(values, is_open, enclosed_vertices(self._surfaces, self._tracer, origins, face_normals))
