import numpy as np
import pytest

from jaxrelight.errors import InputError
from jaxrelight.images import srgb_decode, srgb_encode, tone_map


def test_every_byte_survives_decoding_and_encoding():
    levels = np.arange(256)
    assert np.array_equal(np.rint(srgb_encode(srgb_decode(levels / 255)) * 255), levels)


def test_the_curve_matches_the_published_points():
    # the two pieces of IEC 61966-2-1 meet at 0.0031308; 0.5 is encoded as 0.735357
    np.testing.assert_allclose(srgb_encode([0.0, 0.0031308, 0.5, 1.0]), [0, 0.04044994, 0.735357, 1], atol=1e-6)
    assert np.all(np.diff(srgb_encode(np.linspace(0, 1, 10_000))) > 0)


def test_curves_keep_single_precision():
    single = np.array([0.2], np.float32)
    assert srgb_encode(single).dtype == srgb_decode(single).dtype == np.float32


def test_a_stop_doubles_the_light():
    pixels = np.random.default_rng(0).random((5, 7, 3)).astype(np.float32)
    assert np.array_equal(tone_map(pixels, exposure=1.0), tone_map(2 * pixels))
    assert np.array_equal(tone_map(pixels, exposure=-2.0), tone_map(pixels / 4))


def test_extremes_are_clamped():
    row = [np.nan, np.inf, -np.inf, 1e30, -1.0, 0.0]
    shown = tone_map(np.repeat(np.array(row)[None, :, None], 3, axis=2))
    assert shown.dtype == np.uint8
    assert shown[0, :, 0].tolist() == [0, 255, 0, 255, 0, 0]


def test_alpha_is_left_out():
    assert tone_map(np.ones((2, 3, 4))).shape == (2, 3, 3)


@pytest.mark.parametrize("exposure", [np.nan, np.inf])
def test_exposure_must_be_finite(exposure):
    with pytest.raises(InputError, match="exposure"):
        tone_map(np.ones((1, 1, 3)), exposure)


@pytest.mark.parametrize("shape", [(3,), (4, 4), (4, 4, 2), (1, 4, 4, 3)])
def test_other_shapes_are_refused(shape):
    with pytest.raises(InputError, match="shape"):
        tone_map(np.ones(shape))
