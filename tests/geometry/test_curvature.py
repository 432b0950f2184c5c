"""Curvature in the image: closed forms, and what edges must not add."""

import numpy as np
import pytest

from jaxrelight import Camera, Part, Scene, lambert, plane, sphere
from jaxrelight.geometry.curvature import curvature
from jaxrelight.geometry.gbuffer import trace_gbuffer
from jaxrelight.geometry.primitives import box
from jaxrelight.geometry.tracer import Tracer

CAMERA = Camera((0.0, 1.0, 6.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 30.0, 64, 64)


def curvature_of(mesh):
    surfaces = Scene([Part(mesh, "skin")], {"skin": lambert(0.5)}, CAMERA, name="one").surfaces()
    return curvature(trace_gbuffer(surfaces, Tracer(surfaces), CAMERA), surfaces.radius)


@pytest.mark.parametrize("radius", [0.5, 1.3])
def test_of_a_sphere_it_is_one_over_its_radius(radius: float):
    curvatures = curvature_of(sphere(radius, 64))
    np.testing.assert_allclose(np.median(curvatures), 1 / radius, rtol=0.03)
    assert curvatures.max() < 2 / radius


def test_of_planes_and_their_edges_it_is_nothing():
    assert np.abs(curvature_of(plane([2, 2]))).max() < 1e-6
    assert np.mean(curvature_of(box([1, 1, 1])) > 1e-3) < 0.02


def test_of_some_points_it_is_theirs():
    surfaces = Scene([Part(sphere(0.5, 24), "skin")], {"skin": lambert(0.5)}, CAMERA, name="one").surfaces()
    gbuffer = trace_gbuffer(surfaces, Tracer(surfaces), CAMERA)
    some = np.array([5, 300, 2, 2])
    np.testing.assert_array_equal(curvature(gbuffer, 2.0, some), curvature(gbuffer, 2.0)[some])
