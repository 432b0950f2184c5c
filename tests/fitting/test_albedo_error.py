"""Directional albedos of fits and of data: closed forms, and samples that stand for a whole hemisphere."""

import numpy as np
import pytest

from fitting.albedo_error import albedo_error
from fitting.brdf_samples import BrdfSamples
from jaxrelight.brdf.lobes import lambert


@pytest.mark.parametrize("factor", [1.0, 0.7, 1.5])
def test_it_is_the_relative_difference_of_diffuse_albedos(factor: float):
    data, fit = lambert([0.2, 0.4, 0.6]), lambert([0.2 * factor, 0.4 * factor, 0.6 * factor])
    np.testing.assert_allclose(albedo_error(fit, data), abs(factor - 1), atol=1e-5)


def test_channels_do_not_cancel():
    np.testing.assert_allclose(albedo_error(lambert([0.5, 0.3, 0.2]), lambert([0.3, 0.5, 0.2])), 0.4, atol=1e-5)


def test_samples_stand_for_what_is_near_them():
    random = np.random.default_rng(0)
    omega_i, omega_o = (d / np.linalg.norm(d, axis=1, keepdims=True) for d in random.normal(size=(2, 4000, 3)))
    omega_i[:, 2], omega_o[:, 2] = np.abs(omega_i[:, 2]), np.abs(omega_o[:, 2])
    samples = BrdfSamples(omega_i, omega_o, np.full((4000, 3), 0.4 / np.pi))
    np.testing.assert_allclose(albedo_error(lambert(0.4), samples), 0, atol=1e-5)
    np.testing.assert_allclose(albedo_error(lambert(0.6), samples), 0.5, atol=1e-4)


def test_black_data_say_nothing():
    assert np.isnan(albedo_error(lambert(0.5), lambert(0.0)))
