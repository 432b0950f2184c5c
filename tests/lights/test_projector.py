"""Projected images: what a camera in the same place would see, nothing beside it."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxrelight import Camera, InputError
from jaxrelight.lights.projector import Projector, projector

PLACE = (0.3, 2.0, -1.0), (0.5, 0.0, 0.4)
IMAGE = np.random.default_rng(0).uniform(1, 2, (3, 5, 3))


def test_pixels_fall_where_a_camera_sees_them():
    light = projector(*PLACE, IMAGE, 40.0)
    directions = Camera(*PLACE, fov_y=40.0, width=5, height=3).directions().reshape(-1, 3)
    distance = np.linspace(1, 3, 15)[:, None]
    found = light.at(jnp.asarray(np.array(PLACE[0]) + distance * directions, jnp.float32))
    np.testing.assert_allclose(found.irradiance, IMAGE.reshape(-1, 3) / distance**2, rtol=1e-4)
    np.testing.assert_allclose(found.omega_i, -directions, atol=1e-5)
    np.testing.assert_allclose(found.distance, distance[:, 0], rtol=1e-5)


def test_nothing_falls_beside_the_image_or_behind():
    light = projector((0, 0, 0), (0, 0, 1), np.ones((2, 2, 3)), 90.0)
    places = jnp.asarray([[0, 0, 1], [0.99, 0.99, 1], [1.01, 0, 1], [0, -1.01, 1], [0, 0, -1], [1, 0, 0]])
    np.testing.assert_array_equal(light.at(places).irradiance[:, 0] > 0, [True, True, False, False, False, False])


def test_gradients_are_right(x64):
    places = jnp.asarray([[0.17, 0.23, 1], [-0.3, 0.1, 1.2]], float)
    given = [jnp.asarray(one, float) for one in ((0.01, 0, 0), (0.1, 0, 1), (0, 1, 0), 80.0, IMAGE)]
    irradiance = jax.jit(lambda *numbers: Projector(*numbers).at(places).irradiance)
    check_grads(irradiance, given, order=1, modes=["rev", "fwd"])


def test_gradients_are_finite_at_the_lens_behind_and_beside():
    places = jnp.asarray([[0, 0, 0], [0, 0, -1], [0, 1, 0], [9, 0, 1.0]])
    light = projector((0, 0, 0), (0, 0, 1), IMAGE, 60.0)
    found = jax.jit(jax.grad(lambda light: light.at(places).irradiance.sum()))(light)
    assert all(np.isfinite(part).all() for part in jax.tree.leaves(found))


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
