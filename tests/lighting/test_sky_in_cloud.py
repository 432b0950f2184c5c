"""An environment as directions in the cloud: closed forms, the same as by many lights, and derivatives."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import InputError, Part, Scene
from jaxrelight.basis import latlong
from jaxrelight.lights.local import point
from jaxrelight.lights.sky import even_sky, mean_radiance, nearest_directions, sky_of
from jaxrelight.methods import Indirect
from tests.lighting.test_indirect import opened, reflected, room

CAMERA = jr.Camera((0, 0.6, 1.2), (0, 0.1, 0), fov_y=40.0, width=12, height=10)
ONES = jr.environment(np.ones((8, 16, 3)))


def gradient() -> jr.Environment:
    """Brighter and redder to one side, and above."""
    v, u = (np.indices((16, 32)) + 0.5) / np.array([[[16]], [[32]]])
    pixels = np.stack([1 + np.sin(2 * np.pi * u), 2 - v, 0 * u + 0.5], axis=2)
    return jr.environment(pixels, rotate_y=40.0, scale=0.7)


def outdoors(*more: Part) -> Scene:
    floor = Part(jr.plane((2, 2), 8), "floor")
    return Scene([floor, *more], {"floor": jr.lambert([0.5, 0.4, 0.3]), "gloss": jr.phong(0.2, 0.3, 10.0)}, CAMERA)


@pytest.fixture(scope="module")
def object_outdoors(tmp_path_factory):
    block = jr.box((0.3, 0.3, 0.3), 2)
    block = Part(dataclasses.replace(block, vertices=np.add(block.vertices, [0, 0.15, 0])), "gloss")
    return opened(outdoors(block), tmp_path_factory.mktemp("sky"), gather_samples=1024, sky=True)


def test_an_open_floor_under_an_even_sky_is_its_albedo(tmp_path):
    relighter = opened(outdoors(), tmp_path, gather_samples=1024, sky=True, bounces=1)
    radiance = reflected(relighter, ONES)[np.asarray(relighter.view().pixels.surfaces.covered)]
    np.testing.assert_allclose(radiance, np.tile([0.5, 0.4, 0.3], (len(radiance), 1)), rtol=0.02)


def test_all_light_of_a_map_is_in_one_direction_or_another():
    directions = np.asarray(even_sky(1.0, 50).directions)
    towards = np.concatenate([directions, directions * [1, -1, 1]])
    for height, width in ((16, 32), (4, 8), (64, 128)):
        pixels = np.random.default_rng(0).random((height, width, 3)).astype(np.float32)
        means = mean_radiance(pixels, 0.0, 2.0, jnp.asarray(nearest_directions(towards, height, width)), 100)
        omega = latlong.solid_angles(height, width)[:, None, None]
        np.testing.assert_allclose(means.mean(axis=0) * 4 * np.pi, 2 * (pixels * omega).sum(axis=(0, 1)), rtol=1e-4)


@pytest.mark.parametrize("bounces", [pytest.param(1, marks=pytest.mark.slow), 3])
def test_the_picture_is_that_of_many_lights(object_outdoors, bounces):
    sky, view = gradient(), object_outdoors.view()
    image, wanted = (
        np.asarray(object_outdoors.shade(object_outdoors.light(lights, bounces), view).radiance)
        for lights in (sky, sky_of(sky, 100))
    )
    assert np.linalg.norm(image - wanted) < 0.06 * np.linalg.norm(wanted)
    np.testing.assert_allclose(image.mean(axis=(0, 1)), wanted.mean(axis=(0, 1)), rtol=0.05)


def test_every_bounce_of_a_sky_adds_light(object_outdoors):
    """Without any, pixels see the sky itself; what is added grows less."""
    sky = gradient()
    means = np.asarray([reflected(object_outdoors, sky, bounces).mean() for bounces in range(4)])
    added = np.diff(means)
    assert means[0] > 0
    assert (added > 1e-4 * means[0]).all()
    assert (np.diff(added) < 0).all()


def test_layers_add_up(object_outdoors):
    lights, view = [point([0.4, 0.8, 0.4], 1.0), gradient()], object_outdoors.view()
    image = object_outdoors.layers(lights, view)
    layers = image.layers
    whole = sum(layers[name] for name in ("direct", "indirect.diffuse", "indirect.glossy"))
    np.testing.assert_allclose(image.radiance, whole, rtol=1e-6)
    np.testing.assert_allclose(layers["light1"] + layers["sky"], whole, rtol=1e-3, atol=1e-5)
    shaded = object_outdoors.shade(object_outdoors.light(lights), view)
    np.testing.assert_allclose(shaded.radiance, whole, rtol=1e-4, atol=1e-5)
    np.testing.assert_allclose(shaded.radiance, sum(shaded.layers.values()), rtol=1e-6)


@pytest.mark.slow
def test_derivatives_in_the_map_and_its_turn(object_outdoors):
    pixels, view = jnp.asarray(gradient().pixels), object_outdoors.view()

    def bright(pixels, turn):
        light = object_outdoors.add_bounces(object_outdoors.sky_light(pixels, turn), 2)
        return jnp.sum(object_outdoors.final_gather(light, view)[..., 0] ** 2)

    slopes = jax.grad(bright, (0, 1))(pixels, 10.0)
    assert all(np.isfinite(slope).all() for slope in slopes)
    along = jnp.asarray(np.random.default_rng(0).normal(size=pixels.shape), jnp.float32)
    step = 1e-2
    differ = (bright(pixels + step * along, 10.0) - bright(pixels - step * along, 10.0)) / (2 * step)
    assert float(jnp.sum(slopes[0] * along)) == pytest.approx(float(differ), rel=1e-2)


def test_stores_without_a_sky_say_so(tmp_path):
    """And light an environment by many distant lights."""
    relighter = opened(outdoors(), tmp_path, bounces=1, sky_samples=512)
    with pytest.raises(InputError, match="precomputed without the sky; precompute with --sky"):
        relighter.sky_light(ONES.pixels)
    (group,) = relighter.light(ONES).groups
    assert 256 < np.asarray(group.is_real).sum() <= 512
    image = relighter.picture(ONES, background=False)
    np.testing.assert_allclose(image[image[..., 3] == 1][:, :3].mean(axis=0), [0.5, 0.4, 0.3], rtol=0.01)


def test_photons_do_not_come_from_it():
    with pytest.raises(InputError, match="photons do not come from the sky"):
        Indirect(gather_samples=1024, bounces=2, photons=1000, sky=True)


def test_in_a_closed_room_it_is_dark(tmp_path):
    relighter = opened(room(0.5), tmp_path, gather_samples=1024, sky=True, bounces=1)
    np.testing.assert_allclose(reflected(relighter, ONES), 0, atol=1e-5)
    lamp = point([0.1, 0.2, 0.05], 1.0)
    np.testing.assert_allclose(reflected(relighter, [lamp, ONES]), reflected(relighter, lamp), atol=1e-5)
