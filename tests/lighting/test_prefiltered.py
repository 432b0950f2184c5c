"""Lighting without transport: against another renderer, against exact transport, and laws."""

import dataclasses
import functools
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight import (
    Camera,
    Part,
    Scene,
    ashikhmin_shirley,
    environment,
    image_error,
    load_scene,
    lobe,
    lobe_sum,
    phong,
    plane,
    prepare,
    read_image,
    sphere,
)
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.material import Component, Material, as_material
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.texture import Texture
from jaxrelight.errors import InputError
from jaxrelight.geometry.mesh import transformed
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.lighting.direct_light import shade_lights
from jaxrelight.lighting.prefiltered import PrefilteredRelighter, prefiltered_radiance, shade_environment
from jaxrelight.lighting.shadows import all_visible, group_lights, trace_visibility
from jaxrelight.lighting.visible_surfaces import SurfaceMaterial, VisibleSurfaces, surface_material
from jaxrelight.lights.local import directional, point
from jaxrelight.lights.prefiltered import prefilter
from jaxrelight.methods import Prefiltered, Transport
from jaxrelight.numerics.arrays import as_array
from tests.shared_data import shared

CAMERA = Camera((0.2, 1.2, 3.0), (0.0, 0.0, 0.0), (0.0, 1.0, 0.0), 40.0, 24, 20)
LAFORTUNE = lobe_sum(
    [0.2, 0.1, 0.3],
    [lobe([-1, -1, 0.8], 30, specular=[0.4, 0.3, 0.2]), lobe([0.3, 0.6, 0.7], 3, peak=0.2)],
)


def ball(brdf) -> Scene:
    """A ball alone, which casts no shadow on itself."""
    return Scene([Part(sphere(1, 24), "skin")], {"skin": brdf}, CAMERA, name="ball")


@functools.cache
def filtered():
    """Of the sky below; made once for all tests."""
    return prefilter(sky(), 32)


def sky() -> np.ndarray:
    pixels = np.random.default_rng(0).uniform(0.05, 0.5, (16, 32, 3)).astype(np.float32)
    pixels[4, 6] = 20
    return pixels


class Seen(NamedTuple):
    """A scene's materials, and what its camera sees of them."""

    materials: tuple[SurfaceMaterial, ...]
    view: VisibleSurfaces
    centre: np.ndarray

    @property
    def covered(self) -> np.ndarray:
        return np.asarray(self.view.covered)


def prepared(scene: Scene, **dials) -> PrefilteredRelighter:
    given: dict[str, Any] = {"map_rows": 32, "occlusion_resolution": 0} | dials
    relighter = prepare(scene, Prefiltered(**given))
    assert isinstance(relighter, PrefilteredRelighter)
    return relighter


def look(scene: Scene, **dials) -> Seen:
    relighter = prepared(scene, **dials)
    return Seen(relighter.materials, relighter.view(), relighter.geometry.surfaces.centre)


def under(seen: Seen, maps, *given, **how):
    """What `shade_environment` makes of a filtered environment."""
    return shade_environment(seen.materials, seen.view, maps, *given, **how)


def lit_by(seen: Seen, lights, shadows: bool = True, **how):
    """What `shade_lights` makes of local lights, with shadow rays or without."""
    groups = group_lights(lights, seen.centre)
    visibility = (trace_visibility if shadows else all_visible)(seen.view.points, groups)
    radiance = shade_lights(seen.materials, seen.view, groups, visibility, **how)
    assert radiance is not None
    return radiance


@functools.cache
def lafortune() -> Seen:
    """The ball of LAFORTUNE, as the camera sees it."""
    return look(ball(LAFORTUNE))


@jax.jit
def radiances(brdfs, maps):
    """Of several BRDFs, whose arrays lead with their number."""
    eye = jnp.asarray([0.48, 0.36, 0.8])
    return jax.vmap(lambda one: prefiltered_radiance(one, eye, jnp.eye(3), maps))(brdfs)


