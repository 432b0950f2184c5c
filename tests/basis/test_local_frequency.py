"""Frequencies of sine waves, spots and constants, where they are."""

import numpy as np
import pytest
import pywt
from scipy import ndimage

from jaxrelight.basis.local_frequency import around_sphere, local_frequency, mirrored

N = 128


def _wave(cycles: int) -> np.ndarray:
    return np.broadcast_to(np.sin(2 * np.pi * cycles * (np.arange(N) + 0.5) / N), (N, N))[..., None]


@pytest.mark.parametrize("cycles", [2, 5, 11, 23, 47])
def test_wave_has_the_frequency_of_its_octave(cycles: int):
    frequency = local_frequency(_wave(cycles), threshold=0.5)
    assert np.all(frequency >= 0.7 * cycles / N)
    assert np.all(frequency <= 2.9 * cycles / N)
    np.testing.assert_array_equal(local_frequency(_wave(cycles).swapaxes(0, 1), threshold=0.5), frequency.T)


def test_constant_has_none():
    assert not local_frequency(np.full((N, N, 3), 7.0)).any()
    assert not local_frequency(np.zeros((8, 8, 1))).any()


def test_scale_and_a_constant_beside_it_change_nothing():
    image = np.random.default_rng(0).random((N, N, 2)) ** 8
    frequency = local_frequency(image)
    np.testing.assert_array_equal(local_frequency(1e6 * image), frequency)
    np.testing.assert_array_equal(local_frequency(image + 1), frequency)


def test_spot_is_found_where_it_is():
    y, x = np.indices((N, N))
    image = np.exp(-((x - 40) ** 2 + (y - 90) ** 2) / 2) + 0.2 * np.cos(2 * np.pi * x / N)
    frequency = local_frequency(image[..., None])
    assert frequency[90, 40] >= 0.25
    far = np.hypot((x - 40 + 64) % N - 64, (y - 90 + 64) % N - 64) > 24
    assert np.median(frequency[far]) <= 0.25 * frequency[90, 40]
    peak = np.argwhere(frequency == frequency.max()).mean(axis=0)
    np.testing.assert_allclose(peak, [90, 40], atol=2)


def test_coarse_levels_are_as_on_the_grid_of_the_image():
    """Against all levels at every pixel: nearly all are the same, and none is off by more than an octave."""
    y, x = np.indices((N, N))
    waves = 0.3 * np.cos(2 * np.pi * 3 * x / N) + 0.02 * (y > N / 2) * np.sin(2 * np.pi * 23 * y / N)
    image = np.stack([waves + np.exp(-((x - 40) ** 2 + (y - 90) ** 2) / 8), waves], axis=2)
    found, wanted = local_frequency(image), _at_every_pixel(image)
    assert np.mean(found == wanted) > 0.95
    assert np.abs(np.log2(found / wanted)).max() <= 1


def _at_every_pixel(image: np.ndarray, threshold: float = 0.01) -> np.ndarray:
    contrast, coarse = [], image
    for level in range(int(np.log2(N))):
        coarse, details = pywt.dwt2(coarse, "db4", "periodization", axes=(0, 1))
        detail = pywt.idwt2((None, details), "db4", "periodization", axes=(0, 1))
        for _ in range(level):
            detail = pywt.idwt2((detail, (None,) * 3), "db4", "periodization", axes=(0, 1))
        contrast.append(ndimage.maximum_filter(np.abs(detail).max(axis=2), 2 ** (level + 1) + 1, mode="wrap"))
    size = np.array(contrast) * (2.0 ** np.arange(1, len(contrast) + 1))[:, None, None]
    counts = np.cumsum(size, axis=0) >= threshold * size.max(axis=0)
    return 0.5 ** (1.5 + np.argmax(counts, axis=0))


def test_mirrored_and_carried_around_the_sphere_without_a_step():
    ramp = np.indices((16, 32)).sum(axis=0)[..., None].astype(float)
    once = mirrored(ramp)
    assert once.shape == (32, 64, 1)
    assert np.abs(np.diff(np.concatenate([once, once[:1]]), axis=0)).max() == 1
    # Over the pole one comes down on the other side.
    height = np.broadcast_to(np.cos(np.pi * (np.arange(16) + 0.5) / 16)[:, None, None], (16, 32, 1))
    around = around_sphere(height)
    assert np.abs(np.diff(np.concatenate([around, around[:1]]), axis=0)).max() < 0.2
