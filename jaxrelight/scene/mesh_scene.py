"""A scene around a mesh file that comes alone: a floor, a camera, a sky, and the file's own materials."""

import dataclasses
import pathlib

import numpy as np

from jaxrelight.brdf import lobes
from jaxrelight.geometry import mesh as meshes
from jaxrelight.geometry import primitives
from jaxrelight.geometry.mesh_files import READERS
from jaxrelight.lights.local import point
from jaxrelight.scene.demo_scene import evening_sky
from jaxrelight.scene.framing import framing, lamp_for
from jaxrelight.scene.mesh_placement import UpAxis, turned_up, up_matrix
from jaxrelight.scene.scene import Part, Scene
from jaxrelight.scene.scene_file import file_parts, load_scene
from jaxrelight.scene.surroundings import file_camera, file_lights

# A few backs are seen through small holes; more are walls that face inwards, or cards.
_MAX_BACKFACE_SHARE = 0.02
_FLOOR, _FLOOR_QUADS = 5.0, 96
# The floor lies so much lower below a mesh that has faces on y = 0: at one place, either would be seen.
_BELOW = 1e-3


def open_scene(path: str | pathlib.Path, *, zero_nonfinite: bool = False, up: UpAxis = "y") -> Scene:
    """A scene file; or a mesh file by itself, see `scene_of_mesh`.

    Args:
        path: of the file.
        zero_nonfinite: as for `load_scene`.
        up: the upward axis of mesh files, where a scene file does not say.

    Raises:
        InputError: as `load_scene` and `load_mesh` do.
    """
    path = pathlib.Path(path)
    if path.suffix.lower() in READERS:
        return scene_of_mesh(path, up=up)
    return load_scene(path, zero_nonfinite=zero_nonfinite, up=up)


def scene_of_mesh(path: str | pathlib.Path, *, up: UpAxis = "y") -> Scene:
    """A mesh file on a floor under an evening sky, seen whole; or seen from inside, where its walls face inwards.

    It is scaled to a longest side of one metre and stands on y = 0. It has its own materials, or a warm plaster where
    the file says nothing. A camera of the file is taken instead of one that frames it, and lights of the file are added
    to the sky. All that was assumed stands in the scene's notes.

    Args:
        path: of the file.
        up: its upward axis, "y" or "z".

    Raises:
        InputError: as `load_mesh` does.
    """
    path = pathlib.Path(path)
    file = meshes.load_file(path)
    read = turned_up(file.parts, up)
    frame = meshes.joint_bounds([part.mesh for part in read])
    scaled = [dataclasses.replace(part, mesh=meshes.normalized(part.mesh, 1.0, frame)) for part in read]
    plain = {part.name: "plaster" for part in scaled if part.material is None}
    parts, materials, notes = file_parts(path.name, scaled, plain)
    materials |= {"floor": lobes.lambert([0.46, 0.45, 0.43]), "plaster": lobes.lambert([0.70, 0.62, 0.52])}
    around = file.surroundings.moved(meshes.normalizing_matrix(1.0, frame) @ up_matrix(up))
    of_file, seen_by = file_camera([(path.name, around)], meshes.joint_bounds([part.mesh for part in scaled]))
    seen = framing([part.mesh for part in parts])
    if seen.backs > _MAX_BACKFACE_SHARE:
        parts = [dataclasses.replace(part, mesh=meshes.with_back(part.mesh)) for part in parts]
        notes.append(f"{path.name}: {seen.backs:.0%} of what is seen are backs of faces; taken as two-sided")
    camera = of_file or seen.camera
    # A floor would hide everything from an eye below it.
    floor = np.asarray(camera.origin)[1] > 0
    if floor:
        parts.append(Part(_floor([part.mesh for part in scaled]), "floor", "floor"))
    put = " and put on a floor" if floor else ""
    lights, lines = file_lights(path.name, around.lights, wanted=True)
    lit = "under a built-in sky"
    if seen.inside and not lights:
        lit += " and a lamp near the ceiling"
        lights.append(point(*lamp_for(seen, [part.mesh for part in scaled])))
    where = "" if of_file else "seen from the front (+z) by a camera that frames it, "
    if seen.inside and not of_file:
        where = "seen from inside, as its walls face inwards, "
    assumed = [
        f"{path.name}: scaled to a longest side of 1 m{put}, {where}{lit}; --up z, --env, --origin, --target "
        "and a scene file give others",
        *seen_by,
        *lines,
    ]
    if plain:
        assumed.append(f"{path.name}: nothing is said about the material of {', '.join(plain)}; plaster is taken")
    lines = *assumed, *notes
    return Scene(tuple(parts), materials, camera, [evening_sky(), *lights], path.stem, assumptions=lines)


def _floor(standing: list[meshes.Mesh]) -> meshes.Mesh:
    """The floor under meshes that stand on y = 0."""
    plane = primitives.plane((_FLOOR, _FLOOR), _FLOOR_QUADS)
    flat = any((mesh.vertices[mesh.faces, 1] < _BELOW).all(axis=1).any() for mesh in standing)
    down = np.eye(4)
    down[1, 3] = -_BELOW
    return meshes.transformed(plane, down) if flat else plane
