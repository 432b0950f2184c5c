"""Projected images: what a camera in the same place would see, nothing beside it."""

import jax
import numpy as np
import pytest

from jaxrelight import Camera, InputError
from jaxrelight.lights.projector import Projector, projector

PLACE = (0.3, 2.0, -1.0), (0.5, 0.0, 0.4)
IMAGE = np.random.default_rng(0).uniform(1, 2, (3, 5, 3))


@jax.jit
def _at(light, places):
    return light.at(places)


def test_pixels_fall_where_a_camera_sees_them():
    light = projector(*PLACE, IMAGE, 40.0)
    directions = Camera(*PLACE, fov_y=40.0, width=5, height=3).directions().reshape(-1, 3)
    distance = np.linspace(1, 3, 15)[:, None]
    incident = _at(light, (np.array(PLACE[0]) + distance * directions).astype(np.float32))
    np.testing.assert_allclose(incident.irradiance, IMAGE.reshape(-1, 3) / distance**2, rtol=1e-4)
    np.testing.assert_allclose(incident.omega_i, -directions, atol=1e-5)
    np.testing.assert_allclose(incident.distance, distance[:, 0], rtol=1e-5)


def test_nothing_falls_beside_the_image_or_behind():
    light = projector((0, 0, 0), (0, 0, 1), np.ones((2, 2, 3)), 90.0)
    places = [[0, 0, 1], [0.99, 0.99, 1], [1.01, 0, 1], [0, -1.01, 1], [0, 0, -1], [1, 0, 0]]
    irradiance = np.asarray(_at(light, np.asarray(places, np.float32)).irradiance)
    np.testing.assert_array_equal(irradiance[:, 0] > 0, [True, True, False, False, False, False])


def _moved(given, way, step: float) -> Projector:
    return Projector(*(np.asarray(x + step * w) for x, w in zip(given, way, strict=True)))  # pyright: ignore[reportArgumentType]


@jax.jit
def _slopes(given, way, back, places):
    def irradiance(*numbers):
        return Projector(*numbers).at(places).irradiance

    return jax.jvp(irradiance, given, way)[1], jax.vjp(irradiance, *given)[1](back)


def test_gradients_are_right_and_finite_at_the_lens_behind_and_beside(x64):
    """Forwards as central differences have it, and backwards as forwards."""
    random = np.random.default_rng(1)
    given = tuple(np.asarray(one, float) for one in ((0.01, 0, 0), (0.1, 0, 1), (0, 1, 0), 80.0, IMAGE))
    way = tuple(random.normal(size=one.shape) for one in given)
    places, back = (
        np.asarray([[0.17, 0.23, 1], [-0.3, 0.1, 1.2], [0.1, 0.2, 2], [0.07, -0.11, 1.5]]),
        random.normal(size=(4, 3)),
    )
    forwards, backwards = _slopes(given, way, back, places)
    ends = [np.asarray(_at(_moved(given, way, step), places).irradiance) for step in (1e-6, -1e-6)]
    np.testing.assert_allclose(forwards, (ends[0] - ends[1]) / 2e-6, rtol=1e-6, atol=1e-7)
    along = sum(np.vdot(x, np.asarray(y)) for x, y in zip(way, backwards, strict=True))
    np.testing.assert_allclose(along, np.vdot(back, np.asarray(forwards)), rtol=1e-9)
    beside = np.asarray([[0.01, 0, 0], [0.01, 0, -1], [0, 1, 0], [9, 0, 1.0]])
    assert all(np.isfinite(np.asarray(part)).all() for part in jax.tree.leaves(_slopes(given, way, back, beside)))


@pytest.mark.usefixtures("wrong_types")
@pytest.mark.parametrize(
    ("change", "what"),
    [
        ({"image": np.ones((2, 2))}, r"image must be \[h, w, 3\], not \[2, 2\]"),
        ({"image": np.ones((0, 2, 3))}, "image must be"),
        ({"image": -np.ones((2, 2, 3))}, "finite and not negative"),
        ({"image": np.full((2, 2, 3), np.nan)}, "finite and not negative"),
        ({"fov_y": 0.0}, "fov_y must lie between 0 and 180 degrees, not 0"),
        ({"fov_y": 180.0}, "not 180"),
        ({"target": (0, 0, 0)}, "a projector's target is where it stands"),
        ({"up": (0, 0, 2)}, "a projector's up is along the way"),
    ],
)
def test_what_is_no_projector_is_refused(change, what):
    good = {"position": (0, 0, 0), "target": (0, 0, 1), "image": np.ones((2, 2, 3)), "fov_y": 40.0}
    with pytest.raises(InputError, match=what):
        projector(**good | change)
