"""Rays against triangles."""

import concurrent.futures

import numpy as np
import pytest
import trimesh

from jaxrelight.errors import InputError
from jaxrelight.geometry.mesh import Mesh, transformed
from jaxrelight.geometry.primitives import box, plane, sphere
from jaxrelight.geometry.surfaces import Surfaces, join
from jaxrelight.geometry.tracer import OFFSET, Tracer


def unit(vectors) -> np.ndarray:
    return vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)


def random_directions(count: int, seed: int = 0) -> np.ndarray:
    return unit(np.random.default_rng(seed).normal(size=(count, 3)))


def moved(mesh: Mesh, offset, scale: float = 1.0) -> Mesh:
    matrix = np.diag([scale, scale, scale, 1.0])
    matrix[:3, 3] = offset
    return transformed(mesh, matrix)


def points_on(surfaces: Surfaces, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Random points, corners and edges among them, and the normals of their faces."""
    rng = np.random.default_rng(0)
    face = rng.integers(len(surfaces.faces), size=count)
    weight = rng.dirichlet([1, 1, 1], size=count)
    weight[: count // 8] = [1, 0, 0]
    weight[count // 8 : count // 4] = [0.5, 0, 0.5]
    corners = surfaces.vertices[surfaces.faces[face]]
    return np.einsum("pk,pkx->px", weight, corners), surfaces.face_normals(face)


def rays_above(normals: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Random directions above a surface, directions that graze it, and its normals."""
    directions = random_directions(len(normals))
    directions[np.sum(directions * normals, axis=-1) < 0] *= -1
    return directions, unit(np.cross(directions, normals) + 1e-3 * normals), normals


def icosphere() -> Mesh:
    """A sphere whose mesh is convex."""
    solid = trimesh.creation.icosphere(3, 0.5)
    return Mesh(np.array(solid.vertices), np.array(solid.faces), np.array(solid.vertex_normals))


PLACED = {
    "plane": plane((2, 3), 20),
    "box": box((1, 2, 3), 5),
    "sphere": icosphere(),
    "sphere far away": moved(icosphere(), [1e6, -1e6, 1e6]),
    "large tilted plane": transformed(
        plane((1, 1), 9), np.array([[600, -800, 0, 5e5], [800, 600, 0, 0], [0, 0, 1000, -5e5], [0, 0, 0, 1]])
    ),
}


@pytest.mark.parametrize("name", PLACED)
def test_lifted_rays_do_not_hit_their_own_surface(name):
    """All of these are convex, so nothing lies above any of their faces, grazing directions included."""
    surfaces = join([PLACED[name]])
    tracer = Tracer(surfaces)
    origins, normals = points_on(surfaces, 4000)
    for rays in rays_above(normals):
        assert tracer.occluded(origins + OFFSET * normals, rays).sum() == 0


def test_what_lifted_rays_hit_on_our_own_sphere_they_hit_from_the_front():
    """Its quads are folded along one diagonal, so a few folds are hollow and rightly occlude."""
    surfaces = join([sphere(0.5, 12)])
    tracer = Tracer(surfaces)
    origins, normals = points_on(surfaces, 4000)
    for rays, most in zip(rays_above(normals), (0.01, 0.2, 0), strict=True):
        face, _ = tracer.first_hits(origins + OFFSET * normals, rays)
        hit = face >= 0
        assert hit.mean() <= most
        assert (np.sum(surfaces.face_normals(face[hit]) * rays[hit], axis=-1) < 0).all()


def test_rays_into_a_surface_hit_it():
    surfaces = join([PLACED["sphere"]])
    origins, normals = points_on(surfaces, 1000)
    assert Tracer(surfaces).occluded(origins + OFFSET * normals, -normals).all()


def test_occlusion_by_a_sphere_is_the_analytic_one():
    """But for rays that pass between the sphere of the mesh's vertices and the one inside all its faces."""
    surfaces = join([sphere(0.5, 24), moved(plane((2, 2), 1), [0, -1, 0])])
    outer = 0.5 / surfaces.radius
    centre = surfaces.to_scene(np.zeros(3))
    corners = surfaces.vertices[surfaces.faces[: 12 * 24**2]] - centre
    inner = np.abs(
        np.sum(unit(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])) * corners[:, 0], -1)
    )
    assert 0.99 * outer < inner.min() < outer
    origins = np.random.default_rng(1).uniform(-0.9, 0.9, size=(4000, 3))
    floor = surfaces.to_scene(np.array([0, -1, 0]))[1]
    origins = origins[(np.linalg.norm(origins - centre, axis=-1) > outer + 0.01) & (origins[:, 1] > floor)]
    directions = random_directions(len(origins))
    directions[:, 1] = np.abs(directions[:, 1])
    to_centre = centre - origins
    along = np.sum(to_centre * directions, axis=-1)
    distance = np.linalg.norm(to_centre - along[:, None] * directions, axis=-1)
    sure = (along < 0) | (distance < inner.min()) | (distance > outer)
    expected = (along > 0) & (distance < outer)
    occluded = Tracer(surfaces).occluded(origins, directions)
    assert occluded.dtype == bool
    assert 0.05 < expected.mean() < 0.95
    assert sure.mean() > 0.95
    np.testing.assert_array_equal(occluded[sure], expected[sure])


