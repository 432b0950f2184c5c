"""Whether turning about the normal changes a BRDF."""

import pytest

from jaxrelight.brdf.ashikhmin_shirley import ashikhmin_shirley
from jaxrelight.brdf.isotropy import is_isotropic
from jaxrelight.brdf.lobes import lambert, lobe, lobe_sum, phong


@pytest.mark.parametrize("brdf", [lambert(0.5), lambert(0.0), phong(0.1, 0.4, 50), ashikhmin_shirley(0.1, 0.5, 50, 50)])
def test_isotropic(brdf):
    assert is_isotropic(brdf)


@pytest.mark.parametrize(
    "brdf",
    [ashikhmin_shirley(0.1, 0.5, 10, 500), lobe_sum([0.1] * 3, [lobe([-1, -0.8, 1], 20, specular=0.3)])],
)
def test_anisotropic(brdf):
    assert not is_isotropic(brdf)
