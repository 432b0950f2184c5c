"""Triangle meshes: read from files, repaired where that is safe, moved and scaled."""

import contextlib
import dataclasses
import logging
import pathlib
import warnings
from collections.abc import Iterator, Sequence

import numpy as np
from jaxtyping import ArrayLike, Float, Int

from jaxrelight.errors import InputError
from jaxrelight.geometry.file_lights import Surroundings
from jaxrelight.geometry.file_materials import FileMaterial
from jaxrelight.geometry.mesh_files import READERS
from jaxrelight.geometry.raw_mesh import RawMesh
from jaxrelight.geometry.repair import FACES_INWARD, MAX_COORDINATE, Repaired, repaired
from jaxrelight.geometry.triangles import area_vectors, unit

_UNREAD = "string or file could not be read to its end"  # numpy warns so, then returns what it had
_FARTHEST_UV = 1e6  # beyond, float32 does not tell texels apart


@dataclasses.dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles with one normal per vertex.

    Attributes:
        vertices: positions in metres, float64.
        faces: vertex numbers, counter-clockwise seen from the front.
        normals: unit shading normals.
        notes: one line for each repair made while reading, and for each doubt left.
        uv: texture coordinates, u rightwards and v upwards, two columns for each set; None where there are none.
        two_sided: whether the back is a surface like the front; else it is black.
        uv_tangents: whether tangent frames follow u of the first set instead of Wang 2006 §3.3.2.
        pure_normals: whether shading normals are taken as they are. Else those that face away from the eye are turned
            to it, and rays start on the smooth surface that the normals stand for, see `ray_origins`.
        colours: linear colours of the vertices, 0 … 1, which `VertexColours` in a material reads; None for none.
    """

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "v 3"]
    notes: tuple[str, ...] = ()
    uv: Float[np.ndarray, "v u"] | None = None
    two_sided: bool = False
    uv_tangents: bool = False
    pure_normals: bool = False
    colours: Float[np.ndarray, "v 3"] | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class MeshPart:
    """The faces of one material of a mesh file.

    Attributes:
        mesh: those faces.
        name: the material's.
        material: what the file says of it, if anything.
        uv_sets: numbers of the sets of texture coordinates that the file has for them.
    """

    mesh: Mesh
    name: str
    material: FileMaterial | None
    uv_sets: tuple[int, ...] = ()


def load_mesh(path: str | pathlib.Path, crease_angle: float | None = None) -> Mesh:
    """Reads a PLY, OBJ, STL, GLB or glTF file as one mesh and repairs what can be repaired without guessing.

    Identical vertices (equal position, and equal texture coordinates, colour and normal where the file has them) become
    one. Normals are the file's, else the mean of the adjacent faces' weighted by their angles; sharp edges have one for
    each side: those that a file's smoothing groups or its format say, else those between faces whose normals differ by
    more than the crease angle. Faces without area, with vertices that are missing or not finite, and repeated faces are
    dropped; winding is made consistent along shared edges, and with the file's normals. Every such change is one line
    of `notes`. A face and the same face seen from behind are a sheet with two sides, not a repetition. What the file
    says of materials does not count, and neither do the colours of its vertices.

    Args:
        path: of the file.
        crease_angle: in degrees, 0 … 180, where the file has no normals; it takes the place of what the file says of
            smoothing. By default the file's word holds, and 40 degrees where it says nothing.

    Raises:
        InputError: the file is missing, cut short, malformed, or more than half of its faces are unusable; or the
            crease angle is out of range.
    """
    return load_file(path, crease_angle).mesh


def load_parts(path: str | pathlib.Path, crease_angle: float | None = None) -> list[MeshPart]:
    """Reads a file as `load_mesh` does, as a mesh for each of its materials; the first one has the file's notes.

    Raises:
        InputError: as `load_mesh` does.
    """
    return load_file(path, crease_angle).parts


@dataclasses.dataclass(frozen=True, eq=False)
class MeshFile:
    """What a mesh file holds, as `load_mesh` and `load_parts` give it, and the lights and cameras in it."""

    raw: RawMesh
    repaired: Repaired

    @property
    def mesh(self) -> Mesh:
        """All of it as one mesh."""
        return _whole(self.raw, self.repaired)

    @property
    def parts(self) -> list[MeshPart]:
        """A mesh for each of its materials."""
        return _parts(self.raw, self.repaired)

    @property
    def surroundings(self) -> Surroundings:
        """Its lights and cameras."""
        return self.raw.surroundings


def load_file(path: str | pathlib.Path, crease_angle: float | None = None) -> MeshFile:
    """Reads a mesh file.

    Raises:
        InputError: as `load_mesh` does.
    """
    return MeshFile(*_load(path, crease_angle))


def _whole(raw: RawMesh, good: Repaired) -> Mesh:
    part = raw.part[good.source]
    uv, _, _ = _coordinates(raw.uv[good.source])
    notes = [note for number in np.unique(part) for note in _coordinates(raw.uv[good.source[part == number]])[2]]
    return Mesh(good.vertices, good.faces, good.normals, (*good.notes, *notes), uv)


def _parts(raw: RawMesh, good: Repaired) -> list[MeshPart]:
    part_of_vertex = raw.part[good.source]
    part_of_face = part_of_vertex[good.faces[:, 0]]
    parts = []
    for number, part in enumerate(raw.parts):
        part_vertices = np.flatnonzero(part_of_vertex == number)
        if not len(part_vertices):
            continue
        place = np.zeros(len(part_of_vertex), np.int64)
        place[part_vertices] = np.arange(len(part_vertices))
        uv, uv_sets, doubts = _coordinates(raw.uv[good.source[part_vertices]])
        colours, clamped = _colours(raw, good.source[part_vertices])
        notes = [
            *((*good.notes, *raw.material_notes) if not parts else ()),
            *(f"{part.name}: {doubt}" for doubt in (*doubts, *clamped)),
        ]
        mesh = Mesh(
            good.vertices[part_vertices],
            place[good.faces[part_of_face == number]],
            good.normals[part_vertices],
            tuple(notes),
            uv,
            colours=colours,
        )
        # Vertex colours alone are the colours of the surface.
        material = FileMaterial((1.0, 1.0, 1.0)) if part.material is None and colours is not None else part.material
        two_sided = material is not None and material.two_sided
        parts.append(MeshPart(with_back(mesh) if two_sided else mesh, part.name, material, uv_sets))
    return parts


def _load(path: str | pathlib.Path, crease_angle: float | None) -> tuple[RawMesh, Repaired]:
    path = pathlib.Path(path)
    if crease_angle is not None and not 0 <= crease_angle <= 180:
        raise InputError(f"crease_angle is {crease_angle:g}; give degrees from 0 (flat faces) to 180 (all smooth)")
    read = READERS.get(path.suffix.lower())
    if read is None:
        known = f"{', '.join(list(READERS)[:-1])} or {list(READERS)[-1]}"
        raise InputError(_line(f"{path}: unknown mesh format '{path.suffix}'; use {known}"))
    try:
        if path.exists() and not path.is_file():  # reading a pipe or a device could wait or go on for ever
            raise OSError("it is not a regular file")
        data = path.read_bytes()
    except (OSError, ValueError) as fault:
        reason = getattr(fault, "strerror", None) or fault
        raise InputError(_line(f"{path}: cannot be read ({reason}); check the path")) from None
    try:
        with _quiet():
            raw = read(data, path.parent)
            return raw, repaired(raw, crease_angle)
    except InputError as fault:
        raise InputError(_line(f"{path}: {fault}")) from None
    except MemoryError as fault:
        raise InputError(_line(f"{path}: is larger than the free memory; simplify the mesh")) from fault
    except Exception as fault:  # whatever a parser trips over is a fault of the file
        name = path.suffix[1:].upper()
        reason = _line(f"{fault}")[:160] or type(fault).__name__
        if _UNREAD in reason:
            reason = "something else where a number belongs"
        raise InputError(_line(f"{path}: damaged or no {name} file ({reason}); export it again")) from fault


def _coordinates(uv: Float[np.ndarray, "v u"]) -> tuple[Float[np.ndarray, "v w"] | None, tuple[int, ...], list[str]]:
    """Texture coordinates without gaps, the numbers of the sets that are there, and where one has gaps.

    Sets after the last one that is there are left out; there may be none.
    """
    sets = uv.reshape(len(uv), -1, 2)
    missing = ~np.less_equal(np.abs(sets).max(axis=2), _FARTHEST_UV)  # true for NaN
    there = np.flatnonzero(~missing.all(axis=0))
    if not len(there):
        return None, (), []
    gaps, total = np.count_nonzero(missing, axis=0), f"of {len(uv):,} vertices; (0, 0) is taken"
    notes = [f"texture coordinates are missing at {gaps[number]:,} {total}" for number in there if gaps[number]]
    filled = np.where(missing[:, :, None], 0, sets)[:, : there[-1] + 1]
    return filled.reshape(len(uv), -1), tuple(there.tolist()), notes


def _colours(raw: RawMesh, source: Int[np.ndarray, " v"]) -> tuple[Float[np.ndarray, "v 3"] | None, list[str]]:
    """The colours of some of a file's vertices, from 0 to 1; white where a vertex has none. None where none has any."""
    if raw.colours is None:
        return None, []
    colours = raw.colours[source]
    usable = np.asarray(np.isfinite(colours).all(axis=1))
    if not usable.any():
        return None, []
    colours = np.where(usable[:, None], colours, 1.0)
    outside = ((colours < 0) | (colours > 1)).any(axis=1)
    notes = [f"colours of {outside.sum():,} vertices are clamped to 0 … 1"] if outside.any() else []
    return np.clip(colours, 0.0, 1.0), notes


