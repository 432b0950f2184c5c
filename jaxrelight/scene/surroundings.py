"""Lights and cameras that mesh files bring, where a scene names none."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxrelight.errors import InputError
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.file_lights import FileCamera, FileLight, Surroundings
from jaxrelight.lights.local import Light, directional, point, spot


def file_lights(file: str, lights: Sequence[FileLight], *, wanted: bool) -> tuple[list[Light], list[str]]:
    """The lights of a mesh file, and what was assumed of them.

    Lux and candela count as W/m² and W/sr: pictures are radiance, whose scale is the lights'.

    Args:
        file: what notes call the file.
        lights: what it describes.
        wanted: whether they are used; where not, none is returned, and it is said.
    """
    if not lights:
        return [], []
    names = ", ".join(f"'{light.name}' ({light.kind})" for light in lights)
    if not wanted:
        return [], [f"{file}: its lights are left out, the scene has its own: {names}"]
    made, notes = [], [f"{file}: its lights are used, lux and candela as W/m² and W/sr: {names}"]
    if any(light.kind == "spot" for light in lights):
        notes.append(f"{file}: between their inner and outer cone its spots fall off linearly in the angle")
    for light in lights:
        try:
            made.append(_light(light))
        except InputError as error:
            notes.append(f"{file}: its light '{light.name}' is left out: {error}")
    return made, notes


def _light(light: FileLight) -> Light:
    if light.kind == "directional":
        return directional(light.direction, light.intensity)
    if light.kind == "point":
        return point(light.position, light.intensity)
    return spot(light.position, light.position + light.direction, light.intensity, light.outer, light.inner)


def file_camera(
    surroundings: Sequence[tuple[str, Surroundings]], frame: Float[np.ndarray, "2 3"], *, wanted: bool = True
) -> tuple[Camera | None, list[str]]:
    """The first camera of some mesh files, and what was assumed; None where none has any.

    Args:
        surroundings: of each file, by what notes call it.
        frame: lowest and highest corner of what is seen.
        wanted: whether it is used; where not, None is returned, and it is said.
    """
    cameras = [(file, camera) for file, around in surroundings for camera in around.cameras]
    if not cameras:
        return None, []
    if not wanted:
        return None, [f"{file}: its camera '{camera.name}' is left out, the scene has one" for file, camera in cameras]
    (file, camera), *others = cameras
    notes = [f"{file}: seen by its camera '{camera.name}'"]
    notes += [f"{file}: its camera '{camera.name}' is left out, another one is taken" for file, camera in others]
    return _camera(camera, frame), notes


def _camera(camera: FileCamera, frame: Float[np.ndarray, "2 3"]) -> Camera:
    """A camera whose target is where its axis is nearest to the middle of what is seen."""
    ahead = float((frame.mean(axis=0) - camera.origin) @ camera.direction)
    target = camera.origin + (ahead if ahead > 0 else 1.0) * camera.direction
    aspect = 1.0 if camera.aspect is None or not camera.aspect > 0 else camera.aspect
    width = max(round(Camera.height * aspect), 1)
    return Camera(tuple(camera.origin), tuple(target), tuple(camera.up), camera.fov_y, width)
