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
from jaxrelight.geometry.triangles import area_vectors
from jaxrelight.lights.sky_panel import POWER, SKIES, sky_panel
from jaxrelight.numerics.unique_rows import unique_rows
from jaxrelight.precomputation.groups import Threads
from jaxrelight.progress import Report
from jaxrelight.scene.scene import Scene
from jaxrelight.transport.adaptive_visibility import trace_adaptively

# Side of the cube map through which light reaches vertices here.
_RESOLUTION = 16
# Lengths of edges, see `_lengths`: where longer ones see anything but open sky, they are halved; those of which the
# tolerance is, see `_needed`; and those that are short enough where meshes have them.
_LONGEST, _LENGTH, _FINE = 1 / 4, 1 / 32, 1 / 64
# The least light, over that of open sky, that the tolerance is relative to.
_DARK = 0.2
# Two of them halve a face in both directions: these are many more than lead from the scene's size to the shortest edge.
_MOST_ROUNDS = 32
# Middles of edges in the same place, as those of two parts at their border, differ by less.
_SAME_PLACE = 1e-6
# Of layers: what a mesh is halved by, apart from the scene and the tolerance.
DIALS = _RESOLUTION, _LONGEST, _LENGTH, _FINE, _DARK, POWER


class Refined(NamedTuple):
    """A scene with more vertices.

    Attributes:
        scene: it.
        layer: the name of the store's layer that tells which edges were halved.
        added: vertices, and backs of vertices.
        even: how many vertices and backs there would be if those of meshes with added ones were as dense everywhere.
    """

    scene: Scene
    layer: str
    added: int
    even: int


def refined(scene: Scene, tolerance: float, folder: pathlib.Path, key: str, report: Report | None = None) -> Refined:
    """The scene with more vertices in its meshes. What the store tells of halved edges is not traced again.

    Args:
        scene: any.
        tolerance: by how much irradiance may be off in the middle of an edge, of that under open sky.
        folder: the store.
        key: of all that rays depend on.
        report: called with the progress.
    """
    name = layer_name(key, tolerance)
    layout = {"edges": ((-1,), np.dtype(np.int64)), "counts": ((-1,), np.dtype(np.int64))}
    layer = store.make_layer(folder / name, layout, 1)
    if layer.missing:
        rounds = _rounds(scene, tolerance, report)
        chosen = [np.flatnonzero(of) for one in rounds for of in one]
        edges = np.concatenate([np.zeros(0, np.int64), *chosen])
        layer.write(0, edges=edges, counts=np.array([len(one) for one in chosen], np.int64))
    finer = stored_refinement(scene, layer)
    before, after = (_counts([part.mesh for part in one.parts]) for one in (scene, finer))
    added = np.flatnonzero(after > before)
    even = after.astype(float)
    even[added] *= [_density(finer.parts[int(number)].mesh) for number in added]
    return Refined(finer, name, int((after - before).sum()), int(even.sum()))


def layer_name(key: str, tolerance: float) -> str:
    """Of the layer that tells which edges were halved."""
    return f"refinement-{store.key_of(key, tolerance, DIALS)}"


def stored_refinement(scene: Scene, layer: store.Layer) -> Scene:
    """The scene with edges halved as a layer tells."""
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
    return _with_meshes(scene, meshes)


def _counts(meshes: Sequence[Mesh]) -> Int[np.ndarray, " p"]:
    """Of vertices and their backs."""
    return np.array([len(mesh.vertices) * (2 if mesh.two_sided else 1) for mesh in meshes])


def _density(mesh: Mesh) -> float:
    """How much denser a mesh's vertices are where its faces are small, which one in twenty is, than in the mean."""
    areas = np.linalg.norm(area_vectors(mesh.vertices[mesh.faces]), axis=1)
    areas = areas[areas > 0]
    return float(areas.mean() / np.quantile(areas, 0.05)) if len(areas) else 1.0


def _with_meshes(scene: Scene, meshes: Sequence[Mesh]) -> Scene:
    parts = [dataclasses.replace(part, mesh=mesh) for part, mesh in zip(scene.parts, meshes, strict=True)]
    return dataclasses.replace(scene, parts=parts)


