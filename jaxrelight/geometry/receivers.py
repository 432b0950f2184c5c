"""The points for which transport is precomputed, and the groups in which it is."""

import dataclasses
import functools

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxrelight.geometry.gbuffer import GBuffer
from jaxrelight.geometry.morton import morton
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.geometry.triangles import area_vectors

# Receivers of a group: the unit of tracing, baking, storing and resuming.
GROUP = 128

# How far vertices at the rim of a surface are moved into it, times their lift: see `_off_the_rim`.
_INSET = 4
# The cosine between the normals of a vertex and of a face around it that are taken to be on the same side.
_MIN_SLOPE = 0.2
# The slope above which a neighbour rises above the horizon of a vertex.
_RISE = 0.01
# Faces lie in two planes where the least eigenvalue of their normals' products is this much of the largest.
_FLAT = 1e-9


@dataclasses.dataclass(frozen=True)
class Receivers:
    """Surface points in scene space, in groups of GROUP that are close to each other and of one material.

    A material's groups follow each other; its last one is filled up with copies of its first receiver, which nobody
    reads. `slot_of` says where the i-th vertex or covered pixel went; the backs of two-sided vertices come after all
    vertices.

    Attributes:
        positions: in scene space, on the surface.
        normals: unit shading normals.
        face_normals: unit normals of the faces; at vertices their mean.
        origins: of rays, lifted off the surface.
        tangents: what tangent frames follow, see `tangent_frame`.
        omega_o: unit world direction to the eye for pixels, None for vertices.
        uv: surface coordinates for pixels, None for vertices.
        footprint: area in the first set of texture coordinates that each pixel covers, None for vertices.
        material_of_group: number of each group's material.
        filled: receivers of each group that are not copies.
        slot_of: place in the flattened groups of each vertex, back of a vertex, or covered pixel.
    """

    positions: Float[np.ndarray, "g m 3"]
    normals: Float[np.ndarray, "g m 3"]
    face_normals: Float[np.ndarray, "g m 3"]
    origins: Float[np.ndarray, "g m 3"]
    tangents: Float[np.ndarray, "g m 3"]
    omega_o: Float[np.ndarray, "g m 3"] | None
    uv: Float[np.ndarray, "g m u"] | None
    footprint: Float[np.ndarray, "g m"] | None
    material_of_group: Int[np.ndarray, " g"]
    filled: Int[np.ndarray, " g"]
    slot_of: Int[np.ndarray, " v"]

    @property
    def count(self) -> int:
        """Receivers, copies not counted."""
        return len(self.slot_of)

    @functools.cached_property
    def single_precision_axes(self) -> tuple[Float[np.ndarray, "g m 3"], Float[np.ndarray, "g m 3"]]:
        """Normals and tangents."""
        return self.normals.astype(np.float32), self.tangents.astype(np.float32)

    def groups_of(self, material: int | np.integer) -> Int[np.ndarray, " g"]:
        """The groups of a material, which follow each other."""
        return np.flatnonzero(self.material_of_group == material)


def vertex_receivers(
    surfaces: Surfaces, material_of_mesh: Int[np.ndarray, " m"], tracer: Tracer | None = None
) -> Receivers:
    """Every vertex, and the back of every one that has it: the view stays free.

    Args:
        surfaces: of the scene.
        material_of_mesh: numbers.
        tracer: of the scene: rays of vertices in faces that stand for a smooth surface leave from that, as those of
            pixels do, unless something stands between. Without it they leave from the faces.
    """
    material = np.asarray(material_of_mesh)[surfaces.mesh_of_vertex]
    two_sided = np.flatnonzero(surfaces.back >= 0)

    def both(values, back=1):
        return np.concatenate([values, back * values[two_sided]])

    origins, face_normals = lifted_vertices(surfaces)
    if tracer is not None:
        origins = _on_smooth_surface(surfaces, tracer, origins)
    normals, positions, tangents = both(surfaces.normals, -1), both(_off_the_rim(surfaces)), both(surfaces.tangents)
    return _grouped(positions, normals, face_normals, origins, tangents, None, None, None, both(material))


