import re
import subprocess
import sys

import numpy as np
import pytest

from jaxrelight.errors import InputError
from jaxrelight.images import image_error, read_image
from tests.shared_data import shared


def _pair(h=20, w=20, seed=0):
    reference = np.random.default_rng(seed).random((h, w, 4)) + 0.1
    reference[..., 3] = 1
    return reference.copy(), reference


@pytest.mark.parametrize("pair", [("bunny_lambert_b0", "bunny_lambert_b1"), ("room_point_b0", "room_point_b3")])
def test_numbers_are_those_of_the_reference_script(pair):
    ours, reference = (shared("reference", f"{name}.exr") for name in pair)
    script = [sys.executable, str(shared("reference", "image_error.py")), str(ours), str(reference), "1"]
    printed = subprocess.run(script, capture_output=True, text=True, check=False).stdout
    expected = [float(number) for number in re.findall(r"\d+\.\d{4}", printed)]
    error = image_error(read_image(ours), read_image(reference))
    assert [round(x, 4) for x in (error.trimmed, error.untrimmed, error.mean_ratio)] == expected


def test_equal_images_have_no_error():
    error = image_error(*_pair())
    assert (error.trimmed, error.untrimmed, error.mean_ratio) == (0.0, 0.0, 1.0)


def test_a_common_factor_is_the_error():
    ours, reference = _pair()
    error = image_error(1.25 * ours, reference)
    assert error.untrimmed == pytest.approx(0.25)
    assert error.mean_ratio == pytest.approx(1.25)


def test_a_few_wild_pixels_are_trimmed_and_still_reported():
    ours, reference = _pair()
    ours.reshape(-1, 4)[:20, :3] += 100  # 20 of 400 pixels: just 5 %
    error = image_error(ours, reference)
    assert error.trimmed == 0
    assert error.untrimmed > 10
    assert image_error(ours, reference, trim=0.0).trimmed == error.untrimmed


def test_only_covered_pixels_count():
    ours, reference = _pair()
    reference[:5, :, 3] = 0.999
    ours[:5] = 1e6
    assert image_error(ours, reference).untrimmed == 0
    assert image_error(ours, reference, alpha_above=0.5).untrimmed > 1


def test_a_reference_without_alpha_counts_everywhere():
    ours, reference = _pair()
    ours[0, 0] += 1
    assert image_error(ours[..., :3], reference[..., :3]) == image_error(ours, reference)


def test_nan_is_never_a_good_result():
    ours, reference = _pair()
    ours[3, 3, 1] = np.nan
    error = image_error(ours, reference)
    assert np.isnan([error.trimmed, error.untrimmed, error.mean_ratio]).all()


def test_it_reads_as_one_line():
    ours, reference = _pair()
    text = str(image_error(1.25 * ours, reference))
    assert "0.2500" in text
    assert "1.2500" in text
    assert "\n" not in text


@pytest.mark.parametrize(
    ("ours", "reference", "options", "complaint"),
    [
        (np.ones((4, 5, 3)), np.ones((5, 4, 3)), {}, "our image is 5x4, the reference 4x5"),
        (np.ones((4, 5)), np.ones((4, 5, 3)), {}, "our image has shape"),
        (np.ones((4, 5, 3)), np.ones((4, 5, 2)), {}, "the reference has shape"),
        (np.ones((4, 5, 3)), np.zeros((4, 5, 3)), {}, "black"),
        (np.ones((4, 5, 3)), np.zeros((4, 5, 4)), {}, "alpha"),
        (np.ones((4, 5, 3)), np.ones((4, 5, 3)), {"trim": 1.0}, "trim"),
    ],
)
def test_what_cannot_be_compared_is_refused(ours, reference, options, complaint):
    with pytest.raises(InputError, match=complaint):
        image_error(ours, reference, **options)