@pytest.mark.parametrize("name", ["room_spot", pytest.param("room_point", marks=pytest.mark.slow)])
def test_local_lights_with_shadows_are_those_of_another_renderer(name):
    scene = load_scene(shared("reference", f"{name}.toml"))
    image = prepared(scene).picture(scene.lights.local, background=False)
    error = image_error(image, read_image(shared("reference", f"{name}_b0.exr")))
    assert error.trimmed < 1e-3
    assert abs(error.mean_ratio - 1) < 2e-3


def test_a_ball_is_lit_as_by_exact_transport_and_better_than_with_the_cosine_outside(tmp_path):
    light = environment(sky(), rotate_y=37, scale=2)
    scene = dataclasses.replace(ball(LAFORTUNE), lights=light)
    exact = prepare(scene, Transport("pixels", 32, coefficients="all"), tmp_path)
    truth = exact.picture(background=False)
    cut, outside = (
        image_error(prepared(scene, horizon=horizon).picture(background=False), truth) for horizon in ("cut", "outside")
    )
    assert cut.trimmed < 0.02
    assert cut.trimmed < 0.5 * outside.trimmed
    assert cut.untrimmed < outside.untrimmed


def test_pictures_are_the_environment_local_lights_and_emission():
    """The steps by themselves add up to what the relighter shades; the dial of shadows reaches it."""
    glow = np.array([0.3, 0.2, 0.1], np.float32)
    parts = [Part(sphere(0.5, 12), "skin"), Part(plane((4, 4), 1), "lamp")]
    lamp = Material(as_material(phong(0.5, 0, 1)).components, emission=glow)
    scene = Scene(parts, {"skin": LAFORTUNE, "lamp": lamp}, CAMERA)
    local, seen = [point([2, 1, 0], 3), directional([-1, -1, 0], 2)], look(scene)
    on_lamp = np.zeros(seen.covered.size, bool)
    (number,) = (k for k, one in enumerate(seen.materials) if one.name == "lamp")
    for part in seen.view.parts:
        pixel = np.asarray(part.pixels.pixel)
        on_lamp[pixel[pixel < on_lamp.size]] = part.material == number
    emitted = on_lamp.reshape(seen.covered.shape)[..., None] * glow
    for shadows in (True, False):
        relighter = prepared(scene, shadows=shadows)
        lit = relighter.light([environment(sky(), rotate_y=37, scale=2), *local])
        image = relighter.shade(lit, relighter.view())
        wanted = under(seen, filtered(), 37, 2) + lit_by(seen, local, shadows) + emitted
        np.testing.assert_allclose(image.radiance, wanted, rtol=1e-5, atol=1e-6)
        np.testing.assert_array_equal(image.alpha, seen.covered)
        alone = relighter.shade(relighter.light(None), relighter.view())
        np.testing.assert_allclose(alone.radiance, emitted, rtol=1e-6)


def test_turning_the_map_is_turning_its_pixels():
    seen, pixels = lafortune(), sky()
    turned = under(seen, prefilter(np.roll(pixels, -8, axis=1), 32))
    np.testing.assert_allclose(under(seen, filtered(), 90), turned, rtol=2e-3, atol=1e-4)


def test_the_background_is_the_map_as_it_is_turned():
    view, light = lafortune().view, environment(sky(), 90, 2)
    turned = environment(2 * np.roll(sky(), -8, axis=1))
    np.testing.assert_allclose(view.background(light), view.background(turned), rtol=1e-5)
    assert np.asarray(view.background(light)).std() > 0.01


def test_light_adds_up_and_scales():
    seen = lafortune()
    one, two = point([2, 3, 1], [5, 4, 3]), directional([-1, -1, 0], 2)
    both = lit_by(seen, [one, two])
    np.testing.assert_allclose(both, lit_by(seen, [one]) + lit_by(seen, [two]), rtol=1e-5)
    maps = filtered()
    np.testing.assert_allclose(under(seen, maps, 0, 3), 3 * under(seen, maps), rtol=1e-5)


