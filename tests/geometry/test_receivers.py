"""Groups of receivers, and the way back from them."""

import dataclasses

import numpy as np
import pytest

from jaxrelight.basis import cubemap
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.gbuffer import trace_gbuffer
from jaxrelight.geometry.mesh import Mesh, transformed
from jaxrelight.geometry.primitives import box, plane, sphere
from jaxrelight.geometry.ray_origins import ray_origins
from jaxrelight.geometry.receivers import GROUP, Receivers, pixel_receivers, vertex_receivers
from jaxrelight.geometry.subdivision import edges_of, halved
from jaxrelight.geometry.surfaces import join
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.transport.visibility import trace_visibility
from tests.scenes import inside_out

# Materials 2, 0, 2 of meshes with 81, 386 and 256 vertices.
MESHES = [
    plane((2, 2), 8),
    transformed(sphere(0.5, 8), np.array([[1, 0, 0, 0], [0, 1, 0, 0.5], [0, 0, 1, 0], [0, 0, 0, 1]])),
    transformed(plane((2, 2), 15), np.array([[1, 0, 0, 0], [0, 1, 0, 1.5], [0, 0, 1, 0], [0, 0, 0, 1]])),
]
MATERIALS = np.array([2, 0, 2])


@pytest.fixture(scope="module")
def surfaces():
    return join(MESHES)