def lifted_vertices(surfaces: Surfaces) -> tuple[Float[np.ndarray, "r 3"], Float[np.ndarray, "r 3"]]:
    """Origins of the rays of every vertex, and of the back of every one that has it, and the normals of faces there."""
    two_sided = np.flatnonzero(surfaces.back >= 0)
    face_normals, positions = _vertex_face_normals(surfaces), _off_the_rim(surfaces)
    fronts, backs = (_lifted(surfaces, positions, side * face_normals, side) for side in (1, -1))
    return np.concatenate([fronts, backs[two_sided]]), np.concatenate([face_normals, -face_normals[two_sided]])


def pixel_receivers(
    gbuffer: GBuffer, origins: Float[np.ndarray, "p 3"], material_of_mesh: Int[np.ndarray, " m"]
) -> Receivers:
    """Every covered pixel, with its origin of rays: the view is fixed and the BRDF exact."""
    material = np.asarray(material_of_mesh)[gbuffer.mesh]
    normals = gbuffer.normals, gbuffer.face_normals
    seen = gbuffer.tangents, gbuffer.omega_o, gbuffer.uv, gbuffer.footprint
    return _grouped(gbuffer.positions, *normals, origins, *seen, material)


def _off_the_rim(surfaces: Surfaces) -> Float[np.ndarray, "v 3"]:
    """The vertices, those at the rim moved a little into the surface, along it.

    Where surfaces meet, as walls and a floor do, the vertices of one lie in the plane of the other: half of their rays
    would start behind it, and see light through the wall.
    """
    ends = np.sort(surfaces.faces[:, [[0, 1], [1, 2], [2, 0]]].reshape(-1, 2), axis=1).astype(np.int64)
    edge, count = np.unique(ends[:, 0] * len(surfaces.vertices) + ends[:, 1], return_counts=True)
    rim = np.unique(np.stack(np.divmod(edge[count == 1], len(surfaces.vertices))))
    if not len(rim):
        return surfaces.vertices
    touching = np.isin(surfaces.faces, rim)
    faces, corners = np.nonzero(touching)
    vertex = surfaces.faces[faces, corners]
    centres = surfaces.vertices[surfaces.faces[faces]].mean(axis=1) - surfaces.vertices[vertex]
    sums = [np.bincount(vertex, centres[:, axis], len(surfaces.vertices))[rim] for axis in range(3)]
    inwards, normals = np.stack(sums, axis=1), surfaces.normals[rim]
    inwards -= normals * np.sum(normals * inwards, axis=1, keepdims=True)
    length = np.linalg.norm(inwards, axis=1, keepdims=True)
    positions = surfaces.vertices.copy()
    # On a small face they move by no more than a tenth of the way.
    inset = np.minimum(_INSET * surfaces.vertex_lift[rim, None], length / 10)
    positions[rim] += inwards / np.where(length > 0, length, 1) * inset
    return positions


def _lifted(
    surfaces: Surfaces, positions: Float[np.ndarray, "v 3"], normals: Float[np.ndarray, "v 3"], side: int
) -> Float[np.ndarray, "v 3"]:
    """Vertices lifted along their normals until they are as far above every face around them as rays need.

    Args:
        surfaces: of the scene.
        positions: of the vertices, maybe moved off the rim, which can be under a face that rises from there.
        normals: unit normals to lift along.
        side: 1 for the fronts of faces, −1 for their backs.
    """
    height = surfaces.vertex_lift.copy()
    of_faces = side * surfaces.face_normals(np.arange(len(surfaces.faces)))
    for corner in range(3):
        vertex = surfaces.faces[:, corner]
        moved = positions[vertex] - surfaces.vertices[vertex]
        slope = np.sum(normals[vertex] * of_faces, axis=1)
        short = surfaces.vertex_lift[vertex] - np.sum(moved * of_faces, axis=1)
        np.maximum.at(height, vertex, np.where(slope > _MIN_SLOPE, short / np.maximum(slope, _MIN_SLOPE), 0))
    return positions + height[:, None] * normals


