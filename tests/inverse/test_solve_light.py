"""Light from pictures: what was hidden is found where the pictures tell it, and said to be unknown elsewhere."""

import dataclasses
from typing import Any

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.errors import InputError
from jaxrelight.inverse.light_grid import light_grid
from jaxrelight.inverse.solve_light import environment
from tests.scenes import ball_over_floor

CAMERA = jr.Camera((0.4, 1.2, 2.2), (0.0, 0.2, 0), fov_y=50, width=24, height=18)
LAMP = jr.point([0.8, 1.2, 0.8], [1.0, 0.6, 0.3])


def hidden(grid) -> Any:
    """Texels of a sky with a coloured gradient and one bright texel."""
    directions = grid.directions
    texels = 0.5 + 0.3 * directions[:, 1:2] + np.array([[0.0, 0.1, 0.2]]) * directions[:, :1]
    texels[int(np.argmax(directions @ [0.5, 0.8, 0.3]))] += 4.0
    return texels.astype(np.float32)


@pytest.fixture(scope="module")
def relighter():
    scene = ball_over_floor(jr.phong([0.3, 0.2, 0.1], 0.4, 20.0), CAMERA, quads=(4, 8))
    return jr.prepare(scene, jr.Transport("pixels", resolution=8, coefficients="all"))


@pytest.fixture(scope="module")
def view(relighter):
    return relighter.view()


GRID = light_grid(2)
TEXELS = hidden(GRID)
LIGHT = jr.Environment(np.asarray(GRID.pixels(TEXELS)))


def pictured(relighter, view, lights: Any = LIGHT) -> np.ndarray:
    return np.asarray(relighter.shade(relighter.light(lights), view).radiance)


def seen_error(found) -> np.ndarray:
    """How far off texels are of which the pictures tell nearly all, and how many these are."""
    told = found.certainty.texel_shares().min(axis=1) > 0.98
    assert told.sum() >= len(told) // 3
    return np.abs(found.texels - TEXELS)[told] / TEXELS[told]


@pytest.mark.parametrize(
    "dials",
    [
        pytest.param({"not_negative": False}, marks=pytest.mark.slow),
        {},
        pytest.param({"prior": "sparse"}, marks=pytest.mark.slow),
    ],
    ids=["any sign", "natural", "sparse"],
)
def test_hidden_light_is_found_where_pictures_tell_it(relighter, view, dials):
    picture = pictured(relighter, view)
    found = environment(relighter, [picture], [view], unknowns=2, **dials)
    assert found.residual < 2e-3
    assert found.held_out is not None
    assert found.held_out < 4e-3
    # A light that is not sparse is found so where it is brightest.
    bright = int(np.argmax(TEXELS.sum(axis=1)))
    np.testing.assert_allclose(found.texels[bright], TEXELS[bright], rtol=0.05)
    assert dials.get("prior") == "sparse" or seen_error(found).max() < 0.05
    assert found.texels.min() >= 0 or not dials.get("not_negative", True)
    np.testing.assert_allclose(found.pictures[0], picture, atol=5e-3 * picture.max())


@pytest.mark.slow
def test_deviations_are_those_of_what_is_found_of_noisy_pictures(relighter, view):
    picture = pictured(relighter, view)
    random, errors, deviations = np.random.default_rng(0), [], []
    for seed in range(8):
        noisy = picture + random.normal(size=picture.shape).astype(np.float32) * 0.02
        found = environment(relighter, [noisy], [view], unknowns=2, not_negative=False, strength=0.05, seed=seed)
        told = found.certainty.texel_shares().min(axis=1) > 0.98
        errors.append((found.texels - TEXELS)[told].ravel())
        deviations.append(found.certainty.texel_deviations()[told].ravel())
    ratio = np.concatenate(errors).std() / np.sqrt(np.mean(np.concatenate(deviations) ** 2))
    assert 0.6 < ratio < 1.4


@pytest.mark.slow
def test_what_a_picture_does_not_tell_is_flagged():
    """A floor alone shows nothing of the sky below it, and nothing of details: but of its mean irradiance."""
    scene = jr.Scene([jr.Part(jr.plane((2, 2), 2), "paper")], {"paper": jr.lambert(0.5)}, CAMERA)
    floor = jr.prepare(scene, jr.Transport("pixels", resolution=8, coefficients="all"))
    picture = pictured(floor, floor.view())
    found = environment(floor, [picture], unknowns=4, strength=1e-3)
    grid = found.certainty.grid
    cosine = grid.directions[:, 1] * grid.solid_angles
    irradiance, below = found.estimate(np.maximum(cosine, 0)), found.estimate(np.maximum(-cosine, 0))
    one = found.estimate(np.eye(grid.size)[int(np.argmax(cosine))])
    assert irradiance.determined
    true = np.asarray(grid.on_grid(np.asarray(LIGHT.pixels)))
    np.testing.assert_allclose(irradiance.value, np.maximum(cosine, 0) @ true / np.maximum(cosine, 0).sum(), rtol=0.03)
    assert not below.determined
    assert (below.share < 0.03).all()
    assert not one.determined
    assert found.certainty.told == (1, 1, 1)
    assert (found.certainty.details()[cosine < -0.1] == 180).all()


