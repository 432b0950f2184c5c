"""All meshes of a scene as one set of triangles, moved to the scene's centre and scaled."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float, Int

from jaxrelight.errors import InputError
from jaxrelight.geometry.mesh import Mesh


@dataclasses.dataclass(frozen=True)
class Surfaces:
    """Triangles in scene space: world coordinates less `centre`, divided by `radius`, so that all fit in [−1, 1]³.

    Attributes:
        vertices: positions in scene space, float64.
        normals: unit shading normals.
        faces: vertex numbers, counter-clockwise seen from the front.
        mesh_of_vertex: which mesh each vertex belongs to.
        centre: world position of the scene's centre.
        radius: half of the bounding box's longest side, in world units.
    """

    vertices: Float[np.ndarray, "v 3"]
    normals: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    mesh_of_vertex: Int[np.ndarray, " v"]
    centre: Float[np.ndarray, "3"]
    radius: float

    def to_scene(self, world: Float[np.ndarray, "... 3"]) -> Float[np.ndarray, "... 3"]:
        """Positions in scene space of world positions."""
        return (np.asarray(world, float) - self.centre) / self.radius

    def face_normals(self, faces: Int[np.ndarray, " p"]) -> Float[np.ndarray, "p 3"]:
        """Unit geometric normals of some faces; the zero vector for one that rounding left without area."""
        corners = self.vertices[self.faces[faces]]
        normal = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        length = np.linalg.norm(normal, axis=-1, keepdims=True)
        return normal / np.where(length > 0, length, 1)


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
    return Surfaces(
        vertices=(vertices - centre) / radius,
        normals=np.concatenate([mesh.normals for mesh in meshes]),
        faces=np.concatenate([mesh.faces + start for mesh, start in zip(meshes, starts, strict=False)]),
        mesh_of_vertex=np.repeat(np.arange(len(meshes)), np.diff(starts)),
        centre=centre,
        radius=radius,
    )
