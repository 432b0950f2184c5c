"""Nested lattices: what must be shaded is, linear functions are reproduced, kinds do not mix, noise adds up."""

import functools

import jax
import numpy as np
import pytest

from jaxrelight.lighting.adaptive.hierarchy import LEVELS, Features, Hierarchy, _most_around, hierarchy
from jaxrelight.numerics.arrays import as_array

H, W = 40, 48
# Channels of an image that are worked on together: one number of them is compiled.
CHANNEL_CHUNK = 64


def features(kind=None, angular: float | np.ndarray = 0.5, contrast=1.0, spatial=0.0, bent=0.01) -> Features:
    """Mirrors that turn evenly to the right and down."""
    y, x = np.mgrid[:H, :W].astype(np.float32)
    mirror = np.stack([bent * (x - W / 2), bent * (y - H / 2), np.ones_like(x)], axis=-1)
    mirror /= np.linalg.norm(mirror, axis=-1, keepdims=True)
    kind = np.zeros((H, W), np.int32) if kind is None else kind
    position = np.stack([x, y, 0 * x], axis=-1)
    angular, spatial, contrast = (np.broadcast_to(np.float32(of), (H, W)) for of in (angular, spatial, contrast))
    return Features(*map(as_array, (kind, mirror, angular, position, spatial, contrast)))


