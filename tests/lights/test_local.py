"""Local lights: closed forms, limits, and what is refused."""

from collections.abc import Callable

import jax
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxrelight.errors import InputError
from jaxrelight.lights.area import area
from jaxrelight.lights.local import Incident, Light, Punctual, directional, point, spot
from jaxrelight.lights.projector import projector
from jaxrelight.lights.shaped import shaped

# Far away, and nothing that single precision could hold.
AWAY = np.array([1e6 + 0.3, -2e6 + 0.1, 3e5 + 0.7])
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


class Column(Punctual):
    """Light of one's own, along an axis that is upright at x = 2**20."""

    irradiance: jax.Array

    def at(self, positions) -> Incident:
        up = jax.numpy.broadcast_to(jax.numpy.asarray([0.0, 1, 0], positions.dtype), positions.shape)
        inside = jax.numpy.abs(positions[:, 0] - 2.0**20) < 1
        return Incident(up, jax.numpy.full(len(positions), jax.numpy.inf), inside[:, None] * self.irradiance[None])


LAMPS: dict[str, Callable[[np.ndarray, np.ndarray], Light]] = {
    "point": lambda place, aim: point(place, 1),
    "spot": lambda place, aim: spot(place, aim, 1, 60, 20),
    "projector": lambda place, aim: projector(place, aim, IMAGE, 90),
    "shaped": lambda place, aim: shaped(place, aim, 1, 40, 70),
    "area": lambda place, aim: area(place, [1, 0, 0], [0, 0, 1], 1, 2),
}
IMAGE = np.random.default_rng(0).uniform(size=(4, 4, 3))


@pytest.mark.parametrize(
    "kind", [pytest.param(kind, marks=[pytest.mark.slow] * (kind not in ("point", "spot"))) for kind in LAMPS]
)
def test_lamps_far_from_the_origin_are_exact_from_a_centre_nearby(kind):
    # Less than single precision tells apart at that distance.
    here, aside = np.array([0.013, -0.027, 0.041]), np.array([1, 0.5, 0])
    near, far = (LAMPS[kind](centre + here, centre + here + aside).parts() for centre in (np.zeros(3), AWAY))
    received = [
        [at(one.relative_to(centre), POINTS).irradiance for one in parts]
        for parts, centre in ((near, np.zeros(3)), (far, AWAY))
    ]
    assert np.any(received[0])
    np.testing.assert_allclose(received[1], received[0], rtol=1e-5, atol=1e-6)


def test_traced_positions_are_told_from_a_centre_as_exactly_as_they_are_known():
    """Also where the compiler sees both steps."""
    place = AWAY.astype(np.float32)
    told = jax.jit(lambda place: point(place, 1).relative_to(AWAY))(place).position  # pyright: ignore[reportAttributeAccessIssue]
    np.testing.assert_allclose(told, place.astype(float) - AWAY, atol=1e-7)


def test_a_light_of_ones_own_is_told_where_points_are_in_the_world():
    light = Column(jax.device_put(np.ones(3, np.float32))).relative_to(np.array([2.0**20, 0, 0]))
    np.testing.assert_array_equal(at(light, POINTS).irradiance[:, 0], np.abs(POINTS[:, 0]) < 1)


@pytest.mark.usefixtures("wrong_types")
def test_a_target_that_is_at_the_light_in_single_precision_is_refused():
    with pytest.raises(InputError, match="target is where it stands"):
        spot([1, 0, 0], [1 + 1e-12, 0, 0], 1, 30).relative_to(np.zeros(3))


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
