"""Primaries: closed forms and published matrices."""

import numpy as np
import pytest

from jaxrelight.images.primaries import REC709, to_rec709

REC2020 = (0.708, 0.292, 0.170, 0.797, 0.131, 0.046, 0.3127, 0.3290)
ACES = (0.7347, 0.2653, 0.0, 1.0, 0.0001, -0.0770, 0.32168, 0.33767)


def matrix(chromaticities) -> np.ndarray:
    conversion = to_rec709(chromaticities)
    assert conversion is not None
    return conversion


def test_published_matrices():
    bt2087 = [[1.6605, -0.5876, -0.0728], [-0.1246, 1.1329, -0.0083], [-0.0182, -0.1006, 1.1187]]
    np.testing.assert_allclose(matrix(REC2020), bt2087, atol=2e-4)
    # ACES AP0 by Bradford's transform, as OpenColorIO's configurations print it
    aces = [[2.52169, -1.13413, -0.38756], [-0.27648, 1.37272, -0.09624], [-0.01538, -0.15298, 1.16835]]
    np.testing.assert_allclose(matrix(ACES), aces, atol=1e-5)


def test_primaries_of_rec709_need_nothing_whatever_white_they_were_adapted_to():
    assert to_rec709(REC709) is None
    assert to_rec709((0.64, 0.33, 0.3, 0.6, 0.15, 0.06, 0.31271, 0.32902)) is None
    assert to_rec709((0.648447, 0.330877, 0.321187, 0.597894, 0.155901, 0.066056, 0.345708, 0.358541)) is None  # D50


@pytest.mark.parametrize("chromaticities", [REC2020, ACES, (1, 0, 0, 1, 0, 0, 1 / 3, 1 / 3)])
def test_white_stays_white(chromaticities):
    np.testing.assert_allclose(matrix(chromaticities) @ np.ones(3), 1, atol=1e-9)


@pytest.mark.usefixtures("wrong_types")
@pytest.mark.parametrize(
    "chromaticities", [[0.3] * 8, [0] * 8, [np.nan] * 8, [1e30] * 8, [0.1, 0.2], (*REC709[:6], 0.3, 0)]
)
def test_what_are_no_primaries(chromaticities):
    with pytest.raises(ValueError, match=r"needed|line|luminance"):
        to_rec709(chromaticities)
