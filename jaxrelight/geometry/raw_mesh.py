"""The content of a mesh file, before repair."""

import dataclasses

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxrelight.geometry.file_lights import Surroundings
from jaxrelight.geometry.file_materials import FileMaterial


@dataclasses.dataclass
class FilePart:
    """Faces of one material: its name, and what the file says about it, if anything."""

    name: str
    material: FileMaterial | None = None


@dataclasses.dataclass
class RawMesh:
    """The content of a mesh file.

    Attributes:
        vertices: positions, as written.
        faces: triangles, possibly with vertex numbers out of range.
        normals: the file's normals, as written.
        stated: which vertices have a normal in the file.
        uv: texture coordinates, v upwards, two columns for each set; NaN where the file has none.
        part: of each vertex; vertices of different parts stay apart.
        parts: what they are.
        smoothing: of each face, see `smooth_normals`; None where the file says nothing.
        lost: faces already given up, counted by reason.
        notes: what the reader had to guess.
        material_notes: what it had to guess of materials.
        colours: of vertices, linear, 0 … 1; NaN at vertices that have none, and None where the file has none. They
            multiply the diffuse colour of the part's `FileMaterial`, or stand for it where the part has no material.
        surroundings: the lights and cameras of the file.
    """

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "v 3"]
    stated: Bool[np.ndarray, " v"]
    uv: Float[np.ndarray, "v u"]
    part: Int[np.ndarray, " v"]
    parts: list[FilePart]
    lost: dict[str, int] = dataclasses.field(default_factory=dict)
    notes: list[str] = dataclasses.field(default_factory=list)
    material_notes: list[str] = dataclasses.field(default_factory=list)
    colours: Float[np.ndarray, "v 3"] | None = None
    smoothing: Int[np.ndarray, " f"] | None = None
    surroundings: Surroundings = dataclasses.field(default_factory=Surroundings)
