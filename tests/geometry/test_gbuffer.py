"""What a camera sees, by closed forms and against the alpha of a reference image."""

import dataclasses
import os

import numpy as np
import pytest

from jaxrelight.geometry import gbuffer as module
from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.gbuffer import GBuffer, trace_gbuffer
from jaxrelight.geometry.mesh import Mesh, transformed
from jaxrelight.geometry.primitives import plane, sphere
from jaxrelight.geometry.surfaces import Surfaces, join
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.images import read_image
from jaxrelight.scene.scene_file import load_scene
from tests.shared_data import shared


def traced(meshes, camera: Camera) -> tuple[Surfaces, GBuffer]:
    surfaces = join(meshes)
    return surfaces, trace_gbuffer(surfaces, Tracer(surfaces), camera)


def test_a_plane_is_seen_where_rays_meet_it():
    camera = Camera((1, 3, 2), (0.1, 0, 0), width=24, height=16)
    surfaces, gbuffer = traced([plane((2, 3), 7)], camera)
    origin, directions = np.array([1, 3, 2]), camera.directions()
    point = origin - directions * (3 / directions[..., 1:2])
    inside = (directions[..., 1] < 0) & (np.abs(point[..., 0]) < 1) & (np.abs(point[..., 2]) < 1.5)
    assert 0.1 < inside.mean() < 0.9
    np.testing.assert_array_equal(gbuffer.covered, inside)
    np.testing.assert_allclose(gbuffer.positions, surfaces.to_scene(point[inside]), atol=1e-5)
    np.testing.assert_allclose(gbuffer.omega_o, -directions[inside])
    np.testing.assert_array_equal(gbuffer.directions, directions)
    for normals in (gbuffer.normals, gbuffer.face_normals):
        np.testing.assert_allclose(normals, np.tile([0, 1, 0], (inside.sum(), 1)), atol=1e-12)
    np.testing.assert_array_equal(gbuffer.mesh, 0)


def test_bands_on_several_threads_are_the_whole(monkeypatch):
    camera = Camera((0, 0.5, 3), (0, 0, 0), fov_y=20, width=13, height=11)
    _, whole = traced([sphere(0.5, 6), plane((2, 2))], camera)
    monkeypatch.setattr(os, "cpu_count", lambda: 4)
    monkeypatch.setattr(module, "_PIXEL_CHUNK", 30)
    _, banded = traced([sphere(0.5, 6), plane((2, 2))], camera)
    for field in dataclasses.fields(GBuffer):
        np.testing.assert_array_equal(getattr(banded, field.name), getattr(whole, field.name))


def test_barycentric_weights_give_position_and_smooth_normal():
    surfaces, gbuffer = traced([sphere(0.5, 6)], Camera((0, 0.5, 3), (0, 0, 0), fov_y=20, width=12, height=12))
    assert gbuffer.covered.any()
    assert not gbuffer.covered.all()
    assert gbuffer.corners.shape == gbuffer.barycentric.shape == (gbuffer.covered.sum(), 3)
    np.testing.assert_allclose(gbuffer.barycentric.sum(axis=-1), 1, atol=1e-6)
    assert gbuffer.barycentric.min() > -1e-6
    corners = surfaces.vertices[gbuffer.corners]
    np.testing.assert_allclose(np.einsum("pk,pkx->px", gbuffer.barycentric, corners), gbuffer.positions, atol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(gbuffer.normals, axis=-1), 1, atol=1e-12)
    smooth = gbuffer.positions / np.linalg.norm(gbuffer.positions, axis=-1, keepdims=True)
    assert np.sum(gbuffer.normals * smooth, axis=-1).min() > 0.999
    assert np.sum(gbuffer.normals * gbuffer.face_normals, axis=-1).min() < 0.99
    assert np.sum(gbuffer.face_normals * gbuffer.omega_o, axis=-1).min() > 0


