"""Codes with scales: laws of the coding, of the extremes, and of what transforms make of it."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.operators.quantised import Quantised, decoded, quantised
from jaxrelight.operators.sparse_rows import sparse_rows

D = 300
STEPS = {8: 127, 16: 32767}


def numbers(*shape: int, seed: int = 0, dtype=np.float32) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=shape).astype(dtype)


def spread(kept: Quantised) -> np.ndarray:
    """The scale of every number."""
    return np.repeat(np.asarray(kept.scale, float), kept.run, axis=-1)[..., : kept.shape[-1]]


@pytest.mark.parametrize(("bits", "run"), list(itertools.product(STEPS, (None, 16, 7, 1, 100))))
def test_no_number_is_off_by_more_than_half_a_step(bits, run):
    values = numbers(5, 3, 40) * np.geomspace(1e-3, 1e3, 40, dtype=np.float32)
    kept = quantised(values, bits, run)
    assert kept.codes.dtype == f"int{bits}"
    assert kept.shape == values.shape
    assert kept.scale.shape == (5, 3, -(-40 // min(run or 40, 40)))
    assert kept.nbytes == kept.codes.size * bits // 8 + kept.scale.size * 4
    # Rounding of single precision beside the half step.
    slack = 1e-6 * np.abs(values)
    assert (np.abs(np.asarray(kept.decoded()) - values) <= spread(kept) / 2 + slack).all()
    # Steps are as fine as they can be: of each run the largest has the largest code, of its sign, and is kept.
    for run_values, codes in zip(runs_of(values, kept.run), runs_of(kept.codes, kept.run), strict=True):
        largest = np.abs(run_values).argmax(axis=-1)[..., None]
        chosen = np.take_along_axis(codes, largest, axis=-1)
        np.testing.assert_array_equal(chosen, STEPS[bits] * np.sign(np.take_along_axis(run_values, largest, axis=-1)))
        assert np.abs(codes.astype(int)).max() == STEPS[bits]


def runs_of(array, run: int) -> list[np.ndarray]:
    return [np.asarray(array)[..., start : start + run] for start in range(0, array.shape[-1], run)]


@pytest.mark.parametrize("bits", STEPS)
def test_codes_go_round(bits):
    kept = quantised(numbers(6, 32), bits, 8)
    again = quantised(np.asarray(kept.decoded()), bits, 8)
    np.testing.assert_array_equal(again.codes, kept.codes)
    np.testing.assert_allclose(again.scale, kept.scale, rtol=1e-6)


def test_the_sign_goes_through_and_the_size_is_only_in_the_scale():
    values = numbers(4, 32)
    kept, turned, larger = (quantised(factor * values, 8, 16) for factor in (1, -1, 1024))
    np.testing.assert_array_equal(turned.codes, -np.asarray(kept.codes))
    np.testing.assert_array_equal(larger.codes, kept.codes)
    np.testing.assert_array_equal(larger.scale, 1024 * np.asarray(kept.scale))


@pytest.mark.parametrize(("host", "bits"), list(itertools.product((True, False), STEPS)))
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_extremes(x64, host, bits, dtype):
    largest, smallest = float(np.finfo(dtype).max), float(np.finfo(dtype).tiny)
    rows = [[0, 0, 0], [1e-38, -1e-38, 0], [1e38, -1e38, 1], [1e6, 1, -0.5], [largest, -largest, 0]]
    rows += [[smallest, 0, 0], [1e-35, -5e-36, 0], [1e-30, -1e-30, 1e-36], [smallest / 1e5, 0, 0]]
    values = np.asarray(rows, dtype)
    kept = quantised(values if host else jnp.asarray(values), bits)
    restored = np.asarray(kept.decoded())
    assert restored.dtype == dtype
    assert np.isfinite(restored).all()
    scale = np.asarray(kept.scale)
    assert np.isfinite(scale).all()
    assert ((scale == 0) | (scale >= smallest)).all()
    # What is smaller than the smallest scale may become zero.
    half = np.maximum(scale / 2, STEPS[bits] * smallest)
    assert (np.abs(restored / 2 - values / 2) <= half / 2 + 1e-6 * np.abs(values)).all()
    np.testing.assert_array_equal(restored[0], 0)
    np.testing.assert_allclose(restored[2, :2], values[2, :2], rtol=1e-6)
    np.testing.assert_allclose(restored[3, 0], 1e6, rtol=1e-6)


@pytest.mark.parametrize("host", [True, False])
@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_what_is_not_finite_stays_seen_and_spoils_only_its_run(host, bad):
    values = numbers(2, 8)
    values[1, 2] = bad
    kept = quantised(values if host else jnp.asarray(values), 8, 4)
    restored = np.asarray(kept.decoded())
    assert np.isnan(restored[1, :4]).all()
    good = np.asarray(quantised(numbers(2, 8), 8, 4).decoded())
    others = np.arange(16).reshape(2, 8) // 4 != 2
    np.testing.assert_array_equal(restored[others], good[others])


def test_numpy_and_jax_make_the_same_each_by_itself():
    values = numbers(7, 33)
    host = quantised(values, 8, 16)
    assert isinstance(host.codes, np.ndarray)
    assert isinstance(host.scale, np.ndarray)
    device = jax.jit(lambda x: quantised(x, 8, 16))(values)
    np.testing.assert_allclose(device.scale, host.scale, rtol=1e-6)
    np.testing.assert_allclose(device.decoded(), host.decoded(), atol=1.01 * host.scale.max())
    assert np.mean(np.asarray(device.codes) != host.codes) < 0.01


def test_transforms_go_through():
    values = jnp.asarray(numbers(6, 32))
    one = quantised(values, 16, 8)
    many = jax.vmap(lambda row: quantised(row, 16, 8))(values)
    np.testing.assert_array_equal(many.codes, one.codes)
    np.testing.assert_array_equal(jax.jit(decoded)(one), one.decoded())
    np.testing.assert_array_equal(jax.vmap(lambda row: row.decoded())(one), one.decoded())
    np.testing.assert_array_equal(decoded(values), values)


@pytest.mark.parametrize("bits", [1, 7, 32])
def test_other_numbers_of_bits_are_refused(bits):
    with pytest.raises(ValueError, match=f"8 or 16 bits, not {bits}"):
        quantised(numbers(3), bits)


@pytest.mark.parametrize(("bits", "run"), [(8, None), (8, 16), (16, None)])
def test_rows_are_as_near_as_their_steps_allow(bits, run):
    """Against the same rows as they were, under any light: at most Σ|x|·scale/2 apart, and no nearer than that says."""
    indices = np.sort(np.random.default_rng(1).random((9, D)).argsort(axis=-1)[:, :40], axis=-1)
    values, light = numbers(9, 3, 40), numbers(D, 3, seed=2)
    kept = quantised(values, bits, run)
    whole, coded = sparse_rows(indices, values, D), sparse_rows(indices, kept, D)
    apart = np.abs(np.asarray(coded.apply(jnp.asarray(light))) - np.asarray(whole.apply(jnp.asarray(light))))
    gathered = np.abs(np.moveaxis(light[indices], -1, 1))
    bound = np.sum(gathered * spread(kept), axis=-1) / 2
    assert (apart <= bound + 1e-5).all()
    assert apart.max() > 0.01 * bound.max()
    assert coded.indices.nbytes + kept.nbytes == coded.nbytes
    assert all(isinstance(channel, Quantised) and channel.codes.dtype == f"int{bits}" for channel in coded.values)
