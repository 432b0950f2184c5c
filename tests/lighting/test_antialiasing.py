"""Joining samples and pixels: on a flat wall all is as it was; across an edge nothing leaks."""

import dataclasses

import jax.numpy as jnp
import numpy as np

import jaxrelight as jr
from jaxrelight.geometry.gbuffer import trace_gbuffer
from jaxrelight.geometry.surfaces import join
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.lighting.antialiasing import joined, nearest_pixels

CAMERA = jr.Camera((0.05, 0.07, 3), (0, 0, 0), fov_y=40.0, width=20, height=16)


def upright(size: float, z: float) -> jr.Mesh:
    plane = jr.plane((size, size), 2)
    turn = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])
    return dataclasses.replace(plane, vertices=plane.vertices @ turn.T + [0, 0, z], normals=plane.normals @ turn.T)


def seen(meshes, factor: int = 2):
    surfaces = join(meshes)
    tracer = Tracer(surfaces)
    finer = dataclasses.replace(CAMERA, width=factor * CAMERA.width, height=factor * CAMERA.height)
    coarse, fine = (trace_gbuffer(surfaces, tracer, camera) for camera in (CAMERA, finer))
    angle = 2 * np.tan(np.radians(CAMERA.fov_y) / 2) / CAMERA.height
    return coarse, fine, nearest_pixels(fine, coarse, surfaces.to_scene(CAMERA.origin), angle)


def test_on_a_wall_each_sample_has_its_own_pixel():
    _, fine, nearest = seen([upright(20, 0)])
    assert fine.covered.all()
    np.testing.assert_array_equal(nearest, np.arange(320).reshape(16, 20).repeat(2, 0).repeat(2, 1))
    image = jnp.asarray(np.random.default_rng(0).uniform(size=(16, 20, 3)), jnp.float32)
    np.testing.assert_allclose(joined(jnp.ones((32, 40, 3)), image, jnp.asarray(nearest)), 1 + image, rtol=1e-6)


def test_nothing_leaks_across_edges():
    """A square before a wall: its samples take pixels of the square, and the wall's those of the wall."""
    coarse, fine, nearest = seen([upright(20, 0), upright(0.8, 0.5)])
    of_pixel = np.zeros(coarse.covered.size, int)
    of_pixel[coarse.covered.reshape(-1)] = coarse.mesh
    mine = nearest[fine.covered]
    crossing = mine != np.arange(320).reshape(16, 20).repeat(2, 0).repeat(2, 1)[fine.covered]
    assert crossing.any()
    np.testing.assert_array_equal(of_pixel[mine], fine.mesh)


def test_where_nothing_is_seen_there_is_nothing():
    coarse, fine, nearest = seen([upright(0.8, 0)])
    assert (nearest[~fine.covered] == -1).all()
    image = np.asarray(joined(jnp.zeros((32, 40, 3)), jnp.ones((16, 20, 3)), jnp.asarray(nearest)))
    share = fine.covered.reshape(16, 2, 20, 2).mean(axis=(1, 3))
    np.testing.assert_allclose(image[..., 0], share * (image[..., 0] > 0), atol=1e-6)
    assert (image[coarse.covered] > 0).all()


def test_more_samples_a_pixel():
    *_, nearest = seen([upright(20, 0)], 3)
    assert nearest.shape == (48, 60)
    assert joined(jnp.ones((48, 60, 3)), jnp.ones((16, 20, 3)), jnp.asarray(nearest)).shape == (16, 20, 3)
