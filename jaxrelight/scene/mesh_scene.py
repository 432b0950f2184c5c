"""A scene around a mesh file that comes alone: a floor, a camera, a sky, and the file's own materials."""

import dataclasses
import pathlib

import numpy as np

from jaxrelight.brdf import lobes
from jaxrelight.geometry import mesh as meshes
from jaxrelight.geometry import primitives
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.mesh_files import READERS
from jaxrelight.geometry.surfaces import join
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.scene.demo_scene import evening_sky
from jaxrelight.scene.scene import Part, Scene
from jaxrelight.scene.scene_file import file_parts, load_scene

# Camera and floor for a mesh whose longest side is 1; the eye looks from the front, a little from the right and above.
_EYE = np.array([0.42, 0.38, 1.0])
_FOV_Y = 34.0
_MARGIN = 1.15
# A few backs are seen through small holes; more are walls that face inwards, or cards.
_MAX_BACKFACE_SHARE = 0.02
_FLOOR, _FLOOR_QUADS = 5.0, 96


def open_scene(path: str | pathlib.Path, *, zero_nonfinite: bool = False) -> Scene:
    """A scene file; or a mesh file by itself, see `scene_of_mesh`.

    Raises:
        InputError: as `load_scene` and `load_mesh` do.
    """
    path = pathlib.Path(path)
    return scene_of_mesh(path) if path.suffix.lower() in READERS else load_scene(path, zero_nonfinite=zero_nonfinite)


def scene_of_mesh(path: str | pathlib.Path) -> Scene:
    """A mesh file on a floor under an evening sky, seen whole.

    It is scaled to a longest side of one metre and stands on y = 0. It has its own materials, or a warm plaster where
    the file says nothing. All that was assumed stands in the scene's notes.

    Raises:
        InputError: as `load_mesh` does.
    """
    path = pathlib.Path(path)
    read = meshes.load_parts(path)
    frame = meshes.joint_bounds([part.mesh for part in read])
    scaled = [dataclasses.replace(part, mesh=meshes.normalized(part.mesh, 1.0, frame)) for part in read]
    plain = {part.name: "plaster" for part in scaled if part.material is None}
    parts, materials, notes = file_parts(path.name, scaled, plain)
    materials |= {"floor": lobes.lambert([0.46, 0.45, 0.43]), "plaster": lobes.lambert([0.70, 0.62, 0.52])}
    camera = _framing(np.concatenate([part.mesh.vertices for part in scaled]))
    behind = _seen_from_behind([part.mesh for part in parts], camera)
    if behind > _MAX_BACKFACE_SHARE:
        parts = [dataclasses.replace(part, mesh=meshes.with_back(part.mesh)) for part in parts]
        notes.append(f"{path.name}: {behind:.0%} of what is seen are backs of faces; taken as two-sided")
    parts.append(Part(primitives.plane((_FLOOR, _FLOOR), _FLOOR_QUADS), "floor", "floor"))
    assumed = [
        f"{path.name}: scaled to a longest side of 1 m and put on a floor, seen from the front (+z) by a camera "
        "that frames it, under a built-in sky; --env, --origin, --target and a scene file give others"
    ]
    if plain:
        assumed.append(f"{path.name}: nothing is said about the material of {', '.join(plain)}; plaster is taken")
    return Scene(tuple(parts), materials, camera, evening_sky(), path.stem, assumptions=(*assumed, *notes))


def _seen_from_behind(seen: list[meshes.Mesh], camera: Camera) -> float:
    """The share of what a camera sees that are backs of faces."""
    surfaces = join(seen)
    rays = dataclasses.replace(camera, width=96, height=96).directions().reshape(-1, 3)
    face, _ = Tracer(surfaces).first_hits(np.broadcast_to(surfaces.to_scene(np.array(camera.origin)), rays.shape), rays)
    hit = face >= 0
    back = np.sum(surfaces.face_normals(face[hit]) * rays[hit], axis=1) > 0
    return float(back.mean()) if hit.any() else 0.0


def _framing(vertices: np.ndarray) -> Camera:
    """A camera that sees all vertices, with a margin."""
    low, high = vertices.min(axis=0), vertices.max(axis=0)
    target = (low + high) / 2
    towards = _EYE / np.linalg.norm(_EYE)
    right = np.cross([0.0, 1.0, 0.0], towards)
    right /= np.linalg.norm(right)
    up = np.cross(towards, right)
    offset = vertices - target
    across = np.maximum(np.abs(offset @ right), np.abs(offset @ up)) * _MARGIN
    # A point is inside where its distance from the axis is at most tan(fov/2) times its depth.
    distance = (across / np.tan(np.radians(_FOV_Y / 2)) + offset @ towards).max()
    return Camera(tuple(target + distance * towards), tuple(target), fov_y=_FOV_Y)
