"""Plane, sphere and box: closed forms, winding and refusals."""

from typing import Any

import numpy as np
import pytest
import trimesh

from jaxrelight.errors import InputError
from jaxrelight.geometry.mesh import Mesh, bounds, face_normals
from jaxrelight.geometry.primitives import box, plane, sphere

any_plane: Any = plane  # for calls that types alone would refuse
any_sphere: Any = sphere
any_box: Any = box


def welded(mesh: Mesh) -> trimesh.Trimesh:
    """trimesh's view of a mesh, as an outside judge."""
    solid = trimesh.Trimesh(mesh.vertices, mesh.faces, process=False)
    solid.merge_vertices()
    return solid


@pytest.mark.parametrize("mesh", [plane(), plane((2, 3), (1, 5)), sphere(), sphere(2, 1), box(), box((1, 2, 3), 1)])
def test_normals_are_unit_and_on_the_front(mesh):
    np.testing.assert_allclose(np.linalg.norm(mesh.normals, axis=1), 1, atol=1e-12)
    assert (mesh.normals[mesh.faces] * face_normals(mesh)[:, None]).sum(axis=2).min() > 0.5
    np.testing.assert_array_equal(np.unique(mesh.faces), np.arange(len(mesh.vertices)))
    assert mesh.vertices.dtype == mesh.normals.dtype == np.float64
    assert mesh.faces.dtype == np.int64
    assert mesh.notes == ()


def test_plane_has_the_layout_of_the_reference_script():
    n, (sx, sz) = 5, (2.0, 3.0)
    x, z = np.meshgrid(np.linspace(-sx / 2, sx / 2, n + 1), np.linspace(-sz / 2, sz / 2, n + 1), indexing="ij")
    i = (np.arange(n)[:, None] * (n + 1) + np.arange(n)).ravel()
    faces = np.concatenate([np.stack([i, i + 1, i + n + 2], 1), np.stack([i, i + n + 2, i + n + 1], 1)])
    mesh = plane((sx, sz), n)
    np.testing.assert_allclose(mesh.vertices, np.stack([x, 0 * x, z], -1).reshape(-1, 3), atol=1e-15)
    np.testing.assert_array_equal(mesh.faces, faces)
    np.testing.assert_array_equal(mesh.normals, np.tile([0, 1, 0], ((n + 1) ** 2, 1)))


def test_plane_with_two_resolutions_covers_its_rectangle():
    mesh = plane((2, 3), (4, 7))
    assert len(mesh.vertices) == 5 * 8
    assert len(mesh.faces) == 2 * 4 * 7
    np.testing.assert_allclose(welded(mesh).area, 6)
    np.testing.assert_array_equal(bounds(mesh), [[-1, 0, -1.5], [1, 0, 1.5]])


@pytest.mark.parametrize("resolution", [1, 2, 7, 32])
def test_sphere_is_closed_and_converges_to_the_ball(resolution):
    mesh = sphere(2.0, resolution)
    assert len(mesh.vertices) == 6 * resolution**2 + 2
    assert len(mesh.faces) == 12 * resolution**2
    np.testing.assert_allclose(mesh.vertices, 2 * mesh.normals, atol=1e-15)
    solid = welded(mesh)
    assert len(solid.vertices) == len(mesh.vertices)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    missing = 4 / 3 * np.pi * 8 - solid.volume
    assert 0 < missing < 37 / resolution**2
    assert 0 < 16 * np.pi - solid.area < 37 / resolution**2


def test_sphere_triangles_are_near_uniform():
    areas = welded(sphere(0.5, 32)).area_faces
    assert areas.max() / areas.min() < 1.42


@pytest.mark.parametrize("resolution", [1, 3])
def test_box_is_closed_flat_shaded_and_exact(resolution):
    mesh = box((1, 2, 3), resolution)
    assert len(mesh.vertices) == 6 * (resolution + 1) ** 2
    assert len(mesh.faces) == 12 * resolution**2
    np.testing.assert_array_equal(bounds(mesh), [[-0.5, -1, -1.5], [0.5, 1, 1.5]])
    np.testing.assert_array_equal(mesh.normals[mesh.faces[:, 0]], face_normals(mesh))
    solid = welded(mesh)
    assert solid.is_watertight
    assert solid.is_winding_consistent
    np.testing.assert_allclose([solid.volume, solid.area], [6, 22])


@pytest.mark.usefixtures("wrong_types")
@pytest.mark.parametrize(
    "make",
    [
        lambda: any_plane((1, 0)),
        lambda: any_plane((1, 2, 3)),
        lambda: any_plane(1.0),
        lambda: any_plane((1, np.nan)),
        lambda: any_plane((1, "wide")),
        lambda: any_plane(resolution=0),
        lambda: any_plane(resolution=2.5),
        lambda: any_plane(resolution=True),
        lambda: any_plane(resolution="64"),
        lambda: any_plane(resolution=(1, 2, 3)),
        lambda: any_plane(resolution=10**9),
        lambda: any_sphere(-1),
        lambda: any_sphere(np.inf),
        lambda: any_sphere(None),
        lambda: any_sphere(resolution=0),
        lambda: any_sphere(resolution=(4, 4)),
        lambda: any_sphere(resolution=5000),
        lambda: any_box((1, 1)),
        lambda: any_box((1, 1, -1)),
        lambda: any_box(resolution=-3),
        lambda: any_box(resolution=None),
    ],
)
def test_bad_sizes_and_resolutions_are_refused(make):
    with pytest.raises(InputError) as caught:
        make()
    assert "\n" not in str(caught.value)
    assert str(caught.value).split(":")[0] in ("plane", "sphere", "box")


def test_numpy_numbers_are_welcome():
    assert len(plane(np.array([1, 2]), np.array([2, 3])).faces) == 12
    assert len(any_sphere(np.float32(1), np.int32(2)).faces) == 48


@pytest.mark.parametrize("shape", [plane((2, 3), 2), box((1, 2, 3), 2)])
def test_images_lie_on_sides_whole_and_not_mirrored(shape):
    assert shape.uv is not None
    np.testing.assert_array_equal([shape.uv.min(axis=0), shape.uv.max(axis=0)], [[0, 0], [1, 1]])
    corners, uv = shape.vertices[shape.faces], shape.uv[shape.faces]
    assert (np.linalg.det(uv[:, 1:] - uv[:, :1]) > 0).all()
    # v goes up on upright sides, and towards −z on the top.
    edges, rise = corners[:, 1:] - corners[:, :1], (uv[:, 1:] - uv[:, :1])[..., 1]
    up = np.linalg.norm(np.cross(edges[:, 0], edges[:, 1])[:, [0, 2]], axis=1) > 1e-9
    assert ((edges[..., 1] > 1e-9)[up] == (rise > 1e-9)[up]).all()
    top = np.cross(edges[:, 0], edges[:, 1])[:, 1] > 1e-9
    assert ((edges[..., 2] < -1e-9)[top] == (rise > 1e-9)[top]).all()
