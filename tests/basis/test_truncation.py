"""Non-linear approximation: the error is the dropped energy, and no choice is better."""

from itertools import combinations

import hypothesis
import hypothesis.strategies as st
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.basis import truncation
from jaxrelight.basis.truncation import Truncated

gather = jax.jit(truncation.gather)
# Most rows are of this shape: programs are the same.
SHAPE = (5, 3, 24)
SHAPES = [(*SHAPE, 6), (4, 1, 24, 1), (*SHAPE, 23), (2, 3, 96, 16)]


def keep_largest(rows, count: int) -> Truncated:
    return jax.tree.map(np.asarray, _keep_largest(rows, count))


_keep_largest = jax.jit(truncation.keep_largest, static_argnums=1)


def random_rows(r: int, c: int, d: int, seed: int = 0) -> np.ndarray:
    """Rows whose coefficients fall off over many decades, as wavelets of transport do."""
    rng = np.random.default_rng(seed)
    size = 10.0 ** rng.uniform(-5, 2, size=(r, 1, d))
    return (size * rng.normal(size=(r, c, d))).astype(np.float32)


def written_out(kept: Truncated, d: int) -> np.ndarray:
    """Kept rows in float64 with zeros elsewhere."""
    values = np.asarray(kept.values, float)
    out = np.zeros((*values.shape[:2], d))
    np.put_along_axis(out, np.broadcast_to(np.asarray(kept.indices)[:, None], values.shape), values, axis=-1)
    return out


@pytest.mark.parametrize(("r", "c", "d", "count"), SHAPES)
def test_the_kept_set_is_the_best_one(r, c, d, count):
    rows = random_rows(r, c, d)
    kept = keep_largest(rows, count)
    assert kept.indices.shape == (r, count)
    assert kept.values.shape == (r, c, count)
    assert (np.diff(kept.indices, axis=-1) > 0).all()
    energy = np.sum(rows.astype(float) ** 2, axis=1)
    best = np.sort(energy, axis=-1)[:, ::-1][:, :count]
    kept_energy = np.take_along_axis(energy, np.asarray(kept.indices), axis=-1)
    np.testing.assert_allclose(np.sort(kept_energy, axis=-1)[:, ::-1], best, rtol=1e-6)
    np.testing.assert_array_equal(kept.values, gather(rows, kept.indices))


def test_small_dropped_energy_is_not_lost_beside_a_large_total():
    row = np.full(SHAPE, 1e-3, np.float32)
    row[..., 7] = 1e5
    kept = keep_largest(row, 1)
    np.testing.assert_allclose(kept.dropped, 23e-6, rtol=1e-5)
    assert kept.indices.tolist() == [[7]] * 5


def test_nothing_is_dropped_with_all_coefficients():
    rows = random_rows(*SHAPE)
    kept = keep_largest(rows, 24)
    np.testing.assert_array_equal(kept.dropped, 0)
    np.testing.assert_array_equal(kept.indices, np.broadcast_to(np.arange(24), (5, 24)))
    np.testing.assert_array_equal(kept.values, rows)


def test_ties_and_empty_rows():
    ties = keep_largest(np.ones(SHAPE, np.float32), 6)
    assert all(len(set(row)) == 6 for row in ties.indices.tolist())
    np.testing.assert_array_equal(ties.dropped, 18)
    np.testing.assert_array_equal(ties.total, 24)
    empty = keep_largest(np.zeros(SHAPE, np.float32), 6)
    assert all(len(set(row)) == 6 for row in empty.indices.tolist())
    np.testing.assert_array_equal(empty.values, 0)
    np.testing.assert_array_equal(empty.dropped, 0)
    np.testing.assert_array_equal(empty.total, 0)


def test_channels_are_judged_together():
    """1² + 1² + 1² beats 1.5² + 0 + 0."""
    row = np.zeros(SHAPE, np.float32)
    row[:, :, 2], row[:, 0, 5] = 1, 1.5
    kept = keep_largest(row, 1)
    assert kept.indices.tolist() == [[2]] * 5
    np.testing.assert_allclose(kept.dropped, [[2.25, 0, 0]] * 5)


def test_what_counts_most_under_light_is_kept():
    """Of all choices, the mean square of what is left out of products with such light is smallest."""
    rows, deviations = random_rows(3, 2, 8), (0.5 ** np.arange(8)).astype(np.float32)
    kept = jax.tree.map(np.asarray, _keep_largest(rows, 3, deviations))
    left = np.sum(((rows - written_out(kept, 8)) * deviations) ** 2, axis=(1, 2))
    for row, least in zip(rows, left, strict=True):
        choices = [np.sum((np.delete(row * deviations, chosen, axis=1)) ** 2) for chosen in combinations(range(8), 3)]
        np.testing.assert_allclose(least, min(choices), rtol=1e-5)
    np.testing.assert_allclose(kept.dropped, np.sum((rows - written_out(kept, 8)) ** 2, axis=-1), rtol=1e-5)
    plain = keep_largest(rows, 3)
    same = jax.tree.map(np.asarray, _keep_largest(rows, 3, np.full(8, 2.0, np.float32)))
    np.testing.assert_array_equal(same.indices, plain.indices)


def test_float64(x64):
    rows = random_rows(2, 3, 24).astype(float)
    kept = keep_largest(rows, 6)
    assert kept.values.dtype == kept.dropped.dtype == np.float64
    np.testing.assert_allclose(kept.dropped, np.sum((rows - written_out(kept, 24)) ** 2, axis=-1), rtol=1e-13)


def test_gather_is_linear_and_its_gradient_goes_to_what_was_kept():
    rows = random_rows(*SHAPE)
    indices = np.sort(np.random.default_rng(3).permuted(np.tile(np.arange(24), (5, 1)), axis=1)[:, :6], axis=1)
    weight = np.random.default_rng(2).normal(size=(5, 3, 6)).astype(np.float32)
    slope = jax.jit(jax.grad(lambda rows: jnp.sum(weight * gather(rows, indices))))(rows)
    expected = np.zeros(rows.shape)
    np.put_along_axis(expected, np.broadcast_to(indices[:, None], weight.shape), weight, axis=-1)
    np.testing.assert_allclose(slope, expected, rtol=1e-6)
    tangent = jax.jit(lambda rows, way: jax.jvp(lambda rows: gather(rows, indices), (rows,), (way,))[1])(rows, 2 * rows)
    np.testing.assert_allclose(tangent, 2 * np.asarray(gather(rows, indices)), rtol=1e-6)


ROW = st.lists(st.floats(-1e3, 1e3, width=32), min_size=8, max_size=8)


@hypothesis.given(ROW, st.sampled_from([1, 3, 8]))
def test_any_row_is_split_into_kept_and_dropped(values, count):
    row = np.asarray(values, np.float32)[None, None]
    kept = keep_largest(row, count)
    energy = np.sort(row.astype(float)[0, 0] ** 2)
    np.testing.assert_allclose(kept.dropped[0, 0], energy[: 8 - count].sum(), rtol=1e-5, atol=1e-35)
    np.testing.assert_allclose(kept.total[0, 0], energy.sum(), rtol=1e-5, atol=1e-35)
