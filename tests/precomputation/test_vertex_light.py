"""What reaches vertices does not depend on which others are asked for."""

import numpy as np

from jaxrelight.precomputation.vertex_light import LitVertices
from tests.precomputation.test_receiver_refinement import room


def test_a_few_vertices_get_what_they_get_among_all():
    scene = room()
    meshes = [part.mesh for part in scene.parts]
    lit = LitVertices(scene.surfaces(), 8, None)
    every = lit.at(scene, meshes, [np.arange(len(mesh.vertices)) for mesh in meshes])
    some = [np.arange(0, len(mesh.vertices), 3) for mesh in meshes]
    for own, light, wanted in zip(some, lit.at(scene, meshes, some), every, strict=True):
        np.testing.assert_allclose(light.values, wanted.values[own], atol=1e-6)
        np.testing.assert_array_equal(light.is_open, wanted.is_open[own])
        np.testing.assert_array_equal(light.enclosed, wanted.enclosed[own])
