"""Other materials on a prepared scene: the pictures of the scene that is prepared with them, and their derivatives."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import Adaptive, Indirect, InputError, Prefiltered, Transport
from jaxrelight.brdf.material import textured_lambert
from tests.operators.derivatives import check_derivatives
from tests.scenes import ball_over_floor

CAMERA = jr.Camera((0.4, 1.0, 2.0), (0, 0.3, 0), fov_y=45, width=16, height=12)
BEFORE = {"gloss": jr.phong([0.2, 0.1, 0.05], [0.5, 0.4, 0.3], 20.0), "paper": jr.lambert([0.7, 0.6, 0.5])}
AFTER = {"gloss": jr.phong([0.1, 0.3, 0.25], [0.2, 0.4, 0.5], 24.0), "paper": jr.lambert([0.2, 0.6, 0.9])}
SKY = jr.environment((0.3 + np.random.default_rng(0).random((16, 32, 3))).astype(np.float32))
LIGHTS = [SKY, jr.point([1, 2, 1], [3.0, 2, 1])]
TINY = dataclasses.replace(CAMERA, width=8, height=6)

# Each method, and how far off a picture may be for what is held: kept sets, factors, bounces, shapes of lobes.
METHODS = {
    "all": (Transport(resolution=8, coefficients="all"), 1e-6),
    "rows": (Transport(resolution=8, coefficients=64), 2e-3),
    "shared": (Transport(resolution=8), 2e-3),
    "filtered": (Transport("vertices", receiver_tolerance=0, resolution=8, coefficients=64), 1e-5),
    "factors": (
        Transport("vertices", receiver_tolerance=0, resolution=8, reflection="factors", factor_resolution=16, terms=6),
        0.01,
    ),
    "pixels that see a bounce": (Transport(resolution=8, receiver_tolerance=0, bounces=1, gather_resolution=8), 0.05),
    "vertices that see a bounce": (
        Transport("vertices", receiver_tolerance=0, resolution=8, bounces=1, gather_resolution=8),
        0.05,
    ),
    "indirect": (Indirect(gather_samples=256, bounces=2, sky_samples=8), 5e-3),
    "prefiltered": (Prefiltered(map_rows=32, receiver_tolerance=0), 1e-6),
    "adaptive": (Adaptive(samples=16), 1e-6),
}
DEAR = [pytest.param(name, marks=pytest.mark.slow) for name in METHODS if name != "rows"]


def scene(materials, camera=CAMERA) -> jr.Scene:
    return ball_over_floor(materials["gloss"], camera, LIGHTS, paper=materials["paper"], quads=(4, 6))


def prepared(name: str, folder, materials=None, camera=CAMERA) -> jr.Relighter:
    stored = METHODS[name][0].is_stored
    return jr.prepare(scene(materials or BEFORE, camera), METHODS[name][0], folder if stored else None)


def off(image, wanted) -> float:
    return float(np.linalg.norm(np.asarray(image) - np.asarray(wanted)) / np.linalg.norm(np.asarray(wanted)))


@pytest.mark.parametrize("name", ["rows", *DEAR])
def test_pictures_are_those_of_the_scene_prepared_with_them(name, tmp_path):
    relighter = prepared(name, tmp_path)
    view, lit = relighter.view(), relighter.light(LIGHTS)
    traced = relighter.trace(lit, view)
    before = relighter.shade(lit, view, traced).radiance
    changed = relighter.with_materials(AFTER)
    image = changed.shade(changed.relit(lit), view, traced).radiance
    # Light that is made anew has the same terms as light that is taken over.
    np.testing.assert_allclose(changed.shade(changed.light(LIGHTS), view, traced).radiance, image, rtol=1e-4, atol=1e-5)
    other = prepared(name, tmp_path, AFTER)
    is_store = METHODS[name][0].is_stored
    wanted = other.shade(other.light(LIGHTS), other.view() if is_store else view, traced).radiance
    assert off(before, wanted) > 0.5
    assert off(image, wanted) < METHODS[name][1]
    same = relighter.with_materials(BEFORE)
    assert off(same.shade(same.relit(lit), view, traced).radiance, before) < 1e-3
    assert relighter.held


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rows", "shared", "filtered", "indirect"])
@pytest.mark.usefixtures("x64")
def test_derivatives_in_both_modes_with_the_scene_as_an_argument(name, tmp_path):
    with jax.enable_x64(False):  # threads that precompute do not know of it
        relighter = prepared(name, tmp_path, camera=TINY)
    base = relighter.with_materials(BEFORE)
    sky = jr.environment(np.asarray(SKY.pixels, np.float64))
    view, lit = relighter.view(), base.light([sky, LIGHTS[1]])
    traced = base.trace(lit, view)
    shade = jax.jit(lambda of, lit, materials: _shaded(of.with_materials(materials), lit, view, traced))

    def picture(albedo, diffuse, specular, exponent):
        return shade(base, lit, {"gloss": jr.phong(diffuse, specular, exponent), "paper": jr.lambert(albedo)})

    at = np.array([0.6, 0.5, 0.4]), np.array([0.2, 0.1, 0.05]), np.array([0.5, 0.4, 0.3]), np.array(20.0)
    check_derivatives(picture, at)


def _shaded(relighter, lit, view, traced):
    return relighter.shade(relighter.relit(lit), view, traced).radiance


@pytest.fixture(scope="module")
def of_pixels(tmp_path_factory) -> jr.Relighter:
    """With a channel that is black."""
    black = {**BEFORE, "paper": jr.lambert([0.5, 0.0, 0.5])}
    return jr.prepare(scene(black), METHODS["rows"][0], tmp_path_factory.mktemp("pixels"))


def test_a_black_channel_may_become_bright(of_pixels, tmp_path):
    view = of_pixels.view()
    changed = of_pixels.with_materials(AFTER)
    image = changed.shade(changed.relit(of_pixels.light(LIGHTS)), view).radiance
    grey = of_pixels.with_materials({"paper": jr.lambert(0.9)})
    rows = np.asarray(grey.shade(grey.light(SKY), view).radiance)
    part = next(part for part in view.surfaces.parts if of_pixels.materials[part.material].name == "paper")
    pixel = np.asarray(part.pixels.pixel)
    paper = rows.reshape(-1, 3)[pixel[pixel < rows.shape[0] * rows.shape[1]]]
    assert (paper > 0).all()
    assert np.isfinite(image).all()
    # Grey light on grey paper would be grey; the sky's channels are as bright as each other in the mean.
    np.testing.assert_allclose(paper.mean(axis=0), paper.mean(), rtol=0.05)


def test_of_a_black_channel_that_is_traced_only_black_is_known(of_pixels):
    """Its rows cannot be made in time; nothing else becomes NaN."""
    view, lit = of_pixels.view(), of_pixels.light(SKY)

    @jax.jit
    def picture(relighter, albedo):
        return relighter.with_materials({"paper": jr.lambert(albedo)}).shade(lit, view).radiance

    still = np.asarray(picture(of_pixels, jnp.asarray([0.5, 0.0, 0.5])))
    np.testing.assert_allclose(still, of_pixels.shade(lit, view).radiance, rtol=1e-5, atol=1e-6)
    bright = np.asarray(picture(of_pixels, jnp.asarray([0.5, 0.5, 0.5])))
    np.testing.assert_array_equal(bright[..., [0, 2]], still[..., [0, 2]])
    assert np.isnan(bright[..., 1]).any()


def test_an_albedo_is_a_factor_on_light_terms(of_pixels):
    """Nothing of light is made anew, and the picture is linear in a texture."""
    changed = of_pixels.with_materials({"gloss": BEFORE["gloss"]})
    lit = changed.light(LIGHTS)
    numbers = [i for i, block in enumerate(changed.transport.blocks) if not block.remade]
    assert numbers
    again = changed.relit(lit)
    assert all(again.terms[i] is lit.terms[i] for i in numbers)


def test_what_cannot_be_is_one_line(of_pixels):
    two = jr.Material(tuple(jr.Component(jr.phong(0.1, 0.2, n)) for n in (5.0, 9.0)))
    wrong = {
        "no surface has a material 'wood'; there are gloss, paper": {"wood": jr.lambert(0.5)},
        "material 'gloss' was prepared as 0 diffuse and 1 glossy BRDFs": {"gloss": two},
        "material 'paper' was prepared as 1 diffuse and 0 glossy BRDFs": {"paper": jr.phong(0.1, 0.2, 9.0)},
    }
    for message, materials in wrong.items():
        with pytest.raises(InputError, match=message) as caught:
            of_pixels.with_materials(materials)
        assert len(str(caught.value).splitlines()) == 1


def test_a_part_that_is_left_out_is_black(of_pixels):
    """A material of fewer parts than were prepared."""
    view = of_pixels.view()
    black = of_pixels.with_materials({"gloss": jr.lambert(0.0), "paper": textured_lambert(jr.constant([0.0, 0, 0]))})
    image = black.shade(black.light(LIGHTS), view).radiance
    assert not np.any(image)
    assert jnp.isfinite(image).all()
