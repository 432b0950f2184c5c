"""The Z-shaped curve."""

import numpy as np
import pytest

from jaxrelight.geometry.morton import morton


@pytest.mark.parametrize("dimensions", [2, 3])
def test_every_cell_has_its_place_and_blocks_follow_each_other(dimensions):
    cells = np.stack(np.meshgrid(*[np.arange(4)] * dimensions, indexing="ij"), axis=-1).reshape(-1, dimensions)
    place = morton((cells + 0.5) / 4) // 2 ** (8 * dimensions)
    assert sorted(place) == list(range(4**dimensions))
    inner = (cells < 2).all(axis=1)
    assert sorted(place[inner]) == list(range(2**dimensions))


def test_points_beyond_are_clipped():
    np.testing.assert_array_equal(morton(np.array([[-1.0, 2.0], [0.0, 1.0]])), [morton(np.array([[0.0, 1.0]]))[0]] * 2)
