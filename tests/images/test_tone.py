import numpy as np
import pytest

from jaxrelight.errors import InputError
from jaxrelight.images import auto_exposure, srgb_decode, srgb_encode, tone_map
from jaxrelight.images.tone import TONES, displayed


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


@pytest.mark.parametrize("tone", TONES)
def test_tones_are_monotone_from_black_to_white_and_keep_grey(tone):
    levels = np.concatenate([[0.0], 2.0 ** np.linspace(-20, 8, 4000), [1e30, np.inf]])
    shown = displayed(np.repeat(levels[None, :, None], 3, axis=2), tone=tone)
    assert np.ptp(shown, axis=2).max() < 1e-6
    grey = shown[0, :, 0]
    assert grey[0] == 0
    assert grey[-1] == pytest.approx(1, abs=1e-6)
    assert np.diff(grey).min() > -1e-6
    assert grey.min() >= 0
    assert grey.max() <= 1
    colours = displayed(np.random.default_rng(0).gamma(0.2, 5, size=(50, 50, 3)), tone=tone)
    assert colours.min() >= 0
    assert colours.max() <= 1


def test_filmic_is_hables_curve():
    # x = 2 · 0.18: (x(0.15x + 0.05) + 0.004) / (x(0.15x + 0.5) + 0.06) − 0.02/0.3, over that of 11.2
    assert srgb_decode(displayed(np.full((1, 1, 3), 0.18), tone="filmic"))[0, 0, 0] == pytest.approx(0.1284, abs=1e-4)


def test_agx_puts_middle_grey_near_the_middle_and_bleaches_bright_colours():
    shown = displayed(np.array([[[0.18, 0.18, 0.18], [20.0, 0.0, 0.0]]]), tone="agx")
    assert shown[0, 0, 0] == pytest.approx(0.5, abs=0.01)
    assert shown[0, 1, 1:].min() > 0.2


@pytest.mark.usefixtures("wrong_types")
def test_unknown_tones_are_refused():
    with pytest.raises(InputError, match="tone 'aces' is not known; known are linear, filmic, agx"):
        tone_map(np.ones((1, 1, 3)), tone="aces")  # pyright: ignore[reportArgumentType]


def test_automatic_exposure_shows_the_95th_percentile_of_what_is_covered_at_the_documented_level():
    rng, pixels = np.random.default_rng(1), np.ones((20, 20, 4), np.float32)
    pixels[..., :3] = 1e-3 * rng.random((20, 20, 1)) + 1e-4
    pixels[:10] = [50, 50, 50, 0]  # the background does not count
    level = np.percentile(pixels[10:, :, 0], 95)
    assert auto_exposure(pixels) == pytest.approx(np.log2(0.8 / level), abs=0.02)
    assert auto_exposure(4 * pixels) == pytest.approx(auto_exposure(pixels) - 2, abs=0.05)
    assert np.array_equal(tone_map(pixels, "auto"), tone_map(pixels, auto_exposure(pixels)))


@pytest.mark.parametrize("pixels", [np.zeros((3, 3, 4)), np.full((3, 3, 3), np.nan), np.full((3, 3, 3), -1.0)])
def test_automatic_exposure_of_nothing_is_none(pixels):
    assert auto_exposure(pixels) == 0
    assert tone_map(pixels, "auto").max() == 0


def test_automatic_exposure_leaves_out_what_is_black_or_not_finite():
    pixels = np.full((10, 10, 3), 0.2)
    pixels[:9] = 0
    pixels[0, 0], pixels[0, 1] = np.inf, np.nan
    assert auto_exposure(pixels) == pytest.approx(2)
    assert auto_exposure(np.full((2, 2, 3), 1e-300)) == 100


@pytest.mark.parametrize("shape", [(3,), (4, 4), (4, 4, 2), (1, 4, 4, 3)])
def test_other_shapes_are_refused(shape):
    with pytest.raises(InputError, match="shape"):
        tone_map(np.ones(shape))