def check_grouping(receivers: Receivers, positions, normals, material):
    """What holds for any receivers: the way back, one material a group, copies of the first as padding."""
    groups = len(receivers.filled)
    assert receivers.positions.shape == receivers.normals.shape == receivers.face_normals.shape == (groups, GROUP, 3)
    assert receivers.count == len(positions) == receivers.filled.sum()
    slot = receivers.slot_of
    # Those at a rim are moved off it.
    np.testing.assert_allclose(receivers.positions.reshape(-1, 3)[slot], positions, atol=1e-4)
    np.testing.assert_array_equal(receivers.normals.reshape(-1, 3)[slot], normals)
    np.testing.assert_array_equal(receivers.material_of_group[slot // GROUP], material)
    assert len(np.unique(slot)) == len(slot)
    assert (slot % GROUP < receivers.filled[slot // GROUP]).all()
    for number in np.unique(material):
        mine = receivers.groups_of(int(number))
        np.testing.assert_array_equal(mine, np.arange(mine[0], mine[0] + len(mine)))
        assert len(mine) == -(-(material == number).sum() // GROUP)
        assert (receivers.filled[mine[:-1]] == GROUP).all()
        first = receivers.positions[mine[0], 0]
        padding = receivers.positions[mine[-1], receivers.filled[mine[-1]] :]
        np.testing.assert_array_equal(padding, np.broadcast_to(first, padding.shape))


def test_vertices_are_grouped_by_material_and_found_again(surfaces):
    receivers = vertex_receivers(surfaces, MATERIALS)
    check_grouping(receivers, surfaces.vertices, surfaces.normals, MATERIALS[surfaces.mesh_of_vertex])
    assert receivers.omega_o is None
    np.testing.assert_array_equal(receivers.material_of_group, [0, 0, 0, 0, 2, 2, 2])
    np.testing.assert_array_equal(receivers.filled, [128, 128, 128, 2, 128, 128, 81])
    assert len(receivers.groups_of(1)) == 0


def test_groups_are_close_together():
    surfaces = join([plane((2, 2), 63)])
    receivers = vertex_receivers(surfaces, np.array([0]))
    extent = np.ptp(receivers.positions, axis=1).max(axis=-1)
    assert np.median(extent) < 0.6
    check_grouping(receivers, surfaces.vertices, surfaces.normals, np.zeros(64 * 64))


def test_no_ray_from_a_rim_passes_between_walls():
    """The vertices of a room's walls lie in each other's planes, at edges and in corners."""
    room = box((1, 1, 1), 3)
    surfaces = join([inside_out(room)])
    receivers = vertex_receivers(surfaces, np.array([0]))
    directions = cubemap.directions(16)
    bits, _ = trace_visibility(Tracer(surfaces), receivers.origins[0], receivers.normals[0], directions)
    assert not bits.any()


def test_only_rims_are_moved():
    surfaces = join([plane((2, 2), 4)])
    moved = vertex_receivers(surfaces, np.array([0]))
    distance = np.linalg.norm(moved.positions.reshape(-1, 3)[moved.slot_of] - surfaces.vertices, axis=1)
    rim = np.abs(surfaces.vertices).max(axis=1) == 1
    assert not distance[~rim].any()
    np.testing.assert_allclose(distance[rim], 4 * surfaces.vertex_lift[rim])


@pytest.mark.parametrize("resolution", [1, 10])
def test_a_group_is_never_empty_nor_over_full(resolution):
    surfaces = join([plane((2, 2), resolution)])
    receivers = vertex_receivers(surfaces, np.array([0]))
    np.testing.assert_array_equal(receivers.filled, [(resolution + 1) ** 2])
    check_grouping(receivers, surfaces.vertices, surfaces.normals, np.zeros((resolution + 1) ** 2))


def test_pixels_are_grouped_by_what_they_show(surfaces):
    gbuffer = trace_gbuffer(surfaces, Tracer(surfaces), Camera((0, 1, 4), (0, 0.4, 0), width=24, height=24))
    origins = ray_origins(surfaces, Tracer(surfaces), gbuffer)
    receivers = pixel_receivers(gbuffer, origins, MATERIALS)
    np.testing.assert_array_equal(receivers.origins.reshape(-1, 3)[receivers.slot_of], origins)
    check_grouping(receivers, gbuffer.positions, gbuffer.normals, MATERIALS[gbuffer.mesh])
    assert receivers.omega_o is not None
    np.testing.assert_array_equal(receivers.omega_o.reshape(-1, 3)[receivers.slot_of], gbuffer.omega_o)
    np.testing.assert_array_equal(receivers.face_normals.reshape(-1, 3)[receivers.slot_of], gbuffer.face_normals)


def test_no_pixels_make_no_groups(surfaces):
    gbuffer = trace_gbuffer(surfaces, Tracer(surfaces), Camera((0, 5, 0), (0, 9, 0), (0, 0, 1), width=4, height=4))
    receivers = pixel_receivers(gbuffer, np.zeros((0, 3)), MATERIALS)
    assert receivers.count == len(receivers.filled) == 0
    assert receivers.positions.shape == (0, GROUP, 3)


def test_face_normals_of_vertices_are_those_of_the_faces_around():
    """A box has corners of their own on every side; a sphere's are close to its smooth normals."""
    for mesh, cosine in [(box(), 1 - 1e-12), (sphere(0.5, 8), 0.99)]:
        surfaces = join([mesh])
        receivers = vertex_receivers(surfaces, np.array([0]))
        np.testing.assert_allclose(np.linalg.norm(receivers.face_normals, axis=-1), 1, atol=1e-12)
        assert np.sum(receivers.face_normals * receivers.normals, axis=-1).min() > cosine


def test_face_normals_are_weighted_by_area_and_fall_back_to_the_shading_normal():
    vertices = np.array([[0.0, 0, 0], [2, 0, 0], [0, 0, -2], [0, 1, 0], [5, 5, 5]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])  # areas 2 and 1 towards +y and +x
    normals = np.tile([0.0, 0, 1], (5, 1))
    surfaces = join([Mesh(vertices, faces, normals)])
    receivers = vertex_receivers(surfaces, np.array([0]))
    face_normals = receivers.face_normals.reshape(-1, 3)[receivers.slot_of]
    np.testing.assert_allclose(face_normals[0], np.array([1, 2, 0]) / 5**0.5, atol=1e-12)
    np.testing.assert_allclose(face_normals[1], [0, 1, 0], atol=1e-12)
    np.testing.assert_allclose(face_normals[3], [1, 0, 0], atol=1e-12)
    np.testing.assert_allclose(face_normals[4], [0, 0, 1], atol=1e-12)


def test_origins_at_the_rim_of_a_hollow_are_above_the_faces_that_rise_from_it():
    """A shallow bowl: its rim slopes up on both sides of every vertex; and the same as its own back."""
    grid = plane((2, 2), 4)
    heights = 0.4 * (np.abs(grid.vertices[:, 0]) + np.abs(grid.vertices[:, 2]))
    bowl = dataclasses.replace(grid, vertices=grid.vertices + heights[:, None] * np.array([0, 1, 0]), two_sided=True)
    surfaces = join([bowl])
    receivers = vertex_receivers(surfaces, np.array([0]))
    origins = receivers.origins.reshape(-1, 3)[receivers.slot_of]
    for side, mine in ((1, origins[: len(heights)]), (-1, origins[len(heights) :])):
        for corner in range(3):
            vertex = surfaces.faces[:, corner]
            moved, normals = mine[vertex] - surfaces.vertices[vertex], surfaces.face_normals(np.arange(32))
            above = side * np.sum(moved * normals, axis=1)
            assert (above >= 0.999 * surfaces.vertex_lift[vertex]).all()


def test_rays_of_vertices_inside_faces_leave_from_the_smooth_surface():
    """A ball with finer faces in the same planes occludes itself as little as before: under open sky not at all."""
    coarse = sphere(0.5, 6)
    edges = edges_of(coarse)
    fine = halved(coarse, edges, np.ones(len(edges.ends), bool))
    edges = edges_of(fine)
    fine = halved(fine, edges, np.ones(len(edges.ends), bool))
    surfaces = join([fine])
    tracer, hidden = Tracer(surfaces), []
    for of in (None, tracer):
        receivers = vertex_receivers(surfaces, np.array([0]), of)
        seen = [
            trace_visibility(tracer, *rays, cubemap.directions(8))
            for rays in zip(receivers.origins, receivers.normals, strict=True)
        ]
        rays = sum(count for _, count in seen)
        hidden.append(1 - sum(int(np.unpackbits(bits).sum()) for bits, _ in seen) / rays)
    assert hidden[0] > 0.01
    assert hidden[1] < 0.15 * hidden[0]
    # Vertices of the ball as it was stay where they were.
    count = len(coarse.vertices)
    lifted, raised = (vertex_receivers(surfaces, np.array([0]), of) for of in (None, tracer))
    own = lifted.slot_of[:count]
    np.testing.assert_array_equal(raised.origins.reshape(-1, 3)[own], lifted.origins.reshape(-1, 3)[own])
