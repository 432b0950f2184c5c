"""Lights made of traced numbers, and the types of what is made: as of known numbers, derivatives too."""

from typing import Any

import jax
import numpy as np
import pytest

from jaxrelight import InputError
from jaxrelight.geometry.frame import frames_of_points, to_local
from jaxrelight.lights.area import area
from jaxrelight.lights.local import directional, point, spot
from jaxrelight.lights.projector import projector
from jaxrelight.lights.shaped import shaped
from tests.brdf.test_traced import content
from tests.compilations import compilations

PLACES = np.array([[0.3, 0.2, -0.1], [-0.4, 0.1, 0.2]])
IMAGE = np.random.default_rng(0).uniform(1, 2, (3, 5, 3))

# Of a number near 1, as it may stand in every argument.
MADE: dict[str, Any] = {
    "point": lambda k: point([0, k, 0.1], [k, 2 * k, 3]),
    "spot": lambda k: spot([0, k, 0.1], [k, 0, 0], 3 * k, 70 * k),
    "spot with a beam": lambda k: spot([0, k, 0.1], [0, 0, 0], [1, k, 2], 80.0, 5 * k),
    "directional": lambda k: directional([0.1, -k, 0.2], 2 * k),
    "area": lambda k: area([0, 2 * k, 0], [k, 0, 0.1], [0, 0.1, k], [k, 1, 2], 2),
    "projector": lambda k: projector([0, 2, k], [0, 0, 0], IMAGE.astype(k.dtype) * k, 50 * k, up=[0.1, k, 0]),
    "shaped": lambda k: shaped([0, k, 0.1], [k, 0, 0], k, 30 * k, [50, 60 * k], roundness=0.5 * k, far=(4 * k, 5)),
    "shaped otherwise": lambda k: shaped(
        [0, k, 0.1],
        [0, 0, 0],
        [1, k, 2],
        [30, 40 * k],
        near=(0.1, 0.3 * k),
        falloff=2 * k,
        reference=3 * k,
        up=[0, 0, k],
    ),
}


def finite(made):
    """Without the distances that are infinite, which have no derivative."""
    return jax.tree.map(lambda leaf: jax.numpy.where(jax.numpy.isfinite(leaf), leaf, 0), made)


def test_traced_numbers_make_what_known_ones_make_and_have_its_derivatives(x64):
    """Under `jit` and `vmap`, and by reverse mode against central differences of what is made outside of JAX."""

    def total(numbers):
        made = {name: make(numbers[name]) for name, make in MADE.items()}
        return sum(content(finite(light)) for light in made.values()), made

    places, step = np.array([0.8, 1.1]), 1e-6
    slopes, made = jax.jit(jax.vmap(jax.grad(total, has_aux=True)))(dict.fromkeys(MADE, places))
    for name, make in MADE.items():
        for i, k in enumerate(places):
            for traced, wanted in zip(jax.tree.leaves(made[name]), jax.tree.leaves(make(k)), strict=True):
                np.testing.assert_allclose(traced[i], wanted, rtol=1e-13, err_msg=name)
            high, low = (
                content(jax.tree.map(lambda leaf: np.nan_to_num(np.asarray(leaf), posinf=0), make(k + by)))
                for by in (step, -step)
            )
            assert slopes[name][i] == pytest.approx((high - low) / (2 * step), rel=1e-6), name
            assert slopes[name][i] != 0, name


def test_the_light_of_a_lamp_is_differentiated_in_where_it_stands():
    """Straight above, twice as far is a quarter of the light: its slope is −2 over the distance."""
    below = np.zeros((1, 3), np.float32)
    value, slope = jax.jit(jax.value_and_grad(lambda y: point([0, y, 0], 3.0).at(below).irradiance[0, 0]))(2.0)
    assert value == pytest.approx(3 / 4)
    assert slope == pytest.approx(-2 / 2 * 3 / 4)


