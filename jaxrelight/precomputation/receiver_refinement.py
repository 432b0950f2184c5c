"""Meshes with vertices where light needs them: edges are halved where it is not linear along them.

What is compared is the light of a fixed panel of skies that reaches the middle of an edge with what lies between its
ends, so that another environment, or another material, asks for no other vertices. Faces are halved in their planes:
what rays meet stays the same surface.
"""

import pathlib
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxrelight.files import store
from jaxrelight.geometry.mesh import Mesh
from jaxrelight.geometry.subdivision import Edges, conforming, edges_of, halved
from jaxrelight.geometry.triangles import area_vectors
from jaxrelight.lights.sky_panel import POWER
from jaxrelight.precomputation.vertex_light import LitVertices, VertexLight, unknown, with_meshes
from jaxrelight.progress import Report
from jaxrelight.scene.scene import Scene

# Side of the cube map through which light reaches vertices.
_RESOLUTION = 16
# Lengths of edges, see `_lengths`: where longer ones see anything but open sky, they are halved; those of which the
# tolerance is, see `_needed`; and those that are short enough where meshes have them.
_LONGEST, _LENGTH, _FINE = 1 / 4, 1 / 32, 1 / 64
# The least light, over that of open sky, that the tolerance is relative to.
_DARK = 0.2
# Refinement of a mesh ends when the edges still to be halved are at most this share of its edges, and the faces around
# them at most this share of its area.
_NEGLIGIBLE = 1e-3
# Two of them halve a face in both directions: these are many more than lead from the scene's size to the shortest edge.
_MAX_ROUNDS = 32
# Of layers: what a mesh is halved by, apart from the scene and the tolerance.
DIALS = _RESOLUTION, _LONGEST, _LENGTH, _FINE, _DARK, _NEGLIGIBLE, POWER, "ends that differ"


class Refined(NamedTuple):
    """A scene with more vertices.

    Attributes:
        scene: it.
        layer: the name of the store's layer that tells which edges were halved.
        added: vertices, and backs of vertices.
        even: how many vertices and backs there would be if those of meshes with added ones were as dense everywhere.
        rays: that were cast to find out.
    """

    scene: Scene
    layer: str
    added: int
    even: int
    rays: int


def refined(scene: Scene, tolerance: float, folder: pathlib.Path, key: str, report: Report | None = None) -> Refined:
    """The scene with more vertices in its meshes. What the store tells of halved edges is not traced again.

    Args:
        scene: any.
        tolerance: by how much irradiance may be off in the middle of an edge, see `Transport.receiver_tolerance`.
        folder: the store.
        key: of all that rays depend on.
        report: called with the progress.
    """
    name = layer_name(key, tolerance)
    layout = {array: ((-1,), np.dtype(np.int64)) for array in ("edges", "counts", "rays")}
    layer = store.make_layer(folder / name, layout, 1)
    if layer.missing:
        rounds, rays = _rounds(scene, tolerance, _RESOLUTION, report)
        chosen = [of for one in rounds for of in one]
        edges = np.concatenate([np.zeros(0, np.int64), *chosen])
        layer.write(0, edges=edges, counts=np.array([len(one) for one in chosen], np.int64), rays=np.array([rays]))
    finer = stored_refinement(scene, layer)
    before, after = (_counts([part.mesh for part in one.parts]) for one in (scene, finer))
    added = np.flatnonzero(after > before)
    even = after.astype(float)
    even[added] *= [_density(finer.parts[int(number)].mesh) for number in added]
    return Refined(finer, name, int((after - before).sum()), int(even.sum()), int(layer.read("rays", 0)[0]))


def with_needed_vertices(scene: Scene, tolerance: float, resolution: int, report: Report | None = None) -> Scene:
    """The scene with the vertices that `refined` adds, without a store.

    Args:
        scene: any.
        tolerance: as of `refined`.
        resolution: side of the cube map through which light reaches vertices.
        report: called with the progress.
    """
    return _with_halved(scene, _rounds(scene, tolerance, min(resolution, _RESOLUTION), report)[0])


def layer_name(key: str, tolerance: float) -> str:
    """Of the layer that tells which edges were halved."""
    return f"refinement-{store.key_of(key, tolerance, DIALS)}"


def stored_refinement(scene: Scene, layer: store.Layer) -> Scene:
    """The scene with edges halved as a layer tells."""
    counts, chosen = layer.read("counts", 0), layer.read("edges", 0)
    each = np.split(chosen, np.cumsum(counts)[:-1]) if len(counts) else []
    parts = len(scene.parts)
    return _with_halved(scene, [each[start : start + parts] for start in range(0, len(each), parts)])


def _with_halved(scene: Scene, rounds: Sequence[Sequence[Int[np.ndarray, " _"]]]) -> Scene:
    """The scene with edges halved, one time after the other: of each part those with some numbers."""
    meshes = [part.mesh for part in scene.parts]
    for one in rounds:
        for number, chosen in enumerate(one):
            if len(chosen):
                edges = edges_of(meshes[number])
                mask = np.zeros(len(edges.ends), bool)
                mask[chosen] = True
                meshes[number] = halved(meshes[number], edges, mask)
    return with_meshes(scene, meshes)


