"""Where a mesh of a scene file stands: its upward axis, its size, and how it is scaled, turned and moved."""

import dataclasses
from collections.abc import Sequence
from typing import Literal

import numpy as np
from jaxtyping import Float

from jaxrelight.errors import InputError
from jaxrelight.files.toml_table import Table
from jaxrelight.geometry import mesh as meshes

UpAxis = Literal["y", "z"]

# A quarter turn about x: what pointed to +z points to +y, and what pointed to −y to +z.
_Z_TO_Y = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])


def turned_up(parts: Sequence[meshes.MeshPart], up: UpAxis) -> list[meshes.MeshPart]:
    """The parts of a file whose upward axis is +y or +z, with +y upwards."""
    if up == "y":
        return list(parts)
    return [dataclasses.replace(part, mesh=meshes.transformed(part.mesh, _Z_TO_Y)) for part in parts]


def up_matrix(up: UpAxis) -> Float[np.ndarray, "4 4"]:
    """What turns a file whose upward axis is +y or +z so that +y is upwards."""
    return _Z_TO_Y if up == "z" else np.eye(4)


def placed(
    table: Table, parts: Sequence[meshes.MeshPart], up: UpAxis = "y"
) -> tuple[list[meshes.MeshPart], Float[np.ndarray, "4 4"]]:
    """All parts of one [[mesh]] turned upright, normalized, and transformed, together, and the matrix of all that.

    Args:
        table: of the [[mesh]].
        parts: as they are read.
        up: the upward axis of a file whose table does not say.

    Raises:
        InputError: for `transform` beside other keys that move the mesh, or values out of range.
    """
    if table.has("file") and table.has("up"):
        axis = table.text("up")
        if axis not in ("y", "z"):
            raise InputError(f'{table.where}: \'up\' is "y" or "z", not {axis!r}')
        up = "z" if axis == "z" else "y"
    up = up if table.has("file") else "y"
    parts, whole = turned_up(parts, up), up_matrix(up)
    size = table.number("normalize") if table.has("normalize") else None
    matrix = _matrix(table)
    frame = meshes.joint_bounds([part.mesh for part in parts])
    moved = []
    for part in parts:
        mesh = part.mesh if size is None else meshes.normalized(part.mesh, size, frame)
        mesh = mesh if matrix is None else meshes.transformed(mesh, matrix)
        moved.append(dataclasses.replace(part, mesh=mesh))
    whole = whole if size is None else meshes.normalizing_matrix(size, frame) @ whole
    return moved, whole if matrix is None else matrix @ whole


def _matrix(table: Table) -> Float[np.ndarray, "4 4"] | None:
    """`transform`; or what scales first, turns then and moves last; None without any of them."""
    steps = [key for key in ("scale", "rotate", "translate") if table.has(key)]
    if table.has("transform"):
        if steps:
            raise InputError(f"{table.where}: give either 'transform' or '{steps[0]}'; both would move the mesh")
        return table.array("transform", (4, 4))
    if not steps:
        return None
    scale = np.broadcast_to(table.channels("scale", 1.0), 3)
    if not (scale != 0).all():
        raise InputError(f"{table.where}: 'scale' is {table.get('scale')!r}, which flattens the mesh")
    matrix = np.eye(4)
    matrix[:3, :3] = _rotation(table) * scale
    matrix[:3, 3] = table.array("translate", (3,), (0, 0, 0))
    return matrix


def _rotation(table: Table) -> Float[np.ndarray, "3 3"]:
    """Of `rotate`: degrees about x, then y, then z; or an axis and degrees about it, counter-clockwise from its end."""
    numbers = table.numbers("rotate", [(3,), (4,)], (0, 0, 0))
    if len(numbers) == 3:
        about_x, about_y, about_z = (_about(axis, angle) for axis, angle in zip(np.eye(3), numbers, strict=True))
        return about_z @ about_y @ about_x
    length = np.linalg.norm(numbers[:3])
    if not length > 0:
        raise InputError(f"{table.where}: 'rotate' has an axis of length 0; write it as [x, y, z, degrees]")
    return _about(numbers[:3] / length, numbers[3])


def _about(axis: Float[np.ndarray, "3"], degrees: float) -> Float[np.ndarray, "3 3"]:
    """The rotation about a unit axis (Rodrigues)."""
    x, y, z = axis
    cross, angle = np.array([[0, -z, y], [z, 0, -x], [-y, x, 0]]), np.radians(degrees)
    return np.eye(3) + np.sin(angle) * cross + (1 - np.cos(angle)) * cross @ cross
