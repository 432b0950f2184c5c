"""Lights as layers: their sum is the picture, and moving one computes one."""

from unittest import mock

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight import InputError
from jaxrelight.lighting.indirect import IndirectRelighter
from jaxrelight.lighting.light_layers import LightLayers
from jaxrelight.lights.local import point
from tests.lighting.test_indirect import LAMP, opened, picture, room

OTHER = point([-0.2, 0.1, 0.0], [0.2, 0.4, 0.8])


@pytest.fixture(scope="module")
def relighter(tmp_path_factory):
    glowing = room([0.5, 0.4, 0.3], np.asarray([0.1, 0.2, 0.3], np.float32))
    return opened(glowing, tmp_path_factory.mktemp("layers"), bounces=2)


def test_the_sum_is_the_picture_by_all_of_them(relighter):
    layers = LightLayers(relighter, [LAMP, OTHER])
    np.testing.assert_allclose(layers.picture(), picture(relighter, [LAMP, OTHER]), rtol=1e-4, atol=1e-5)
    tinted = [LAMP, point(OTHER.position, np.asarray(OTHER.intensity) * [2.0, 0.5, 0.0])]
    image = layers.picture([1.0, [2.0, 0.5, 0.0]])
    np.testing.assert_allclose(image, picture(relighter, tinted), rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(layers.picture([0, 0]), picture(relighter, []), atol=1e-6)
    assert LightLayers(relighter, []).picture().mean() > 0.05


def test_moving_one_computes_one(relighter):
    layers = LightLayers(relighter, [LAMP, OTHER])
    with mock.patch.object(IndirectRelighter, "light", autospec=True, side_effect=IndirectRelighter.light) as computed:
        layers.move(1, LAMP)
        layers.picture([1.0, 0.5])
    assert computed.call_count == 1
    np.testing.assert_allclose(layers.picture([1, 1]), layers.picture([2, 0]), rtol=1e-5, atol=1e-6)


def test_gains_are_differentiable(relighter):
    layers = LightLayers(relighter, [LAMP, OTHER])
    gradient = jax.grad(lambda gains: jnp.sum(layers.picture(gains)))(jnp.ones((2, 3)))
    np.testing.assert_allclose(gradient, layers.pictures.sum(axis=(1, 2)), rtol=1e-5)


def test_gains_and_numbers_that_do_not_fit_are_refused(relighter):
    layers = LightLayers(relighter, [LAMP])
    with pytest.raises(InputError, match="2 gains were given for 1 lights"):
        layers.picture([1, 2])
    with pytest.raises(InputError, match="light 1 is none of the 1"):
        layers.move(1, OTHER)