@pytest.mark.usefixtures("wrong_types")
@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda k: point([k, 0], 1), r"position must be three finite numbers, not a traced array of the shape \(2,\)"),
        (lambda k: point([k, 0, 0], -1), "intensity must be one number or three"),
        (lambda k: point([0, 0, np.nan], k), "position must be three finite numbers"),
        (lambda k: spot([0, 0, 0], [0, 0, 0], k, 30), "target is where it stands"),
        (lambda k: spot([0, 0, k], [0, 0, 0], k, 200), "0 ≤ beam ≤ cutoff ≤ 180, not beam 150 and cutoff 200"),
        (lambda k: spot([0, 0, k], [0, 0, 0], k, k, -1), "not beam -1 and cutoff a traced array"),
        (lambda k: directional([0, 0, 0], k), "the zero vector"),
        (lambda k: area([0, 0, k], [1, 1, 0], [2, 2, 0], k), "lie along each other"),
        (lambda k: projector([0, 0, 0], [0, 0, 1], np.ones((2, 2, 3)) * k, 190), "fov_y must lie between"),
        (lambda k: projector([0, 0, 0], [0, 0, 1], np.ones((2, 2)) * k, 90), "image must be"),
        (lambda k: projector([0, 0, 0], [0, 0, 1], np.ones((2, 2, 3)), k, up=[0, 0, 1]), "up is along the way"),
        (lambda k: shaped([0, 0, 0], [0, 0, 1], k, 20.0, k, roundness=2), "roundness must be from 0"),
        (lambda k: shaped([0, 0, 0], [0, 0, 1], 1, k, near=(k, 3), far=(2, k)), "distances must grow"),
    ],
)
def test_beside_traced_numbers_shapes_and_known_numbers_are_checked(make, what):
    with pytest.raises(InputError, match=what):
        jax.eval_shape(lambda k: (make(k), None)[1], 1.0)


def test_known_numbers_compile_nothing():
    given = jax.device_put(np.array([0.2, 0.3, 0.4], np.float32))
    with compilations() as compiled:
        for make in MADE.values():
            make(np.float64(1.1))
        point(given, given)
        spot(given, [0, 0, 0], given, 30)
        projector(given, [0, 0, 0], np.ones((7, 11, 3)), 30)
    assert not compiled


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_light_has_the_type_of_the_arrays_given(x64, dtype):
    """Of shapes only, for which nothing is compiled."""
    for name, make in MADE.items():
        light = make(np.ones((), dtype))
        assert {leaf.dtype for leaf in jax.tree.leaves(light)} == {np.dtype(dtype)}, name
        shapes = jax.eval_shape(lambda light=light: [part.at(PLACES.astype(dtype)) for part in light.parts()])
        assert {leaf.dtype for leaf in jax.tree.leaves(shapes)} - {np.dtype(bool)} == {np.dtype(dtype)}, name


def test_numbers_of_python_have_the_type_that_jax_is_set_to():
    with jax.enable_x64(True):
        light = spot([0, 1, 0], [0, 0, 0], 1, 30)
        assert {leaf.dtype for leaf in jax.tree.leaves(light)} == {np.dtype(np.float64)}
    light = spot(np.array([0.0, 1, 0]), [0, 0, 0], 1, 30)
    assert {leaf.dtype for leaf in (light.intensity, light.cutoff, light.beam)} == {np.dtype(np.float32)}
    # Positions are rounded once the centre of a scene was subtracted.
    assert {leaf.dtype for leaf in (light.position, light.target)} == {np.dtype(np.float64)}
    assert {leaf.dtype for leaf in jax.tree.leaves(light.relative_to(np.zeros(3)))} == {np.dtype(np.float32)}


def test_frames_of_points_are_rotations_to_the_last_digits_of_their_type(x64):
    generator = np.random.default_rng(3)
    normals, tangents = generator.normal(size=(2, 50, 3))
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    for dtype, tolerance in ((np.float64, 1e-14), (np.float32, 1e-5)):
        frames = frames_of_points(normals.astype(dtype), tangents.astype(dtype))
        local = to_local(frames, normals)
        assert frames.dtype == local.dtype == dtype
        np.testing.assert_allclose(
            frames @ frames.swapaxes(1, 2), np.broadcast_to(np.eye(3), (50, 3, 3)), atol=tolerance
        )
        np.testing.assert_allclose(local, np.tile([0.0, 0, 1], (50, 1)), atol=tolerance)
