"""Points that stand for surfaces: as many everywhere as their area, or importance, asks for."""

import dataclasses

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import InputError
from jaxrelight.gather.gather_cloud import gather_cloud
from jaxrelight.geometry.mesh import with_back
from jaxrelight.geometry.surfaces import join


def total_area(surfaces) -> float:
    corners = surfaces.vertices[surfaces.faces]
    return np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum() / 2


@pytest.fixture(scope="module")
def surfaces():
    return join([jr.sphere(0.5, 6), jr.plane((3, 2), 5)])


@pytest.mark.parametrize("count", [64, 1024])
def test_areas_are_those_of_the_surfaces(surfaces, count):
    cloud = gather_cloud(surfaces, count)
    np.testing.assert_allclose(cloud.areas, total_area(surfaces) / count)
    assert cloud.side**2 == count == len(cloud.positions)


def test_points_lie_on_their_faces(surfaces):
    cloud = gather_cloud(surfaces, 1024)
    corners = surfaces.vertices[surfaces.faces[cloud.faces]]
    np.testing.assert_allclose(cloud.positions, np.einsum("pk,pkx->px", cloud.barycentric, corners), atol=1e-12)
    assert cloud.barycentric.min() >= 0
    np.testing.assert_allclose(cloud.barycentric.sum(axis=1), 1)
    np.testing.assert_allclose(np.linalg.norm(cloud.normals, axis=1), 1)
    assert (np.sum(cloud.normals * cloud.face_normals, axis=1) > 0.5).all()
    assert not cloud.back.any()


def test_large_triangles_have_their_share_spread_out():
    """One point more or less than the area asks for; no worse spread than a jittered grid."""
    cloud = gather_cloud(join([jr.plane((2, 1), 1)]), 4096)
    assert np.abs(np.bincount(cloud.faces) - 2048).max() <= 32
    inside = (cloud.positions[:, [0, 2]] * [1, 2] + 1) / 2
    counts, *_ = np.histogram2d(*inside.T, bins=(16, 16), range=[[0, 1], [0, 1]])
    # Points at random have a variance of 16.
    assert counts.var() < 6


def test_small_triangles_share_points(surfaces):
    """Where triangles are many more than points, any half of the scene has its share."""
    fine = join([jr.plane((2, 2), 64)])
    cloud = gather_cloud(fine, 64)
    for axis in (0, 2):
        for at in (-0.5, 0, 0.5):
            assert abs(np.mean(cloud.positions[:, axis] < at) - (at + 1) / 2) <= 0.1


def test_importance_asks_for_more_points(surfaces):
    """Three times the density where importance is three times as high, and each stands for a third of the area."""

    def worth(positions, normals, areas):
        np.testing.assert_allclose(areas.sum(), total_area(surfaces))
        np.testing.assert_allclose(np.linalg.norm(normals, axis=1), 1)
        return np.where(positions[:, 0] > 0, 3.0, 1.0)

    cloud = gather_cloud(surfaces, 4096, worth)
    right = cloud.positions[:, 0] > 0.05
    left = cloud.positions[:, 0] < -0.05
    assert cloud.areas[left].mean() / cloud.areas[right].mean() == pytest.approx(3)
    assert np.mean(right) == pytest.approx(3 * np.mean(left), rel=0.03)
    assert cloud.areas.sum() == pytest.approx(total_area(surfaces), rel=1e-2)


def test_backs_are_surfaces_too():
    mesh = with_back(jr.plane((1, 1), 2))
    cloud = gather_cloud(join([mesh]), 256)
    assert np.mean(cloud.back) == pytest.approx(0.5, abs=0.01)
    np.testing.assert_allclose(cloud.normals[:, 1], np.where(cloud.back, -1, 1))
    np.testing.assert_allclose(cloud.face_normals, cloud.normals, atol=1e-12)


def test_seeds(surfaces):
    one, same, other = (gather_cloud(surfaces, 256, seed=seed) for seed in (0, 0, 1))
    for field in dataclasses.fields(one):
        np.testing.assert_array_equal(getattr(one, field.name), getattr(same, field.name))
    assert np.abs(one.positions - other.positions).max() > 1e-3


@pytest.mark.parametrize("count", [0, 1, 16, 128, 1000, 32768])
def test_other_counts_are_refused(surfaces, count):
    with pytest.raises(InputError, match=f"gather samples are {count:,}; they must be a power of four"):
        gather_cloud(surfaces, count)


def test_a_face_without_area_gets_no_point():
    mesh = jr.plane((1, 1), 1)
    flat = dataclasses.replace(mesh, faces=np.concatenate([mesh.faces, [[0, 0, 1]]]))
    assert gather_cloud(join([flat]), 64).faces.max() <= 1
