"""The mean spectrum of light that is there: by level, whatever the resolution."""

import numpy as np
import pytest

from jaxrelight.basis.haar import levels
from jaxrelight.lights.natural_spectrum import natural_spectrum


def by_level(resolution: int) -> np.ndarray:
    spectrum, level = natural_spectrum(resolution), levels(resolution)
    level_values = [np.unique(spectrum[level == i]) for i in range(level.max() + 1)]
    assert all(len(values) == 1 for values in level_values)
    return np.concatenate(level_values)


def test_finer_maps_add_levels_of_less():
    coarse, fine = by_level(64), by_level(512)
    np.testing.assert_array_equal(fine[:7], coarse)
    assert coarse[0] == 1
    assert (np.diff(fine) < 0).all()
    # Past what was measured, half of the one before.
    np.testing.assert_allclose(fine[7:] / fine[6:-1], 0.5)


@pytest.mark.parametrize("resolution", [4, 64])
def test_every_coefficient_has_one(resolution):
    assert natural_spectrum(resolution).shape == (6 * resolution**2,)
    assert natural_spectrum(resolution).dtype == np.float32
