"""Surface coordinates of several meshes: sets of texture coordinates, their areas, and colours."""

import dataclasses

import numpy as np

from jaxrelight import plane
from jaxrelight.geometry.surfaces import join


def test_plain_meshes_have_u_and_v_alone():
    surfaces = join([plane((1, 1), 2), dataclasses.replace(plane((1, 1), 2), uv=None)])
    assert surfaces.uv.shape == (18, 2)
    assert not surfaces.uv[9:].any()


def test_sets_and_colours_of_one_mesh_leave_the_others_plain():
    flat = plane((2, 2), 2)
    assert flat.uv is not None
    colours = np.tile([0.2, 0.4, 0.6], (9, 1))
    wide = dataclasses.replace(flat, uv=np.concatenate([flat.uv, 3 * flat.uv], axis=1), colours=colours)
    uv = join([flat, wide]).uv
    assert uv.shape == (18, 8)
    np.testing.assert_array_equal(uv[:9], np.column_stack([flat.uv, np.zeros((9, 3)), np.ones((9, 3))]))
    np.testing.assert_allclose(uv[9:], np.column_stack([flat.uv, 3 * flat.uv, np.full(9, 9.0), colours]))


def test_areas_are_of_the_second_set_where_there_is_no_first():
    flat = plane((2, 2), 1)
    assert flat.uv is not None
    surfaces = join([dataclasses.replace(flat, uv=np.concatenate([0 * flat.uv, flat.uv], axis=1))])
    covered = 0.1 * surfaces.uv_densities(np.arange(2))
    np.testing.assert_allclose(covered[0] * surfaces.uv[:, 4], 0.1 / 4)  # the plane has an area of 4 in scene space


def test_growing_u_of_any_coordinates():
    flat = plane((2, 2), 1)
    assert flat.uv is not None
    surfaces = join([flat])
    turned = np.column_stack([-flat.uv[:, 1], flat.uv[:, 0]])
    np.testing.assert_allclose(surfaces.u_axes_along(flat.uv), surfaces.u_axes)
    # v of the turned coordinates grows as u did, and −v as u does.
    axes = surfaces.u_axes_along(turned)
    across = axes[:, 3:] * np.cross(surfaces.normals, axes[:, :3])
    np.testing.assert_allclose(across, surfaces.u_axes[:, :3], atol=1e-12)
