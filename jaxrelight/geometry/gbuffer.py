"""What is seen along rays: the surface points of a camera's pixels, or of any others."""

import dataclasses
import itertools

import numpy as np
from jaxtyping import Bool, Float, Int

from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.sensors import Sensors
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.numerics.threads import in_parts

# The cosine of a face seen nearly edge on, which covers no more of a texture than this says.
_MIN_COSINE = 1e-3
# Pixels in each part.
_PIXEL_CHUNK = 16384


@dataclasses.dataclass(frozen=True)
class GBuffer:
    """Surface points seen through the centres of pixels that see any, and all pixels' directions.

    Any set of rays may stand for the pixels, and so may the points of sensors, which lie on no face.

    Attributes:
        covered: which pixels, row by row, see a surface; their points follow in that order.
        directions: unit world direction through every pixel.
        face: number of the face seen; −1 for points of sensors.
        corners: vertex numbers of that face; those of the first face for points of sensors.
        barycentric: weights of its corners.
        back: whether the back of a two-sided mesh is seen; all normals are that side's.
        normals: interpolated unit shading normals.
        face_normals: unit geometric normals.
        tangents: interpolated, see `Surfaces.tangents`.
        positions: in scene space.
        uv: surface coordinates.
        footprint: area in the first set of texture coordinates that a pixel covers.
        mesh: number of the mesh seen; points of sensors have the one after the last.
        omega_o: unit direction back to the eye.
    """

    covered: Bool[np.ndarray, "*h"]
    directions: Float[np.ndarray, "*h 3"]
    face: Int[np.ndarray, " p"]
    corners: Int[np.ndarray, "p 3"]
    barycentric: Float[np.ndarray, "p 3"]
    back: Bool[np.ndarray, " p"]
    positions: Float[np.ndarray, "p 3"]
    normals: Float[np.ndarray, "p 3"]
    face_normals: Float[np.ndarray, "p 3"]
    tangents: Float[np.ndarray, "p 3"]
    uv: Float[np.ndarray, "p u"]
    footprint: Float[np.ndarray, " p"]
    mesh: Int[np.ndarray, " p"]
    omega_o: Float[np.ndarray, "p 3"]

    @property
    def is_of_sensors(self) -> bool:
        """Whether its points are those of sensors."""
        return bool((self.face < 0).any())


def trace_gbuffer(surfaces: Surfaces, tracer: Tracer, camera: Camera) -> GBuffer:
    """One ray through every pixel's centre."""
    directions, solid_angles = camera.directions(), camera.solid_angles()
    origin = surfaces.to_scene(np.asarray(camera.origin))

    def band(rows: slice) -> GBuffer:
        return trace_points(surfaces, tracer, origin, directions[rows], solid_angles[rows])

    bands = in_parts(band, camera.height, -(-_PIXEL_CHUNK // camera.width))
    if len(bands) == 1:
        return bands[0]
    names = [field.name for field in dataclasses.fields(GBuffer)]

    def joined(which: slice):
        return [np.concatenate([getattr(one, name) for one in bands]) for name in names[which]]

    return GBuffer(*itertools.chain(*in_parts(joined, len(names), 1)))


def trace_points(
    surfaces: Surfaces,
    tracer: Tracer,
    origins: Float[np.ndarray, "*o 3"],
    directions: Float[np.ndarray, "*h 3"],
    solid_angles: Float[np.ndarray, "*h"],
) -> GBuffer:
    """The first surface point along each ray, which stands for a pixel of some solid angle.

    Origins, one of each or one for all, are in scene space; lift them off the surface that they are on.
    """
    flat, origin = directions.reshape(-1, 3), origins if origins.ndim == 1 else origins.reshape(-1, 3)
    face, weights = tracer.first_hits(origin, flat)
    covered = face >= 0
    face, weights = face[covered], weights[covered]
    corners = surfaces.faces[face]
    mesh = surfaces.mesh_of_vertex[corners[:, 0]]

    def interpolated(values):
        return np.einsum("pk,pkx->px", weights, values[corners])

    normal = interpolated(surfaces.normals)
    length = np.linalg.norm(normal, axis=-1, keepdims=True)
    face_normal = surfaces.face_normals(face)
    normal = np.where(length > 1e-9, normal / np.maximum(length, 1e-9), face_normal)
    back = surfaces.two_sided[mesh] & (np.sum(face_normal * flat[covered], axis=1) > 0)
    side = np.where(back, -1.0, 1.0)[:, None]
    positions = interpolated(surfaces.vertices)
    footprint, uv, tangents = np.zeros(len(face)), np.zeros((len(face), surfaces.uv.shape[1])), np.zeros((len(face), 3))
    if surfaces.has_uv:
        distance = np.linalg.norm(positions - (origin if origin.ndim == 1 else origin[covered]), axis=1)
        cosine = np.abs(np.sum(face_normal * flat[covered], axis=1))
        seen = solid_angles.reshape(-1)[covered] * distance**2 / np.maximum(cosine, _MIN_COSINE)
        footprint, uv = seen * surfaces.uv_densities(face), interpolated(surfaces.uv)
    if surfaces.uv_tangents.any():
        tangents = interpolated(surfaces.tangents)
    return GBuffer(
        covered=covered.reshape(directions.shape[:-1]),
        directions=directions,
        face=face,
        corners=corners,
        barycentric=weights,
        back=back,
        positions=positions,
        normals=side * normal,
        face_normals=side * face_normal,
        tangents=tangents,
        uv=uv,
        footprint=footprint,
        mesh=mesh,
        omega_o=-flat[covered],
    )


def sensor_gbuffer(surfaces: Surfaces, sensors: Sensors) -> GBuffer:
    """The points of sensors in place of what pixels see, looked at from straight above."""
    count = sensors.width
    normals = sensors.normals
    return GBuffer(
        covered=np.ones((1, count), bool),
        directions=-normals[None],
        face=np.full(count, -1),
        corners=np.tile(surfaces.faces[:1], (count, 1)),
        barycentric=np.tile([1.0, 0.0, 0.0], (count, 1)),
        back=np.zeros(count, bool),
        positions=surfaces.to_scene(sensors.positions),
        normals=normals,
        face_normals=normals,
        tangents=np.zeros((count, 3)),
        uv=np.zeros((count, surfaces.uv.shape[1])),
        footprint=np.zeros(count),
        mesh=np.full(count, len(surfaces.two_sided)),
        omega_o=normals,
    )
