"""Surface points as an image: a permutation whose blocks are compact, by equal halves."""

import numpy as np
import pytest

from jaxrelight.basis.quadtree import flattened, z_curve


def scattered(count: int, seed: int = 0) -> tuple[np.ndarray, np.ndarray]:
    """Points on the six sides of a box, and its normals."""
    random = np.random.default_rng(seed)
    axis, sign = random.integers(3, size=count), random.choice([-1.0, 1], size=count)
    positions = random.uniform(-1, 1, (count, 3))
    positions[np.arange(count), axis] = sign
    normals = np.zeros((count, 3))
    normals[np.arange(count), axis] = sign
    return positions, normals


def test_the_curve_of_small_images():
    np.testing.assert_array_equal(z_curve(1), [0])
    np.testing.assert_array_equal(z_curve(2), [0, 1, 2, 3])
    np.testing.assert_array_equal(z_curve(4), [0, 1, 4, 5, 2, 3, 6, 7, 8, 9, 12, 13, 10, 11, 14, 15])


@pytest.mark.parametrize("side", [1, 2, 8, 64])
def test_runs_of_the_curve_are_blocks(side):
    place = z_curve(side)
    np.testing.assert_array_equal(np.sort(place), np.arange(side * side))
    for size in (2**k for k in range(side.bit_length())):
        y, x = np.divmod(place.reshape(-1, size * size), side)
        assert (np.ptp(y, axis=1) < size).all()
        assert (np.ptp(x, axis=1) < size).all()


def test_every_point_has_a_texel():
    order = flattened(*scattered(256))
    np.testing.assert_array_equal(np.sort(order), np.arange(256))


def test_one_point_is_an_image():
    np.testing.assert_array_equal(flattened(np.zeros((1, 3)), np.ones((1, 3))), [0])


def test_coinciding_points_are_an_image():
    np.testing.assert_array_equal(np.sort(flattened(np.zeros((16, 3)), np.tile([0.0, 0, 1], (16, 1)))), np.arange(16))


def test_what_lies_apart_is_parted():
    """Four heaps of as many points are the four children."""
    random = np.random.default_rng(1)
    heaps = np.array([[0, 0, 0], [9, 0, 0], [0, 0, 7], [9, 0, 7.0]])
    of_heap = random.permutation(np.repeat(np.arange(4), 16))
    positions = heaps[of_heap] + random.uniform(size=(64, 3))
    image = of_heap[flattened(positions, np.tile([0.0, 1, 0], (64, 1)))].reshape(8, 8)
    blocks = image.reshape(2, 4, 2, 4).swapaxes(1, 2).reshape(4, 16)
    assert (blocks == blocks[:, :1]).all()
    assert len(set(blocks[:, 0].tolist())) == 4


@pytest.mark.parametrize(("balance", "by_normal"), [(1e-3, True), (1e3, False)])
def test_balance(balance, by_normal):
    """Two sides of a thin sheet: normals part them first, unless positions count for much more."""
    random = np.random.default_rng(2)
    positions = random.uniform(size=(256, 3)) * [1, 1e-3, 1]
    up = random.permutation(np.repeat([1.0, -1], 128))
    order = flattened(positions, np.outer(up, [0, 1, 0]), balance)
    halves = up[order].reshape(2, 128)
    assert (np.abs(halves.sum(axis=1)) == 128).all() == by_normal


def test_blocks_are_compact():
    """Nearer together than runs of a space-filling order, whose normals it does not know."""
    from jaxrelight.geometry.morton import morton

    positions, normals = scattered(4096)

    def spread(members: np.ndarray) -> float:
        return sum(
            float(np.mean(np.var(values[members], axis=1).sum(axis=1) ** 0.5)) for values in (positions, normals)
        )

    image = flattened(positions, normals)[z_curve(64)]
    curve = np.argsort(morton((positions + 1) / 2), kind="stable")
    for size in (16, 64):
        assert spread(image.reshape(-1, size)) < 0.75 * spread(curve.reshape(-1, size))
