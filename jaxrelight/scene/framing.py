"""Cameras that show a mesh: from outside where that shows its fronts, and from inside where walls face inwards."""

import dataclasses
from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.mesh import Mesh, joint_bounds
from jaxrelight.geometry.surfaces import Surfaces, join
from jaxrelight.geometry.tracer import Tracer

# The eye looks from the front, a little from the right and above.
_EYE = np.array([0.42, 0.38, 1.0])
_FOV_Y, _FOV_Y_INSIDE = 34.0, 65.0
_MARGIN = 1.15
# Pixels along each side of the view in which backs are counted.
_VIEW = 96
# Where more than this share of what is seen from outside are backs, walls face inwards.
_MAX_OUTSIDE_BACKS = 0.4
# Places along each side of the bounds where an eye is tried, and the directions that it looks around in.
_PLACES, _AROUND, _LEVEL = 12, 96, 48
# A place is inside where so large a share of rays meets fronts, and so small a share backs.
_MIN_FRONTS, _MAX_BACKS = 0.5, 0.1
# The eye stands at this height between floor and ceiling, and so far of the way back to the wall behind it.
_EYE_HEIGHT, _STEP_BACK = 0.4, 0.8


@dataclasses.dataclass(frozen=True)
class Framing:
    """How a mesh is best seen.

    Attributes:
        camera: in world space.
        backs: the share of what a camera outside sees that are backs of faces.
        inside: whether the camera is inside, as a camera outside would see the backs of walls.
    """

    camera: Camera
    backs: float
    inside: bool


def framing(meshes: Sequence[Mesh]) -> Framing:
    """A camera that shows all of some meshes; or stands in the largest free space of those that enclose one."""
    outside = framing_camera(np.concatenate([mesh.vertices for mesh in meshes]))
    surfaces = join(list(meshes))
    tracer = Tracer(surfaces)
    backs = _seen_from_behind(surfaces, tracer, outside)
    inside = _camera_inside(surfaces, tracer, joint_bounds(meshes)) if backs > _MAX_OUTSIDE_BACKS else None
    return Framing(inside or outside, backs, inside is not None)


def lamp_for(framed: Framing, meshes: Sequence[Mesh]) -> tuple[Float[np.ndarray, "3"], float]:
    """Position and intensity of a point lamp that lights what a camera sees about as a sky of radiance 1 does.

    It hangs to the left of the camera and above; inside, below the ceiling between the eye and what it looks at.
    """
    position, camera = _lamp_position(framed, meshes), framed.camera
    away = np.linalg.norm(position - np.asarray(camera.target))
    return position, float(np.pi * away**2)


def _lamp_position(framed: Framing, meshes: Sequence[Mesh]) -> Float[np.ndarray, "3"]:
    camera, (low, high) = framed.camera, joint_bounds(meshes)
    eye, target = np.asarray(camera.origin), np.asarray(camera.target)
    forward = target - eye
    distance = np.linalg.norm(forward)
    if framed.inside:
        surfaces = join(list(meshes))
        middle = eye + 0.5 * forward
        above = Tracer(surfaces).distances(surfaces.to_scene(middle)[None], np.array([[0.0, 1, 0]]))[0]
        clear = min(above * surfaces.radius, high[1] - middle[1])
        return middle + np.array([0, 0.8 * max(clear, 0.0), 0])
    left = np.cross([0.0, 1, 0], forward)
    left /= max(np.linalg.norm(left), 1e-12)
    up = np.array([0, 0.4 * distance + (high[1] - low[1]) / 2, 0])
    return target - 0.6 * forward + 0.5 * distance * left + up


def framing_camera(vertices: Float[np.ndarray, "v 3"]) -> Camera:
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


def _seen_from_behind(surfaces: Surfaces, tracer: Tracer, camera: Camera) -> float:
    """The share of what a camera sees that are backs of one-sided faces."""
    rays = dataclasses.replace(camera, width=_VIEW, height=_VIEW).directions().reshape(-1, 3)
    hit, back, _ = _first_hits(surfaces, tracer, surfaces.to_scene(np.array(camera.origin)), rays)
    return float(back[hit].mean()) if hit.any() else 0.0


