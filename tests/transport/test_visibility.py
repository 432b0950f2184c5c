"""One bit a direction, against closed forms and brute force."""

import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.basis import cubemap
from jaxrelight.geometry.mesh import transformed
from jaxrelight.geometry.primitives import box, plane, sphere
from jaxrelight.geometry.surfaces import Surfaces, join
from jaxrelight.geometry.tracer import OFFSET, Tracer
from jaxrelight.transport.bake import unpack
from jaxrelight.transport.visibility import trace_visibility

N = 8
DIRECTIONS = cubemap.directions(N)


def trace(surfaces: Surfaces, positions, normals, face_normals=None) -> tuple[np.ndarray, int]:
    """Visibility [m, d] as booleans, and the number of rays."""
    positions, normals = np.atleast_2d(positions).astype(float), np.atleast_2d(normals).astype(float)
    face_normals = normals if face_normals is None else face_normals
    bits, rays = trace_visibility(Tracer(surfaces), positions + OFFSET * face_normals, normals, DIRECTIONS)
    assert bits.shape == (len(positions), 6 * N * N // 8)
    assert bits.dtype == np.uint8
    return np.unpackbits(bits, axis=-1, bitorder="little").astype(bool), rays


def brute_force(surfaces: Surfaces, origin: np.ndarray, directions: np.ndarray) -> np.ndarray:
    """Whether each ray meets any triangle: Möller and Trumbore's test, all against all."""
    a, b, c = np.moveaxis(surfaces.vertices[surfaces.faces], 1, 0)
    first, second = b - a, c - a
    p = np.cross(directions[:, None], second)
    determinant = np.sum(first * p, axis=-1)
    with np.errstate(divide="ignore", invalid="ignore"):
        u = np.sum((origin - a) * p, axis=-1) / determinant
        q = np.cross(origin - a, first)
        v = np.sum(directions[:, None] * q, axis=-1) / determinant
        t = np.sum(second * q, axis=-1) / determinant
        return ((np.abs(determinant) > 1e-15) & (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0)).any(axis=-1)


def test_a_plane_sees_all_above_it():
    surfaces = join([plane((2, 2), 4)])
    visible, rays = trace(surfaces, surfaces.vertices, surfaces.normals)
    above = DIRECTIONS[:, 1] > 0
    np.testing.assert_array_equal(visible, np.broadcast_to(above, visible.shape))
    assert rays == len(surfaces.vertices) * above.sum()


def test_a_ball_sees_all_above_its_own_normal():
    surfaces = join([sphere(0.5, 6)])
    normals = surfaces.normals[::17]
    # From just outside, so that hollows of the mesh do not matter.
    visible, _ = trace(surfaces, 1.05 * surfaces.vertices[::17], normals)
    height = normals @ DIRECTIONS.T
    sure = np.abs(height) > 1e-6
    np.testing.assert_array_equal(visible[sure], height[sure] > 0)


def test_inside_a_box_nothing_is_seen():
    surfaces = join([box((2, 2, 2), 2)])
    normals = np.random.default_rng(0).normal(size=(6, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    positions = np.random.default_rng(1).uniform(-0.9, 0.9, size=(6, 3))
    visible, rays = trace(surfaces, positions, normals)
    assert not visible.any()
    assert rays == (normals @ DIRECTIONS.T > 0).sum()
    inwards, _ = trace(surfaces, surfaces.vertices[:9], -surfaces.normals[:9])
    assert not inwards.any()


def test_is_the_brute_force_answer():
    ball = transformed(sphere(0.4, 4), np.array([[1, 0, 0, 0.1], [0, 1, 0, 0.5], [0, 0, 1, 0.05], [0, 0, 0, 1]]))
    wall = transformed(plane((1, 1), 2), np.array([[0, -1, 0, -0.7], [1, 0, 0, 0.3], [0, 0, 1, 0], [0, 0, 0, 1]]))
    surfaces = join([plane((2, 2), 3), ball, wall])
    chosen = np.arange(0, len(surfaces.vertices), 9)
    positions, normals = surfaces.vertices[chosen], surfaces.normals[chosen]
    visible, _ = trace(surfaces, positions, normals)
    height = normals @ DIRECTIONS.T
    free = [~brute_force(surfaces, origin, DIRECTIONS) for origin in positions + OFFSET * normals]
    expected = (height > 0) & np.array(free)
    assert 0.1 < expected.mean() < 0.5
    assert expected.sum() < 0.8 * (height > 0).sum()
    # In float32 directions along the surface, and rays through an edge of a triangle, may be judged otherwise.
    assert np.mean((visible != expected)[np.abs(height) > 1e-6]) < 1e-3


def test_directions_above_the_shading_normal_but_below_the_surface_hit_it():
    surfaces = join([plane((2, 2), 1)])
    tilted = np.array([[0.6, 0.8, 0]])
    visible, _ = trace(surfaces, [[0.1, 0, 0.2]], tilted, np.array([[0.0, 1, 0]]))
    np.testing.assert_array_equal(visible[0], (DIRECTIONS @ tilted[0] > 0) & (DIRECTIONS[:, 1] > 0))


def test_origins_are_lifted_along_the_face_normal_even_where_the_shading_normal_points_into_the_surface():
    surfaces = join([plane((2, 2), 1)])
    inwards = np.array([[0.8, -0.6, 0]])
    visible, _ = trace(surfaces, [[-0.1, 0, 0.2]], inwards, np.array([[0.0, 1, 0]]))
    np.testing.assert_array_equal(visible[0], (DIRECTIONS @ inwards[0] > 0) & (DIRECTIONS[:, 1] > 0))
    assert visible.any()


def test_a_normal_without_direction_sees_nothing_and_traces_nothing():
    visible, rays = trace(join([plane()]), [[0, 0, 0]], [[0, 0, 0]], np.array([[0.0, 1, 0]]))
    assert rays == 0
    assert not visible.any()


def test_first_direction_is_the_lowest_bit():
    """As `bake.unpack` reads it."""
    surfaces = join([plane((2, 2), 1)])
    up = np.array([[0.0, 1, 0]])
    bits, _ = trace_visibility(Tracer(surfaces), OFFSET * up, up, DIRECTIONS)
    np.testing.assert_array_equal(unpack(jnp.asarray(bits), jnp.float32)[0], DIRECTIONS[:, 1] > 0)
    np.testing.assert_array_equal(unpack(jnp.asarray([1, 128], jnp.uint8), jnp.float32), np.eye(16)[0] + np.eye(16)[15])


@pytest.mark.parametrize(("scale", "offset"), [(1e-3, 0.0), (1e6, 0.0), (1.0, 1e6)])
def test_scale_and_place_of_the_world_change_next_to_nothing(scale, offset):
    meshes = [plane((2, 2), 3), sphere(0.4, 4)]
    matrix = np.diag([scale, scale, scale, 1.0])
    matrix[:3, 3] = [offset, -offset, offset]
    here, there = join(meshes), join([transformed(mesh, matrix) for mesh in meshes])
    one, _ = trace(here, here.vertices, here.normals)
    other, _ = trace(there, there.vertices, there.normals)
    assert np.mean(one != other) < 1e-3
