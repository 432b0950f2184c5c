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

from jaxrelight import Camera, Part, Scene, environment, lambert, phong, plane, sphere
from jaxrelight.basis import latlong
from jaxrelight.brdf.material import Component, Material
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.texture import Texture
from jaxrelight.errors import InputError
from jaxrelight.geometry.mesh import transformed
from jaxrelight.images import srgb_encode
from jaxrelight.images.tone import to_unit
from jaxrelight.lighting.adaptive.shader import AdaptiveShader, display_slope, largest_around
from jaxrelight.lighting.antialiasing import averaged
from jaxrelight.lighting.prefiltered import look_at
from jaxrelight.lights.local import directional
from jaxrelight.lights.pyramid import cells, light_pyramid
from jaxrelight.numerics.arrays import as_array

CAMERA = Camera((0.2, 1.2, 3.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 40.0, 48, 40)
GLOSSY = phong([0.2, 0.1, 0.05], 0.4, 60)
MATT = phong(0.5, 0, 1)
# All maps have one size, and BRDFs one lobe: what is compiled for one of them serves the others.
ROWS = 256


@functools.cache
def sky():
    return light_of(0.3 + np.random.default_rng(0).random((16, 32, 3)) ** 8)


def light_of(pixels: np.ndarray):
    times = ROWS // len(pixels)
    return light_pyramid(environment(np.kron(pixels, np.ones((times, times, 1))).astype(np.float32)))


def ball_on_floor(brdf=GLOSSY, floor=None) -> Scene:
    down = transformed(plane([4, 4]), np.array([[1, 0, 0, 0], [0, 1, 0, -1], [0, 0, 1, 0], [0, 0, 0, 1.0]]))
    parts = [Part(sphere(1, 24), "skin"), Part(down, "floor")]
    return Scene(parts, {"skin": brdf, "floor": floor or MATT}, CAMERA, name="ball")


@functools.cache
def shader() -> AdaptiveShader:
    scene = ball_on_floor()
    return AdaptiveShader(look_at(scene), scene.camera)


@functools.cache
def wanted(shadows: bool) -> np.ndarray:
    return np.asarray(shader().uniform(sky(), 2048, 7, filtered=True, shadows=shadows))


def off(image, other, covered) -> float:
    """Root-mean-square difference of displayed values."""
    one, two = (srgb_encode(to_unit(np.asarray(x)))[covered] for x in (image, other))
    return float(np.sqrt(np.mean((one - two) ** 2)))


@pytest.mark.parametrize(
    ("shadows", "tolerance"), [(False, 0.006), pytest.param(False, 0.02, marks=pytest.mark.slow), (True, 0.02)]
)
def test_the_error_is_what_was_asked_for(shadows: bool, tolerance: float):
    plan = shader().plan(sky(), tolerance=tolerance, shadows=shadows)
    found = off(shader().shade(plan, sky()), wanted(shadows), shader().seen.covered)
    assert found < 1.3 * tolerance
    assert np.hypot(plan.interpolation, plan.noise) < 1.05 * tolerance
    # Fewer samples than as many everywhere, and than pixels times the least.
    assert plan.shaded < 0.9 * shader().seen.covered.sum()


def test_noise_is_tried_out_for_each_material(monkeypatch):
    """So samples go where noise is found, however wrong it is predicted."""

    def share():
        plan = shader().plan(sky(), samples=64, shadows=True)
        return plan.layers[0].counts[shader()._material == 0].sum() / plan.samples

    right, asked = share(), AdaptiveShader._asked

    def wrong(self, *given):
        found = asked(self, *given)
        return found._replace(deviation=found.deviation * np.where(self._material == 0, 10, 1))

    monkeypatch.setattr(AdaptiveShader, "_asked", wrong)
    np.testing.assert_allclose(share(), right, atol=0.05)


def test_budgets_are_kept_and_more_is_better():
    pixels, errors = shader().seen.covered.sum(), []
    for samples in (8, 32, 128):
        plan = shader().plan(sky(), samples=samples)
        assert 0.7 * samples < plan.samples / pixels < 1.15 * samples
        errors.append(off(shader().shade(plan, sky()), wanted(False), shader().seen.covered))
    assert errors == sorted(errors, reverse=True)
    # Against the same number everywhere.
    even = off(shader().uniform(sky(), 32), wanted(False), shader().seen.covered)
    assert errors[1] < 0.5 * even


@pytest.mark.slow
def test_lambert_under_a_constant_sky_is_exact_and_hardly_shaded():
    camera = dataclasses.replace(CAMERA, width=240, height=200)
    seen = look_at(Scene([Part(sphere(1, 48), "skin")], {"skin": lambert(0.6)}, camera, name="ball"))
    white, one = light_pyramid(environment(np.ones((8, 16, 3), np.float32))), AdaptiveShader(seen, camera)
    plan = one.plan(white, tolerance=0.01)
    image = np.asarray(one.shade(plan, white))
    facing = seen.covered.copy()
    facing[seen.covered] = np.sum(seen.gbuffer.normals * seen.gbuffer.omega_o, axis=1) > 0
    np.testing.assert_allclose(image[facing], 0.6, rtol=1e-3)
    assert plan.shaded < 0.01 * seen.covered.sum()


def test_nothing_to_see_is_a_plan_too():
    away = dataclasses.replace(CAMERA, target=(0.2, 1.2, 9.0))
    seen = look_at(Scene([Part(sphere(1, 24), "skin")], {"skin": MATT}, away, name="ball"))
    one = AdaptiveShader(seen, away)
    plan = one.plan(sky(), tolerance=0.01, shadows=True)
    assert plan.samples == plan.shaded == 0
    assert not any(of.any() for of in plan.maps().values())
    assert not np.asarray(one.shade(plan, sky())).any()
    # As dark as can be, and seen.
    black = light_of(np.zeros((8, 16, 3)))
    plan = shader().plan(black, tolerance=0.01, shadows=True)
    assert not np.asarray(shader().shade(plan, black)).any()
    assert all(np.isfinite(of).all() for of in plan.maps().values())


def test_the_same_seed_is_the_same_image():
    plan = shader().plan(sky(), samples=16)
    one = np.asarray(shader().shade(plan, sky(), 3))
    np.testing.assert_array_equal(shader().shade(plan, sky(), 3), one)
    assert np.abs(np.asarray(shader().shade(plan, sky(), 4)) - one).max() > 0


def test_a_sun_is_lit_by_a_few_directions_in_every_pixel():
    """Against the two parts of the sky, each by itself, and against the shadow of a distant light."""
    pixels = np.full((ROWS, 2 * ROWS, 3), 0.2, np.float32)
    pixels[80, 160] = 1e5
    v, u = (np.array([80.5, 160.5]) / [ROWS, 2 * ROWS]).astype(np.float32)
    towards, area = latlong.directions(u, v), latlong.solid_angles(ROWS, 2 * ROWS)[80]
    light, even = light_of(pixels), light_of(np.full_like(pixels, 0.2))
    plan = shader().plan(light, tolerance=0.01, shadows=True)
    found = np.asarray(shader().shade(plan, light))
    sun = np.asarray(shader().seen.lit_by([directional(-towards, float(1e5 * area))]))
    wanted = np.asarray(shader().uniform(even, 512, 7, filtered=True, shadows=True)) + sun
    covered = shader().seen.covered
    assert off(found, wanted, covered) < 0.02
    # Of the floor, some lies in the shadow, and only the sky is left.
    dark = covered & (sun.max(axis=2) == 0)
    assert dark.sum() > 50
    assert found[dark].max() < 0.5
    same = np.asarray(shader().uniform(light, 16, filtered=True, shadows=True))
    np.testing.assert_array_equal(same[~covered], 0)


def test_textures_ask_for_no_shading():
    """A checked floor is as sharp as it is, though few of its pixels are shaded."""
    checks = Texture(np.kron(np.indices((8, 8)).sum(axis=0) % 2, np.ones((4, 4)))[..., None].astype(np.float32))
    bare, checked = (Material((Component(MATT, weight),)) for weight in ((), (checks,)))
    images = []
    for floor in (bare, checked):
        scene = ball_on_floor(floor=floor)
        one = AdaptiveShader(look_at(scene), CAMERA)
        plan = one.plan(sky(), tolerance=0.01)
        images.append((np.asarray(one.shade(plan, sky())), plan.shaded))
    (plain, few), (sharp, more) = images
    assert more <= 1.1 * few
    floor = shader().seen.materials[0].name == "floor"
    number = np.asarray(shader().seen.materials[0 if floor else 1].pixels.pixel)
    number = number[number < plain[..., 0].size]
    share = sharp.reshape(-1, 3)[number] / plain.reshape(-1, 3)[number]
    assert (share.min(), share.max()) == (0, pytest.approx(1, abs=0.1))


@pytest.mark.parametrize("texels", [64, pytest.param(2, marks=pytest.mark.slow)])
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
    one = AdaptiveShader(look_at(ball_on_floor(floor=Material((Component(spatial),)))), CAMERA)
    plan = one.plan(sky(), samples=32)
    exact = one.uniform(sky(), 1024, 7, filtered=True)
    assert off(one.shade(plan, sky()), exact, one.seen.covered) < 0.015
    m = next(of for of in one.seen.materials if of.name == "floor")
    number = np.asarray(m.pixels.pixel)
    number = number[number < one.seen.covered.size]
    shaded = plan.maps()["samples"].ravel()[number] > 0
    assert (shaded.mean() > 0.9) == (texels == 64)


def test_a_wire_one_pixel_wide_is_not_lost():
    wire = transformed(plane([0.03, 4]), np.array([[1, 0, 0, 0], [0, 1, 0, 1.02], [0, 0, 1, 0], [0, 0, 0, 1.0]]))
    parts = [*ball_on_floor().parts, Part(wire, "wire")]
    scene = Scene(parts, {**ball_on_floor().materials, "wire": phong([1, 0, 0], 0, 1)}, CAMERA, name="wire")
    one = AdaptiveShader(look_at(scene), CAMERA)
    image = np.asarray(one.shade(one.plan(sky(), samples=32), sky()))
    exact = np.asarray(one.uniform(sky(), 512, 1, filtered=True))
    red = exact[..., 0] > 4 * exact[..., 1] + 1e-3
    assert red.sum() > 10
    np.testing.assert_allclose(image[red], exact[red], rtol=0.15, atol=0.02)


@pytest.mark.slow
@pytest.mark.parametrize("factor", [2, 4])
def test_several_samples_of_surfaces_in_a_pixel(factor: int):
    """The mean over them has the error that was asked for, and takes not as many times the samples."""
    fine = dataclasses.replace(CAMERA, width=factor * 48, height=factor * 40)
    seen = look_at(dataclasses.replace(ball_on_floor(), camera=fine))
    one = AdaptiveShader(seen, fine, shader().parts, factor=factor)
    plan = one.plan(sky(), tolerance=0.01)
    exact, found = (
        averaged(jnp.asarray(image), factor)
        for image in (one.uniform(sky(), 1024, 7, filtered=True), one.shade(plan, sky()))
    )
    covered = np.asarray(averaged(jnp.asarray(seen.covered[..., None], jnp.float32), factor))[..., 0] > 0
    assert off(found, exact, covered) < 0.013
    assert plan.samples < 0.6 * factor**2 * shader().plan(sky(), tolerance=0.01).samples


def test_maps_show_what_was_planned():
    plan = shader().plan(sky(), samples=32)
    maps = plan.maps()
    assert set(maps) == {"bandwidth", "level", "samples", "error"}
    assert all(of.shape == (40, 48) and np.isfinite(of).all() for of in maps.values())
    assert maps["samples"].sum() == plan.samples
    assert ((maps["samples"] > 0) <= (maps["level"] == 0)).all()
    covered = shader().seen.covered
    total = np.sqrt(np.mean(maps["error"][covered] ** 2))
    np.testing.assert_allclose(total, np.hypot(plan.interpolation, plan.noise), rtol=0.25)


def test_gradients_are_finite_and_descend():
    one = AdaptiveShader(look_at(Scene([Part(sphere(1, 24), "skin")], {"skin": GLOSSY}, CAMERA)), CAMERA)
    plan = one.plan(sky(), samples=16)
    pixels = np.full((8, 16, 3), 0.5, np.float32)

    @jax.jit
    @functools.partial(jax.value_and_grad, argnums=(0, 1))
    def loss(pixels, brdf):
        lit = eqx.tree_at(lambda of: of.radiance, sky(), cells(pixels))
        parts = [[eqx.tree_at(lambda of: of.brdf, part, brdf) for part in of] for of in one.parts]
        return jnp.mean((one.shade(plan, lit, parts=parts) - 0.1) ** 2)

    value, gradients = loss(pixels, GLOSSY)
    for gradient in jax.tree.leaves(gradients):
        assert np.isfinite(gradient).all()
    by_light, by_diffuse = np.asarray(gradients[0]), np.asarray(gradients[1].diffuse)
    step = np.float32(0.05) / np.abs(by_light).max()
    assert loss(pixels - step * by_light, GLOSSY)[0] < value
    darker = eqx.tree_at(lambda of: of.diffuse, GLOSSY, np.asarray(GLOSSY.diffuse) - np.float32(0.05) * by_diffuse)
    assert loss(pixels, darker)[0] < value


def test_one_of_both_dials():
    for dials in ({}, {"samples": 8, "tolerance": 0.1}, {"samples": 0}, {"tolerance": float("nan")}, {"samples": -1}):
        with pytest.raises(InputError, match="adaptive shading"):
            shader().plan(sky(), **dials)  # pyright: ignore[reportArgumentType]


def test_the_slope_is_that_of_what_is_displayed():
    x = np.linspace(0.001, 0.999, 97)
    slope = (srgb_encode(x + 1e-6) - srgb_encode(x - 1e-6)) / 2e-6
    *found, beyond = np.asarray(jax.jit(display_slope)(np.append(x, 100).astype(np.float32)))
    np.testing.assert_allclose(found, slope, rtol=1e-3)
    assert beyond < 1e-3


@pytest.mark.parametrize("window", [1, 3, 5, 9])
def test_the_largest_around_each_pixel(window: int):
    image = np.random.default_rng(window).random((13, 11, 2), np.float32)
    wanted = ndimage.maximum_filter(image, (window, window, 1), mode="constant")
    np.testing.assert_array_equal(np.stack(largest_around(image, window), axis=-1), wanted)