def interpolated(between: Hierarchy, image: np.ndarray) -> np.ndarray:
    """By so many channels at a time."""
    channels = image.shape[2]
    wide = np.pad(image.astype(np.float32), ((0, 0), (0, 0), (0, -channels % CHANNEL_CHUNK)))
    parts = np.split(wide, wide.shape[2] // CHANNEL_CHUNK, axis=2)
    return np.concatenate([between.interpolate(as_array(part)) for part in parts], axis=2)[..., :channels]


@functools.cache
def plain() -> Hierarchy:
    return hierarchy(features())


def test_nothing_is_left_without_tolerance_and_little_is_shaded_with_much():
    between = plain()
    assert np.asarray(between.shaded).all()
    least = np.asarray(between.within(1e9).shaded)
    assert least[:: 2**LEVELS, :: 2**LEVELS].all()
    # Beyond the last lattice a line through its pixels would make their noise larger.
    assert least[: -(H % 2**LEVELS), : -(W % 2**LEVELS)].sum() == 1
    assert least.mean() < 0.02
    counts = [np.asarray(between.within(tolerance).shaded).sum() for tolerance in (0.3, 0.1, 0.03, 0.01)]
    assert counts == sorted(counts)
    assert (np.asarray(between.within(0.1).left) <= 0.1).all()


def test_what_is_linear_in_the_mirror_is_reproduced():
    given = features()
    image = np.asarray(given.mirror) @ np.array([[0.5, 2], [1, -1], [0, 0]], np.float32) + 3
    between = plain().within(0.02)
    shaded = np.asarray(between.shaded)
    assert shaded.mean() < 0.7
    np.testing.assert_allclose(interpolated(between, np.where(shaded[..., None], image, 7)), image, atol=0.02)


def test_shaded_pixels_stay():
    image = np.random.default_rng(0).random((H, W, 3)).astype(np.float32)
    between = plain().within(0.05)
    shaded = np.asarray(between.shaded)
    np.testing.assert_array_equal(interpolated(between, image)[shaded], image[shaded])
    np.testing.assert_allclose(interpolated(plain().within(1e9), np.ones((H, W, 1))), 1, atol=1e-5)


def test_kinds_do_not_mix():
    kind = np.zeros((H, W), np.int32)
    kind[:, 19:] = 1
    kind[5:9, 10:30] = 2
    kind[:, 40:] = -1
    between = hierarchy(features(kind)).within(1e9)
    image = np.where(kind >= 0, kind + 1.0, 99)[..., None].astype(np.float32)
    filled = interpolated(between, image)
    asked = kind >= 0
    np.testing.assert_allclose(filled[asked], image[asked], atol=1e-4)
    assert not np.asarray(between.shaded)[~asked].any()
    # A wire one pixel wide is shaded or between pixels of its own.
    kind = np.zeros((H, W), np.int32)
    kind[:, 7] = 1
    filled = interpolated(hierarchy(features(kind)).within(1e9), kind[..., None])
    np.testing.assert_allclose(filled[..., 0], kind, atol=1e-4)


@pytest.mark.parametrize("of", ["angular", "spatial", "contrast"])
def test_more_of_anything_asks_for_more(of: str):
    base = {"angular": 0.5, "spatial": 0.002, "contrast": 1.0}
    counts = []
    for factor in (1, 3, 10):
        between = hierarchy(features(**{**base, of: base[of] * factor})).within(0.1)
        counts.append(np.asarray(between.shaded).sum())
    assert counts == sorted(counts)
    assert counts[0] < counts[2]


def test_all_is_smooth_where_nothing_varies():
    assert np.asarray(hierarchy(features(angular=0)).within(1e-6).shaded).sum() < 0.02 * H * W


def test_influence_is_the_transpose_of_how_variance_is_propagated():
    between = plain().within(0.05)
    variance = np.random.default_rng(0).random((H, W)).astype(np.float32)
    shaded = np.asarray(between.shaded)
    total = np.asarray(between.propagate_variance(as_array(variance))).sum()
    np.testing.assert_allclose(np.sum(np.asarray(between.influence())[shaded] * variance[shaded]), total, rtol=1e-4)


@pytest.mark.parametrize("tolerance", [0.1, 0.4, 2.0])
def test_propagated_variance_is_near_that_of_what_lies_between(tolerance: float):
    """Were all parents taken for independent, it would be down to a quarter of that."""
    between = plain().within(tolerance)
    shaded = np.flatnonzero(np.asarray(between.shaded))
    each = np.zeros((H * W, len(shaded)), np.float32)
    each[shaded, np.arange(len(shaded))] = 1
    exact = np.sum(interpolated(between, each.reshape(H, W, -1)) ** 2)
    variance = np.asarray(between.propagate_variance(as_array(np.ones((H, W), np.float32))))
    assert 0.75 < variance.sum() / exact < 1.35


def test_levels_say_what_lies_between():
    between = plain().within(1e9)
    levels = between.levels()
    assert levels[0, 0] == 0
    assert levels[0, 2 ** (LEVELS - 1)] == LEVELS
    assert levels[1, 1] == levels[0, 1] == 1
    assert ((levels == 0) == np.asarray(between.shaded)).all()


@pytest.mark.parametrize("place", [15.5, 23.7, 31.5, 40.2])
@pytest.mark.parametrize("way", [(1.0, 0.0), (0.0, 1.0), (0.8, 0.6)])
def test_an_edge_is_not_bridged(place: float, way: tuple[float, float]):
    """A step, seen by a band of five pixels beside it: none of all others lie between parents on both of its sides."""
    y, x = np.mgrid[:H, :W]
    away = way[0] * x + way[1] * y - place
    image = np.where(away > 0, 1, 0.25).astype(np.float32)
    between = hierarchy(features(angular=np.where(np.abs(away) < 2.5, 40, 0.05))).within(0.02)
    assert np.asarray(between.shaded).mean() < 0.25
    np.testing.assert_allclose(interpolated(between, image[..., None])[..., 0], image, atol=0.02)


def test_errors_of_parents_are_passed_on():
    """To the error of lying between shaded ones comes what others are off themselves; to those of none, nothing."""
    between = plain().within(0.4)
    own, left, shaded = (np.asarray(of) for of in (between.error, between.left, between.shaded))
    assert (left[shaded] == 0).all()
    assert (left[~shaded] >= 0.999 * own[~shaded]).all()
    assert (left[~shaded] > 1.5 * own[~shaded]).mean() > 0.5


def test_coarse_pixels_are_shaded_for_smaller_errors():
    between = plain().within(0.2)
    level, own = np.asarray(between.levels()), np.asarray(between.error)
    most = [own[level == of].max(initial=0) for of in range(1, LEVELS + 1)]
    assert all(one <= 0.2 / 2**of + 1e-6 for of, one in enumerate(most, start=1))


def test_inside_pixels_the_nearest_parents_alone_count():
    """Of two and four where there are eight and twelve; linear functions are reproduced all the same."""
    nearest = hierarchy(features(), inside=2)
    size = -(-H // 2**LEVELS) * -(-W // 2**LEVELS)
    coarse = sum(4**level * size for level in range(LEVELS - 2))
    for given, start, counts in (plain(), 0, (8, 8, 12)), (nearest, 0, (8, 8, 12)), (nearest, coarse, (2, 2, 4)):
        used = np.asarray(given.weights)[..., start : start + coarse].any(axis=2)
        assert used.sum(axis=0).tolist() == list(counts)
    between = nearest.within(0.02)
    image = np.asarray(features().mirror) @ np.array([[0.5, 2], [1, -1], [0, 0]], np.float32) + 3
    shaded = np.asarray(between.shaded)
    assert shaded.mean() < 0.7
    np.testing.assert_allclose(interpolated(between, np.where(shaded[..., None], image, 7)), image, atol=0.02)
    # Those of coarser levels are what they are without.
    these, those = (np.asarray(of.weights)[..., :coarse] for of in (nearest, plain()))
    np.testing.assert_array_equal(these, those)


def test_opposite_borders_are_not_beside_each_other():
    """What varies at one border of the picture asks for nothing at the other, and other kinds ask for nothing."""
    rates, kinds = np.zeros((1, 6, 6), np.float32), np.zeros((6, 6), np.int32)
    rates[0, 5, 5] = rates[0, 1, 3] = 1
    kinds[1, 3] = 1
    wanted = np.zeros((6, 6))
    wanted[4:, 4:] = wanted[1, 3] = 1
    np.testing.assert_array_equal(jax.jit(_most_around)(rates, kinds)[0], wanted)


def test_sources_are_the_shaded_pixels_that_others_hang_on():
    """What lies between them is the same where no other pixel is shaded."""
    between = hierarchy(features(angular=0.5)).within(0.3)
    chosen = np.zeros((H, W), bool)
    chosen[5, 7] = chosen[8, 8] = chosen[H - 1, W - 1] = True
    found, image = between.sources(chosen), np.random.default_rng(0).random((H, W, 3), np.float32)
    assert not np.asarray(between.shaded)[chosen].all()
    assert found.sum() < np.asarray(between.shaded).sum()
    all_of_it, some = (
        np.asarray(between.interpolate(as_array(of)))[chosen] for of in (image, image * found[..., None])
    )
    np.testing.assert_array_equal(some, all_of_it)
