"""Texels fitted by themselves: known maps come back, bad texels are flagged and harm nobody."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fitting import sbrdf, sbrdf_levels
from fitting.prediction import lambert_only, predicted, relative_error
from fitting.sbrdf import fit_sbrdf, reached
from fitting.sbrdf_levels import coarser
from fitting.solve import Options, Verdict
from fitting.stack import Stack, stack_of
from fitting.stack_files import load_stack
from jaxrelight.brdf.files.sbrdf import SbrdfLevel
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.numerics.arrays import as_array
from tests.shared_data import shared

SIZE = 4


@pytest.fixture(autouse=True)
def _small_chunks(monkeypatch):
    """As few as are refitted together, so that one program fits in all tests."""
    monkeypatch.setattr(sbrdf, "CHUNK", 2)
    monkeypatch.setattr(sbrdf_levels, "CHUNK", 2)


def _level() -> SbrdfLevel:
    """Two materials: a soft and a sharper lobe, over different albedos."""
    left = np.arange(SIZE)[None, :, None] < SIZE / 2
    shape = (SIZE, SIZE)
    diffuse = np.where(left, [0.4, 0.2, 0.1], [0.1, 0.3, 0.5])
    C = np.broadcast_to([-1.0, -1, 0.9], (*shape, 1, 3))
    exponent = np.broadcast_to(np.where(left, 6.0, 20.0), (*shape, 1))
    scale = np.broadcast_to(np.where(left, 0.4, 1.2)[..., None], (*shape, 1, 3))
    axis = np.broadcast_to([1.0, 0], (*shape, 2))
    maps = SpatialLobes(
        *(as_array(a, jnp.float32) for a in (np.broadcast_to(diffuse, (*shape, 3)), C, exponent, scale, axis))
    )
    normals = np.random.default_rng(0).normal([0, 0, 1], 0.15, (*shape, 3))
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    return SbrdfLevel(maps, normals, np.zeros(shape, int), np.zeros(shape, np.float32))


def _stack(count=256, noise=0.0) -> Stack:
    index = np.arange(count)
    slant = 0.95 * np.sqrt((index + 0.5) / count)
    lights = np.stack([slant * np.cos(2.4 * index), slant * np.sin(2.4 * index), np.sqrt(1 - slant**2)], axis=-1)
    eyes = np.stack([0.5 * np.sin(1.7 * index), 0.4 * np.cos(1.1 * index), np.ones(count)], axis=-1)
    blank = stack_of(np.zeros((count, SIZE, SIZE, 3)), lights, views=eyes, normals=_level().normals)
    images = predicted(_level(), blank)
    return dataclasses.replace(blank, images=images * (1 + noise * np.random.default_rng(1).normal(size=images.shape)))


def test_known_lobes_come_back():
    fit = fit_sbrdf(_stack(), share=0)
    assert fit.counts() == {"good": SIZE * SIZE}
    assert not fit.estimated
    truth = _level().lobes
    np.testing.assert_allclose(fit.level.lobes.exponent, truth.exponent, rtol=0.02)
    np.testing.assert_allclose(fit.level.lobes.C, truth.C, atol=0.01)
    np.testing.assert_allclose(fit.level.lobes.diffuse, truth.diffuse, atol=0.005)


@pytest.mark.slow
def test_images_held_out_are_predicted_to_the_noise_and_better_than_by_lambert():
    stack = _stack(60, noise=0.02)
    held = np.arange(60) % 6 == 3
    seen, unseen = stack.of(~held), stack.of(held)
    fit = fit_sbrdf(seen)
    error = relative_error(predicted(fit.level, unseen), unseen)
    assert error < 0.04
    assert error < 0.3 * relative_error(predicted(lambert_only(seen, fit.level.normals), unseen), unseen)


def test_bad_texels_are_flagged_and_leave_the_others_as_they_are():
    stack = _stack()
    images, usable = stack.images.copy(), stack.usable.copy()
    images[:, 0, 0], usable[:, 0, 0] = 0, False  # as stack_of leaves NaN
    images[:, 1, 1] = 0
    bad = fit_sbrdf(dataclasses.replace(stack, images=images, usable=usable), share=0)
    good = fit_sbrdf(stack, share=0)
    assert bad.level.flag[0, 0] == Verdict.NO_DATA
    assert bad.level.flag[1, 1] == Verdict.BLACK
    same = np.ones((SIZE, SIZE), bool)
    same[0, 0] = same[1, 1] = False
    for leaf, wanted in zip(*map(jax.tree.leaves, (bad.level.lobes, good.level.lobes)), strict=True):
        np.testing.assert_array_equal(np.asarray(leaf)[same], np.asarray(wanted)[same])
    assert all(np.isfinite(array).all() for array in jax.tree.leaves(bad.level.lobes))


@pytest.mark.slow
def test_what_was_done_is_not_done_again(tmp_path, monkeypatch):
    stack = _stack(60)
    told = []

    def stop(done, total):
        told.append((done, total))
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        fit_sbrdf(stack, folder=tmp_path, report=stop)
    assert told == [(2, 16)]
    calls = []
    inner = sbrdf._fit_texels
    monkeypatch.setattr(sbrdf, "_fit_texels", lambda *given: calls.append(1) or inner(*given))
    resumed = fit_sbrdf(stack, folder=tmp_path)
    assert len(calls) == 7
    whole = fit_sbrdf(stack)
    np.testing.assert_array_equal(resumed.level.lobes.exponent, whole.level.lobes.exponent)


@pytest.mark.slow
def test_the_coarser_level_is_the_mean_of_the_functions():
    """Of equal texels it is those; of a soft and a sharp highlight neither, but close to their mean."""
    level, mask = coarser(_level(), np.ones((SIZE, SIZE), bool), Options())
    assert mask.shape == (2, 2)
    np.testing.assert_allclose(level.lobes.exponent[:, 0, 0], 6, rtol=0.03)
    np.testing.assert_allclose(level.lobes.exponent[:, 1, 0], 20, rtol=0.03)
    coarsest, mask = coarser(level, mask, Options())
    assert coarsest.lobes.shape == mask.shape == (1, 1)
    assert 6 < float(coarsest.lobes.exponent[0, 0, 0]) < 20
    assert coarsest.residual[0, 0] < 0.1
    np.testing.assert_allclose(np.linalg.norm(coarsest.normals, axis=-1), 1)


def test_texels_off_the_mask_do_not_count():
    mask = np.ones((SIZE, SIZE), bool)
    mask[:, 1] = False
    mask[2:, :2] = False
    level, new_mask = coarser(_level(), mask, Options())
    np.testing.assert_array_equal(new_mask, [[True, True], [False, True]])
    np.testing.assert_allclose(np.asarray(level.lobes.exponent)[0, 0], 6, rtol=0.03)


def test_the_lowest_of_some_angles_is_found_between_them():
    angles = np.arange(6) * np.pi / 12
    truth = np.array([0.3, 1.4, 0.0, 1.56])
    apart = np.sin(angles - truth[:, None])
    residuals = np.sqrt(0.1 + np.minimum(apart**2, np.cos(angles - truth[:, None]) ** 2))
    lowest = sbrdf._lowest(angles, residuals)
    difference = (lowest - truth + np.pi / 4) % (np.pi / 2) - np.pi / 4
    assert np.abs(difference).max() < np.radians(4)


def _seen_from_one_place() -> Stack:
    """Ten lights near the eye, and a tilted surface of no highlight, with noise."""
    rng = np.random.default_rng(0)
    index = np.arange(10)
    lights = np.stack([0.35 * np.cos(2.4 * index), 0.35 * np.sin(2.4 * index), np.full(10, 0.94)], axis=-1)
    normals = np.broadcast_to([0.6, 0.3, 0.74], (SIZE, SIZE, 3))
    images = (
        np.einsum("nx,hwx->nhw", lights, normals / np.linalg.norm(normals, axis=-1, keepdims=True))[..., None] * 0.3
    )
    return stack_of(images * (1 + 0.03 * rng.normal(size=(10, SIZE, SIZE, 3))), lights, normals=normals)


@pytest.mark.slow
def test_lobes_that_no_sample_sees_are_not_made_up():
    """Noise alone can be fitted best by a lobe whose peak lies between all lights, and is as high as one likes."""
    stack = _seen_from_one_place()
    around = np.linspace(-0.9, 0.9, 15)
    x, y = (axis.ravel() for axis in np.meshgrid(around, around))
    inside = x * x + y * y < 0.9
    lights = np.stack([x, y, np.sqrt(np.maximum(1 - x * x - y * y, 0))], axis=-1)[inside]
    everywhere = stack_of(np.zeros((len(lights), SIZE, SIZE, 3)), lights, normals=stack.normals)
    largest = predicted(fit_sbrdf(stack).level, everywhere).max()
    assert largest < 0.5


@pytest.mark.slow
@pytest.mark.parametrize(("name", "every"), [("uw_owl", 6), ("diligent_ball", 8)])
def test_photographs_held_out_are_predicted_better_than_by_lambert(name, every):
    stack = load_stack(shared("data", "photometric", f"{name}.npz"))
    few = np.zeros_like(stack.mask)
    few[::4, ::4] = stack.mask[::4, ::4]
    stack = dataclasses.replace(stack, mask=few)
    held = np.arange(len(stack.images)) % every == every - 1
    seen, unseen = stack.of(~held), stack.of(held)
    fit = fit_sbrdf(seen)
    levels = fit.level, lambert_only(seen, fit.level.normals)
    fitted, lambert = (relative_error(predicted(level, unseen), unseen) for level in levels)
    assert fitted < (0.7 if name == "diligent_ball" else 1) * lambert


def test_peaks_that_no_sample_comes_near_are_told():
    """Of an eye straight above and lamps at 60°, 0.5⁶⁹ of a lobe along the normal can be seen, and a half of n = 1."""
    eye, lamp = np.array([[[0, 0, 1]]], np.float32), np.array([[[np.sqrt(0.75), 0, 0.5]]], np.float32)
    C = np.array([[[[0.5, 0.5, 1.0]], [[0.5, 0.5, 1.0]]]])
    maps = np.zeros((1, 3)), C, np.array([[[69.0], [1.0]]]), np.ones((1, 2, 3))
    brdf, full, none = LobeSum(*(as_array(a, jnp.float32) for a in maps)), np.ones((1, 1)), np.zeros((1, 1))
    for light, weight, expected in ((lamp, full, [False, True]), (eye, full, [True, True]), (eye, none, [False] * 2)):
        assert reached(brdf, light, eye, weight.astype(np.float32)).tolist() == [expected]
