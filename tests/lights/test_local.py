"""Local lights: closed forms, limits, and what is refused."""

import jax
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxrelight.errors import InputError
from jaxrelight.lights.local import directional, point, spot

POINTS = np.random.default_rng(0).normal(size=(7, 3)).astype(np.float32)


@jax.jit
def _at(light, places):
    return light.at(places)


def at(light, places):
    """Of up to seven places: the same program for all."""
    padded = np.pad(np.asarray(places, np.float32), [(0, 7 - len(places)), (0, 0)], mode="edge")
    return jax.tree.map(lambda part: np.asarray(part)[: len(places)], _at(light, padded))


def test_a_point_light_falls_off_with_the_square_of_the_distance():
    incident = at(point([0, 2, 0], [4, 8, 12]), [[0, 0, 0], [3, 2, 4]])
    np.testing.assert_allclose(incident.omega_i, [[0, 1, 0], [-0.6, 0, -0.8]], atol=1e-6)
    np.testing.assert_allclose(incident.distance, [2, 5])
    np.testing.assert_allclose(incident.irradiance, [[1, 2, 3], [0.16, 0.32, 0.48]], rtol=1e-6)


def test_a_directional_light_is_the_same_everywhere():
    incident = at(directional([0, -2, 0], 3), POINTS)
    np.testing.assert_allclose(incident.omega_i, np.tile([0, 1, 0], (7, 1)))
    np.testing.assert_allclose(incident.irradiance, 3)
    assert np.isinf(incident.distance).all()


def test_a_spot_is_a_point_within_its_beam_nothing_beyond_its_cutoff_and_linear_between():
    light = spot([0, 1, 0], [0, 0, 0], 2, cutoff=30, beam=10)
    angles = np.radians([0, 9.9, 20, 25, 30.1, 180])
    places = np.stack([np.sin(angles), 1 - np.cos(angles), 0 * angles], axis=1)
    incident = at(light, places)
    np.testing.assert_allclose(incident.irradiance[:, 0], [2, 2, 1, 0.5, 0, 0], atol=1e-4)
    hard = at(spot([0, 1, 0], [0, 0, 0], 2, cutoff=30, beam=30), places)
    np.testing.assert_allclose(hard.irradiance[:, 0], [2, 2, 2, 2, 0, 0], atol=1e-4)


@pytest.mark.parametrize("light", [point([0, 0, 0], 1), spot([0, 0, 0], [0, 0, 1], 1, 40)])
def test_at_the_light_itself_all_is_finite(light):
    incident = at(light, np.zeros((1, 3)))
    assert all(np.isfinite(part).all() for part in incident[:3])


def test_gradients_are_right(x64):
    places = POINTS.astype(float) + 4
    light = spot([0.1, 2, 0.3], [4, 4, 4], [1, 2, 3], 60, 20)
    numbers = (light.position, light.target, light.intensity, light.cutoff, light.beam)
    check_grads(
        jax.jit(lambda *given: type(light)(*given).at(places)[::2]),
        [np.asarray(n, float) for n in numbers],
        order=1,
        modes=["rev"],
    )


@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda: point([0, 0], 1), "position must be three finite numbers"),
        (lambda: point([0, 0, np.nan], 1), "position must be three finite numbers"),
        (lambda: point([0, 0, 0], -1), "intensity must be one number or three, finite and not negative"),
        (lambda: point([0, 0, 0], [1, 2]), "intensity must be one number or three"),
        (lambda: directional([0, 0, 0], 1), "the zero vector"),
        (lambda: spot([0, 0, 0], [0, 0, 0], 1, 30), "target is where it stands"),
        (lambda: spot([0, 0, 0], [1, 0, 0], 1, 30, 40), "0 ≤ beam ≤ cutoff ≤ 180, not beam 40 and cutoff 30"),
        (lambda: spot([0, 0, 0], [1, 0, 0], 1, 0), "not beam 0 and cutoff 0"),
    ],
)
def test_lights_that_are_none_are_refused(make, what):
    with pytest.raises(InputError, match=what):
        make()
