import dataclasses

import numpy as np
import pytest

from jaxrelight import InputError, box, plane, sphere
from jaxrelight.geometry.mesh import Mesh
from jaxrelight.geometry.subdivision import subdivided


def lengths(mesh: Mesh) -> np.ndarray:
    corners = mesh.vertices[mesh.faces]
    return np.linalg.norm(corners - np.roll(corners, -1, axis=1), axis=-1)


def area_vectors(mesh: Mesh) -> np.ndarray:
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    return np.cross(b - a, c - a) / 2


def volume(mesh: Mesh) -> float:
    a, b, c = np.moveaxis(mesh.vertices[mesh.faces], 1, 0)
    return float(np.sum(a * np.cross(b, c)) / 6)


def uneven() -> Mesh:
    """Faces of many shapes and sizes, so that one, two and three edges are halved."""
    mesh = sphere(1.0, 8)
    return dataclasses.replace(mesh, vertices=mesh.vertices * [3, 1, 0.2], uv=mesh.vertices[:, :2])


@pytest.mark.parametrize("max_edge", [0.5, 0.2, 0.07])
def test_the_surface_stays_and_no_edge_is_longer(max_edge):
    mesh = uneven()
    finer = subdivided(mesh, max_edge)
    assert lengths(finer).max() <= max_edge
    assert len(finer.faces) > len(mesh.faces)
    np.testing.assert_allclose(area_vectors(finer).sum(axis=0), area_vectors(mesh).sum(axis=0), atol=1e-12)
    area = [np.linalg.norm(area_vectors(m), axis=-1).sum() for m in (mesh, finer)]
    np.testing.assert_allclose(*area, rtol=1e-12)
    np.testing.assert_allclose(volume(finer), volume(mesh), rtol=1e-12)
    np.testing.assert_allclose(np.linalg.norm(finer.normals, axis=-1), 1, atol=1e-12)
    # Texture coordinates were linear in position, and stay so.
    assert finer.uv is not None
    np.testing.assert_allclose(finer.uv, finer.vertices[:, :2] / [3, 1], atol=1e-12)


def test_neighbours_share_the_new_vertices():
    """Every edge of a closed surface still has two faces, in opposite directions: no crack, no T-junction."""
    mesh = box((1.0, 2.0, 0.3), 1)
    # The box's sides have vertices of their own; join them by position.
    places, inverse = np.unique(mesh.vertices.round(9), axis=0, return_inverse=True)
    joined = Mesh(places, inverse.reshape(-1)[mesh.faces], np.ones_like(places) / np.sqrt(3))
    finer = subdivided(joined, 0.37)
    directed = np.stack([finer.faces, np.roll(finer.faces, -1, axis=1)], axis=-1).reshape(-1, 2)
    assert len(np.unique(directed, axis=0)) == len(directed)
    np.testing.assert_array_equal(np.unique(directed, axis=0), np.unique(directed[:, ::-1], axis=0))


def test_small_faces_stay_as_they_are():
    mesh = plane((1.0, 1.0), 8)
    same = subdivided(mesh, 0.5)
    np.testing.assert_array_equal(same.vertices, mesh.vertices)
    np.testing.assert_array_equal(same.faces, mesh.faces)


@pytest.mark.parametrize("max_edge", [0, -1.0, float("nan"), float("inf")])
def test_lengths_that_are_none_are_refused(max_edge):
    with pytest.raises(InputError, match="max_edge"):
        subdivided(plane(), max_edge)


def test_too_many_faces_are_refused():
    with pytest.raises(InputError, match="choose a larger"):
        subdivided(plane((1.0, 1.0), 1), 1e-5)


def test_all_coordinates_and_colours_are_interpolated():
    flat = plane((2.0, 2.0), 1)
    assert flat.uv is not None
    coordinates = np.concatenate([flat.uv, 1 - flat.uv], axis=1)
    wide = dataclasses.replace(flat, uv=coordinates, colours=flat.vertices / 2 + 0.5)
    fine = subdivided(wide, 0.5)
    assert fine.uv is not None
    assert fine.colours is not None
    np.testing.assert_allclose(fine.uv[:, 2:], 1 - fine.uv[:, :2])
    np.testing.assert_allclose(fine.colours, fine.vertices / 2 + 0.5)
