"""All meshes of a scene as one set of triangles, moved to the scene's centre and scaled."""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np
from jaxtyping import Bool, Float, Int, Real

from jaxrelight.errors import InputError
from jaxrelight.geometry.mesh import Mesh

# How far origins of rays are lifted off a face, relative to its coordinates and its size: rays have no near limit.
# Sixteen roundings of single precision. Planes and boxes of every size and turn have no self-hits from four on.
LIFT = 2.0**-20


@dataclasses.dataclass(frozen=True)
class Surfaces:
    """Triangles in scene space: world coordinates less `centre`, divided by `radius`, so that all fit in [−1, 1]³.

    Attributes:
        vertices: positions in scene space, float64.
        normals: unit shading normals.
        faces: vertex numbers, counter-clockwise seen from the front.
        uv: surface coordinates as `jaxrelight.brdf.texture` describes them: zeros for the sets of texture coordinates
            that a mesh does not have, and white where it has no colours but another mesh has.
        mesh_of_vertex: which mesh each vertex belongs to.
        two_sided: which meshes have a back that is a surface, too.
        uv_tangents: which meshes have tangent frames along u.
        pure_normals: which meshes' shading normals are taken as they are, see `Mesh.pure_normals`.
        centre: world position of the scene's centre.
        radius: half of the bounding box's longest side, in world units.
    """

    vertices: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    uv: Float[np.ndarray, "v u"]
    mesh_of_vertex: Int[np.ndarray, " v"]
    two_sided: Bool[np.ndarray, " m"]
    uv_tangents: Bool[np.ndarray, " m"]
    pure_normals: Bool[np.ndarray, " m"]
    centre: Float[np.ndarray, "3"]
    radius: float

    def to_scene(
        self, world: Sequence[float] | Sequence[Sequence[float]] | Real[np.ndarray, "... 3"]
    ) -> Float[np.ndarray, "... 3"]:
        """Positions in scene space of world positions."""
        return (np.asarray(world, float) - self.centre) / self.radius

    @functools.cached_property
    def back(self) -> Int[np.ndarray, " v"]:
        """The number of the receiver at the back of each vertex: backs are counted after all vertices, where any."""
        has_back = self.two_sided[self.mesh_of_vertex]
        return np.where(has_back, len(self.vertices) - 1 + np.cumsum(has_back), -1)

    @functools.cached_property
    def u_axes(self) -> Float[np.ndarray, "v 4"]:
        """`u_axes_along` for the first set of texture coordinates."""
        return self.u_axes_along(self.uv[:, :2])

    def u_axes_along(self, coordinates: Float[np.ndarray, "v 2"]) -> Float[np.ndarray, "v 4"]:
        """Unit directions of growing u along the surface, and ±1: v grows towards that times normal × u.

        Means over the adjacent faces, weighted by area; zeros where (u, v) do not tell.
        """
        corners, uv = self.vertices[self.faces], coordinates[self.faces]
        (first, second), (du, dv) = ((a[:, 1] - a[:, 0], a[:, 2] - a[:, 0]) for a in (corners, uv))
        turn = np.sign(du[:, 0] * dv[:, 1] - du[:, 1] * dv[:, 0])
        along = turn[:, None] * (first * dv[:, 1:] - second * du[:, 1:])
        length = np.linalg.norm(along, axis=1, keepdims=True)
        area = np.linalg.norm(np.cross(first, second), axis=1, keepdims=True)
        share = np.column_stack([along / np.where(length > 0, length, 1), turn]) * area
        axes = np.stack([np.bincount(self.faces.ravel(), np.repeat(share[:, k], 3), len(self.uv)) for k in range(4)], 1)
        axes[:, :3] -= self.normals * np.sum(axes[:, :3] * self.normals, axis=1, keepdims=True)
        length = np.linalg.norm(axes[:, :3], axis=1, keepdims=True)
        known = length > 1e-6 * np.bincount(self.faces.ravel(), np.repeat(area[:, 0], 3), len(self.uv))[:, None]
        axes[:, :3] = np.where(known, axes[:, :3] / np.where(known, length, 1), 0)
        return np.column_stack([axes[:, :3], np.sign(axes[:, 3])])

    @functools.cached_property
    def has_uv(self) -> bool:
        """Whether any mesh has texture coordinates."""
        return bool(self.uv.any())

    @functools.cached_property
    def tangents(self) -> Float[np.ndarray, "v 3"]:
        """What tangent frames follow at each vertex; zeros where the normal alone tells (Wang 2006 §3.3.2)."""
        asked = self.uv_tangents[self.mesh_of_vertex]
        return np.where(asked[:, None], self.u_axes[:, :3], 0) if asked.any() else np.zeros_like(self.vertices)

    @functools.cached_property
    def face_lift(self) -> Float[np.ndarray, " f"]:
        """How far off each face rays start, in scene space: what rounding of its coordinates and its size needs."""
        corners = self.vertices[self.faces]
        reach, size = np.abs(corners).max(axis=(1, 2)), np.ptp(corners, axis=1).max(axis=1)
        return LIFT * np.maximum(reach, size)

    @functools.cached_property
    def vertex_lift(self) -> Float[np.ndarray, " v"]:
        """The largest lift of the faces around each vertex."""
        lift = np.zeros(len(self.vertices))
        np.maximum.at(lift, self.faces.ravel(), np.repeat(self.face_lift, 3))
        return lift

    def uv_densities(self, faces: Int[np.ndarray, " p"]) -> Float[np.ndarray, " p"]:
        """Area in texture coordinates over area in scene space of some faces; 0 for those without area.

        It is that of the first set, where there are no others; a face without area in it counts as if it had the area
        that it has in scene space, so that areas in further sets can be told from it.
        """
        return self._uv_density_of_face[faces]

    def face_normals(self, faces: Int[np.ndarray, " p"]) -> Float[np.ndarray, "p 3"]:
        """Unit geometric normals of some faces; the zero vector for one that rounding left without area."""
        return self._normal_of_face[faces]

    # Rays meet faces many times over: with both computed once, surface points of rays take half the time.
    @functools.cached_property
    def _uv_density_of_face(self) -> Float[np.ndarray, " f"]:
        density = _densities(self.vertices, self.faces, self.uv[:, :2])
        return density if self.uv.shape[1] == 2 else np.where(density > 0, density, 1.0)

    @functools.cached_property
    def _normal_of_face(self) -> Float[np.ndarray, "f 3"]:
        corners = self.vertices[self.faces]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normal, axis=-1, keepdims=True)
        return normal / np.where(length > 0, length, 1)


