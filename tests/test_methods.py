"""The dials and their limits."""

import dataclasses
from typing import Any

import pytest

from jaxrelight.errors import InputError
from jaxrelight.methods import Transport

any_settings: Any = Settings


def test_defaults():
    settings = Transport("vertices")
    of_cloud = 0, 0.1, 0.01, "disc", False, 0, False, 0
    of_sky = "vertices", 64, 1, 4, "shared", 48, 0.02, 32, 0, 32, "barycentric"
    assert dataclasses.astuple(settings) == (*of_sky, *of_cloud)
    assert settings.samples_per_side == 1


@pytest.mark.parametrize(
    "good",
    [
        {"receivers": "pixels"},
        {"resolution": 4, "coefficients": 96},
        {"resolution": 512},
        {"terms": 1},
        {"coefficients": 1},
        {"coefficients": 6 * 64**2},
        {"coefficients": "all"},
        {"coefficients": "shared"},
        {"factor_resolution": 4},
    ],
)
def test_the_ends_of_every_range_are_accepted(good):
    settings = any_settings(**good)
    assert {name: getattr(settings, name) for name in good} == good


@pytest.mark.parametrize(("rays", "side"), [(1, 1), (4, 2), (9, 3), (16, 4), (25, 5)])
def test_samples_make_a_square(rays, side):
    assert Transport("vertices", visibility_samples=rays).samples_per_side == side


@pytest.mark.parametrize(
    ("bad", "message"),
    [
        ({"receivers": "texels"}, "'vertices' or 'pixels', not 'texels'"),
        ({"resolution": 2}, "resolution is 2; it must be a power of two from 4 to 512"),
        ({"resolution": 1024}, "resolution is 1024"),
        ({"resolution": 48}, "resolution is 48"),
        ({"resolution": 0}, "resolution is 0"),
        ({"resolution": -64}, "resolution is -64"),
        ({"visibility_samples": 0}, "visibility samples are 0"),
        ({"visibility_samples": 2}, "visibility samples are 2"),
        ({"visibility_samples": 36}, "visibility samples are 36"),
        ({"terms": 0}, "terms are 0"),
        ({"factor_resolution": 3}, "factor resolution is 3"),
        ({"coefficients": 0}, "coefficients are 0; from 1 to 24,576"),
        ({"coefficients": 24577}, "coefficients are 24577"),
        ({"coefficients": 97, "resolution": 4}, "from 1 to 96 can be kept at resolution 4"),
        ({"coefficients": "some"}, "coefficients are some"),
        ({"coefficients": 1.5}, "coefficients are 1.5"),
        ({"coefficients": None}, "coefficients are None"),
    ],
)
def test_all_else_is_refused_in_one_line(bad, message):
    with pytest.raises(InputError, match=message) as caught:
        any_settings(**bad)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    "wrong", [{"resolution": 8.0}, {"terms": "4"}, {"terms": 2.5}, {"visibility_samples": True}, {"coefficients": True}]
)
def test_what_is_no_whole_number_is_refused(wrong):
    with pytest.raises(InputError):
        Transport(**wrong)