def _first_hits(surfaces: Surfaces, tracer: Tracer, origins, rays):
    """Of each ray, whether it meets a face, whether that is the back of a one-sided one, and how far away it is."""
    origins = np.broadcast_to(origins, rays.shape)
    face, weights = tracer.first_hits(origins, rays)
    hit, corners = face >= 0, surfaces.faces[np.maximum(face, 0)]
    one_sided = ~surfaces.two_sided[surfaces.mesh_of_vertex[corners[:, 0]]]
    back = hit & one_sided & (np.sum(surfaces.face_normals(np.maximum(face, 0)) * rays, axis=1) > 0)
    at = np.einsum("rk,rkx->rx", weights, surfaces.vertices[corners])
    return hit, back, np.where(hit, np.linalg.norm(at - origins, axis=1), np.inf)


def _camera_inside(surfaces: Surfaces, tracer: Tracer, bounds: Float[np.ndarray, "2 3"]) -> Camera | None:
    """A camera in the largest free space that surfaces enclose, which looks along it; None where none is enclosed."""
    low, high = surfaces.to_scene(bounds)
    size = np.linalg.norm(high - low)
    steps = (np.arange(_PLACES) + 0.5) / _PLACES
    places = np.stack(np.meshgrid(steps, steps[::2], steps, indexing="ij"), axis=-1).reshape(-1, 3)
    places = low + places * (high - low)
    around = _sphere(_AROUND)
    rays = np.tile(around, (len(places), 1))
    hit, back, distance = (
        of.reshape(len(places), -1) for of in _first_hits(surfaces, tracer, places.repeat(_AROUND, axis=0), rays)
    )
    enclosed = (np.mean(hit & ~back, axis=1) >= _MIN_FRONTS) & (back.mean(axis=1) <= _MAX_BACKS)
    if not enclosed.any():
        return None
    # Where there is most room: rays that leave through an opening say nothing of it.
    room = np.where(hit, np.minimum(distance, size), 0).mean(axis=1)
    eye = places[np.argmax(np.where(enclosed, room, -1))]
    vertical = np.array([[0.0, -1, 0], [0.0, 1, 0]])
    _, _, (down, above) = _first_hits(surfaces, tracer, np.tile(eye, (2, 1)), vertical)
    floor, ceiling = eye[1] - min(down, eye[1] - low[1]), eye[1] + min(above, high[1] - eye[1])
    eye = np.array([eye[0], floor + _EYE_HEIGHT * (ceiling - floor), eye[2]])
    angles = 2 * np.pi * np.arange(_LEVEL) / _LEVEL
    level = np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=1)
    _, back, free = _first_hits(surfaces, tracer, np.tile(eye, (_LEVEL, 1)), level)
    # Directions that lead outside, or to the back of a wall, show no room; narrow gaps do not count.
    free = np.where(np.isfinite(free) & ~back, free, 0)
    wide = np.minimum(free, np.minimum(np.roll(free, 1), np.roll(free, -1)))
    # The eye steps back, and sees the way before it and that behind it.
    ahead = int(np.argmax(wide + _STEP_BACK * np.roll(wide, _LEVEL // 2)))
    behind = _STEP_BACK * wide[(ahead + _LEVEL // 2) % _LEVEL]
    eye, target = eye - behind * level[ahead], eye + 0.5 * max(free[ahead], 0.05 * size) * level[ahead]
    eye, target = (surfaces.centre + surfaces.radius * of for of in (eye, target))
    return Camera(tuple(eye), tuple(target), fov_y=_FOV_Y_INSIDE)


def _sphere(count: int) -> Float[np.ndarray, "{count} 3"]:
    """Directions spread evenly over the sphere (Fibonacci's spiral)."""
    y = 1 - (2 * np.arange(count) + 1) / count
    angle, across = np.pi * (3 - np.sqrt(5)) * np.arange(count), np.sqrt(1 - y * y)
    return np.stack([across * np.sin(angle), y, across * np.cos(angle)], axis=1)