def bounds(mesh: Mesh) -> Float[np.ndarray, "2 3"]:
    """Lowest and highest corner of the axis-aligned box around a mesh."""
    return np.stack([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)])


def face_normals(mesh: Mesh) -> Float[np.ndarray, "f 3"]:
    """Unit normals towards the side from which faces are counter-clockwise; +y for a face without area."""
    return unit(area_vectors(mesh.vertices[mesh.faces]), np.array([0.0, 1.0, 0.0]))


def with_back(mesh: Mesh) -> Mesh:
    """The mesh as a two-sided one, of which it does not matter whether it faces inward."""
    return dataclasses.replace(mesh, two_sided=True, notes=tuple(n for n in mesh.notes if n != FACES_INWARD))


def joint_bounds(meshes: Sequence[Mesh]) -> Float[np.ndarray, "2 3"]:
    """Lowest and highest corner of the box around several meshes."""
    corners = np.concatenate([bounds(mesh) for mesh in meshes])
    return np.stack([corners.min(axis=0), corners.max(axis=0)])


def normalized(mesh: Mesh, size: float, frame: Float[np.ndarray, "2 3"] | None = None) -> Mesh:
    """The mesh with its longest side `size` metres long, standing on y = 0, centred in x and z.

    Args:
        mesh: what to move and scale.
        size: in metres.
        frame: the box whose longest side it is that counts; by default the mesh's own.

    Raises:
        InputError: `size` is not a positive number, or the mesh is a single point.
    """
    origin, scale = _normalizing(size, bounds(mesh) if frame is None else frame)
    return dataclasses.replace(mesh, vertices=(mesh.vertices - origin) * scale)