class _Light(NamedTuple):
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

    def some(self, vertices: Int[np.ndarray, " n"]) -> "_Light":
        """Those of some vertices."""
        return _Light(*(of[vertices] for of in self))

    def fill(self, vertices: Int[np.ndarray, " n"], light: "_Light") -> None:
        """Puts in those of some vertices."""
        for values, own in zip(self, light, strict=True):
            values[vertices] = own

    def beside(self, other: "_Light") -> "_Light":
        """Those of more vertices."""
        return _Light(*(np.concatenate(pair) for pair in zip(self, other, strict=True)))

    def between(self, ends: Int[np.ndarray, "e 2"]) -> "_Light":
        """What pictures show in the middle between vertices: what is enclosed takes no part."""
        is_open, enclosed = np.all(self.is_open[ends], axis=1), np.all(self.enclosed[ends], axis=1)
        taking_part = ~self.enclosed[ends] | enclosed[:, None]
        weights = taking_part / taking_part.sum(axis=1, keepdims=True)
        values = np.einsum("eb,ebs->es", weights, self.values[ends])
        return _Light(values, is_open, enclosed, np.all(self.known[ends], axis=1))


def _rounds(scene: Scene, tolerance: float, report: Report | None) -> list[list[Bool[np.ndarray, " _"]]]:
    """Which edges of each part are halved, one time after the other."""
    surfaces = scene.surfaces()
    meshes = [part.mesh for part in scene.parts]
    counts = [len(mesh.vertices) for mesh in meshes]
    light, settled = [_unknown(count) for count in counts], [np.zeros(0, np.int64) for _ in meshes]
    lit: _LitVertices | None = None
    rounds: list[list[Bool[np.ndarray, " _"]]] = []
    for _ in range(_MOST_ROUNDS):
        edges = [edges_of(mesh) for mesh in meshes]
        lengths = _lengths(meshes, edges, surfaces.radius)
        asked = []
        for length, of, known, count in zip(lengths, edges, settled, counts, strict=True):
            coarse = (length > _FINE) | (of.ends >= count).any(axis=1)
            asked.append(coarse & (length > _shortest(tolerance)) & ~np.isin(_names(of), known))
        if not any(one.any() for one in asked):
            break
        lit = lit or _LitVertices(surfaces, report)
        ends = [np.unique(of.ends[ask]) for of, ask in zip(edges, asked, strict=True)]
        ends = [own[~one.known[own]] for own, one in zip(ends, light, strict=True)]
        for one, own, new in zip(light, ends, lit.at(scene, meshes, ends), strict=True):
            one.fill(own, new)
        tried = [halved(*given) for given in zip(meshes, edges, asked, strict=True)]
        new = [np.arange(len(mesh.vertices), len(more.vertices)) for mesh, more in zip(meshes, tried, strict=True)]
        middles = lit.at(scene, tried, new)
        chosen = [_needed(*given, tolerance) for given in zip(edges, asked, lengths, light, middles, strict=True)]
        chosen = _completed(meshes, edges, lengths, chosen, surfaces.radius)
        if not any(one.any() for one in chosen):
            break
        for number, (of, ask, take) in enumerate(zip(edges, asked, chosen, strict=True)):
            settled[number] = np.union1d(settled[number], _names(of)[ask & ~take])
            added = _unknown(int(take.sum()))
            added.fill(np.flatnonzero(ask[take]), middles[number].some((np.cumsum(ask) - 1)[take & ask]))
            light[number] = light[number].beside(added)
        meshes = [halved(*given) for given in zip(meshes, edges, chosen, strict=True)]
        rounds = [*rounds, chosen]
    return rounds


def _shortest(tolerance: float) -> float:
    """Edges up to this length are not halved: light that is between those of both ends cannot be off enough there."""
    return 2 * tolerance * _LENGTH


def _lengths(meshes, edges, radius: float) -> list[Float[np.ndarray, " _"]]:
    """Of edges, relative to the geometric mean of the scene's radius and their part's."""
    lengths = []
    for mesh, of in zip(meshes, edges, strict=True):
        ends, size = mesh.vertices[of.ends], np.ptp(mesh.vertices, axis=0).max() / 2
        lengths.append(np.linalg.norm(ends[:, 1] - ends[:, 0], axis=-1) / np.sqrt(radius * size))
    return lengths