def test_first_hits_give_the_nearest_face_and_the_point_on_it():
    lower, upper = plane((2, 2), 4), moved(plane((1, 1), 3), [0, 0.5, 0])
    surfaces = join([lower, upper])
    scene = surfaces.to_scene
    targets = np.array([[0.1, 0.5, 0.2], [-0.4, 0.5, 0.4], [0.7, 0, 0.3], [-0.9, 0, -0.8]])
    origins = targets + np.array([0.02, 1, -0.03])
    directions = unit(targets - origins)
    face, weights = Tracer(surfaces).first_hits(scene(origins), directions)
    assert (face >= 0).all()
    np.testing.assert_allclose(weights.sum(axis=-1), 1, atol=1e-6)
    points = np.einsum("pk,pkx->px", weights, surfaces.vertices[surfaces.faces[face]])
    np.testing.assert_allclose(points, scene(targets), atol=1e-6)
    np.testing.assert_array_equal(face >= len(lower.faces), [True, True, False, False])


def test_first_hits_mark_rays_that_miss():
    surfaces = join([plane()])
    face, weights = Tracer(surfaces).first_hits(np.array([[0, 1, 0], [5, 1, 0]]), np.array([[0, 1, 0], [0, -1, 0]]))
    np.testing.assert_array_equal(face, [-1, -1])
    assert weights.shape == (2, 3)


def test_both_sides_of_a_surface_occlude():
    tracer = Tracer(join([plane()]))
    np.testing.assert_array_equal(
        tracer.occluded(np.array([[0, 1, 0], [0, -1, 0]]), np.array([[0, -1, 0], [0, 1, 0]])), [True, True]
    )


def test_rays_without_end_are_traced_to_the_end():
    surfaces = join([box((1e6, 1e6, 1e6), 1), sphere(1, 4)])
    assert Tracer(surfaces).occluded(np.zeros((100, 3)), random_directions(100)).all()
    origins = np.array([[0, 1e4, 0], [5, 1e4, 0]])
    face, _ = Tracer(surfaces).first_hits(origins, np.array([[0, -1.0, 0], [0, -1, 0]]))
    np.testing.assert_array_equal(face >= 0, [True, False])


@pytest.mark.usefixtures("wrong_types")
@pytest.mark.parametrize(
    ("origins", "directions"),
    [((4, 3), (3, 3)), ((3, 3), (4, 3)), ((3,), (3,)), ((4, 2), (4, 2)), ((1, 3), (4, 3)), ((2, 2, 3), (2, 2, 3))],
)
def test_other_shapes_are_refused(origins, directions):
    tracer = Tracer(join([plane()]))
    for query in (tracer.occluded, tracer.first_hits):
        with pytest.raises(ValueError, match="equal shapes"):
            query(np.zeros(origins), np.ones(directions))


