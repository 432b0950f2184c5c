"""What hides the environment from vertices: of a store of transport, or from a few hundred rays each in seconds."""

import pathlib

import equinox as eqx
import numpy as np
from jaxtyping import Int, Int8

from jaxrelight.errors import InputError
from jaxrelight.files import store
from jaxrelight.geometry.gbuffer import sensor_gbuffer
from jaxrelight.geometry.occluders import Occluders
from jaxrelight.geometry.ray_origins import ray_origins
from jaxrelight.geometry.receivers import Receivers, pixel_receivers, vertex_receivers
from jaxrelight.geometry.sensors import Sensors
from jaxrelight.geometry.surfaces import Surfaces
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.numerics.arrays import as_array
from jaxrelight.precomputation.groups import Threads
from jaxrelight.precomputation.placing import geometry_keys
from jaxrelight.precomputation.receiver_refinement import layer_name, stored_refinement
from jaxrelight.progress import Report
from jaxrelight.scene.scene import Scene
from jaxrelight.transport import bake
from jaxrelight.transport.adaptive_visibility import trace_adaptively
from jaxrelight.transport.compression import padded_receivers
from jaxrelight.transport.filtered_visibility import FilteredVisibility, visibility_distances
from jaxrelight.transport.model import ByKey, frames_of


class Slots(ByKey):
    """Where each vertex, or back of one, stands among the receivers."""

    def __init__(self, of_vertex: Int[np.ndarray, " v"], key: str):
        self.of_vertex, self.key = of_vertex, key


class VertexOcclusion(eqx.Module):
    """Filtered visibility of all vertices.

    Attributes:
        visibility: of the receivers.
        slots: where each vertex stands among them.
    """

    visibility: FilteredVisibility
    slots: Slots = eqx.field(static=True)


def vertex_occlusion(
    surfaces: Surfaces, tracer: Tracer, resolution: int, report: Report | None = None
) -> VertexOcclusion:
    """Traces rays from every vertex, and filters what they see.

    Args:
        surfaces: all meshes.
        tracer: of them.
        resolution: side of the faces of the cube map along whose texels rays go.
        report: called with the progress, in vertices.
    """
    receivers = vertex_receivers(surfaces, np.zeros(len(surfaces.two_sided), int), tracer)
    return _traced_occlusion(receivers, surfaces, tracer, resolution, report)


def sensor_occlusion(
    sensors: Sensors, surfaces: Surfaces, tracer: Tracer, resolution: int, report: Report | None = None
) -> VertexOcclusion:
    """The same of the points of sensors, in their order in place of vertices; arguments as of `vertex_occlusion`."""
    points = sensor_gbuffer(surfaces, sensors)
    of_sensors = np.zeros(len(surfaces.two_sided) + 1, int)
    receivers = pixel_receivers(points, ray_origins(surfaces, tracer, points), of_sensors)
    return _traced_occlusion(receivers, surfaces, tracer, resolution, report)


def _traced_occlusion(
    receivers: Receivers, surfaces: Surfaces, tracer: Tracer, resolution: int, report: Report | None
) -> VertexOcclusion:
    groups = len(receivers.filled)
    directions, occluders = bake.directions_for(resolution), Occluders(surfaces)
    codes: list[np.ndarray] = [np.zeros(0, np.int8)] * groups
    frames = frames_of(receivers, np.arange(groups)).astype(np.float32)

    def make(group: int) -> None:
        rays = receivers.origins[group], receivers.normals[group]
        bits, _ = trace_adaptively(tracer, occluders, *rays, resolution)
        codes[group] = np.asarray(visibility_distances(bits, frames[group], directions))

    done = 0
    for group in Threads().run(make, range(groups)):
        done += int(receivers.filled[group])
        if report is not None:
            report("occlusion", done, receivers.count)
    key = store.key_of(tracer.key, receivers.positions, receivers.normals)
    return _occlusion(np.concatenate(codes), receivers, key)


def with_stored_vertices(scene: Scene, folder: str | pathlib.Path) -> Scene:
    """The scene with the vertices that a store of transport added to it; as it is where that is of another geometry.

    Args:
        scene: any.
        folder: the store.

    Raises:
        InputError: if it is no store, or damaged.
    """
    folder = pathlib.Path(folder)
    header = store.read_header(folder)
    if not header.get("refinement"):
        return scene
    try:
        tolerance = header["method"]["dials"]["receiver_tolerance"]
    except (KeyError, TypeError):
        raise _damaged(folder) from None
    name = layer_name(geometry_keys(scene, scene.surfaces())[0], tolerance)
    if header["refinement"] != name:
        return scene
    return stored_refinement(scene, store.open_layer(folder / name))


def stored_occlusion(folder: str | pathlib.Path, scene: Scene, surfaces: Surfaces) -> VertexOcclusion:
    """The filtered visibility that a store of transport has of a scene's vertices; no ray, and nothing is written.

    Args:
        folder: the store.
        scene: of the same geometry; its materials may be others.
        surfaces: its meshes.

    Raises:
        InputError: if it is no store, damaged, of another geometry, or has no filtered visibility.
    """
    folder = pathlib.Path(folder)
    header = store.read_header(folder)
    try:
        is_same = header["geometry"] == f"geometry-{geometry_keys(scene, surfaces)[1]}"
        material_of_mesh, layer = np.array(header["material_of_mesh"]), header.get("filtered")
    except (KeyError, TypeError, ValueError):
        raise _damaged(folder) from None
    if not is_same:
        raise InputError(f"{folder}: is the store of another geometry than {scene.name}; name its own, or none")
    if not layer:
        raise InputError(
            f"{folder}: has no filtered visibility; precompute vertices of a scene with glossy materials there, or "
            "name no store, and rays are cast now"
        )
    receivers = vertex_receivers(surfaces, material_of_mesh)
    codes = store.open_layer(folder / layer)
    if codes.missing or codes.groups != len(receivers.filled):
        raise InputError(f"{folder}: its filtered visibility is not complete; run precompute again")
    read = np.concatenate([codes.read("codes", group) for group in range(codes.groups)])
    return _occlusion(read, receivers, codes.folder.name)


def _damaged(folder: pathlib.Path) -> InputError:
    return InputError(f"{folder / 'store.json'}: damaged; run precompute again")


def _occlusion(codes: Int8[np.ndarray, "r s"], receivers: Receivers, key: str) -> VertexOcclusion:
    """Of one of few lengths, so that another mesh of about the same size compiles nothing new."""
    padded = np.pad(codes, ((0, padded_receivers(len(codes)) - len(codes)), (0, 0)))
    return VertexOcclusion(FilteredVisibility(as_array(padded, np.int8)), Slots(receivers.slot_of, key))
