"""Repair of triangle meshes where no guess is needed, and a count of every change."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxrelight.errors import InputError
from jaxrelight.geometry.creases import BY_ANGLE, CREASE_ANGLE, smooth_normals, split_vertices
from jaxrelight.geometry.raw_mesh import RawMesh
from jaxrelight.geometry.triangles import area_vectors, unit
from jaxrelight.geometry.winding import faces_inward, match_normals, wind_alike
from jaxrelight.numerics.unique_rows import unique_rows

MAX_COORDINATE = 1e30  # float32 ends at 3e38, and areas square what they are given
FACES_INWARD = "closed mesh faces inward: surfaces are one-sided, so it will look black"
FLAT = 1e-12  # a triangle lower than this part of its longest side is no surface
ROUNDING = 1e-15  # nor is one lower than what float64 resolves at its place


class Repaired(NamedTuple):
    """Faces that can be used, and their vertices.

    Attributes:
        vertices: positions.
        faces: vertex numbers.
        normals: of unit length.
        notes: one line for each change made or doubt left.
        source: which vertex of the file each one was.
    """

    vertices: Float[np.ndarray, "v 3"]
    faces: Int[np.ndarray, "f 3"]
    normals: Float[np.ndarray, "v 3"]
    notes: tuple[str, ...]
    source: Int[np.ndarray, " v"]


def repaired(raw: RawMesh, crease_angle: float | None = None) -> Repaired:
    """Drops unusable faces, merges identical vertices, orients faces alike and completes the normals.

    Normals that the file does not have follow from the faces, see `smooth_normals`. A vertex at a sharp edge becomes
    one for each of its normals.

    Args:
        raw: the content of a file.
        crease_angle: in degrees, between 0 and 180, instead of what the file says of smoothing; by default that holds,
            and CREASE_ANGLE where it says nothing.

    Raises:
        InputError: no face, or more than half of the faces unusable.
    """
    vertices, faces, lost = raw.vertices, raw.faces, dict(raw.lost)
    smoothing = np.full(len(faces), BY_ANGLE) if raw.smoothing is None or crease_angle is not None else raw.smoothing
    total = len(faces) + sum(lost.values())
    if total == 0:
        what = "points or lines only, no faces" if len(vertices) else "empty, no vertices and no faces"
        raise InputError(f"{what}; export a triangle mesh")

    def drop(reason: str, good: Bool[np.ndarray, " f"]) -> None:
        nonlocal faces, smoothing
        lost[reason] = lost.get(reason, 0) + int((~good).sum())
        faces, smoothing = faces[good], smoothing[good]

    drop("index out of range", ((faces >= 0) & (faces < len(vertices))).min(axis=1))
    referenced = np.unique(faces)
    sound = np.less_equal(np.abs(vertices).max(axis=1, initial=0), MAX_COORDINATE)  # false for NaN
    drop("NaN, infinite or beyond 1e30", sound[faces].min(axis=1))
    drop("zero area", _has_area(vertices[faces]))
    place = unique_rows(vertices)[1]
    drop("repeated", _first_of_kind(place[faces]))
    lost = {reason: count for reason, count in lost.items() if count}
    gone = sum(lost.values())
    if 2 * gone > total or not len(faces):
        reasons = ", ".join(f"{reason}: {count:,}" for reason, count in lost.items())
        raise InputError(f"{gone:,} of {total:,} faces are unusable ({reasons}); repair it in a mesh editor")
    notes = [*raw.notes, *(f"dropped {count:,} of {total:,} faces: {reason}" for reason, count in lost.items())]

    used = np.unique(faces)
    if len(used) < len(referenced):
        notes.append(f"dropped {len(referenced) - len(used):,} vertices that only dropped faces used")
    usable = raw.stated & np.isfinite(raw.normals).all(axis=1)
    file_normals = unit(np.where(usable[:, None], raw.normals, 0.0), np.zeros(3))  # zero where the file has none
    apart = raw.uv if raw.colours is None else np.column_stack([raw.uv, raw.colours])
    seams = np.column_stack([raw.part, np.round(np.nan_to_num(apart, nan=np.inf) * 1e6)])
    first, same = unique_rows(np.column_stack([vertices, seams, np.round(file_normals * 100)])[used])
    rank = np.argsort(first)  # vertices keep the order of the file
    number = np.empty(len(vertices), np.int64)
    number[used] = np.argsort(rank)[same]
    source = used[first[rank]]
    vertices, faces, file_normals = vertices[source], number[faces], file_normals[source]

    faces, doubts = wind_alike(vertices, faces, file_normals)
    notes += doubts
    faces, file_normals, opposed, doubts = match_normals(vertices, faces, file_normals)
    notes += doubts
    missing = np.equal(np.abs(file_normals).max(axis=1, initial=0), 0)
    if (missing & raw.stated[source]).any():
        notes.append(f"normals computed for {(missing & raw.stated[source]).sum():,} vertices: the file's are unusable")
    if faces_inward(vertices, unique_rows(vertices)[1][faces], faces):
        notes.append(FACES_INWARD)
    computed = missing[faces] | opposed[:, None]
    if not computed.any():
        if crease_angle is not None:
            notes.append("crease_angle changes nothing: the file has normals")
        return Repaired(vertices, np.ascontiguousarray(faces), file_normals, tuple(notes), source)
    angle = CREASE_ANGLE if crease_angle is None else crease_angle
    normals, edges = smooth_normals(vertices, faces, smoothing, angle)
    sharp = np.count_nonzero(computed.any(axis=1)[edges].all(axis=1))
    if sharp:
        notes.append(f"normals computed: {sharp:,} edges sharper than {angle:g} degrees are creases (crease_angle)")
    at_corners = np.where(computed[..., None], normals, file_normals[faces])
    faces, of_vertex, normals = split_vertices(faces, at_corners, computed)
    return Repaired(vertices[of_vertex], np.ascontiguousarray(faces), normals, tuple(notes), source[of_vertex])


def _has_area(corners: Float[np.ndarray, "f 3 3"]) -> Bool[np.ndarray, " f"]:
    """Whether triangles are higher than rounding of their coordinates can explain."""
    longest = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=2).max(axis=1, initial=0)
    reach = np.abs(corners).max(axis=(1, 2), initial=0)
    return np.linalg.norm(area_vectors(corners), axis=1) > longest * np.maximum(FLAT * longest, ROUNDING * reach)


def _first_of_kind(faces: Int[np.ndarray, "f 3"]) -> Bool[np.ndarray, " f"]:
    """Marks all but repetitions: the same three corners in the same turning direction."""
    turned = np.take_along_axis(faces, (faces.argmin(axis=1)[:, None] + np.arange(3)) % 3, axis=1)
    first = np.zeros(len(faces), bool)
    first[unique_rows(turned)[0]] = True
    return first
