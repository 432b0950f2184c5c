"""Blends are means of functions, not of parameters."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from fitting import sbrdf_levels
from fitting.blend import blended, composed, painted, uniform
from fitting.brdf_samples import sample
from fitting.sbrdf import as_level
from fitting.solve import Options, Verdict
from jaxrelight.brdf.ashikhmin_shirley import ashikhmin_shirley
from jaxrelight.brdf.files.sbrdf import read_sbrdf, write_sbrdf
from jaxrelight.brdf.lobes import lambert, lobe, lobe_sum
from jaxrelight.brdf.pairs import spread_pairs
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.errors import InputError
from tests.fitting.synthetic import COARSE

SHARP = lobe_sum([0.1, 0.2, 0.3], [lobe([-1, -1, 0.95], 60, peak=[2.0, 1.5, 1.0])])
BROAD = lobe_sum([0.4, 0.2, 0.1], [lobe([-1, -1, 0.8], 5, peak=[0.2, 0.3, 0.4])])
# Of two lobes each, so that one program refits whatever is brushed.
BRUSHED, CROSSED = (
    lobe_sum(
        [0.1, 0.2, 0.3],
        [lobe([*two, 0.8], 4, peak=[0.2, 0.3, 0.4]), lobe([*one, 0.95], 30, peak=[2.0, 1.5, 1.0])],
    )
    for one, two in (([-1, -0.7], [-0.6, -1]), ([-0.7, -1], [-1, -0.6]))
)
TWO = Options(lobes=2, anisotropic=True)
PAIRS = spread_pairs(256)


@jax.jit
def _of(brdf, turn=0.0):
    """What a BRDF whose axes are turned reflects between the pairs."""
    return jax.vmap(dataclasses.replace(brdf, turn=jnp.asarray(turn)).evaluate)(*PAIRS)


def _apart(brdf, wanted) -> float:
    """Relative root mean square over the grid."""
    return float(np.linalg.norm(sample(brdf, COARSE).values - wanted) / np.linalg.norm(wanted))


@pytest.mark.parametrize(("share", "wanted"), [pytest.param(0, SHARP, marks=pytest.mark.slow), (1, BROAD)])
def test_the_ends_of_a_blend_are_the_materials(share, wanted):
    made = blended(SHARP, BROAD, share, weight="plain", grid=COARSE)
    assert made.verdict == Verdict.GOOD
    np.testing.assert_allclose(made.brdf.exponent, wanted.exponent, rtol=2e-3)
    np.testing.assert_allclose(made.brdf.scale, wanted.scale, rtol=5e-3)
    np.testing.assert_allclose(made.brdf.diffuse, wanted.diffuse, rtol=5e-3)


@pytest.mark.slow
def test_a_blend_is_the_mean_of_the_functions():
    """With two lobes exactly, with one as nearly as it can, and nearer than the mean of the parameters."""
    wanted = 0.5 * sample(SHARP, COARSE).values + 0.5 * sample(BROAD, COARSE).values
    one, two = (blended(SHARP, BROAD, 0.5, options, "plain", COARSE) for options in (Options(), TWO))
    assert _apart(two.brdf, wanted) < 0.01
    parameters = jax.tree.map(lambda a, b: (np.asarray(a) + np.asarray(b)) / 2, SHARP, BROAD)
    assert 0.01 < _apart(one.brdf, wanted) < 0.5 * _apart(parameters, wanted)
    np.testing.assert_allclose(one.residual, _apart(one.brdf, wanted), rtol=1e-3)


@pytest.mark.slow
def test_anything_can_be_blended():
    other = ashikhmin_shirley([0.3, 0.2, 0.1], 0.05, 30, 30)
    assert blended(other, SHARP, 0.3, TWO, "plain", COARSE).residual < 0.2


@pytest.mark.parametrize("share", [-0.1, 1.1, np.nan])
def test_a_share_beyond_the_ends_is_refused(share):
    with pytest.raises(InputError, match="share of a blend must be from 0 to 1"):
        blended(SHARP, BROAD, share)


@pytest.fixture(autouse=True)
def _few_at_a_time(monkeypatch):
    """As few as the maps here have."""
    monkeypatch.setattr(sbrdf_levels, "CHUNK", 2)


def _beside(*layers) -> SpatialLobes:
    """The first row of texels of each layer: [p, q]."""
    return jax.tree.map(lambda *maps: np.stack(maps, axis=1), *(jax.tree.map(lambda a: a[0], of) for of in layers))


@pytest.mark.slow
def test_texels_are_refitted_in_chunks_and_keep_their_order():
    """Three in chunks of two; the share of nearly one alone gives it back."""
    cloth = lobe_sum([0.4, 0.2, 0.1], [lobe([-1, -1, z], n, peak=0.5) for z, n in ((0.5, 3), (0.9, 12))])
    both = _beside(*(jax.tree.map(np.asarray, uniform(brdf, (1, 3)).lobes) for brdf in (BRUSHED, cloth)))
    shares = np.array([[1.0, 1e-5], [1e-5, 3], [2, 1e-5]])
    rows = sbrdf_levels.refitted(both, shares, Options(lobes=2))
    assert len(rows) == 3
    np.testing.assert_allclose(rows[:, 9:11], [[4, 30], [3, 12], [4, 30]], rtol=1e-2)
    np.testing.assert_allclose(rows[:, :3], [BRUSHED.diffuse, cloth.diffuse, BRUSHED.diffuse], rtol=1e-2)


def test_equal_texels_stay_what_they_are(monkeypatch):
    """Also where another one, that does not count, is unlike them."""
    monkeypatch.setattr(sbrdf_levels, "fit_lobes", None)
    parts = uniform(SHARP, (1, 1)), uniform(SHARP, (1, 1)), uniform(BROAD, (1, 1))
    texels = _beside(*(jax.tree.map(np.asarray, part.lobes) for part in parts))
    (row,) = sbrdf_levels.refitted(texels, np.array([[0.5, 2.0, 0.0]]), Options())
    level = as_level(row[None], np.ones((1, 1), bool), parts[0].normals, Options())
    jax.tree.map(np.testing.assert_array_equal, level.lobes, parts[0].lobes)
    assert level.flag[0, 0] == Verdict.GOOD


SHAPE = 2, 3
LEFT = np.array([[1.0, 1, 0], [1, 0.25, 0]])
RIGHT = np.array([[0.0, 0, 2], [0, 0.75, 0]])


def _composed(**options):
    return composed([(uniform(SHARP, SHAPE), LEFT), (uniform(BROAD, SHAPE), RIGHT)], **options)


def _values(level, row: int, column: int):
    return _of_one_texel(jax.tree.map(lambda a: np.asarray(a)[row : row + 1, column : column + 1], level.lobes))


@jax.jit
def _of_one_texel(lobes: SpatialLobes):
    return jax.vmap(lobes.at(jnp.full(2, 0.5)).evaluate)(*PAIRS)


@pytest.mark.slow
def test_masks_choose_and_mix():
    made = _composed()
    for place, wanted in {(0, 0): SHARP, (0, 1): SHARP, (1, 0): SHARP, (0, 2): BROAD}.items():
        np.testing.assert_array_equal(made.lobes.C[place], wanted.C[:, 0])
        np.testing.assert_array_equal(made.lobes.exponent[place], wanted.exponent[:, 0])
        np.testing.assert_array_equal(made.lobes.scale[place], wanted.scale)
        np.testing.assert_array_equal(made.lobes.diffuse[place], wanted.diffuse)
        assert made.flag[place] == Verdict.GOOD
    assert made.flag[1, 2] == Verdict.NO_DATA
    assert not np.asarray(made.lobes.diffuse[1, 2]).any()
    mean = 0.25 * np.asarray(_of(SHARP)) + 0.75 * np.asarray(_of(BROAD))
    weight = np.asarray(PAIRS[0][:, 2] * PAIRS[1][:, 2])[:, None]
    assert np.linalg.norm(weight * (_values(made, 1, 1) - mean)) < 0.4 * np.linalg.norm(weight * mean)


@pytest.mark.slow
def test_two_lobes_mix_better_than_one():
    mean = 0.25 * np.asarray(_of(SHARP)) + 0.75 * np.asarray(_of(BROAD))
    made, two = _composed(), _composed(options=Options(lobes=2))
    assert two.lobes.lobes == 2
    weight = np.asarray(PAIRS[0][:, 2] * PAIRS[1][:, 2])[:, None]
    apart = [np.linalg.norm(weight * (_values(level, 1, 1) - mean)) for level in (two, made)]
    size = np.linalg.norm(weight * mean)
    assert apart[0] < 0.02 * size
    assert apart[0] < apart[1] < 0.4 * size


@pytest.mark.slow
def test_brushed_texels_of_one_direction_are_refitted_in_it():
    """Also where one is painted by a quarter turn, of a lobe that is stretched the other way."""
    angles = np.full((1, 1), 0.4), np.full((1, 1), 0.4 + np.pi / 2)
    layers = [painted(uniform(brdf, (1, 1)), angle) for brdf, angle in zip((BRUSHED, CROSSED), angles, strict=True)]
    made = composed([(layer, np.ones((1, 1))) for layer in layers])
    wanted = np.asarray(_of(BRUSHED, 0.4))
    assert np.linalg.norm(_values(made, 0, 0) - wanted) < 0.01 * np.linalg.norm(wanted)


def test_painted_angles_turn_the_lobes():
    made = painted(uniform(BRUSHED, (1, 2)), np.array([[0.3, -2.0]]))
    for column, angle in enumerate((0.3, -2.0)):
        np.testing.assert_allclose(_values(made, 0, column), _of(BRUSHED, angle), rtol=1e-3, atol=1e-5)
    for wrong in (np.zeros((2, 1)), np.full((1, 2), np.nan)):
        with pytest.raises(InputError, match="finite numbers for"):
            painted(made, wrong)


def test_normals_are_mixed_and_of_unit_length():
    tilted = uniform(BROAD, SHAPE)
    normals = np.broadcast_to([0.6, 0, 0.8], (*SHAPE, 3))
    tilted = type(tilted)(tilted.lobes, normals, tilted.flag, tilted.residual)
    made = composed([(uniform(SHARP, SHAPE), LEFT), (tilted, RIGHT)])
    np.testing.assert_allclose(np.linalg.norm(made.normals, axis=-1), 1)
    np.testing.assert_allclose(made.normals[0, 0], [0, 0, 1])
    np.testing.assert_allclose(made.normals[0, 2], [0.6, 0, 0.8])
    np.testing.assert_allclose(made.normals[1, 1, 0] / made.normals[1, 1, 2], 0.45 / 0.85)


@pytest.mark.slow
def test_layers_of_other_numbers_of_lobes_and_what_comes_of_them_is_written(tmp_path):
    flat, turned = uniform(lambert([0.5] * 3), SHAPE), dataclasses.replace(BRUSHED, turn=jnp.float32(0.4))
    made = composed([(flat, LEFT), (uniform(turned, SHAPE), RIGHT)])
    assert made.lobes.lobes == 2
    np.testing.assert_allclose(_values(made, 0, 0), 0.5 / np.pi, rtol=1e-6)
    np.testing.assert_allclose(_values(made, 0, 2), _of(BRUSHED, 0.4), rtol=1e-4, atol=1e-6)
    write_sbrdf(tmp_path / "a.exr", [made])
    (back,) = read_sbrdf(tmp_path / "a.exr")
    np.testing.assert_array_equal(back.lobes.exponent, made.lobes.exponent)
    np.testing.assert_array_equal(back.flag, made.flag)


@pytest.mark.parametrize(
    ("layers", "what"),
    [
        ([], "at least one layer"),
        ([(uniform(SHARP, SHAPE), LEFT[:1])], "layer 1: has .* and a mask of"),
        ([(uniform(SHARP, SHAPE), LEFT), (uniform(SHARP, (3, 3)), LEFT)], "layer 2: has"),
        ([(uniform(SHARP, SHAPE), -LEFT)], "layer 1: its mask must be finite and not negative"),
        ([(uniform(SHARP, SHAPE), LEFT * np.nan)], "layer 1: its mask must be finite"),
        ([(uniform(SHARP, SHAPE), 0 * LEFT)], "all masks are 0"),
    ],
)
def test_layers_that_do_not_fit_together_are_refused(layers, what):
    with pytest.raises(InputError, match=what):
        composed(layers)


def test_fewer_lobes_than_a_layer_has_are_refused():
    two = lobe_sum(0.1, [lobe([-1, -1, 1], n, peak=1) for n in (3, 30)])
    with pytest.raises(InputError, match="a layer has 2 lobes, more than the 1 asked for"):
        composed([(uniform(two, SHAPE), LEFT)], Options(lobes=1))
    per_channel = lobe_sum(0.1, [lobe([-1, -1, 1], [3, 4, 5], peak=1)])
    with pytest.raises(InputError, match="without --per-channel"):
        uniform(per_channel, SHAPE)
