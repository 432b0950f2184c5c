"""Entries of `jaxrelight.geometry`: host code on meshes, but for frames."""

# Examples are arrays of NumPy, which functions of arrays of JAX take.
# pyright: reportArgumentType=false

import numpy as np

from jaxrelight.geometry import frame
from jaxrelight.gradients.entry import FILES, RAYS, Entries, Entry, Example, Exempt, named
from jaxrelight.gradients.examples import ALONG_X, OMEGA_I, OMEGA_O, at_point

_UP = np.array([0.0, 1.0, 0.0])

ENTRIES: Entries = (
    Entry(
        named("jaxrelight.geometry.frame", "tangent_frame"),
        differentiable_in="normal, tangent",
        example=lambda: Example(
            lambda normal, tangent: (frame.tangent_frame(normal), frame.tangent_frame(normal, tangent)),
            (OMEGA_I, OMEGA_O),
        ),
        orders=2,
        kinks="at the normal −y, where the frame turns about, that of a frame near it",
        ends="a tangent nearer than 1e-6 to the normal is none",
        singular=lambda: (
            at_point("a tangent along the normal", (OMEGA_I, OMEGA_I), 1, ALONG_X, "finite"),
            at_point("the normal −y", (-_UP, OMEGA_I), 0, ALONG_X, "finite"),
            at_point("the normal +y", (_UP, OMEGA_I), 0, ALONG_X),
        ),
    ),
    Exempt(
        (
            *named("jaxrelight.geometry.gltf", "read_glb read_gltf"),
            *named("jaxrelight.geometry.gltf_content", "Content.accessor"),
            *named("jaxrelight.geometry.gltf_nodes", "scene_nodes own_matrix instances all_matrices joint_matrices"),
            *named("jaxrelight.geometry.gltf_nodes", "surroundings"),
            *named("jaxrelight.geometry.mesh_files", "read_stl"),
            *named("jaxrelight.geometry.obj", "read_obj"),
            *named("jaxrelight.geometry.ply", "read_ply"),
            *named("jaxrelight.geometry.ply_format", "read_ascii read_binary"),
            *named(
                "jaxrelight.geometry.mesh",
                "load_mesh load_parts load_file MeshFile.mesh MeshFile.parts MeshFile.surroundings",
            ),
        ),
        FILES,
    ),
    Exempt(
        (
            *named("jaxrelight.geometry.gbuffer", "trace_gbuffer trace_points sensor_gbuffer"),
            *named("jaxrelight.geometry.ray_origins", "ray_origins"),
            *named("jaxrelight.geometry.receivers", "Receivers.single_precision_axes Receivers.groups_of"),
            *named("jaxrelight.geometry.receivers", "vertex_receivers pixel_receivers lifted_vertices"),
            *named("jaxrelight.geometry.enclosed_vertices", "enclosed_vertices weights_in_the_open"),
            *named("jaxrelight.geometry.tracer", "Tracer.occluded Tracer.blocked Tracer.distances"),
            *named("jaxrelight.geometry.tracer", "Tracer.first_hits"),
        ),
        RAYS,
    ),
    Exempt(
        (
            *named("jaxrelight.geometry.camera", "Camera.directions Camera.solid_angles"),
            *named("jaxrelight.geometry.creases", "smooth_normals split_vertices"),
            *named("jaxrelight.geometry.curvature", "curvature"),
            *named("jaxrelight.geometry.file_lights", "FileLight.moved FileCamera.moved Surroundings.moved"),
            *named("jaxrelight.geometry.frame", "frames_of_points to_local"),
            *named("jaxrelight.geometry.morton", "morton"),
            *named("jaxrelight.geometry.occluders", "Occluders.possible"),
            *named("jaxrelight.transport.model", "SceneGeometry.enclosed SceneGeometry.corners"),
            *named("jaxrelight.geometry.polygons", "triangulated"),
            *named("jaxrelight.geometry.primitives", "plane sphere box"),
            *named("jaxrelight.geometry.repair", "repaired"),
            *named("jaxrelight.geometry.sensors", "sensor_grid Sensors.positions Sensors.normals Sensors.slices"),
            *named("jaxrelight.geometry.sensors", "Sensors.solid_angles sensors_of"),
            *named("jaxrelight.geometry.subdivision", "subdivided edges_of halved conforming"),
            *named("jaxrelight.geometry.surfaces", "Surfaces.to_scene Surfaces.back Surfaces.u_axes"),
            *named("jaxrelight.geometry.surfaces", "Surfaces.u_axes_along Surfaces.tangents Surfaces.face_lift"),
            *named("jaxrelight.geometry.surfaces", "Surfaces.vertex_lift Surfaces.uv_densities"),
            *named("jaxrelight.geometry.surfaces", "Surfaces.face_normals join"),
            *named("jaxrelight.geometry.triangles", "half_edges area_vectors unit"),
            *named("jaxrelight.geometry.winding", "wind_alike match_normals faces_inward"),
            *named("jaxrelight.geometry.mesh", "bounds face_normals with_back joint_bounds"),
            *named("jaxrelight.geometry.mesh", "normalized normalizing_matrix transformed"),
        ),
        "host code: vertices are NumPy's, in double precision; geometry is held fixed",
    ),
)
