"""Shading normals with normal maps: at every pixel that is seen, or at vertices."""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from jaxrelight.brdf.texture import Texture
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.gbuffer import GBuffer, sensor_gbuffer, trace_gbuffer
from jaxrelight.geometry.sensors import Sensors
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.numbers import float_dtype

# A normal map, or none, for each mesh.
NormalMaps = Sequence[Texture | None]
# Between the eye and a normal that a map would turn away from it.
_MIN_COSINE = 0.05
# By which the length of a normal in an image of 8 bits, filtered and compressed, may differ from 1.
_NORMAL_LENGTH_ERROR = 0.15


def apply_normal_map(
    normals: Float[np.ndarray, "p 3"],
    u_axes: Float[np.ndarray, "p 4"],
    uv: Float[np.ndarray, "p u"],
    bumps: Texture,
    footprint: Float[np.ndarray, " p"] | float = 0.0,
) -> Float[np.ndarray, "p 3"]:
    """Unit normals n' ∝ x s + y t + z n of a map that holds ((x, y, z) + 1)/2 in the frame of growing u and v.

    s is the direction of growing u made perpendicular to n, and t that of growing v. Where texture coordinates do not
    tell s, or the map has no direction, n stays.
    """
    dtype = float_dtype(bumps)
    covered = jnp.broadcast_to(as_array(footprint, dtype), len(uv))
    texels = jax.vmap(bumps.look_up)(as_array(uv, dtype), covered)
    x, y, z = (2 * np.asarray(texels, float) - 1).T[:, :, None]
    along = u_axes[:, :3] - normals * np.sum(u_axes[:, :3] * normals, axis=1, keepdims=True)
    length = np.linalg.norm(along, axis=1, keepdims=True)
    along = along / np.where(length > 0, length, 1)
    across = np.sign(u_axes[:, 3:]) * np.cross(normals, along)
    turned = x * along + y * across + z * normals
    size = np.linalg.norm(turned, axis=1, keepdims=True)
    return np.where((length > 1e-6) & (size > 1e-6), turned / np.where(size > 0, size, 1), normals)


def _u_axes(surfaces: Surfaces, bumps: Texture) -> Float[np.ndarray, "v 4"]:
    """Directions of growing u in a map, as it lies on the surfaces; see `Surfaces.u_axes`."""
    if bumps.uv_set == 0 and bumps.placement is None:
        return surfaces.u_axes
    return surfaces.u_axes_along(np.asarray(bumps.coordinates(surfaces.uv)))


def at_vertices(surfaces: Surfaces, maps: NormalMaps) -> Surfaces:
    """Surfaces whose vertices' normals are bent."""
    normals = surfaces.normals.copy()
    for number, bumps in enumerate(maps):
        if bumps is not None:
            mine = surfaces.mesh_of_vertex == number
            normals[mine] = apply_normal_map(normals[mine], _u_axes(surfaces, bumps)[mine], surfaces.uv[mine], bumps)
    return dataclasses.replace(surfaces, normals=normals) if any(maps) else surfaces


def see(surfaces: Surfaces, tracer: Tracer, camera: Camera | Sensors, maps: NormalMaps) -> GBuffer:
    """A camera's G-buffer, whose normals are bent; or that of sensors.

    A slope that faces away from the eye could not be seen, were it really there; it is turned until it is, nearly
    edge on. Else it would be black, as what is seen from below its normal is. So are interpolated normals at the rims
    of coarse meshes, unless their mesh asks for shading normals as they are.
    """
    if isinstance(camera, Sensors):
        return sensor_gbuffer(surfaces, camera)
    gbuffer = trace_gbuffer(surfaces, tracer, camera)
    side = np.where(gbuffer.back, -1.0, 1.0)[:, None]
    normals = gbuffer.normals.copy()
    for number, bumps in enumerate(maps):
        mine = np.flatnonzero(gbuffer.mesh == number)
        if bumps is not None and len(mine):
            axes = np.einsum("pk,pkx->px", gbuffer.barycentric[mine], _u_axes(surfaces, bumps)[gbuffer.corners[mine]])
            turned = side[mine] * apply_normal_map(
                side[mine] * normals[mine], axes, gbuffer.uv[mine], bumps, gbuffer.footprint[mine]
            )
            normals[mine] = turned
    away = np.sum(normals * gbuffer.omega_o, axis=1) < _MIN_COSINE
    mine = np.flatnonzero(away & ~surfaces.pure_normals[gbuffer.mesh])
    normals[mine] = _turned_to_eye(normals[mine], gbuffer.face_normals[mine], gbuffer.omega_o[mine])
    return dataclasses.replace(gbuffer, normals=normals)


def _turned_to_eye(
    normals: Float[np.ndarray, "p 3"], face_normals: Float[np.ndarray, "p 3"], omega_o: Float[np.ndarray, "p 3"]
) -> Float[np.ndarray, "p 3"]:
    """Normals turned to the eye as far as the face is, but at most until they are seen, nearly edge on."""
    least = np.minimum(_MIN_COSINE, np.sum(face_normals * omega_o, axis=1, keepdims=True))
    turned = normals + np.maximum(least - np.sum(normals * omega_o, axis=1, keepdims=True), 0) * omega_o
    return turned / np.linalg.norm(turned, axis=1, keepdims=True)


def is_normal_map(pixels: Float[np.ndarray, "h w c"]) -> bool:
    """Whether an image holds unit normals as (n + 1)/2 that lean most to +z, rather than heights or colours.

    A light grey would be of unit length, too, but leans to all sides alike.
    """
    if pixels.shape[-1] < 3:
        return False
    normals = 2 * pixels[..., :3].astype(float) - 1
    of_unit_length = np.abs(np.linalg.norm(normals, axis=-1) - 1) < _NORMAL_LENGTH_ERROR
    upright = normals[..., 2] > np.abs(normals[..., :2]).max(axis=-1) + _NORMAL_LENGTH_ERROR
    return bool((of_unit_length & upright).mean() > 0.5)