def _counts(meshes: Sequence[Mesh]) -> Int[np.ndarray, " p"]:
    """Of vertices and their backs."""
    return np.array([len(mesh.vertices) * (2 if mesh.two_sided else 1) for mesh in meshes])


def _density(mesh: Mesh) -> float:
    """How much denser a mesh's vertices are where its faces are small, which one in twenty is, than in the mean."""
    areas = np.linalg.norm(area_vectors(mesh.vertices[mesh.faces]), axis=1)
    areas = areas[areas > 0]
    return float(areas.mean() / np.quantile(areas, 0.05)) if len(areas) else 1.0


def _rounds(
    scene: Scene, tolerance: float, resolution: int, report: Report | None
) -> tuple[list[list[Int[np.ndarray, " _"]]], int]:
    """Numbers of the edges of each part that are halved, one time after the other, and how many rays that took."""
    surfaces = scene.surfaces()
    meshes = [part.mesh for part in scene.parts]
    counts = [len(mesh.vertices) for mesh in meshes]
    light, settled = [unknown(count) for count in counts], [np.zeros(0, np.int64) for _ in meshes]
    lit: LitVertices | None = None
    rounds: list[list[Int[np.ndarray, " _"]]] = []
    for _ in range(_MAX_ROUNDS):
        edges = [edges_of(mesh) for mesh in meshes]
        lengths = _lengths(meshes, edges, surfaces.radius)
        asked = []
        for length, of, known, count in zip(lengths, edges, settled, counts, strict=True):
            coarse = (length > _FINE) | (of.ends >= count).any(axis=1)
            asked.append(coarse & (length > _shortest(tolerance)) & ~np.isin(_names(of), known))
        if not any(one.any() for one in asked):
            break
        lit = lit or LitVertices(surfaces, resolution, report)
        ends = [np.unique(of.ends[ask]) for of, ask in zip(edges, asked, strict=True)]
        ends = [own[~one.known[own]] for own, one in zip(ends, light, strict=True)]
        for one, own, new in zip(light, ends, lit.at(scene, meshes, ends), strict=True):
            one.fill(own, new)
        asked = [
            ask & _may_be_needed(*given, tolerance) for ask, *given in zip(asked, edges, lengths, light, strict=True)
        ]
        tried = [halved(*given) for given in zip(meshes, edges, asked, strict=True)]
        new = [np.arange(len(mesh.vertices), len(more.vertices)) for mesh, more in zip(meshes, tried, strict=True)]
        middles = lit.at(scene, tried, new)
        chosen = [_needed(*given, tolerance) for given in zip(edges, asked, lengths, light, middles, strict=True)]
        chosen = [one & _is_seen(*given, one) for *given, one in zip(meshes, edges, chosen, strict=True)]
        chosen = conforming(meshes, edges, lengths, chosen, surfaces.radius)
        if not any(one.any() for one in chosen):
            break
        for number, (of, ask, take) in enumerate(zip(edges, asked, chosen, strict=True)):
            settled[number] = np.union1d(settled[number], _names(of)[ask & ~take])
            added = unknown(int(take.sum()))
            added.fill(np.flatnonzero(ask[take]), middles[number].some((np.cumsum(ask) - 1)[take & ask]))
            light[number] = light[number].beside(added)
        meshes = [halved(*given) for given in zip(meshes, edges, chosen, strict=True)]
        rounds.append([np.flatnonzero(one) for one in chosen])
    return rounds, 0 if lit is None else lit.rays


def _is_seen(mesh: Mesh, edges: Edges, chosen: Bool[np.ndarray, " _"]) -> bool:
    """Whether the chosen edges are so many, or the faces around them so large, that pictures show what is there.

    A few long narrow faces ask for more vertices round after round, and nobody sees them.
    """
    if np.count_nonzero(chosen) > _NEGLIGIBLE * len(chosen):
        return True
    areas = np.linalg.norm(area_vectors(mesh.vertices[mesh.faces]), axis=1)
    return bool(areas[chosen[edges.of_sides].any(axis=1)].sum() > _NEGLIGIBLE * areas.sum())


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


def _names(edges: Edges) -> Int[np.ndarray, " e"]:
    """A number for each pair of ends, which stays what it is where vertices are added."""
    return edges.ends[:, 0] << 32 | edges.ends[:, 1]


def _may_be_needed(edges: Edges, lengths, light: VertexLight, tolerance: float) -> Bool[np.ndarray, " e"]:
    """Edges whose middles are worth rays: long ones, and those whose ends differ.

    Light that is between those of both ends is off by no more than half of their difference.
    """
    one, other = light.values[edges.ends.T]
    most = np.maximum(np.maximum(one, other), _DARK)
    differ = (np.abs(one - other) / most).max(axis=1, initial=0) * (lengths / _LENGTH) > tolerance
    return (lengths > _LENGTH) | differ | light.enclosed[edges.ends].any(axis=1)


def _needed(
    edges: Edges, asked, lengths, light: VertexLight, middles: VertexLight, tolerance: float
) -> Bool[np.ndarray, " e"]:
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
