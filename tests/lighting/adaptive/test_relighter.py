"""Adaptive shading: against many samples everywhere, within budgets and tolerances, in pictures where little varies."""

import dataclasses
import functools
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import ndimage

from jaxrelight import Adaptive, Camera, Environment, Part, Scene, environment, lambert, phong, plane, prepare, sphere
from jaxrelight.basis import latlong
from jaxrelight.brdf.material import Component, Material
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.texture import Texture
from jaxrelight.errors import InputError
from jaxrelight.geometry.mesh import transformed
from jaxrelight.images import srgb_encode
from jaxrelight.images.tone import auto_exposure, to_unit
from jaxrelight.lighting.adaptive import relighter as module
from jaxrelight.lighting.adaptive.estimate import RUN
from jaxrelight.lighting.adaptive.layer_estimates import display_slope, largest_around
from jaxrelight.lighting.adaptive.relighter import AdaptiveLight, AdaptiveRelighter
from jaxrelight.lighting.adaptive.view import AdaptiveView
from jaxrelight.lighting.antialiasing import averaged
from jaxrelight.lighting.direct_light import shade_lights
from jaxrelight.lighting.shadows import group_lights, trace_visibility
from jaxrelight.lights.environment_mipmap import cells
from jaxrelight.lights.local import directional, point
from jaxrelight.numerics.arrays import as_array