@pytest.mark.slow
def test_lamps_and_light_together(relighter, view):
    factor = np.array([2.0, 0.5, 1.5])
    lamp = dataclasses.replace(LAMP, intensity=LAMP.intensity * factor.astype(np.float32))
    found = environment(relighter, [pictured(relighter, view, [LIGHT, lamp])], [view], unknowns=2, lamps=LAMP)
    np.testing.assert_allclose(found.lamp_factors, factor[None], rtol=0.02)
    (brightened,) = found.lamps
    assert isinstance(brightened, type(LAMP))
    np.testing.assert_allclose(brightened.intensity, lamp.intensity, rtol=0.02)  # pyright: ignore
    assert seen_error(found).max() < 0.1


@pytest.mark.slow
@pytest.mark.parametrize(("kind", "factors"), [("exposure", 1.7), ("white balance", np.array([1.7, 0.8, 0.4]))])
def test_exposures_are_found_beside_the_light(relighter, view, kind, factors):
    picture = pictured(relighter, view)
    shown = [picture, picture * np.float32(factors)]
    found = environment(relighter, shown, [view, view], unknowns=2, exposures=kind)
    np.testing.assert_allclose(found.exposures, [np.ones(3), factors * np.ones(3)], rtol=0.01)
    assert "scale" in found.notes[0]
    assert seen_error(found).max() < 0.1


@pytest.mark.slow
def test_saturated_pixels_are_lower_bounds(relighter, view):
    """As equalities they would darken what is bright."""
    picture = pictured(relighter, view)
    top = np.float32(np.quantile(picture, 0.97))
    cut = np.minimum(picture, top)
    bounded = environment(relighter, [cut], [view], unknowns=2, saturation=float(top))
    equal = environment(relighter, [cut], [view], unknowns=2)
    assert bounded.saturated > 10
    bright = int(np.argmax(TEXELS.sum(axis=1)))
    off = [np.abs(one.texels[bright] - TEXELS[bright]).max() for one in (bounded, equal)]
    assert off[0] < 0.5 * off[1]


@pytest.mark.slow
def test_a_lat_long_map_is_found_as_well(relighter, view):
    grid = light_grid((4, 8))
    texels = hidden(grid)
    picture = pictured(relighter, view, jr.Environment(np.asarray(grid.pixels(texels))))
    found = environment(relighter, [picture], [view], unknowns=(4, 8))
    assert found.environment.pixels.shape == (4, 8, 3)
    told = found.certainty.texel_shares().min(axis=1) > 0.98
    assert np.abs(found.texels - texels)[told].max() < 0.2


@pytest.mark.parametrize("unknowns", [4, (4, 8)])
def test_grids(unknowns):
    grid = light_grid(unknowns)
    texels: Any = np.random.default_rng(0).uniform(size=(grid.size, 3)).astype(np.float32)
    np.testing.assert_allclose(grid.solid_angles.sum(), 4 * np.pi, rtol=1e-6)
    np.testing.assert_allclose(np.linalg.norm(grid.directions, axis=1), 1, rtol=1e-6)
    np.testing.assert_allclose(grid.texels(grid.basis.encode(texels.T).T), texels, atol=1e-5)
    back = grid.on_grid(np.asarray(grid.pixels(texels)))
    # Pixels of a cube's map are means where they touch several texels.
    np.testing.assert_allclose(back, texels, atol=0.25 if grid.is_cube else 1e-6)
    np.testing.assert_allclose(grid.pixels(0 * texels + 1), 1, rtol=1e-5)


