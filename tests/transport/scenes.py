"""A scene that several tests precompute, in shapes that they share."""

import numpy as np

import jaxrelight as jr
from jaxrelight import Part, Scene
from jaxrelight.geometry import mesh as meshes


def ball_on_floor() -> Scene:
    """A glossy object of two terms on a diffuse floor."""
    raised = np.eye(4)
    raised[1, 3] = 0.4
    ball = meshes.transformed(jr.sphere(0.35, 4), raised)
    parts = [Part(jr.plane((2, 2), 4), "floor"), Part(ball, "lacquer")]
    materials = {"floor": jr.lambert([0.7, 0.6, 0.5]), "lacquer": jr.phong(0.3, 0.4, 6.0)}
    return Scene(parts, materials, jr.Camera((0.5, 1.2, 2), (0, 0.2, 0), fov_y=50, width=20, height=16))