def _on_smooth_surface(
    surfaces: Surfaces, tracer: Tracer, origins: Float[np.ndarray, "r 3"]
) -> Float[np.ndarray, "r 3"]:
    """Origins of vertices that lie below the smooth surface that their faces stand for, raised to it.

    Those are vertices inside what was a larger face, or on what was a longer edge, so that all faces around them lie in
    one or two planes, and neighbours rise above the horizons of their shading normals. They move to the mean of their
    projections onto the tangent planes of their neighbours, see `ray_origins`.
    """
    count = len(surfaces.vertices)
    pairs = np.concatenate([surfaces.faces[:, [a, b]] for a in range(3) for b in range(3) if a != b])
    towards = surfaces.vertices[pairs[:, 1]] - surfaces.vertices[pairs[:, 0]]
    rise = np.sum(towards * surfaces.normals[pairs[:, 0]], axis=1)
    steep = np.abs(rise) > _RISE * np.linalg.norm(towards, axis=1)
    below = np.sum(towards * surfaces.normals[pairs[:, 1]], axis=1)
    degree = np.maximum(np.bincount(pairs[:, 0], minlength=count), 1)
    fronts, two_sided = np.arange(count), np.flatnonzero(surfaces.back >= 0)
    raised = origins.copy()
    for side, vertices, start in ((1.0, fronts, 0), (-1.0, two_sided, count)):
        inside = np.zeros(count, bool)
        inside[pairs[steep & (side * rise > 0), 0]] = True
        inside &= ~surfaces.pure_normals[surfaces.mesh_of_vertex]
        inside[inside] = _in_two_planes(surfaces, np.flatnonzero(inside))
        moves = (np.maximum(side * below, 0) * side / degree[pairs[:, 0]])[:, None] * surfaces.normals[pairs[:, 1]]
        own = np.flatnonzero(inside[vertices])
        bulge = np.stack([np.bincount(pairs[:, 0], moves[:, axis], count) for axis in range(3)], axis=1)[vertices[own]]
        height = np.linalg.norm(bulge, axis=1)
        own, bulge, height = own[height > 0] + start, bulge[height > 0], height[height > 0]
        if len(own):
            clear = ~tracer.blocked(raised[own], bulge / height[:, None], height)
            raised[own[clear]] += bulge[clear]
    return raised


def _in_two_planes(surfaces: Surfaces, vertices: Int[np.ndarray, " n"]) -> Bool[np.ndarray, " n"]:
    """Vertices of which all faces around lie in one plane or in two."""
    place = np.full(len(surfaces.vertices), -1)
    place[vertices] = np.arange(len(vertices))
    face, corner = np.nonzero(place[surfaces.faces] >= 0)
    areas = area_vectors(surfaces.vertices[surfaces.faces[face]])
    sums = np.zeros((len(vertices), 3, 3))
    np.add.at(sums, place[surfaces.faces[face, corner]], areas[:, :, None] * areas[:, None])
    least, _, most = np.linalg.eigvalsh(sums).T
    return least <= _FLAT * most


def _vertex_face_normals(surfaces: Surfaces) -> np.ndarray:
    """Area-weighted mean of the geometric normals around each vertex; the shading normal where they cancel."""
    corners = surfaces.vertices[surfaces.faces]
    area = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    total = np.zeros_like(surfaces.vertices)
    for corner in range(3):
        for axis in range(3):
            total[:, axis] += np.bincount(surfaces.faces[:, corner], area[:, axis], len(total))
    length = np.linalg.norm(total, axis=-1, keepdims=True)
    return np.where(length > 0, total / np.where(length > 0, length, 1), surfaces.normals)


def _grouped(positions, normals, face_normals, origins, tangents, omega_o, uv, footprint, material) -> Receivers:
    order = np.lexsort((morton((positions + 1) / 2), material))
    members, material_of_group, filled = [], [], []
    for number in np.unique(material):
        receivers = order[material[order] == number]
        groups = -(-len(receivers) // GROUP)
        members.append(np.concatenate([receivers, np.full(groups * GROUP - len(receivers), receivers[0])]))
        material_of_group += [number] * groups
        filled += [GROUP] * (groups - 1) + [len(receivers) - (groups - 1) * GROUP]
    member = np.concatenate(members) if members else np.zeros(0, np.int64)
    slot_of = np.zeros(len(positions), np.int64)
    # Backwards, so that a receiver's own slot overwrites those of its copies, which come later.
    slot_of[member[::-1]] = np.arange(len(member))[::-1]

    def pick(values):
        return values[member].reshape(-1, GROUP, *values.shape[1:])

    return Receivers(
        positions=pick(positions),
        normals=pick(normals),
        face_normals=pick(face_normals),
        origins=pick(origins),
        tangents=pick(tangents),
        omega_o=None if omega_o is None else pick(omega_o),
        uv=None if uv is None else pick(uv),
        footprint=None if footprint is None else pick(footprint),
        material_of_group=np.array(material_of_group, np.int64),
        filled=np.array(filled, np.int64),
        slot_of=slot_of,
    )
