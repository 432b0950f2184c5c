"""Triangle meshes: read from files, repaired where that is safe, moved and scaled."""

import contextlib
import dataclasses
import logging
import pathlib
import warnings
from collections.abc import Iterator

import numpy as np
from jaxtyping import ArrayLike, Float, Int

from jaxrelight.errors import InputError
from jaxrelight.geometry.mesh_files import READERS
from jaxrelight.geometry.repair import LARGEST_COORDINATE, area_vectors, repaired, unit

_UNREAD = "string or file could not be read to its end"  # numpy warns so, then returns what it had


@dataclasses.dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with one normal per vertex.

    Attributes:
        vertices: positions in metres, float64.
        faces: vertex numbers, counter-clockwise seen from the front.
        normals: unit shading normals.
        notes: one line for each repair made while reading, and for each doubt left.
    """

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "v 3"]
    notes: tuple[str, ...] = ()


def load_mesh(path: str | pathlib.Path) -> Mesh:
    """Reads a PLY, OBJ or STL file and repairs what can be repaired without guessing.

    Identical vertices (equal position, and equal texture coordinate and normal where the file has them) become one.
    Normals are the file's, else the mean of the adjacent faces' weighted by their angles. Faces without area, with
    vertices that are missing or not finite, and repeated faces are dropped; winding is made consistent along shared
    edges. Every such change is one line of `notes`. A face and the same face seen from behind are a two-sided sheet,
    not a repetition.

    Raises:
        InputError: the file is missing, cut short, malformed, or more than half of its faces are unusable.
    """
    path = pathlib.Path(path)
    read = READERS.get(path.suffix.lower())
    if read is None:
        raise InputError(_line(f"{path}: unknown mesh format '{path.suffix}'; use .ply, .obj or .stl"))
    try:
        data = path.read_bytes()
    except (OSError, ValueError) as fault:
        reason = getattr(fault, "strerror", None) or fault
        raise InputError(_line(f"{path}: cannot be read ({reason}); check the path")) from None
    try:
        with _quiet():
            return Mesh(*repaired(read(data)))
    except InputError as fault:
        raise InputError(_line(f"{path}: {fault}")) from None
    except Exception as fault:  # whatever a parser trips over is a fault of the file
        name = path.suffix[1:].upper()
        reason = _line(f"{fault}")[:160] or type(fault).__name__
        if _UNREAD in reason:
            reason = "something else where a number belongs"
        raise InputError(_line(f"{path}: damaged or no {name} file ({reason}); export it again")) from fault


def bounds(mesh: Mesh) -> Float[np.ndarray, "2 3"]:
    """Lowest and highest corner of the axis-aligned box around a mesh."""
    return np.stack([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)])


def face_normals(mesh: Mesh) -> Float[np.ndarray, "f 3"]:
    """Unit normals towards the side from which faces are counter-clockwise; +y for a face without area."""
    return unit(area_vectors(mesh.vertices[mesh.faces]), np.array([0.0, 1.0, 0.0]))


def normalized(mesh: Mesh, size: float) -> Mesh:
    """The mesh with its longest side `size` metres long, standing on y = 0, centred in x and z.

    Raises:
        InputError: `size` is not a positive number, or the mesh is a single point.
    """
    if not (isinstance(size, int | float) and 0 < size < LARGEST_COORDINATE):
        raise InputError(f"normalize is {size!r}; give the longest side as a positive number of metres")
    low, high = bounds(mesh)
    longest = (high - low).max()
    if not longest > 0:
        raise InputError("a mesh without extent cannot be normalized; leave `normalize` out")
    origin = np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2])
    return dataclasses.replace(mesh, vertices=(mesh.vertices - origin) * (size / longest))


def transformed(mesh: Mesh, matrix: ArrayLike) -> Mesh:
    """The mesh moved by an affine 4×4 matrix that acts on column vectors.

    Normals turn by the inverse transpose. A mirroring matrix reverses the winding, so that the front stays the front.

    Raises:
        InputError: the matrix is not 4×4, not finite, not affine or not invertible, or moves vertices out of range.
    """
    try:
        whole = np.asarray(matrix, float)
    except (TypeError, ValueError):
        whole = np.zeros(0)
    if whole.shape != (4, 4) or not np.isfinite(whole).all():
        raise InputError("transform must be four rows of four finite numbers")
    if not np.allclose(whole[3], [0, 0, 0, 1], rtol=0, atol=1e-9):
        raise InputError("the last row of transform must be 0, 0, 0, 1; write the matrix row by row")
    linear, largest = whole[:3, :3], np.abs(whole[:3, :3]).max()
    if not largest > 0 or np.linalg.cond(linear / largest) > 1e12:
        raise InputError("transform is singular, it flattens the mesh; give three independent axes")
    with np.errstate(over="ignore", invalid="ignore"):
        vertices = mesh.vertices @ linear.T + whole[:3, 3]
    if not (np.abs(vertices) <= LARGEST_COORDINATE).all():
        raise InputError(f"transform moves vertices beyond {LARGEST_COORDINATE:g} metres; scale it down")
    normals = unit(mesh.normals @ np.linalg.inv(linear / largest), np.array([0.0, 1.0, 0.0]))
    mirrors = np.linalg.det(linear / largest) < 0
    faces = np.ascontiguousarray(mesh.faces[:, ::-1]) if mirrors else mesh.faces
    return dataclasses.replace(mesh, vertices=vertices, faces=faces, normals=normals)


def _line(text: str) -> str:
    return " ".join(text.split())


@contextlib.contextmanager
def _quiet() -> Iterator[None]:
    """Silences trimesh and numpy, except for numpy's word that it stopped reading numbers half-way."""
    logger = logging.getLogger("trimesh")
    level = logger.level
    logger.setLevel(logging.CRITICAL + 1)
    try:
        with warnings.catch_warnings(), np.errstate(all="ignore"):
            warnings.simplefilter("ignore")
            warnings.filterwarnings("error", message=_UNREAD)
            yield
    finally:
        logger.setLevel(level)