def test_shadows_only_take_away_and_can_be_left_out():
    parts = [Part(sphere(0.5, 12), "skin"), Part(plane((4, 4), 1), "skin")]
    seen = look(Scene(parts, {"skin": phong(0.5, 0, 1)}, CAMERA))
    lamp = point([2, 1, 0], 3)
    with_shadows, without = (np.asarray(lit_by(seen, [lamp], shadows)) for shadows in (True, False))
    assert (with_shadows <= without).all()
    dark = ((with_shadows == 0) & (without > 0)).any(axis=-1)
    assert 0.02 < dark.mean() < 0.5


def test_what_stands_behind_a_lamp_casts_no_shadow():
    """In a scene whose own unit is ten metres."""
    floor = plane((20, 20), 1)
    roof = transformed(plane((20, 20), 1), np.diag([1.0, -1, -1, 1]) + np.eye(4)[1][:, None] * [0, 0, 0, 4])
    camera = dataclasses.replace(CAMERA, origin=(0.2, 1.5, 3.0))
    lamp = [point([0.0, 2, 0], 3)]
    alone, under = (
        lit_by(look(Scene([Part(mesh, "skin") for mesh in meshes], {"skin": phong(0.5, 0, 1)}, camera)), lamp)
        for meshes in ([floor], [floor, roof])
    )
    assert (np.asarray(alone)[-1] > 0).all()
    np.testing.assert_allclose(under[-1], alone[-1], rtol=1e-4)


def test_lobes_of_each_channel_are_seen_in_that_channel():
    C = np.array([[-1, -1, 1], [1, 1, 1], [-1, 1, 1]], np.float32)
    exponent, diffuse, peaks = (np.array(of, np.float32) for of in ([3, 40, 200], [0.1, 0.2, 0.3], [0.3, 0.2, 0.4]))
    together = radiances(
        LobeSum(*(as_array(of[None]) for of in (diffuse, C[None], exponent[None], peaks[None]))), filtered()
    )
    several = np.tile(diffuse, (3, 1)), C[:, None, None], exponent[:, None, None], np.tile(peaks, (3, 1, 1))
    alone = radiances(LobeSum(*map(as_array, several)), filtered())
    np.testing.assert_allclose(together[0], np.diagonal(alone), rtol=1e-5)


def test_weights_multiply_what_is_reflected():
    factors = np.array([[[0.25, 0.5, 1.0]]], np.float32)
    less = look(ball(Material((Component(LAFORTUNE, (Texture(as_array(factors)),)),))))
    whole, lamp = lafortune(), [point([2, 3, 1], 5)]
    np.testing.assert_allclose(lit_by(less, lamp), lit_by(whole, lamp) * factors, rtol=1e-5)
    np.testing.assert_allclose(under(less, filtered()), under(whole, filtered()) * factors, rtol=1e-5)


def test_a_ray_is_blocked_only_by_what_is_nearer_than_the_light():
    from jaxrelight.geometry.surfaces import join

    tracer = Tracer(join([plane((2, 2), 1)]))
    origins, down = np.tile([0.1, 0.5, 0.2], (3, 1)), np.tile([0.0, -1, 0], (3, 1))
    np.testing.assert_array_equal(tracer.blocked(origins, down, np.array([0.49, 0.51, np.inf])), [False, True, True])


def card(brdf) -> Scene:
    return Scene([Part(plane((3, 3), 2), "card")], {"card": brdf}, CAMERA)


def spatial_lobes(parameters: dict) -> SpatialLobes:
    """Without anisotropy."""
    maps: dict[str, Any] = {name: as_array(value, np.float32) for name, value in parameters.items()}
    return SpatialLobes(**maps, axis=as_array(np.tile([1, 0], (*maps["diffuse"].shape[:2], 1)), np.float32))


