"""Clusters: what they leave out, how they are put together, and what 8 bits do to them."""

from typing import Any

import jax
import numpy as np
import pytest

from jaxrelight.operators.clustered import _GROUP_BATCH, Cluster, Clustered, clustered, quantised_clusters
from jaxrelight.operators.clustering import as_clusters, cluster
from jaxrelight.operators.sparse_rows import sparse_rows

D = 96  # texels of a 6×4² cube map


def random(*shape: int, seed: int = 0) -> Any:
    return np.random.default_rng(seed).normal(size=shape).astype(np.float32)


@jax.jit
def each_and_many(operator: Clustered, lights):
    """The product with each light by itself, and with all at once."""
    return jax.lax.map(operator.apply, lights), operator.apply_many(lights)


def relative(actual, expected) -> float:
    return float(np.linalg.norm(np.asarray(actual, float) - expected) / np.linalg.norm(expected))


def of_sizes(sizes: list[tuple[int, int]], c: int = 1, r: int = 4, d: int = 1536) -> list[Cluster]:
    """Clusters of s coefficients and q shared rows each."""
    rng = np.random.default_rng(0)
    return [
        Cluster(
            np.sort(rng.permutation(d)[:s]),
            rng.normal(size=(q, s)).astype(np.float32),
            rng.normal(size=(c, q, r)).astype(np.float32),
        )
        for s, q in sizes
    ]


def test_a_cluster_leaves_out_what_may_be_left_out():
    """Half by the coefficients of least energy, half by the singular values of the others."""
    rows = np.random.default_rng(0).normal(size=(6, 2, D)) * np.linspace(3, 0.1, D)
    spectrum = np.linspace(1, 2, D)
    (support, basis, weights), dropped = cluster(rows, spectrum, 0.3)
    power = np.sum((rows * spectrum) ** 2, axis=(0, 1))
    may = 0.3**2 / 2 * power.sum()
    fewest = np.argsort(power)[-len(support) :]
    np.testing.assert_array_equal(support, np.sort(fewest))
    assert power.sum() - power[support].sum() <= may < power.sum() - power[fewest[1:]].sum()
    inside = rows[:, :, support].reshape(12, -1)
    tail = np.linalg.svd(inside * spectrum[support], compute_uv=False) ** 2
    assert tail[len(basis) :].sum() <= may < tail[len(basis) - 1 :].sum()
    mixed = np.einsum("cqr,qs->rcs", weights, basis)
    left = np.sum(((inside - mixed.reshape(12, -1)) * spectrum[support]) ** 2)
    np.testing.assert_allclose(left, tail[len(basis) :].sum(), rtol=1e-5)
    whole = np.array(rows)
    whole[:, :, support] -= mixed
    np.testing.assert_allclose(dropped, np.sum(whole**2, axis=-1), rtol=1e-5)