def _densities(
    vertices: Float[np.ndarray, "v 3"], faces: Int[np.ndarray, "f 3"], uv: Float[np.ndarray, "v 2"]
) -> Float[np.ndarray, " f"]:
    """Area of faces in texture coordinates over that in space; 0 for those without area."""
    corners, (du, dv) = vertices[faces], np.moveaxis(uv[faces][:, 1:] - uv[faces][:, :1], -1, 0)
    area = np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1)
    return np.abs(du[:, 0] * dv[:, 1] - du[:, 1] * dv[:, 0]) / np.where(area > 0, area, np.inf)


def _surface_coordinates(mesh: Mesh, vertices: Float[np.ndarray, "v 3"], sets: int, coloured: bool):
    """The columns that `jaxrelight.brdf.texture` describes, of one mesh whose vertices are in scene space."""
    count = len(vertices)
    uv = np.zeros((count, 2 * sets))
    if mesh.uv is not None:
        uv[:, : mesh.uv.shape[1]] = mesh.uv
    columns = [uv[:, :2]]
    for number in range(1, sets):
        own = uv[:, 2 * number : 2 * number + 2]
        first, other = (_densities(vertices, mesh.faces, each) for each in (uv[:, :2], own))
        ratio = np.repeat(other / np.where(first > 0, first, 1.0), 3)
        faces_at = np.maximum(np.bincount(mesh.faces.ravel(), minlength=count), 1)
        columns += [own, (np.bincount(mesh.faces.ravel(), ratio, count) / faces_at)[:, None]]
    if coloured:
        columns.append(np.ones((count, 3)) if mesh.colours is None else mesh.colours)
    return np.concatenate(columns, axis=1)


def join(meshes: Sequence[Mesh]) -> Surfaces:
    """One set of triangles from several meshes.

    Raises:
        InputError: without meshes, or where all vertices coincide.
    """
    if not meshes:
        raise InputError("the scene has no mesh; add a [[mesh]] table")
    vertices = np.concatenate([mesh.vertices for mesh in meshes])
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    centre, radius = (low + high) / 2, float((high - low).max() / 2)
    if not radius > 0:
        raise InputError("the scene has no size: all vertices coincide")
    starts = np.cumsum([0] + [len(mesh.vertices) for mesh in meshes])
    vertices = (vertices - centre) / radius
    sets = max([1, *(mesh.uv.shape[1] // 2 for mesh in meshes if mesh.uv is not None)])
    coloured = any(mesh.colours is not None for mesh in meshes)
    coordinates = [
        _surface_coordinates(mesh, vertices[start : start + len(mesh.vertices)], sets, coloured)
        for mesh, start in zip(meshes, starts, strict=False)
    ]
    return Surfaces(
        vertices=vertices,
        normals=np.concatenate([mesh.normals for mesh in meshes]),
        faces=np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]),
        uv=np.concatenate(coordinates),
        mesh_of_vertex=np.repeat(np.arange(len(meshes)), np.diff(starts)),
        two_sided=np.array([mesh.two_sided for mesh in meshes]),
        uv_tangents=np.array([mesh.uv_tangents for mesh in meshes]),
        pure_normals=np.array([mesh.pure_normals for mesh in meshes]),
        centre=centre,
        radius=radius,
    )
