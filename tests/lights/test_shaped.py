"""Shaped lights: limits that other lights have, edges, distances, and gradients where formulas break down."""

from typing import Any

import jax
import numpy as np
import pytest

from jaxrelight import InputError
from jaxrelight.lights.local import spot
from jaxrelight.lights.shaped import shaped

DOWN = (0, 2, 0), (0, 0, 0)
AXES: dict[str, Any] = {"up": (0, 0, 1)}


def across(*places) -> np.ndarray:
    """Points of a plane at distance 1 below the light: where the tangents of the angles are x, z."""
    return np.asarray([[x, 1, z] for x, z in places], np.float32)


@jax.jit
def _at(light, places):
    return light.at(places)


@jax.jit
def _slopes(light, places):
    return jax.grad(lambda light, places: light.at(places).irradiance.sum(), (0, 1))(light, places)


def at(light, places):
    """Of up to 200 points: the same program for all."""
    padded = np.pad(np.asarray(places, np.float32), [(0, 200 - len(places)), (0, 0)], mode="edge")
    return jax.tree.map(lambda part: np.asarray(part)[: len(places)], _at(light, padded))


def test_a_round_hard_one_is_a_spot():
    places = np.random.default_rng(0).normal(size=(200, 3))
    incident, wanted = (at(light, places) for light in (shaped(*DOWN, 3.0, 30.0, **AXES), spot(*DOWN, 3.0, 30.0, 30.0)))
    for name in ("omega_i", "distance", "irradiance"):
        np.testing.assert_allclose(getattr(incident, name), getattr(wanted, name), rtol=1e-4, atol=1e-6)


def test_rectangles_have_corners_that_ellipses_have_not():
    corner = across((0.9, 0.45))
    angles = np.degrees(np.arctan([1.0, 0.5]))
    shares = [at(shaped(*DOWN, 1.0, angles, roundness=r, **AXES), corner).irradiance[0, 0] for r in (1.0, 0.1, 0.0)]
    assert shares[0] == 0
    assert shares[1] == shares[2] > 0


def test_edges_are_soft_between_the_shapes():
    inner, outer = np.degrees(np.arctan([1.0, 2.0]))
    light = shaped(*DOWN, 1.0, inner, outer, **AXES)
    x = np.array([0.99, 1.01, 1.3, 1.5, 1.7, 1.99, 2.01])
    intensity = at(light, across(*((each, 0) for each in x))).irradiance[:, 0] * (1 + x * x)
    t = np.clip(x - 1, 0, 1)
    np.testing.assert_allclose(intensity, 1 - t * t * (3 - 2 * t), atol=1e-4)


def test_it_begins_and_ends_at_distances():
    light = shaped((0, 0, 0), (0, 0, 1), 5.0, 20.0, near=(1, 2), far=(4, 6), falloff=0.0)
    distances = np.asarray([0.5, 0.99, 1.5, 2, 3, 4, 5, 6.01, 100])
    irradiance = at(light, distances[:, None] * [0, 0, 1]).irradiance[:, 0]
    np.testing.assert_allclose(irradiance, [0, 0, 2.5, 5, 5, 5, 2.5, 0, 0], atol=1e-5)


@pytest.mark.parametrize("falloff", [0.0, 1.0, 2.0, 3.5])
def test_all_exponents_agree_at_the_reference(falloff):
    light = shaped((0, 0, 0), (0, 0, 1), 5.0, 20.0, falloff=falloff, reference=3.0)
    irradiance = at(light, [[0, 0, 3.0], [0, 0, 6.0]]).irradiance[:, 0]
    np.testing.assert_allclose(irradiance, [5 / 9, 5 / 9 / 2**falloff], rtol=1e-5)


@pytest.mark.parametrize("roundness", [0.0, 0.3, 1.0])
def test_gradients_are_finite_everywhere(roundness):
    light = shaped(*DOWN, 1.0, (20.0, 10.0), (30.0, 40.0), roundness=roundness, near=(0, 1), far=(2, 3), **AXES)
    places = [[0, 2, 0], [0, 1, 0], [0, 3, 0], [1, 2, 0], [0.3, 1, 0], [0, 1, 0.2], [5, 0, 5], [0, -9, 0]]
    for outputs in (_slopes(light, np.asarray(places, np.float32)), at(light, places)):
        assert all(np.isfinite(np.asarray(part)).all() for part in jax.tree.leaves(outputs))


@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"inner": 0.0}, "0 < inner ≤ outer < 90"),
        ({"inner": 40.0, "outer": 30.0}, "0 < inner ≤ outer < 90"),
        ({"outer": 90.0}, "below 90"),
        ({"roundness": 1.5}, "roundness must be from 0"),
        ({"near": (2, 1)}, "distances must grow"),
        ({"near": (-1, 1)}, "distances must grow"),
        ({"near": (0, 5), "far": (4, 6)}, "distances must grow"),
        ({"falloff": -1.0}, "falloff must be 0 or more"),
        ({"reference": 0.0}, "reference must be a distance above 0"),
        ({"target": (0, 0, 0)}, "a shaped light's target is where it stands"),
        ({"intensity": -1}, "intensity must be"),
    ],
)
def test_what_is_no_shape_is_refused(change, what):
    good = {"position": (0, 0, 0), "target": (0, 0, 1), "intensity": 1, "inner": 20.0, "outer": 30.0}
    with pytest.raises(InputError, match=what):
        shaped(**good | change)


@pytest.mark.parametrize("roundness", [0.0, 0.02, 0.5])
def test_wide_edges_are_exact_at_every_roundness(roundness):
    """Along an axis all roundnesses reach as far; the outer shape is a hundred times the inner one."""
    inner, outer = np.degrees(np.arctan([0.05, 5.0]))
    light = shaped(*DOWN, 1.0, inner, outer, roundness=roundness, **AXES)
    x = np.array([0.04, 0.5, 1.0, 2.0, 3.0, 4.5])
    intensity = at(light, across(*((each, 0) for each in x))).irradiance[:, 0] * (1 + x * x)
    t = np.clip((x - 0.05) / 4.95, 0, 1)
    np.testing.assert_allclose(intensity, 1 - t * t * (3 - 2 * t), atol=1e-5)
    by_roundness = np.asarray(_slopes(light, np.pad(across((2, 1.9)), [(0, 7), (0, 0)], mode="edge"))[0].roundness)
    assert np.isfinite(by_roundness)
    if roundness:
        assert by_roundness < 0


def test_roundness_nothing_is_a_rectangle():
    """The larger of both distances from the axis counts, also where they are equal."""
    inner, outer = np.degrees(np.arctan([0.5, 2.0]))
    light = shaped(*DOWN, 1.0, inner, outer, roundness=0.0, **AXES)
    x, z = np.meshgrid(np.linspace(0.1, 2.2, 8), np.linspace(0.1, 2.2, 8))
    x, z = x.ravel(), z.ravel()
    intensity = at(light, across(*zip(x, z, strict=True))).irradiance[:, 0] * (1 + x * x + z * z)
    t = np.clip((np.maximum(x, z) - 0.5) / 1.5, 0, 1)
    np.testing.assert_allclose(intensity, 1 - t * t * (3 - 2 * t), atol=1e-5)