CAMERA = Camera((0.2, 1.2, 3.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 40.0, 48, 40)
GLOSSY = phong([0.2, 0.1, 0.05], 0.4, 60)
MATT = phong(0.5, 0, 1)
# All maps have one size, and BRDFs one lobe: what is compiled for one of them serves the others.
ROWS = 256


@functools.cache
def sky() -> AdaptiveLight:
    return lit(light_of(0.3 + np.random.default_rng(0).random((16, 32, 3)) ** 8))


def light_of(pixels: np.ndarray) -> Environment:
    times = ROWS // len(pixels)
    return environment(np.kron(pixels, np.ones((times, times, 1))).astype(np.float32))


def lit(light: Environment) -> AdaptiveLight:
    return of_scene().light(light)


def ball_on_floor(brdf=GLOSSY, floor=None) -> Scene:
    down = transformed(plane([4, 4]), np.array([[1, 0, 0, 0], [0, 1, 0, -1], [0, 0, 1, 0], [0, 0, 0, 1.0]]))
    parts = [Part(sphere(1, 24), "skin"), Part(down, "floor")]
    return Scene(parts, {"skin": brdf, "floor": floor or MATT}, CAMERA, name="ball")


def prepared(scene: Scene, **dials) -> AdaptiveRelighter:
    relighter = prepare(scene, Adaptive(**dials))
    assert isinstance(relighter, AdaptiveRelighter)
    return relighter


@functools.cache
def of_scene(**dials) -> AdaptiveRelighter:
    """The ball on the floor, by any dials; the displayed picture is as bright as its radiance."""
    dials = {"exposure": 0.0} | dials
    return dataclasses.replace(_of_scene(), method=Adaptive(**dials))


@functools.cache
def _of_scene() -> AdaptiveRelighter:
    return prepared(ball_on_floor())


@functools.cache
def view() -> AdaptiveView:
    return of_scene().view()


def covered() -> np.ndarray:
    return np.asarray(view().surfaces.covered)


def shaded(relighter: AdaptiveRelighter, light: AdaptiveLight, view: AdaptiveView):
    """The plan, and its picture."""
    plan = relighter.plan(light, view)
    return plan, np.asarray(relighter.shade_plan(light, view, plan))


@functools.cache
def wanted(shadows: bool) -> np.ndarray:
    return np.asarray(of_scene(seed=7, shadows=shadows).shade_uniform(sky(), view(), 2048, filtered=True))


def off(image, other, covered) -> float:
    """Root-mean-square difference of displayed values."""
    one, two = (srgb_encode(to_unit(np.asarray(x)))[covered] for x in (image, other))
    return float(np.sqrt(np.mean((one - two) ** 2)))


@pytest.mark.parametrize(
    ("shadows", "tolerance"), [(False, 0.006), pytest.param(False, 0.002, marks=pytest.mark.slow), (True, 0.02)]
)
def test_the_error_is_what_was_asked_for(shadows: bool, tolerance: float, monkeypatch):
    monkeypatch.setattr(module, "planning_pays", lambda *_, **__: True)
    plan, image = shaded(of_scene(shadows=shadows, tolerance=tolerance), sky(), view())
    assert 0.6 * tolerance < off(image, wanted(shadows), covered()) < 1.2 * tolerance
    assert np.hypot(plan.interpolation, plan.noise) < 1.01 * tolerance
    # Fewer samples than as many everywhere, and than pixels times the least.
    assert plan.shaded < 0.9 * covered().sum()


@pytest.mark.slow
def test_the_fewest_samples_may_be_better_than_what_was_asked_for(monkeypatch):
    """One run of samples in as few pixels as can be shaded: no tolerance takes less."""
    monkeypatch.setattr(module, "planning_pays", lambda *_, **__: True)
    plan, image = shaded(of_scene(shadows=False, tolerance=0.02), sky(), view())
    ((fewest,), shaded_pixels) = np.unique(plan.maps()["samples"][plan.maps()["samples"] > 0], return_counts=True)
    assert (fewest, shaded_pixels.sum()) == (RUN, plan.shaded)
    assert max(plan.error, off(image, wanted(False), covered())) < 0.02
    assert plan.shaded == shaded(of_scene(shadows=False, tolerance=0.04), sky(), view())[0].shaded


@pytest.mark.slow
def test_automatic_exposure_plans_for_what_will_be_displayed():
    """It estimates the picture's own exposure, so that darker light takes the same samples."""
    automatic = of_scene(shadows=False, exposure="auto", tolerance=0.02)
    image = np.asarray(of_scene(shadows=False).shade_uniform(sky(), view(), 256, filtered=True))
    wanted_stops = auto_exposure(image[covered()])
    assert automatic.displayed_exposure(sky(), view()) == pytest.approx(wanted_stops, abs=0.15)
    own = sky().environment
    assert own is not None
    dim = automatic.light(own.with_(scale=1e-3))
    stops = automatic.displayed_exposure(dim, view())
    assert stops == pytest.approx(automatic.displayed_exposure(sky(), view()) + np.log2(1e3), abs=1e-3)
    assert of_scene(exposure=1.5).displayed_exposure(sky(), view()) == 1.5
    plans = [automatic.plan(one, view()) for one in (sky(), dim)]
    assert plans[1].samples == pytest.approx(plans[0].samples, rel=0.02)


def test_small_pictures_are_shaded_evenly():
    """Where planning would take longer than it saves: all pixels of a material have as many samples."""
    relighter = of_scene(tolerance=0.01, shadows=False)
    plan, image = shaded(relighter, sky(), view())
    maps = plan.maps()
    parts = view().part_image()[:40, :48]
    for part in range(parts.max() + 1):
        (count,) = np.unique(maps["samples"][parts == part])
        assert count >= 16
    assert plan.shaded == (parts >= 0).sum()
    assert float(plan.interpolation) == 0
    assert 0.006 < off(image, wanted(False), covered()) < 0.012


@pytest.mark.parametrize("wrong", [0.3, pytest.param(3.0, marks=pytest.mark.slow)])
def test_the_pilot_puts_a_wrong_prediction_right(wrong: float, monkeypatch):
    """Noise and what lies between are both said to be so many times as large."""
    monkeypatch.setattr(module, "planning_pays", lambda *_, **__: True)
    calibrated = module.calibrate

    def misled(*given):
        layers, power = calibrated(*given)
        return [of._replace(deviation=wrong * of.deviation, share=wrong * of.share) for of in layers], power

    monkeypatch.setattr(module, "calibrate", misled)
    relighter = of_scene(tolerance=0.01, shadows=False)
    _, image = shaded(relighter, sky(), view())
    assert 0.5 * 0.01 < off(image, wanted(False), covered()) < 1.25 * 0.01


def test_noise_is_tried_out_for_each_material(monkeypatch):
    """So samples go where noise is found, however wrong it is predicted."""
    of_first = view().part_image() == 0

    def share():
        plan = of_scene(samples=64).plan(sky(), view())
        return np.asarray(plan.layers[0].counts)[of_first].sum() / plan.samples

    right, estimated = share(), module.estimate_layer

    def wrong(*given):
        layer = estimated(*given)
        return layer._replace(deviation=layer.deviation * np.where(of_first, 10, 1))

    monkeypatch.setattr(module, "estimate_layer", wrong)
    np.testing.assert_allclose(share(), right, atol=0.05)


def test_budgets_are_kept_and_more_is_better():
    pixels, errors = covered().sum(), []
    for samples in (8, 32, 128):
        plan, image = shaded(of_scene(samples=samples, shadows=False), sky(), view())
        assert 0.7 * samples < plan.samples / pixels < 1.15 * samples
        errors.append(off(image, wanted(False), covered()))
    assert errors == sorted(errors, reverse=True)
    # Against the same number everywhere.
    even = off(of_scene(shadows=False).shade_uniform(sky(), view(), 32), wanted(False), covered())
    assert errors[1] < 0.5 * even


@pytest.mark.slow
def test_lambert_under_a_constant_sky_is_exact_and_hardly_shaded(monkeypatch):
    monkeypatch.setattr(module, "planning_pays", lambda *_, **__: True)
    camera = dataclasses.replace(CAMERA, width=240, height=200)
    ball = Scene([Part(sphere(1, 48), "skin")], {"skin": lambert(0.6)}, camera, name="ball")
    relighter = prepared(ball, tolerance=0.01, shadows=False)
    white, mine = relighter.light(environment(np.ones((8, 16, 3), np.float32))), relighter.view()
    plan, image = shaded(relighter, white, mine)
    facing = mine.part_image()[:200, :240] >= 0
    np.testing.assert_allclose(image[facing], 0.6, rtol=1e-3)
    assert plan.shaded < 0.01 * np.asarray(mine.surfaces.covered).sum()


def test_nothing_to_see_is_a_plan_too():
    relighter = of_scene(tolerance=0.01)
    away = relighter.view(dataclasses.replace(CAMERA, target=(0.2, 1.2, 9.0)))
    plan, image = shaded(relighter, sky(), away)
    assert plan.samples == plan.shaded == 0
    assert not any(of.any() for of in plan.maps().values())
    assert not image.any()
    # As dark as can be, and seen.
    plan, image = shaded(relighter, lit(light_of(np.zeros((8, 16, 3)))), view())
    assert not image.any()
    assert all(np.isfinite(of).all() for of in plan.maps().values())


def test_the_same_seed_is_the_same_image():
    plan = of_scene(samples=16).plan(sky(), view())
    one, same, other = (
        np.asarray(of_scene(samples=16, seed=seed, shadows=False).shade_plan(sky(), view(), plan)) for seed in (3, 3, 4)
    )
    np.testing.assert_array_equal(same, one)
    assert np.abs(other - one).max() > 0


def test_a_sun_is_lit_by_a_few_directions_in_every_pixel():
    """Against the two parts of the sky, each by itself, and against the shadow of a distant light."""
    pixels = np.full((ROWS, 2 * ROWS, 3), 0.2, np.float32)
    pixels[80, 160] = 1e5
    v, u = (np.array([80.5, 160.5]) / [ROWS, 2 * ROWS]).astype(np.float32)
    towards, area = latlong.directions(u, v), latlong.solid_angles(ROWS, 2 * ROWS)[80]
    light, even = lit(light_of(pixels)), lit(light_of(np.full_like(pixels, 0.2)))
    relighter, surfaces = of_scene(tolerance=0.01), view().surfaces
    radiance = np.asarray(relighter.shade(light, view()).radiance)
    groups = group_lights([directional(-towards, float(1e5 * area))], relighter.geometry.surfaces.centre)
    sun = np.asarray(shade_lights(relighter.materials, surfaces, groups, trace_visibility(surfaces.points, groups)))
    wanted = np.asarray(of_scene(seed=7).shade_uniform(even, view(), 512, filtered=True)) + sun
    assert off(radiance, wanted, covered()) < 0.02
    # Of the floor, some lies in the shadow, and only the sky is left.
    dark = covered() & (sun.max(axis=2) == 0)
    assert dark.sum() > 50
    assert radiance[dark].max() < 0.5
    assert not radiance[~covered()].any()
    # The sun is none of what samples find.
    assert off(relighter.shade_uniform(light, view(), 512, filtered=True), wanted - sun, covered()) < 0.02


def test_pictures_are_the_environment_local_lights_and_emission():
    """The steps by themselves add up to what is shaded; with rays and samples traced before, and on the way."""
    glow = np.array([0.3, 0.2, 0.1], np.float32)
    floor = Material((Component(MATT),), emission=glow)
    # The exposure is given, since the lamp would change what is estimated.
    relighter = prepared(ball_on_floor(floor=floor), samples=16, exposure=0.0)
    mine, lamp = relighter.view(), point([2, 3, 1], [5, 4, 3])
    assert [one.name for one in relighter.materials] == ["floor", "skin"]
    on_floor = mine.part_image()[:40, :48] == 0
    light, both = (relighter.light([light_of(np.ones((8, 16, 3))), *more]) for more in ((), (lamp,)))
    plan = relighter.plan(light, mine)
    groups = group_lights([lamp], relighter.geometry.surfaces.centre)
    direct = shade_lights(relighter.materials, mine.surfaces, groups, trace_visibility(mine.surfaces.points, groups))
    wanted = np.asarray(relighter.shade_plan(light, mine, plan)) + np.asarray(direct) + on_floor[..., None] * glow
    traced = relighter.trace(both, mine)
    for image in (relighter.shade(both, mine), relighter.shade(both, mine, traced)):
        np.testing.assert_allclose(image.radiance, wanted, rtol=1e-4, atol=1e-5)
        np.testing.assert_array_equal(image.alpha, mine.surfaces.covered)
    alone = relighter.shade(relighter.light(None), mine)
    np.testing.assert_allclose(alone.radiance, on_floor[..., None] * glow, rtol=1e-6)


def test_textures_ask_for_no_shading():
    """A checked floor is as sharp as it is, though few of its pixels are shaded."""
    checks = Texture(np.kron(np.indices((8, 8)).sum(axis=0) % 2, np.ones((4, 4)))[..., None].astype(np.float32))
    bare, checked = (Material((Component(MATT, weight),)) for weight in ((), (checks,)))
    images = []
    for floor in (bare, checked):
        one = prepared(ball_on_floor(floor=floor), tolerance=0.01, shadows=False)
        plan, image = shaded(one, sky(), one.view())
        images.append((image, plan.shaded))
    (plain, few), (sharp, more) = images
    assert more <= 1.1 * few
    number = pixels_of("floor")
    share = sharp.reshape(-1, 3)[number] / plain.reshape(-1, 3)[number]
    assert (share.min(), share.max()) == (0, pytest.approx(1, abs=0.1))


def pixels_of(material: str) -> np.ndarray:
    """Those that see it, of the ball and its floor."""
    names = [one.name for one in of_scene().materials]
    (part,) = (part for part in view().surfaces.parts if names[part.material] == material)
    number = np.asarray(part.pixels.pixel)
    return number[number < covered().size]


def uniform(relighter: AdaptiveRelighter, mine: AdaptiveView, samples: int, seed: int) -> np.ndarray:
    """By other samples, the same number in every pixel."""
    method = dataclasses.replace(relighter.method, seed=seed)
    other = dataclasses.replace(relighter, method=method)
    return np.asarray(other.shade_uniform(sky(), mine, samples, filtered=True))


@pytest.mark.slow
@pytest.mark.parametrize("texels", [64, 2])
def test_an_sbrdf_is_shaded_where_it_varies(texels: int):
    """Stripes of gloss, as fine as the pixels that see them; and two of them, wide."""
    stripes = np.repeat(np.arange(texels) % 2, 64 // texels)
    arrays = {
        "diffuse": np.where(stripes[:, None], 0.5, 0.05) * np.ones(3),
        "C": np.tile([[[-1.0, -1, 1]]], (64, 1, 1)),
        "exponent": np.where(stripes, 3.0, 200)[:, None],
        "scale": np.full((64, 1, 3), 0.3),
    }
    maps: dict[str, Any] = {name: np.asarray(value, np.float32)[None] for name, value in arrays.items()}
    spatial = SpatialLobes(**maps, axis=as_array(np.tile([1, 0], (1, 64, 1)), np.float32))
    one = prepared(ball_on_floor(floor=Material((Component(spatial),))), samples=32, shadows=False)
    mine = one.view()
    plan, image = shaded(one, sky(), mine)
    exact = uniform(one, mine, 1024, 7)
    assert off(image, exact, covered()) < 0.015
    has_samples = plan.maps()["samples"].ravel()[pixels_of("floor")] > 0
    assert (has_samples.mean() > 0.9) == (texels == 64)


def test_a_wire_one_pixel_wide_is_not_lost():
    wire = transformed(plane([0.03, 4]), np.array([[1, 0, 0, 0], [0, 1, 0, 1.02], [0, 0, 1, 0], [0, 0, 0, 1.0]]))
    parts = [*ball_on_floor().parts, Part(wire, "wire")]
    scene = Scene(parts, {**ball_on_floor().materials, "wire": phong([1, 0, 0], 0, 1)}, CAMERA, name="wire")
    one = prepared(scene, samples=32, shadows=False)
    mine = one.view()
    _, image = shaded(one, sky(), mine)
    exact = uniform(one, mine, 512, 1)
    red = exact[..., 0] > 4 * exact[..., 1] + 1e-3
    assert red.sum() > 10
    np.testing.assert_allclose(image[red], exact[red], rtol=0.15, atol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [2, 4])
def test_several_samples_of_surfaces_in_a_pixel(factor: int, monkeypatch):
    """The mean over them has the error that was asked for, and takes not as many times the samples."""
    monkeypatch.setattr(module, "planning_pays", lambda *_, **__: True)
    one = of_scene(tolerance=0.01, shadows=False)
    mine = one.view(antialiasing=factor**2)
    image = one.shade(sky(), mine)
    assert image.radiance.shape == (40, 48, 3)
    exact = averaged(jnp.asarray(uniform(one, mine, 1024, 7)), factor)
    assert off(image.radiance, exact, np.asarray(image.alpha) > 0) < 0.013
    single = of_scene(tolerance=0.01, shadows=False).plan(sky(), view())
    assert image.measured["plan"].samples < 0.6 * factor**2 * single.samples


def test_maps_show_what_was_planned():
    plan = of_scene(samples=32, shadows=False).plan(sky(), view())
    maps = plan.maps()
    assert set(maps) == {"bandwidth", "level", "samples", "error"}
    assert all(of.shape == (40, 48) and np.isfinite(of).all() for of in maps.values())
    assert maps["samples"].sum() == plan.samples
    assert ((maps["samples"] > 0) <= (maps["level"] == 0)).all()
    total = np.sqrt(np.mean(maps["error"][covered()] ** 2))
    np.testing.assert_allclose(total, np.hypot(plan.interpolation, plan.noise), rtol=0.25)


@pytest.mark.slow
def test_gradients_are_finite_and_descend():
    ball = Scene([Part(sphere(1, 24), "skin")], {"skin": GLOSSY}, CAMERA)
    relighter = prepared(ball, samples=16, shadows=False)
    mine, pixels = relighter.view(), np.full((8, 16, 3), 0.5, np.float32)
    traced = relighter.trace(sky(), mine)

    @jax.jit
    @functools.partial(jax.value_and_grad, argnums=(0, 1))
    def loss(pixels, brdf):
        lit = eqx.tree_at(lambda of: of.mipmap.radiance, sky(), cells(pixels))
        other = eqx.tree_at(lambda of: of.sampled_materials[0].components[0].sampler.brdf, relighter, brdf)
        return jnp.mean((other.shade(lit, mine, traced).radiance - 0.1) ** 2)

    value, gradients = loss(pixels, GLOSSY)
    for gradient in jax.tree.leaves(gradients):
        assert np.isfinite(gradient).all()
    by_light, by_diffuse = np.asarray(gradients[0]), np.asarray(gradients[1].diffuse)
    step = np.float32(0.05) / np.abs(by_light).max()
    assert loss(pixels - step * by_light, GLOSSY)[0] < value
    darker = eqx.tree_at(lambda of: of.diffuse, GLOSSY, np.asarray(GLOSSY.diffuse) - np.float32(0.05) * by_diffuse)
    assert loss(pixels, darker)[0] < value


def test_plans_are_of_an_environment():
    relighter = of_scene()
    light = relighter.light(point([2, 3, 1], 5.0))
    with pytest.raises(InputError, match="plans samples of an environment, and the light has none"):
        relighter.plan(light, view())
    assert relighter.trace(light, view()).plan is None


def test_one_of_both_dials():
    with pytest.raises(InputError, match="samples are a budget and tolerance is a quality; give one of both"):
        Adaptive(samples=8, tolerance=0.1)
    for dials in ({"samples": 0}, {"tolerance": float("nan")}, {"samples": -1}, {"tolerance": float("inf")}):
        with pytest.raises(InputError, match="must be above 0, and finite"):
            Adaptive(**dials)
    plans = [of_scene(**dials).plan(sky(), view()) for dials in ({"seed": 0}, {"tolerance": 0.01})]
    assert plans[0].samples == plans[1].samples > 0


def test_the_slope_is_that_of_what_is_displayed():
    x = np.linspace(0.001, 0.999, 97)
    slope = (srgb_encode(x + 1e-6) - srgb_encode(x - 1e-6)) / 2e-6
    *slopes, beyond = np.asarray(jax.jit(display_slope)(np.append(x, 100).astype(np.float32)))
    np.testing.assert_allclose(slopes, slope, rtol=1e-3)
    assert beyond < 1e-3


@pytest.mark.parametrize("window", [1, 3, 5, 9])
def test_the_largest_around_each_pixel(window: int):
    image = np.random.default_rng(window).random((13, 11, 2), np.float32)
    wanted = ndimage.maximum_filter(image, (window, window, 1), mode="constant")
    np.testing.assert_array_equal(np.stack(largest_around(image, window), axis=-1), wanted)
