"""Vertices inside closed surfaces are found, and take no part in what lies between vertices."""

import dataclasses

import numpy as np

import jaxrelight as jr
from jaxrelight.geometry.enclosed_vertices import enclosed_vertices, weights_in_the_open
from jaxrelight.geometry.receivers import lifted_vertices
from jaxrelight.geometry.surfaces import Surfaces, join
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.lighting.transport import TransportRelighter


def found(surfaces: Surfaces) -> np.ndarray:
    return enclosed_vertices(surfaces, Tracer(surfaces), *lifted_vertices(surfaces))


def at(mesh: jr.Mesh, *place: float) -> jr.Mesh:
    matrix = np.eye(4)
    matrix[:3, 3] = place
    return jr.transformed(mesh, matrix)


def test_those_of_a_sphere_inside_a_box_are_found():
    box, sphere = jr.box([1, 1, 1]), at(jr.sphere(0.5, 12), 0.51, 0.03, 0.02)
    inside = (np.abs(sphere.vertices) < 0.5).all(axis=1)
    assert 10 < inside.sum() < len(inside) - 10
    enclosed = found(join([box, sphere]))
    np.testing.assert_array_equal(enclosed[len(box.vertices) :], inside)
    # Vertices of the box are inside the sphere, too.
    within = np.linalg.norm(box.vertices - [0.51, 0.03, 0.02], axis=1)
    assert enclosed[: len(box.vertices)][within < 0.48].all()
    assert not enclosed[: len(box.vertices)][within > 0.5].any()


def test_crevices_and_open_surfaces_enclose_nothing():
    # A gap as narrow as a thousandth, which is dark.
    plates = [at(jr.box([1, 0.1, 1]), 0, y, 0) for y in (0, 0.101)]
    assert not found(join(plates)).any()
    box, card = jr.box([1, 1, 1]), dataclasses.replace(jr.plane((0.2, 0.2), 1), two_sided=True)
    assert not found(join([dataclasses.replace(box, two_sided=True), card])).any()
    # Both sides of a card in a closed box are enclosed.
    expected = [False] * len(box.vertices) + [True] * 2 * len(card.vertices)
    np.testing.assert_array_equal(found(join([box, card])), expected)


def test_weights_are_of_those_outside():
    weights, corners = (
        np.array([[0.2, 0.3, 0.5], [0.2, 0.3, 0.5], [0, 0, 1]]),
        np.array([[0, 1, 2], [3, 1, 2], [3, 3, 2]]),
    )
    enclosed = np.array([False, False, True, True])
    expected = [[0.4, 0.6, 0], [0, 1, 0], [0, 0, 1]]
    np.testing.assert_allclose(weights_in_the_open(weights, corners, enclosed), expected)


def test_a_pillar_that_stands_in_the_ground_is_not_darkened(tmp_path):
    """Its lower vertices are inside the ground, and what is seen of it lies between them and the upper ones."""
    ground, pillar = jr.box([2, 1, 2], 16), at(jr.box([0.4, 2, 0.4], 1), 0, 1, 0)
    scene = jr.Scene(
        [jr.Part(ground, "black"), jr.Part(pillar, "paper")],
        {"black": jr.lambert(0.0), "paper": jr.lambert(0.5)},
        jr.Camera((1.5, 2.0, 3.0), (0, 1, 0), fov_y=45, width=24, height=24),
    )
    # Light from the side, above the ground.
    pixels, errors = np.zeros((8, 16, 3)), []
    pixels[2:4, 7:9] = 1
    sky = jr.environment(pixels)
    method = jr.Transport(resolution=8, coefficients="all", receiver_tolerance=0)
    exact = jr.prepare(scene, method, tmp_path).picture(sky, background=False)
    relighter = jr.prepare(scene, dataclasses.replace(method, receivers="vertices"), tmp_path)
    assert isinstance(relighter, TransportRelighter)
    geometry = relighter.transport.geometry
    assert geometry.enclosed.sum() > 4
    for enclosed in (geometry.enclosed, np.zeros_like(geometry.enclosed)):
        geometry.__dict__["enclosed"] = enclosed
        errors.append(jr.image_error(relighter.picture(sky, background=False), exact).untrimmed)
    assert errors[0] < 0.5 * errors[1], errors