def test_every_texel_has_its_own_lobes():
    flat = {
        "diffuse": [0.2, 0.1, 0.3],
        "C": [[-1, -1, 0.8], [0.3, 0.6, 1]],
        "exponent": [30, 3],
        "scale": [[0.4, 0.3, 0.2], [0.2] * 3],
    }
    spatial = spatial_lobes({name: [[value] * 2] * 2 for name, value in flat.items()})
    lobes = [lobe(*given, peak=peak) for *given, peak in zip(flat["C"], flat["exponent"], flat["scale"], strict=True)]
    same = lobe_sum(flat["diffuse"], lobes)
    scenes = [card(brdf) for brdf in (Material((Component(spatial),)), same)]
    pictures = [
        np.asarray(under(seen, filtered())) + np.asarray(lit_by(seen, [point([1, 2, 1], 3)]))
        for seen in map(look, scenes)
    ]
    np.testing.assert_allclose(*pictures, rtol=2e-3)
    diffuse = np.array(spatial.diffuse)
    diffuse[0, 0] = 1
    seen = look(card(Material((Component(dataclasses.replace(spatial, diffuse=diffuse)),))))
    assert (np.asarray(under(seen, filtered())) - pictures[0]).max() > 0.01


def test_directions_of_anisotropy_follow_the_texture_coordinates():
    """Texture coordinates turned by a quarter turn the highlights as the map's own directions do."""
    card = plane((3, 3), 2)
    assert card.uv is not None
    turned = dataclasses.replace(card, uv=np.stack([card.uv[:, 1], 1 - card.uv[:, 0]], axis=1))
    lamp = [point([0.5, 1, 1], 3)]

    def brushed(mesh, cos2: float) -> np.ndarray:
        one = ([[[0, 0, 0]]], [[[[-1, -0.3, 0.9]]]], [[[20]]], [[[[1, 1, 1]]]], [[[cos2, 0]]])
        spatial = SpatialLobes(*(as_array(part, np.float32) for part in one))
        scene = Scene([Part(mesh, "card")], {"card": Material((Component(spatial),))}, CAMERA)
        assert scene.surfaces().uv_tangents.all()
        return np.asarray(lit_by(look(scene), lamp))

    np.testing.assert_allclose(brushed(turned, 1), brushed(card, -1), atol=1e-5)
    assert np.abs(brushed(card, 1) - brushed(card, -1)).max() > 0.05
    others = Scene([Part(card, "card")], {"card": LAFORTUNE}, CAMERA)
    assert not others.surfaces().uv_tangents.any()


@pytest.mark.slow
def test_reflectance_between_texels_is_the_mean_of_theirs():
    """A card of two columns of texels, of sharp lobes and soft ones: in the middle of the card both are seen half."""
    mirror = [[-1, -1, 1]] * 2
    row = {
        "diffuse": [[0.2] * 3] * 2,
        "C": [mirror] * 2,
        "exponent": [[2, 4], [300, 200]],
        "scale": [[[0.3] * 3] * 2] * 2,
    }
    pair = spatial_lobes({name: [value] * 2 for name, value in row.items()})
    middle = np.full(2, 0.5, np.float32)
    lobes, weights = pair.packed().around(middle, np.float32(0))
    np.testing.assert_allclose(weights.sum(), 1, rtol=1e-6)
    columns = [np.array([0.25, 0.5], np.float32), np.array([0.75, 0.5], np.float32)]
    whole = [pair.at(column, np.float32(0)) for column in columns]
    several = jax.tree.map(lambda *leaves: np.concatenate([leaves[0], np.stack(leaves[1:])]), lobes, *whole)
    radiance = np.asarray(radiances(several, filtered()))
    np.testing.assert_allclose(np.asarray(weights) @ radiance[:4], radiance[4:].mean(axis=0), rtol=1e-4)
    assert np.abs(radiance[4] - radiance[5]).max() > 0.01
    seen = look(card(Material((Component(pair),))))
    lamp = [point([0.3, 2, -1], 3)]
    for light, most in (
        (lambda kind: under(seen, filtered(), texels=kind), 1),
        (lambda kind: lit_by(seen, lamp, texels=kind), np.inf),
    ):
        by_parameters, by_reflectance = (np.asarray(light(kind)) for kind in ("parameters", "reflectance"))
        assert 1e-3 < np.abs(by_parameters - by_reflectance).max() < most