def test_no_rays_at_all_is_no_error():
    assert Tracer(join([plane()])).occluded(np.zeros((0, 3)), np.zeros((0, 3))).shape == (0,)


def test_answers_do_not_depend_on_threads():
    surfaces = join([sphere(0.5, 12), plane((2, 2), 4)])
    tracer = Tracer(surfaces)
    rays = [(np.random.default_rng(i).uniform(-1, 1, (500, 3)), random_directions(500, i)) for i in range(8)]
    expected = [tracer.occluded(*pair) for pair in rays]
    with concurrent.futures.ThreadPoolExecutor(4) as pool:
        occluded = list(pool.map(lambda pair: tracer.occluded(*pair), rays))
    np.testing.assert_array_equal(occluded, expected)


@pytest.mark.parametrize(("scale", "offset"), [(1e-3, 0), (1e6, 0), (1, 1e6), (1e-3, 10.0)])
def test_scale_and_place_of_the_world_change_nothing(scale, offset):
    meshes = [sphere(0.5, 6), moved(plane((2, 2), 2), [0, -0.5, 0])]
    here = join(meshes)
    there = join([moved(mesh, [offset, -offset, offset], scale) for mesh in meshes])
    np.testing.assert_allclose(there.vertices, here.vertices, atol=1e-9)
    np.testing.assert_allclose(there.radius, scale * here.radius, rtol=1e-9)
    assert np.abs(here.vertices).max() == 1
    world = np.array([[0.3, 0.1, -0.2]])
    np.testing.assert_allclose(
        there.to_scene(scale * world + [offset, -offset, offset]), here.to_scene(world), atol=1e-6
    )


def test_join_numbers_vertices_and_meshes_through():
    one, other = plane(resolution=1), box(resolution=1)
    surfaces = join([one, other])
    np.testing.assert_array_equal(surfaces.faces[len(one.faces) :], other.faces + len(one.vertices))
    np.testing.assert_array_equal(surfaces.mesh_of_vertex, np.repeat([0, 1], [len(one.vertices), len(other.vertices)]))
    np.testing.assert_allclose(np.linalg.norm(surfaces.face_normals(np.arange(14)), axis=-1), 1, atol=1e-12)


def test_scenes_of_nothing_are_refused():
    with pytest.raises(InputError, match="no mesh"):
        join([])
    point = Mesh(np.ones((3, 3)), np.array([[0, 1, 2]]), np.tile([0.0, 1, 0], (3, 1)))
    with pytest.raises(InputError, match="no size"):
        join([point])


@pytest.mark.parametrize("turn", range(3))
@pytest.mark.parametrize("height", [1.0, -1.0])
def test_a_face_and_its_reverse_are_met_from_the_front(turn: int, height: float):
    """From above it is the one, from below the other, with the weights of its own corners."""
    vertices = np.array([[-1.0, 0, -1], [-1, 0, 1], [1, 0, -1]])
    reverse = np.roll([2, 1, 0], turn)
    sheet = Mesh(vertices, np.array([[0, 1, 2], reverse]), np.tile([0.0, 1, 0], (3, 1)))
    surfaces = join([sheet])
    places = np.array([[-0.5, height, -0.2], [-0.9, height, 0.7], [0.2, height, -0.6]])
    rays = np.tile([0.0, -np.sign(height), 0], (3, 1))
    face, weights = Tracer(surfaces).first_hits(places, rays)
    assert (face == (0 if height > 0 else 1)).all()
    hits = np.einsum("rk,rkx->rx", weights, surfaces.vertices[surfaces.faces[face]])
    np.testing.assert_allclose(hits, places * [1, 0, 1], atol=1e-6)