@pytest.mark.parametrize(
    ("given", "message"),
    [
        ({"pictures": []}, "no pictures"),
        ({"unknowns": 3}, "power of two"),
        ({"unknowns": (4, 4)}, "twice as wide"),
        ({"prior": "smooth"}, "prior is"),
        ({"exposures": "free"}, "exposures are"),
        ({"strength": -1.0}, "strength"),
        ({"hold_out": 0.0}, "held out"),
        ({"max_steps": 0}, "max_steps"),
        ({"lamps": LIGHT}, "what is sought"),
        ({"lamps": jr.even_sky(16)}, "cannot be unknown"),
        ({"pictures": [np.zeros((18, 24, 3), np.float32)]}, "are black"),
        ({"views": [None, None]}, "2 views"),
        ({"pictures": [np.full((18, 24, 3), np.nan, np.float32)]}, "not finite"),
    ],
    ids=[*"abcdefghijklm"],
)
def test_bad_input_is_one_line(relighter, wrong_types, given, message):
    arguments: dict = {"pictures": [np.ones((18, 24, 3), np.float32)], **given}
    with pytest.raises(InputError, match=message) as error:
        environment(relighter, **arguments)
    assert "\n" not in str(error.value)


@pytest.mark.slow
@pytest.mark.parametrize(
    "method",
    [
        jr.Transport("vertices", receiver_tolerance=0, resolution=8),
        jr.Transport("pixels", resolution=8, receiver_tolerance=0, bounces=1),
        jr.Prefiltered(receiver_tolerance=0),
        jr.Indirect(bounces=1, sky=True, gather_samples=256),
    ],
    ids=["vertices", "bounces", "prefiltered", "indirect"],
)
def test_every_method_under_which_light_is_linear_serves(method):
    other = jr.prepare(ball_over_floor(jr.phong([0.3, 0.2, 0.1], 0.4, 20.0), CAMERA, quads=(4, 8)), method)
    view, lit = other.view(), other.light(LIGHT)
    picture = np.asarray(other.shade(lit, view, other.trace(lit, view)).radiance)
    found = environment(other, [picture], [view], unknowns=2)
    assert found.residual < 1e-3


@pytest.mark.slow
def test_what_is_approximate_is_told(relighter, view):
    picture = pictured(relighter, view)
    assert environment(relighter, [picture], [view], unknowns=2).notes == ()
    few = environment(relighter, [picture], [view], unknowns=2, max_steps=4)
    assert not few.converged
    assert "stopped after 4 steps" in few.notes[0]
    one = np.zeros(picture.shape[:2], bool)
    one[10, 12] = True
    alone = environment(relighter, [picture], [view], unknowns=2, masks=[one])
    assert alone.held_out is None
    assert "held out" in alone.notes[0]
    dark = picture - 0.5 * picture.mean() * (np.arange(24)[None, :, None] > 12)
    signed = environment(relighter, [dark.astype(np.float32)], [view], unknowns=2, not_negative=False)
    assert signed.texels.min() < 0 <= np.asarray(signed.environment.pixels).min()
    assert "negative" in signed.notes[-1]


@pytest.mark.slow
def test_a_channel_without_light_is_black(relighter, view):
    found = environment(relighter, [pictured(relighter, view) * np.array([1, 0, 0], np.float32)], [view], unknowns=2)
    assert not found.texels[:, 1:].any()
    assert found.certainty.told[1:] == (0, 0)
    assert found.residual < 2e-3


@pytest.mark.slow
def test_lower_bounds_keep_what_is_asked_of_light(relighter, view):
    """Under a sparse prior, too; and pixels that are held out judge as bounds."""
    picture = pictured(relighter, view)
    top = float(np.quantile(picture, 0.97))
    cut = np.minimum(picture, np.float32(top))
    found = environment(relighter, [cut], [view], unknowns=2, saturation=top, prior="sparse")
    assert found.texels.min() >= 0
    assert found.residual < 0.01
    bright = int(np.argmax(TEXELS.sum(axis=1)))
    assert found.texels[bright].max() > 0.5 * TEXELS[bright].max()


@pytest.mark.slow
def test_relighters_that_choose_by_the_light_are_refused():
    scene = ball_over_floor(jr.lambert(0.5), CAMERA)
    indirect = jr.prepare(scene, jr.Indirect(bounces=1, gather_samples=64))
    with pytest.raises(InputError, match="sky=True"):
        environment(indirect, [np.ones((18, 24, 3), np.float32)])
    with pytest.raises(InputError, match="for one light"):
        environment(jr.prepare(scene, jr.Adaptive()), [np.ones((18, 24, 3), np.float32)])


@pytest.mark.slow
def test_nothing_is_compiled_for_other_pictures(relighter, view):
    from tests.compilations import compilations

    picture = pictured(relighter, view)
    dials: Any = {"unknowns": 2, "not_negative": False, "strength": 0.01}
    environment(relighter, [picture], [view], **dials)
    with compilations() as compiled:
        environment(relighter, [np.ascontiguousarray(picture[:, ::-1])], [view], **dials)
    assert not compiled
