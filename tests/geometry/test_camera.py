"""The pinhole camera."""

from typing import Any

import numpy as np
import pytest

from jaxrelight.errors import InputError
from jaxrelight.geometry.camera import Camera

any_camera: Any = Camera


def test_centre_pixel_looks_at_the_target():
    camera = Camera((1, 2, 3), (4, 0, -1), width=7, height=5)
    directions = camera.directions()
    assert directions.shape == (5, 7, 3)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1, atol=1e-14)
    forward = np.array([3, -2, -4]) / np.sqrt(29)
    np.testing.assert_allclose(directions[2, 3], forward, atol=1e-14)


def test_top_row_is_up_and_right_column_is_right():
    """Seen along −z, +x is to the right."""
    directions = Camera((0, 0, 5), (0, 0, 0), width=4, height=4).directions()
    assert (directions[0, :, 1] > 0).all()
    assert (directions[-1, :, 1] < 0).all()
    assert (directions[:, 0, 0] < 0).all()
    assert (directions[:, -1, 0] > 0).all()
    np.testing.assert_allclose(directions[::-1] * [1, -1, 1], directions, atol=1e-15)
    np.testing.assert_allclose(directions[:, ::-1] * [-1, 1, 1], directions, atol=1e-15)


@pytest.mark.parametrize(("fov_y", "width", "height"), [(38, 6, 4), (90, 3, 10), (120, 5, 5)])
def test_field_of_view_is_vertical_and_pixels_are_square(fov_y, width, height):
    directions = Camera((0, 0, 0), (0, 0, -1), fov_y=fov_y, width=width, height=height).directions()
    on_plane = directions / -directions[..., 2:]
    pixel = 2 * np.tan(np.radians(fov_y) / 2) / height
    x = (np.arange(width) + 0.5 - width / 2) * pixel
    y = (height / 2 - np.arange(height) - 0.5) * pixel
    np.testing.assert_allclose(on_plane[..., 0], np.broadcast_to(x, (height, width)), atol=1e-13)
    np.testing.assert_allclose(on_plane[..., 1], np.broadcast_to(y[:, None], (height, width)), atol=1e-13)


def test_up_turns_the_image_and_need_not_be_unit_or_perpendicular():
    level = Camera((0, 0, 5), (0, 0, 0), width=5, height=5).directions()
    np.testing.assert_allclose(
        Camera((0, 0, 5), (0, 0, 0), (0, 7, 3), width=5, height=5).directions(), level, atol=1e-14
    )
    turned = Camera((0, 0, 5), (0, 0, 0), (1, 0, 0), width=5, height=5).directions()
    np.testing.assert_allclose(turned, np.stack([level[..., 1], -level[..., 0], level[..., 2]], axis=-1), atol=1e-14)


def test_cameras_compare_by_value():
    assert Camera((0, 0, 5), (0, 0, 0)) == Camera((0, 0, 5), (0, 0, 0))
    assert Camera((0, 0, 5), (0, 0, 0)) != Camera((0, 0, 5), (0, 0, 0), fov_y=39)


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"target": (0, 0, 5)}, "parallel, nor origin equal target"),
        ({"up": (0, 0, 2)}, "must not be parallel"),
        ({"up": (0, 0, 0)}, "must not be parallel"),
        ({"origin": (0, np.nan, 5)}, "three finite numbers"),
        ({"target": (0, 0, np.inf)}, "three finite numbers"),
        ({"origin": (0, 5)}, "three finite numbers"),
        ({"fov_y": np.nan}, "finite"),
        ({"fov_y": 0}, "between 0 and 180"),
        ({"fov_y": 180}, "between 0 and 180"),
        ({"width": 0}, "at least one"),
        ({"height": -3}, "at least one"),
    ],
)
def test_impossible_cameras_are_refused(change, message):
    with pytest.raises(InputError, match=message) as caught:
        any_camera(**{"origin": (0, 0, 5), "target": (0, 0, 0), **change})
    assert "\n" not in str(caught.value)


def test_vectors_of_other_lengths_are_refused():
    with pytest.raises(InputError, match="three finite numbers"):
        Camera((0, 0), (0, 0, 0, 1))  # pyright: ignore[reportArgumentType]


def test_pixels_share_the_solid_angle_of_the_picture():
    """Of a square of half angle 45°: a face of a cube, a sixth of the sphere."""
    angles = Camera((1, 2, 3), (4, 0, -1), fov_y=90, width=64, height=64).solid_angles()
    np.testing.assert_allclose(angles.sum(), 4 * np.pi / 6, rtol=1e-3)
    assert angles[0, 0] < angles[32, 32]
