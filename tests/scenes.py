"""The scenes that tests light: a ball or a block over a floor, and a room seen from inside."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

import jaxrelight as jr
from jaxrelight import Camera, Mesh, Part, Scene
from jaxrelight.geometry.mesh import transformed

PAPER = jr.lambert([0.7, 0.6, 0.5])


def moved(mesh: Mesh, by: Sequence[float]) -> Mesh:
    """A mesh somewhere else."""
    matrix = np.eye(4)
    matrix[:3, 3] = by
    return transformed(mesh, matrix)


def raised(mesh: Mesh, by: float) -> Mesh:
    """A mesh at another height."""
    return moved(mesh, (0, by, 0))


def inside_out(mesh: Mesh) -> Mesh:
    """A mesh whose front is its inside."""
    return dataclasses.replace(mesh, faces=mesh.faces[:, ::-1], normals=-mesh.normals)


def room(wall: Any, camera: Camera, quads: int = 2, more: Sequence[Part] = (), **materials: Any) -> Scene:
    """A box of edges of 1 m, seen from inside."""
    parts = [Part(inside_out(jr.box((1, 1, 1), quads)), "wall"), *more]
    return Scene(parts, {"wall": wall, **materials}, camera)


def ball_over_floor(
    gloss: Any,
    camera: Camera,
    lights: Any = None,
    *,
    paper: Any = PAPER,
    quads: tuple[int, int] = (4, 4),
    radius: float = 0.35,
    height: float = 0.4,
) -> Scene:
    """A ball of "gloss" over a floor of "paper", 2 m wide.

    Args:
        gloss: the ball's material.
        camera: of the scene.
        lights: of the scene.
        paper: the floor's material.
        quads: along an edge of the floor, and along an edge of the ball's six sides.
        radius: of the ball.
        height: of its centre.
    """
    parts = [Part(jr.plane((2, 2), quads[0]), "paper"), Part(raised(jr.sphere(radius, quads[1]), height), "gloss")]
    return Scene(parts, {"paper": paper, "gloss": gloss}, camera, lights)


def block_aside(gloss: Any, block: str = "gloss", *, ball: bool = False, quads: int = 4) -> Scene:
    """A block that stands aside on a floor of "paper", 2 m wide; nothing about it is symmetric.

    Args:
        gloss: a material.
        block: the name of the block's material, "paper" or "gloss".
        ball: whether a ball of "gloss" is beside the block.
        quads: along an edge of the floor.
    """
    parts = [Part(jr.plane((2, 2), quads), "paper"), Part(moved(jr.box((0.3, 0.6, 0.2), 2), (0.5, 0.3, 0.2)), block)]
    if ball:
        parts.insert(1, Part(raised(jr.sphere(0.35, 4), 0.4), "gloss"))
    camera = Camera((0.4, 1.2, 2.2), (0.1, 0.2, 0), fov_y=50, width=16, height=12)
    return Scene(parts, {"paper": PAPER, "gloss": gloss}, camera)