def normalizing_matrix(size: float, frame: Float[np.ndarray, "2 3"]) -> Float[np.ndarray, "4 4"]:
    """What `normalized` does to positions.

    Raises:
        InputError: as `normalized` does.
    """
    origin, scale = _normalizing(size, frame)
    matrix = np.diag([scale, scale, scale, 1.0])
    matrix[:3, 3] = -scale * origin
    return matrix


def _normalizing(size: float, frame: Float[np.ndarray, "2 3"]) -> tuple[Float[np.ndarray, "3"], float]:
    """What is subtracted from positions, and what they are multiplied by then."""
    if not (isinstance(size, int | float) and 0 < size < MAX_COORDINATE):
        raise InputError(f"normalize is {size!r}; give the longest side as a positive number of metres")
    low, high = frame
    longest = (high - low).max()
    if not longest > 0:
        raise InputError("a mesh without extent cannot be normalized; leave `normalize` out")
    return np.array([(low[0] + high[0]) / 2, low[1], (low[2] + high[2]) / 2]), float(size / longest)


def transformed(mesh: Mesh, matrix: ArrayLike) -> Mesh:
    """The mesh moved by an affine 4×4 matrix that acts on column vectors.

    Normals turn by the inverse transpose. A mirroring matrix reverses the winding, so that the front stays the front.

    Raises:
        InputError: the matrix is not 4×4, not finite, not affine or not invertible, or moves vertices out of range.
    """
    try:
        transform = np.asarray(matrix, float)
    except (TypeError, ValueError):
        transform = np.zeros(0)
    if transform.shape != (4, 4) or not np.isfinite(transform).all():
        raise InputError("transform must be four rows of four finite numbers")
    if not np.allclose(transform[3], [0, 0, 0, 1], rtol=0, atol=1e-9):
        raise InputError("the last row of transform must be 0, 0, 0, 1; write the matrix row by row")
    linear, largest = transform[:3, :3], np.abs(transform[:3, :3]).max()
    if not largest > 0 or np.linalg.cond(linear / largest) > 1e12:
        raise InputError("transform is singular, it flattens the mesh; give three independent axes")
    with np.errstate(over="ignore", invalid="ignore"):
        vertices = mesh.vertices @ linear.T + transform[:3, 3]
    if not (np.abs(vertices) <= MAX_COORDINATE).all():
        raise InputError(f"transform moves vertices beyond {MAX_COORDINATE:g} metres; scale it down")
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