def _unknown(count: int) -> "_Light":
    """Of vertices that have not been lit."""
    nothing = np.zeros(count, bool)
    return _Light(np.zeros((count, 2 * SKIES)), nothing, nothing.copy(), nothing.copy())


def _names(edges: Edges) -> Int[np.ndarray, " e"]:
    """A number for each pair of ends, which stays what it is where vertices are added."""
    return edges.ends[:, 0] << 32 | edges.ends[:, 1]


def _needed(edges: Edges, asked, lengths, light: _Light, middles: _Light, tolerance: float) -> Bool[np.ndarray, " e"]:
    """Edges in whose middle light is off by more than the tolerance allows for their length.

    That is less for longer ones, around which more of a picture is off: the squared error of a picture is least, for a
    number of vertices, where errors times lengths are alike.
    """
    shown = light.between(edges.ends[asked])
    most = np.maximum(np.maximum(middles.values, shown.values), _DARK)
    off = (np.abs(middles.values - shown.values) / most).max(axis=1, initial=0) * (lengths[asked] / _LENGTH)
    partly_hidden = ~(middles.is_open & shown.is_open)
    needed = np.zeros(len(asked), bool)
    needed[asked] = ~middles.enclosed & (off > tolerance) | partly_hidden & (lengths[asked] > _LONGEST)
    # Nobody sees an edge that is enclosed.
    needed[asked] &= ~(middles.enclosed & shown.enclosed)
    return needed


def _completed(meshes, edges, lengths, chosen, radius: float) -> list[Bool[np.ndarray, " _"]]:
    """The same with what else has to be halved.

    That is the longest side of every face of which another one is, or faces would become needles whose sides never get
    shorter (Rivara 1984), and what lies in the same place in another part.
    """
    while True:
        count = sum(one.sum() for one in chosen)
        chosen = [one.copy() for one in _shared(meshes, edges, chosen, radius)]
        for one, of, length in zip(chosen, edges, lengths, strict=True):
            touched = of.of_sides[one[of.of_sides].any(axis=1)]
            one[np.take_along_axis(touched, length[touched].argmax(axis=1)[:, None], axis=1)] = True
        if sum(one.sum() for one in chosen) == count:
            return chosen


def _shared(meshes, edges, chosen, radius: float) -> list[Bool[np.ndarray, " _"]]:
    """The same with edges in the same place as one that is halved, so that no vertex lies inside another's edge."""
    middles = [mesh.vertices[of.ends].mean(axis=1) for mesh, of in zip(meshes, edges, strict=True)]
    place = np.rint(np.concatenate(middles) / (radius * _SAME_PLACE)).astype(np.int64)
    _, same = unique_rows(place)
    wanted = np.zeros(same.max(initial=-1) + 1, bool)
    wanted[same[np.concatenate(chosen)]] = True
    return np.split(wanted[same], np.cumsum([len(one) for one in chosen])[:-1])


class _LitVertices:
    """Traces what reaches vertices of the scene's surfaces."""

    def __init__(self, surfaces: Surfaces, report: Report | None):
        self._surfaces, self._tracer, self._occluders = surfaces, Tracer(surfaces), Occluders(surfaces)
        self._report, self._times = report, 0
        self._directions = cubemap.directions(_RESOLUTION)
        self._skies = sky_panel(_RESOLUTION)

    def at(self, scene: Scene, meshes: Sequence[Mesh], vertices: Sequence[Int[np.ndarray, " _"]]) -> list[_Light]:
        """What reaches some vertices of every mesh of the scene's."""
        surfaces = _with_meshes(scene, meshes).surfaces()
        receivers = vertex_receivers(surfaces, np.zeros(len(surfaces.two_sided), int), self._tracer)
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
        every = values, is_open, enclosed, np.ones_like(enclosed)
        return [_Light(*one) for one in zip(*(np.split(of, cuts) for of in every), strict=True)]

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
        enclosed = enclosed_vertices(self._surfaces, self._tracer, origins, face_normals)
        return _Light(values, is_open, enclosed, np.ones_like(enclosed))