@pytest.mark.slow
def test_gradients_in_lights_and_materials_are_right():
    seen = lafortune()
    maps = filtered()

    @jax.jit
    @functools.partial(jax.value_and_grad, argnums=(0, 1, 2))
    def brightness(light, lobes, rotate_y):
        mine = seen._replace(materials=(surface_material("skin", as_material(lobes)),))
        return jnp.mean(lit_by(mine, [light])) + jnp.mean(under(mine, maps, rotate_y))

    given = point([2, 2, 2], 4.0), LAFORTUNE, np.float32(20)
    value, slopes = brightness(*given)
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(slopes))
    step = np.float32(1e-2)
    # Shadows stand still, and the ball casts none.
    moved, back = (
        brightness(dataclasses.replace(given[0], position=np.array([2, 2 + by, 2], np.float32)), *given[1:])[0]
        for by in (step, -step)
    )
    np.testing.assert_allclose(np.asarray(slopes[0].position)[1], (moved - back) / (2 * step), rtol=0.05)
    brighter = dataclasses.replace(LAFORTUNE, diffuse=np.asarray(LAFORTUNE.diffuse) + step)
    change = (brightness(given[0], brighter, given[2])[0] - value) / step
    np.testing.assert_allclose(np.asarray(slopes[1].diffuse).sum(), change, rtol=1e-3)


def test_what_is_no_sum_of_lobes_is_refused_under_an_environment_and_not_under_lamps():
    relighter = prepared(ball(ashikhmin_shirley(0.3, 0.2, 10, 50)))
    lamp = point([2, 2, 2], 4.0)
    with pytest.raises(InputError, match=r"\[material.skin\]: prefiltered environments are for sums of lobes"):
        relighter.light([lamp, environment(sky())])
    assert relighter.picture(lamp)[..., :3].max() > 0


def test_exponents_and_peaks_at_the_extremes_are_finite():
    for exponent in (0, 1e-3, 1e4, 1e6):
        for C in ([-1, -1, 1], [-2, -2, 1.5], [0.5, 0.5, -1], [0, 0, 0]):
            lobes = np.tile(C, (2, 1, 1)), np.full((2, 1), exponent), np.full((2, 3), 0.1)
            brdf = LobeSum(LAFORTUNE.diffuse, *(as_array(of, np.float32) for of in lobes))
            seen = lafortune()._replace(materials=(surface_material("skin", as_material(brdf)),))
            assert np.isfinite(under(seen, filtered())).all()
            assert np.isfinite(lit_by(seen, [directional([0, -1, 0], 1)])).all()


@pytest.mark.parametrize("texels", ["parameters", pytest.param("reflectance", marks=pytest.mark.slow)])
def test_texels_smaller_than_pixels_are_seen_at_coarser_levels(texels):
    """A black map of grey levels, and a black texture of white ones: only who asks for levels sees anything."""
    sizes = [2**n for n in range(8, -1, -1)]

    def level(side: int, albedo: float) -> SpatialLobes:
        shapes = (3,), (0, 3), (0,), (0, 3), (2,)
        return SpatialLobes(
            *(
                as_array(np.full((side, side, *shape), fill), np.float32)
                for shape, fill in zip(shapes, (albedo, 0, 0, 0, 1), strict=True)
            )
        )

    maps = dataclasses.replace(level(256, 0.0), coarser=tuple(level(side, 0.5) for side in sizes[1:]))
    coarser = np.ones((sum(side**2 for side in sizes[1:]), 1), np.float32)
    weight = Texture(as_array(np.zeros((256, 256, 1), np.float32)), as_array(coarser))
    lamp, sky = [point([1, 2, 1], 3)], filtered()
    for component in (Component(maps), Component(lobe_sum([0.5] * 3, []), (weight,))):
        scene = Scene([Part(plane((8, 8), 2), "card")], {"card": Material((component,))}, CAMERA)
        seen = look(scene)
        for image in (under(seen, sky, texels=texels), lit_by(seen, lamp, shadows=False, texels=texels)):
            assert np.asarray(image)[seen.covered].min() > 0
    near = look(dataclasses.replace(scene, materials={"card": Material((Component(maps),))}), minification="none")
    assert not np.asarray(under(near, sky, texels=texels)).any()
