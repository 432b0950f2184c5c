"""Shared solid angles: closed forms, and the sums that any sizes must have."""

import numpy as np
import pytest

from jaxrelight.basis import cubemap, latlong
from jaxrelight.basis.overlaps import overlaps


def table(height: int, width: int, resolution: int) -> np.ndarray:
    """Shares [texel, pixel]."""
    shares = np.zeros((6 * resolution**2, height * width))
    for texel, pixel, shared in overlaps(height, width, resolution):
        np.add.at(shares, (texel, pixel), shared)
    return shares


@pytest.mark.parametrize("resolution", [1, 2, 3, 8])
def test_a_single_pixel_holds_every_texel(resolution):
    np.testing.assert_allclose(table(1, 1, resolution)[:, 0], cubemap.solid_angles(resolution), rtol=1e-6)


def test_eighths_of_faces_and_hemispheres():
    shares = table(2, 8, 1).reshape(6, 2, 8)
    eighth = 4 * np.pi / 48
    np.testing.assert_allclose(shares[2], [[eighth] * 8, [0] * 8], atol=1e-12)
    np.testing.assert_allclose(shares[3], [[0] * 8, [eighth] * 8], atol=1e-12)
    # +z covers the two columns on either side of the centre, and half of it lies above the horizon.
    np.testing.assert_allclose(shares[4], [[0, 0, 0, 2 * eighth, 2 * eighth, 0, 0, 0]] * 2, atol=1e-12)
    np.testing.assert_allclose(shares[0], np.roll(shares[4], -2, axis=1), atol=1e-12)
    np.testing.assert_allclose(shares[5], np.roll(shares[4], 4, axis=1), atol=1e-12)


@pytest.mark.parametrize(
    ("height", "width", "resolution"), [(1, 5, 3), (3, 1, 2), (5, 7, 4), (2, 9, 1), (7, 3, 5), (1, 64, 4), (40, 1, 4)]
)
def test_any_sizes_keep_both_sums(height, width, resolution):
    shares = table(height, width, resolution)
    assert shares.min() >= 0
    np.testing.assert_allclose(shares.sum(axis=1), cubemap.solid_angles(resolution), rtol=2e-6)
    pixel_area = np.repeat(latlong.solid_angles(height, width), width)
    np.testing.assert_allclose(shares.sum(axis=0), pixel_area, rtol=2e-6)


@pytest.mark.parametrize(("height", "width", "resolution"), [(3, 5, 2), (7, 6, 3)])
def test_shares_are_those_of_many_directions(height, width, resolution):
    n = 1500
    u, v = np.meshgrid((np.arange(2 * n) + 0.5) / (2 * n), (np.arange(n) + 0.5) / n)
    texel = cubemap.texel_of(latlong.directions(u, v), resolution)
    pixel = (v * height).astype(int) * width + (u * width).astype(int)
    area = np.broadcast_to(latlong.solid_angles(n, 2 * n)[:, None], u.shape)
    counted = np.zeros((6 * resolution**2, height * width))
    np.add.at(counted, (texel, pixel), area)
    np.testing.assert_allclose(table(height, width, resolution), counted, atol=1e-3)