def test_what_rows_reflect_of_constant_light_is_kept_exactly():
    """With a shared row more than without, at most; the rest is as near as is asked for."""
    rows = np.random.default_rng(0).normal(size=(6, 2, D)) * np.linspace(3, 0.1, D)
    spectrum, constant = np.linspace(1, 2, D), np.arange(D) % (D // 6) == D // 6 - 1
    (support, basis, weights), _ = cluster(rows, spectrum, 0.3, constant)
    whole = np.zeros_like(rows)
    whole[:, :, support] = np.einsum("cqr,qs->rcs", weights, basis)
    np.testing.assert_allclose(whole @ constant, rows @ constant, rtol=1e-5, atol=1e-5)
    power = np.sum((rows * spectrum) ** 2)
    assert np.sum(((rows - whole) * spectrum) ** 2) <= 0.3**2 * power
    assert len(basis) <= len(cluster(rows, spectrum, 0.3)[0].basis) + 1
    black, _ = cluster(0 * rows, spectrum, 0.3, constant)
    assert not len(black.support)


def test_clusters_are_as_small_as_what_they_hold():
    matrix = np.zeros((4, 6, 1, D))
    rng = np.random.default_rng(1)
    matrix[1] = rng.normal(size=(6, 1, 1)) * rng.normal(size=D)
    clusters = [cluster(group, np.ones(D), 1e-3)[0] for group in matrix]
    assert [basis.shape[0] for _, basis, _ in clusters] == [0, 1, 0, 0]
    operator = clustered(clusters, D)
    assert [part.basis.shape for part in operator.buckets] == [(1, 4, 96)]
    assert relative(operator.to_matrix(), matrix.reshape(-1, 1, D)) < 1e-3
    black = clustered(clusters[2:], D)
    np.testing.assert_array_equal(black.apply(random(D, 3)), np.zeros((12, 3)))
    np.testing.assert_array_equal(black.transpose(random(12, 3)), np.zeros((D, 3)))
    assert black.nbytes < 4 * D + 100


@pytest.mark.parametrize("scale", [1e-18, 1.0, 1e18])
def test_clusters_do_not_depend_on_the_unit_of_light(scale):
    rows = np.random.default_rng(0).normal(size=(6, 2, D)).astype(np.float32)
    (one, _, _), _ = cluster(rows, np.ones(D), 0.1)
    (support, basis, weights), dropped = cluster(rows * np.float32(scale), np.ones(D), 0.1)
    np.testing.assert_array_equal(support, one)
    assert np.isfinite(dropped).all()
    mixed = np.einsum("cqr,qs->rcs", weights, basis)
    assert relative(mixed / scale, rows[:, :, support]) < 0.1


def test_buckets_are_joined_where_little_is_filled_up():
    near, far = [(96, 8), (96, 16), (90, 7), (60, 12)], [(1400, 200)] * 3
    operator = clustered(of_sizes([*near, *far, *near]), 1536)
    assert [part.basis.shape for part in operator.buckets] == [(8, 16, 96), (3, 200, 1408)]
    assert [part.groups.tolist() for part in operator.buckets] == [[0, 1, 2, 3, 7, 8, 9, 10], [4, 5, 6]]


def test_every_column_has_all_its_holders_once():
    clusters = of_sizes([(0, 0), (40, 3), (300, 9), (1500, 5), (1, 1), (300, 40)])
    operator = clustered(clusters, 1536)
    held = np.concatenate([np.asarray(part.support).ravel() for part in operator.buckets])
    count = np.zeros(1536, int)
    holders = [np.asarray(places) for places in operator.holders]
    for places in holders:
        real = places < len(held)
        assert (2 * real.sum(axis=1) > places.shape[1]).all()
    for column, row in enumerate(np.asarray(operator.column_place)):
        for places in holders:
            if 0 <= row < len(places):
                valid = places[row][places[row] < len(held)]
                assert (held[valid] == column).all()
                assert len(np.unique(valid)) == len(valid)
                count[column] = len(valid)
            row -= len(places)
    np.testing.assert_array_equal(count, sum(np.bincount(one.support, minlength=1536) for one in clusters))


@pytest.mark.parametrize(
    ("channels", "bits", "groups"),
    [
        *[(1, None, groups) for groups in (1, _GROUP_BATCH, _GROUP_BATCH + 1)],
        *[(channels, bits, _GROUP_BATCH + 1) for channels, bits in ((3, None), (1, 8))],
        *[
            pytest.param(channels, bits, groups, marks=pytest.mark.slow)
            for channels, bits in ((3, None), (1, 8))
            for groups in (1, _GROUP_BATCH)
        ],
    ],
)
def test_many_lights_reach_every_group_once(channels, groups, bits):
    """However many groups of a bucket are a step's; groups that hold nothing, and filling, are black."""
    operator = clustered(of_sizes([(96, 8), (0, 0), *[(90, 7)] * (groups - 1)], channels), 1536)
    assert [len(part.groups) for part in operator.buckets] == [groups]
    operator = (quantised_clusters(operator, bits) if bits else operator).with_filling(groups + 3)
    each, many = (np.asarray(radiance) for radiance in each_and_many(operator, random(5, 1536, 3)))
    assert relative(many, each) < 1e-6
    rows = many.reshape(5, groups + 3, 4, 3)
    assert not rows[:, [1, -2, -1]].any()
    assert rows[:, [0, *range(2, groups + 1)]].any(axis=(0, 2, 3)).all()


def test_many_lights_of_several_buckets():
    operator = clustered(of_sizes([(96, 8), (1400, 200), (0, 0), (90, 7), (1400, 190)], c=3), 1536)
    assert [part.groups.tolist() for part in operator.buckets] == [[0, 3], [1, 4]]
    each, many = each_and_many(operator, random(2, 1536, 3))
    assert relative(many, np.asarray(each)) < 1e-6


def test_light_has_the_channels_of_the_rows():
    operator = clustered(of_sizes([(96, 8)], c=3), 1536)
    for apply in (operator.apply, lambda light: operator.apply_many(light[None])):
        with pytest.raises(ValueError, match="light has 2 channels, the operator 3"):
            apply(random(1536, 2))


def test_eight_bits_are_near_and_small():
    """A scale for each coefficient: levels that differ by orders of magnitude are all kept."""
    clusters = of_sizes([(96, 8), (250, 16)], c=3, r=64)
    level = np.geomspace(1e3, 1e-3, 1536).astype(np.float32)
    clusters = [Cluster(support, basis * level[support], weights) for support, basis, weights in clusters]
    whole = clustered(clusters, 1536)
    for bits, bound in ((8, 0.02), (16, 1e-4)):
        coded = quantised_clusters(whole, bits)
        assert coded.nbytes < (bits / 32 + 0.15) * whole.nbytes
        light = random(1536, 3) / level[:, None]
        assert relative(coded.apply(light), np.asarray(whole.apply(light))) < bound
    with pytest.raises(ValueError, match="8 or 16"):
        quantised_clusters(whole, 4)


def test_rows_become_clusters():
    rng = np.random.default_rng(0)
    indices = np.sort(rng.random((8, D)).argsort(axis=1)[:, :6], axis=1)
    rows = sparse_rows(indices, rng.normal(size=(8, 3, 6)).astype(np.float32), D)
    operator = clustered(as_clusters(rows, 4, 1e-6), D)
    assert relative(operator.to_matrix(), np.asarray(rows.to_matrix())) < 1e-5


@pytest.mark.parametrize("bits", [8, 32])
def test_groups_come_out_as_they_went_in(bits):
    given = of_sizes([(96, 8), (40, 2), (0, 0), (95, 7)], c=3)
    operator = clustered(given, 1536)
    if bits < 32:
        operator = quantised_clusters(operator, bits)
    for one, restored in zip(given, operator.clusters(), strict=True):
        np.testing.assert_array_equal(restored.support, one.support)
        assert restored.weights.shape == one.weights.shape
        if bits == 32:
            np.testing.assert_array_equal(restored.basis, one.basis)
            np.testing.assert_array_equal(restored.weights, one.weights)
        elif len(one.support):
            assert relative(restored.basis, one.basis) < 0.02


def test_filling_is_black():
    operator = clustered(of_sizes([(96, 8), (40, 2)]), 1536)
    light = random(1536, 3)
    filled = np.asarray(operator.with_filling(5).apply(light))
    np.testing.assert_array_equal(filled[:8], operator.apply(light))
    np.testing.assert_array_equal(filled[8:], np.zeros((12, 3)))