def test_the_nearest_mesh_is_seen():
    ball = transformed(sphere(0.5, 8), np.array([[1, 0, 0, 0], [0, 1, 0, 0.5], [0, 0, 1, 0], [0, 0, 0, 1]]))
    _, gbuffer = traced([plane((3, 3), 1), ball], Camera((0, 2, 0), (0, 0, 0), (0, 0, -1), width=9, height=9))
    assert gbuffer.covered.all()
    mesh = gbuffer.mesh.reshape(9, 9)
    assert mesh[4, 4] == 1
    assert mesh[0, 0] == 0


def test_shading_normals_that_cancel_give_way_to_the_face():
    """Seen through its middle, the edge between the normals +x and −x has no shading normal."""
    vertices = np.array([[-1.0, 0, 0], [1, 0, 0], [0, 0, -2]])
    mesh = Mesh(vertices, np.array([[0, 1, 2]]), np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0]]))
    camera = Camera((0, 1, -1e-13), (0, 0, -1e-13), (0, 0, -1), fov_y=1e-9, width=1, height=1)
    _, gbuffer = traced([mesh], camera)
    assert gbuffer.covered.all()
    np.testing.assert_allclose(np.linalg.norm(gbuffer.normals, axis=-1), 1, atol=1e-9)


def test_a_camera_that_sees_nothing():
    _, gbuffer = traced([plane()], Camera((0, 1, 0), (0, 2, 0), (0, 0, 1), width=3, height=2))
    assert gbuffer.covered.shape == (2, 3)
    assert not gbuffer.covered.any()
    assert gbuffer.positions.shape == gbuffer.normals.shape == (0, 3)


@pytest.fixture(scope="module")
def bunny():
    path = shared("reference", "bunny_lambert.toml")
    for part in (("mesh", "bunny_mitsuba.ply"), ("env", "blender_sunset.exr")):
        shared("data", *part)
    scene = load_scene(path)
    return scene, traced([part.mesh for part in scene.parts], scene.camera)[1]


def test_the_reference_image_covers_the_same_pixels(bunny):
    _, gbuffer = bunny
    alpha = read_image(shared("reference", "bunny_lambert_b0.exr"))[..., 3]
    assert gbuffer.covered.shape == alpha.shape
    assert (alpha > 0.999).sum() > 10_000
    assert (alpha < 0.001).sum() > 10_000
    assert gbuffer.covered[alpha > 0.999].all()
    assert not gbuffer.covered[alpha < 0.001].any()


def test_the_reference_scene_shows_the_bunny_before_the_floor(bunny):
    scene, gbuffer = bunny
    mesh = np.full(gbuffer.covered.shape, -1)
    mesh[gbuffer.covered] = gbuffer.mesh
    assert scene.parts[0].material == "object"
    assert mesh[128, 128] == 0
    assert set(np.unique(mesh)) == {-1, 0, 1}


def test_footprints_of_a_plane_add_up_to_its_texture():
    """Pixels that cover a whole card cover all of its unit square, however it is turned."""
    card = plane((2, 3), 4)
    for origin in ((0, 3, 0.01), (2, 3, 1), (0.3, 1, -4)):
        _, gbuffer = traced([card], Camera(origin, (0, 0, 0), fov_y=60, width=96, height=96))
        assert not gbuffer.covered[[0, -1]].any()
        assert not gbuffer.covered[:, [0, -1]].any()
        np.testing.assert_allclose(gbuffer.footprint.sum(), 1, rtol=0.04)


def test_footprints_are_finite_at_grazing_and_without_texture_coordinates():
    flat = plane((2, 2), 2)
    assert flat.uv is not None
    pinched = Mesh(flat.vertices, flat.faces, normals=flat.normals, uv=flat.uv * 0)
    camera = Camera((0, 1e-4, 3), (0, 0, 0), width=32, height=33)
    for mesh, largest in ((flat, 1e3), (pinched, 0)):
        _, gbuffer = traced([mesh], camera)
        assert gbuffer.covered.any()
        assert np.isfinite(gbuffer.footprint).all()
        assert 0 <= gbuffer.footprint.min() <= gbuffer.footprint.max() <= largest
