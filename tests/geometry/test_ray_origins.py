"""Where rays leave surfaces: no self-hits, no leaks, and no black pixels along the terminator."""

import dataclasses

import numpy as np
import pytest

from jaxrelight.geometry.camera import Camera
from jaxrelight.geometry.gbuffer import GBuffer, trace_gbuffer
from jaxrelight.geometry.mesh import Mesh, transformed
from jaxrelight.geometry.primitives import box, plane, sphere
from jaxrelight.geometry.ray_origins import ray_origins
from jaxrelight.geometry.surfaces import Surfaces, join
from jaxrelight.geometry.tracer import Tracer

CAMERA = Camera((0, 0, 4), (0, 0, 0), fov_y=32.0, width=48, height=48)


def seen(mesh: Mesh, camera: Camera = CAMERA) -> tuple[Surfaces, Tracer, GBuffer]:
    surfaces = join([mesh])
    tracer = Tracer(surfaces)
    return surfaces, tracer, trace_gbuffer(surfaces, tracer, camera)


def hidden(mesh: Mesh, towards: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Of pixels whose shading normal faces a direction, which are hidden from it, and the cosines."""
    surfaces, tracer, points = seen(mesh)
    cosines = points.normals @ towards
    origins = ray_origins(surfaces, tracer, points)[cosines > 0]
    return tracer.occluded(origins, np.broadcast_to(towards, origins.shape)), cosines[cosines > 0]


def turned(mesh: Mesh, seed: int) -> Mesh:
    axes = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    matrix = np.eye(4)
    matrix[:3, :3] = axes * np.sign(np.linalg.det(axes))
    return transformed(mesh, matrix)


@pytest.mark.parametrize("mesh", [plane((2, 2), 1), plane((2, 2), 64), box((1, 2, 1), 3)])
def test_no_face_hides_what_is_above_it(mesh: Mesh):
    for seed in range(4):
        surfaces, tracer, points = seen(turned(mesh, seed))
        origins = ray_origins(surfaces, tracer, points)
        rays = np.random.default_rng(seed).normal(size=origins.shape)
        rays *= np.sign(np.sum(rays * points.normals, axis=1, keepdims=True))
        front = np.sum(points.normals * points.omega_o, axis=1) > 0
        assert not tracer.occluded(origins[front], rays[front]).any()


@pytest.mark.parametrize("gap", [5e-6, 1e-5])
def test_a_thin_sheet_over_a_wide_floor_hides_the_sky(gap: float):
    """One of a centimetre over a floor of two kilometres, and of half as much."""
    sheet = plane((1e-3, 1e-3), 1)
    sheet = dataclasses.replace(sheet, vertices=sheet.vertices + np.array([0, gap, 0]))
    surfaces = join([plane((2, 2), 1), sheet])
    tracer = Tracer(surfaces)
    camera = Camera((0, gap / 2, 0), (0, 0, 0), (0, 0, -1), fov_y=90.0, width=4, height=4)
    points = trace_gbuffer(surfaces, tracer, camera)
    assert (points.mesh == 0).all()
    assert tracer.occluded(ray_origins(surfaces, tracer, points), points.face_normals).all()


@pytest.mark.parametrize("resolution", [6, 12])
def test_a_coarse_ball_has_no_black_pixels_at_its_terminator(resolution: int):
    towards = np.array([-1.0, 0.2, 0.1]) / np.sqrt(1.05)
    ball = sphere(1.0, resolution)
    dark, cosines = hidden(ball, towards)
    assert len(dark) > 300
    assert not dark[cosines > 0.02].any()
    pure, _ = hidden(dataclasses.replace(ball, pure_normals=True), towards)
    assert pure.sum() > 10


def test_flat_faces_and_hollows_are_not_raised():
    hollow = sphere(1.0, 12)
    hollow = dataclasses.replace(hollow, faces=hollow.faces[:, ::-1], normals=-hollow.normals)
    for mesh in (plane((2, 2), 4), box((1, 1, 1), 4), hollow):
        inside = dataclasses.replace(CAMERA, origin=(0, 0.3, 0.2), target=(0.1, -0.5, 0.0))
        surfaces, tracer, points = seen(mesh, inside)
        height = np.linalg.norm(ray_origins(surfaces, tracer, points) - points.positions, axis=1)
        np.testing.assert_allclose(height, surfaces.face_lift[points.face], rtol=1e-6)


def test_what_stands_over_a_face_keeps_its_rays_below():
    """A sheet between the face of a coarse ball and the smooth ball."""
    ball = sphere(1.0, 4)
    surfaces, tracer, points = seen(ball)
    heights = np.linalg.norm(ray_origins(surfaces, tracer, points) - points.positions, axis=1)
    highest = np.argmax(heights)
    place = (points.positions * surfaces.radius + surfaces.centre)[highest]
    above = place + 0.3 * heights[highest] * surfaces.radius * points.face_normals[highest]
    aside = np.cross(points.face_normals[highest], [0.0, 1, 0])
    aside *= 0.05 / np.linalg.norm(aside)
    across = np.cross(points.face_normals[highest], aside)
    corners = above + np.array([-aside - across, aside - across, aside + across, across - aside])
    sheet = Mesh(corners, np.array([[0, 1, 2], [0, 2, 3]]), np.tile(points.face_normals[highest], (4, 1)))
    both = join([ball, sheet])
    covered = Tracer(both)
    kept = np.linalg.norm(ray_origins(both, covered, points) - points.positions, axis=1)
    assert kept[highest] < 0.01 * heights[highest]
    assert covered.occluded(ray_origins(both, covered, points)[[highest]], points.face_normals[[highest]]).all()


def test_the_back_of_a_two_sided_mesh_is_raised_to_its_own_side():
    shell = dataclasses.replace(sphere(1.0, 6), two_sided=True)
    inside = dataclasses.replace(CAMERA, origin=(0, 0.3, 0.2), target=(0.1, -0.5, 0.0))
    surfaces, tracer, points = seen(shell, inside)
    assert points.back.all()
    moved = ray_origins(surfaces, tracer, points) - points.positions
    assert (np.sum(moved * points.face_normals, axis=1) > 0).all()
