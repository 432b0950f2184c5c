"""From light to picture: linearity, the white furnace, rotation and what lies behind the surfaces."""

import dataclasses
from typing import Literal

import jax
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import Part, Scene
from jaxrelight.basis import latlong
from jaxrelight.brdf.material import Material, as_material
from jaxrelight.geometry import mesh as meshes
from jaxrelight.lighting.transport import TransportRelighter
from jaxrelight.lighting.transport_view import TransportView
from jaxrelight.methods import Transport
from jaxrelight.precomputation.precompute import precompute
from jaxrelight.transport.compression import padded_receivers
from tests.opening import open_transport
from tests.scenes import block_aside, raised

SKY = np.random.default_rng(6).gamma(0.4, size=(8, 16, 3)).astype(np.float32)


def _scene() -> Scene:
    """A glossy ball beside a block on a floor."""
    return block_aside(jr.phong([0.2, 0.3, 0.1], 0.4, 6.0), "paper", ball=True)


@pytest.fixture(scope="module", params=["vertices", "pixels"])
def relighter(request, tmp_path_factory) -> TransportRelighter:
    folder = tmp_path_factory.mktemp("store")
    precompute(
        _scene(),
        Transport(request.param, resolution=8, terms=2, coefficients=48, factor_resolution=12),
        folder,
    )
    return open_transport(folder)


def _relative(actual, wanted) -> float:
    return float(np.linalg.norm(np.subtract(actual, wanted, dtype=float)) / np.linalg.norm(np.asarray(wanted, float)))


def _picture(relighter: TransportRelighter, environment, view: TransportView, background: bool = True) -> np.ndarray:
    lit = relighter.light(environment)
    return relighter.shade(lit, view).rgba(relighter.background(lit, view) if background else None)


def _surface(relighter: TransportRelighter, environment, view: TransportView) -> np.ndarray:
    return _picture(relighter, environment, view, background=False)[..., :3]


# Linearity.


def test_picture_is_linear_in_the_light(relighter: TransportRelighter):
    """But for a sun that is split off, which is not found by a linear rule."""
    generator = np.random.default_rng(0)
    one, other = SKY, generator.random(SKY.shape).astype(np.float32)
    other[2, 3] = 300
    whole = dataclasses.replace(relighter.method, split_sun=False)
    linear = jr.prepare(_scene(), whole, relighter.transport.stored.folder)
    view, skies = linear.view(), [jr.environment(pixels) for pixels in (one, other, 2.5 * one + 0.3 * other)]
    pictures = [linear.shade(linear.light(sky), view).radiance for sky in skies]
    assert _relative(pictures[2], 2.5 * pictures[0] + 0.3 * pictures[1]) < 1e-6
    assert _relative(_surface(relighter, skies[1], view), pictures[1]) > 1e-3


def test_picture_is_linear_in_scale(relighter: TransportRelighter):
    view = relighter.view()
    plain = _surface(relighter, jr.environment(SKY), view)
    for scale in (0.0, 1e-3, 7.0, 1e5):
        assert np.abs(_surface(relighter, jr.environment(SKY, scale=scale), view) - scale * plain).max() <= (
            1e-6 * scale * np.abs(plain).max()
        )


def test_black_sky_gives_black(relighter: TransportRelighter):
    image = _picture(relighter, jr.environment(0 * SKY), relighter.view())
    assert not image[..., :3].any()


def test_channels_do_not_mix(relighter: TransportRelighter):
    view = relighter.view()
    together = _surface(relighter, jr.environment(SKY), view)
    for c in range(3):
        alone = np.zeros_like(SKY)
        alone[..., c] = SKY[..., c]
        picture = _surface(relighter, jr.environment(alone), view)
        np.testing.assert_allclose(picture[..., c], together[..., c], rtol=1e-6, atol=1e-7)
        assert not np.delete(picture, c, axis=-1).any()


def test_light_and_shade_make_the_picture(relighter: TransportRelighter):
    """What changes with the light is paid apart from what changes with the view."""
    environment, view = jr.environment(SKY, rotate_y=40, scale=2), relighter.view()
    lit = relighter.light(environment)
    terms = lit.terms
    for part, block in zip(terms, relighter.transport.blocks, strict=True):
        count = 128 * len(block.groups)
        assert part.shape == (padded_receivers(count), block.reflection.terms, 3)
        assert np.asarray(part)[:count].any()
        assert not np.asarray(part)[count:].any()
    vector = relighter.light_vector(SKY, 40.0, 2.0)
    for block_terms, wanted in zip(terms, relighter.terms(vector), strict=True):
        np.testing.assert_allclose(block_terms, wanted, rtol=1e-6, atol=1e-7)
    given = relighter.shade(lit, view).rgba(relighter.background(lit, view))
    np.testing.assert_array_equal(given, relighter.picture(environment))
    covered, lobes = np.asarray(view.surfaces.covered), relighter.shade_lobes(lit, view)
    assert (lobes is None) == (relighter.method.receivers == "pixels")
    both = np.asarray(relighter.shade_terms(terms, view)) + (0 if lobes is None else np.asarray(lobes))
    np.testing.assert_allclose(given[covered][:, :3], both[covered], rtol=1e-6)


def test_many_lights_are_each_by_itself(relighter: TransportRelighter):
    """A sky turned in steps, and another: each as it is alone, in all terms and in its picture."""
    turned = [jr.environment(SKY, rotate_y=degrees, scale=2) for degrees in (0, 30, 200)]
    environments = [*turned, jr.environment(SKY[::-1].repeat(2, axis=0).repeat(2, axis=1) + 1)]
    many, view = relighter.light_many(environments), relighter.view()
    for i, environment in enumerate(environments):
        for block_terms, wanted in zip(many[i].terms, relighter.light(environment).terms, strict=True):
            assert block_terms.shape == wanted.shape
            np.testing.assert_allclose(block_terms, wanted, rtol=1e-5, atol=1e-5)
        image = relighter.shade(many[i], view).radiance
        np.testing.assert_allclose(image, _surface(relighter, environment, view), rtol=1e-5, atol=1e-5)
    assert _relative(many[0].terms[0], many[1].terms[0]) > 0.1


@pytest.mark.parametrize("coefficients", ["shared", pytest.param("all", marks=pytest.mark.slow)])
def test_many_lights_where_surfaces_emit(tmp_path, coefficients):
    """What bounces add is added to each: to clusters, and to rows that are baked as they are needed."""
    lamp = Material(as_material(jr.lambert(0.0)).components, emission=np.array([5, 4, 3], np.float32))
    parts = [Part(jr.plane((2, 2), 2), "paper"), Part(raised(jr.box((0.2, 0.2, 0.2), 1), 0.3), "lamp")]
    scene = Scene(parts, {"paper": jr.lambert([0.7, 0.6, 0.5]), "lamp": lamp}, _scene().camera)
    settings = Transport(
        "vertices", receiver_tolerance=0, resolution=8, bounces=1, gather_resolution=8, coefficients=coefficients
    )
    precompute(scene, settings, tmp_path)
    relighter = open_transport(tmp_path)
    assert any(block.emitted is not None for block in relighter.transport.blocks)
    skies = [jr.environment(SKY), jr.environment(SKY, rotate_y=70)]
    many = relighter.light_many(skies)
    for i, sky in enumerate(skies):
        for block_terms, wanted in zip(many[i].terms, relighter.light(sky).terms, strict=True):
            np.testing.assert_allclose(block_terms, wanted, rtol=1e-5, atol=1e-5)


def test_pixels_that_are_not_finite_are_refused(relighter: TransportRelighter):
    pixels = SKY.copy()
    pixels[2, 3, 1] = np.inf
    with pytest.raises(jr.InputError, match="1 NaN or infinite pixels, the first in row 2, column 3"):
        relighter.light_vector(pixels)


def test_light_may_be_traced_first(relighter: TransportRelighter):
    """Tables that are kept between calls hold nothing of the function that was being traced when they were made."""
    traced = jax.jit(lambda pixels: relighter.terms(relighter.light_vector(pixels, 20.0)))(SKY)
    for block_terms, wanted in zip(traced, relighter.terms(relighter.light_vector(SKY, 20.0)), strict=True):
        assert _relative(block_terms, wanted) < 1e-5


# The white furnace.


@pytest.mark.parametrize(
    ("receivers", "mesh"),
    [("vertices", jr.sphere(0.5, 6)), ("pixels", jr.box((0.7, 0.8, 0.9), 1))],
    ids=["ball", "box"],
)
@pytest.mark.parametrize("radiance", [1.0, 1e5])
def test_white_furnace(tmp_path, receivers: Literal["vertices", "pixels"], mesh, radiance: float):
    """A white convex object under constant light cannot be told from its surroundings."""
    camera = jr.Camera((0.9, 1.1, 1.6), (0, 0, 0), fov_y=40, width=24, height=24)
    scene = Scene([Part(mesh, "white")], {"white": jr.lambert(1.0)}, camera)
    precompute(scene, Transport(receivers, resolution=32, coefficients="all"), tmp_path)
    relighter = open_transport(tmp_path)
    view = relighter.view()
    image = _picture(relighter, jr.environment(np.full((8, 16, 3), radiance)), view)
    assert 150 < np.asarray(view.surfaces.covered).sum() < 450
    np.testing.assert_allclose(image[..., :3], radiance, rtol=1e-3)


def test_albedo_is_the_radiance_in_the_furnace(tmp_path):
    """Albedo 0.3 by channel and albedo 1 in one scene, kept coefficients: constant light is their average."""
    camera = jr.Camera((0, 0.3, 2), (0, 0, 0), fov_y=40, width=16, height=12)
    scene = Scene([Part(jr.box((1, 1, 1), 1), "paper")], {"paper": jr.lambert([0.3, 0.5, 1.0])}, camera)
    precompute(scene, Transport("pixels", resolution=8, coefficients=256), tmp_path)
    relighter = open_transport(tmp_path)
    image = relighter.picture(jr.environment(np.ones((8, 16, 3))))
    seen = image[image[..., 3] == 1][:, :3]
    np.testing.assert_allclose(seen, np.broadcast_to([0.3, 0.5, 1.0], seen.shape), rtol=0.01)


# Rotation.


def test_turning_the_sky_shifts_its_columns(relighter: TransportRelighter):
    """Counter-clockwise seen from +y: what shone from +z (the middle) shines from +x (a quarter) after 90°."""
    view = relighter.view()
    turned = _picture(relighter, jr.environment(SKY, rotate_y=90), view)
    rolled = _picture(relighter, jr.environment(np.roll(SKY, -4, axis=1)), view)
    np.testing.assert_allclose(turned, rolled, rtol=1e-4)
    for degrees in (450, -270):
        np.testing.assert_allclose(_picture(relighter, jr.environment(SKY, rotate_y=degrees), view), turned, rtol=1e-4)
    assert _relative(turned, _picture(relighter, jr.environment(SKY), view)) > 0.1


def test_light_from_one_side_falls_on_that_side(tmp_path):
    """A sun in +x lights the side of a box that faces +x; turned by 90° counter-clockwise, the one that faces −z."""
    sun = np.full((16, 32, 3), 1e-3)
    sun[7:9, 7:9] = 100
    camera = jr.Camera((2, 1, -2), (0, 0, 0), fov_y=40, width=16, height=16)
    scene = Scene([Part(jr.box((1, 1, 1), 1), "paper")], {"paper": jr.lambert(0.5)}, camera)
    precompute(scene, Transport("vertices", receiver_tolerance=0, resolution=8, coefficients=256), tmp_path)
    relighter = open_transport(tmp_path)
    normals = jr.box((1, 1, 1), 1).normals
    slots = relighter.transport.receivers.slot_of
    for degrees, direction in ((0, (1, 0, 0)), (90, (0, 0, -1)), (180, (-1, 0, 0)), (270, (0, 0, 1))):
        (terms,) = relighter.light(jr.environment(sun, rotate_y=degrees)).terms
        radiance = np.asarray(terms)[slots, 0, 0]
        facing = normals @ np.array(direction) > 0.5
        assert radiance[facing].min() > 10 * radiance[~facing].max()


def test_turning_the_sky_is_turning_the_scene_back(tmp_path):
    """Sky by 90°, or meshes and camera by −90°. The cube map has that symmetry, and so has isotropic reflection."""
    scene = _scene()
    # About +y: x' = cos·x + sin·z, z' = −sin·x + cos·z, here for −90°.
    back = np.array([[0.0, 0, -1, 0], [0, 1, 0, 0], [1, 0, 0, 0], [0, 0, 0, 1]])

    def turned(point):
        return tuple(back[:3, :3] @ np.array(point))

    camera = dataclasses.replace(scene.camera, origin=turned(scene.camera.origin), target=turned(scene.camera.target))
    parts = [dataclasses.replace(part, mesh=meshes.transformed(part.mesh, back)) for part in scene.parts]
    settings = Transport("pixels", resolution=16, coefficients="all")
    images = []
    for name, placed, degrees in (
        ("sky", scene, 90.0),
        ("scene", dataclasses.replace(scene, camera=camera, parts=parts), 0.0),
    ):
        precompute(placed, settings, tmp_path / name)
        relighter = open_transport(tmp_path / name)
        images.append(relighter.picture(jr.environment(SKY, rotate_y=degrees)))
    assert images[0][..., 3].mean() > 0.3
    # Rays that graze an edge may fall on either side of it: a texel of 1,536 in a receiver is 0.1 % of its light.
    assert _relative(images[0], images[1]) < 2e-3
    np.testing.assert_array_equal(images[0][..., 3], images[1][..., 3])


# What lies behind.


def _coloured(u, v) -> np.ndarray:
    """A smooth map: each channel is linear in the direction."""
    return (1.5 + latlong.directions(u, v) @ [[1.0, 0, 0.2], [0, 1, 0.3], [0.1, 0, 1]]).astype(np.float32)


@pytest.mark.parametrize("degrees", [0, 90, -45, -720])
def test_background_shows_each_pixels_own_direction(relighter: TransportRelighter, degrees: float):
    u, v = np.meshgrid((np.arange(128) + 0.5) / 128, (np.arange(64) + 0.5) / 64)
    environment = jr.environment(_coloured(u, v), rotate_y=degrees, scale=0.5)
    view, lit = relighter.view(), relighter.light(environment)
    image, covered = relighter.picture(environment), np.asarray(view.surfaces.covered)
    # From the convention's own words: the top row looks to +y; the image centre to +z, a quarter from the left to +x.
    x, y, z = np.moveaxis(relighter.camera.directions(), -1, 0)
    expected = 0.5 * _coloured(0.5 - np.arctan2(x, z) / (2 * np.pi) + degrees / 360, np.arccos(y) / np.pi)
    assert 30 < (~covered).sum() < covered.size
    np.testing.assert_allclose(image[~covered][:, :3], expected[~covered], atol=2e-3)
    np.testing.assert_allclose(view.surfaces.background(environment), expected, atol=2e-3)
    # Nothing of it lies before a surface.
    shown = np.where(covered[..., None], 0, expected)
    np.testing.assert_allclose(relighter.background(lit, view), shown, atol=2e-3)
    assert not np.asarray(relighter.background(relighter.light(None), view)).any()


def test_maps_that_are_far_finer_than_pixels_are_averaged_behind_surfaces(relighter: TransportRelighter):
    """Every cell of noise by itself would show as noise."""
    noise = np.random.default_rng(0).uniform(size=(1024, 2048, 1)).astype(np.float32).repeat(3, axis=2)
    shown = np.asarray(relighter.view().surfaces.background(jr.environment(noise)))
    assert shown.mean() == pytest.approx(0.5, abs=0.02)
    assert shown.std() < 0.1


def test_background_may_be_left_out(relighter: TransportRelighter):
    environment, covered = jr.environment(SKY), np.asarray(relighter.view().surfaces.covered)
    shown, bare = (relighter.picture(environment, background=background) for background in (True, False))
    assert shown.dtype == bare.dtype == np.float32
    assert shown.shape == bare.shape == (12, 16, 4)
    for image in (shown, bare):
        np.testing.assert_array_equal(image[..., 3], covered)
    assert not bare[~covered].any()
    assert (shown[~covered][:, :3] > 0).all()
    np.testing.assert_array_equal(shown[covered], bare[covered])
    assert (bare[covered][:, :3] > 0).all()


def test_sky_of_any_size_lights_the_same(relighter: TransportRelighter):
    """A map with every pixel doubled, or doubled until it is coarsened again, is the same light."""
    view = relighter.view()
    plain = _surface(relighter, jr.environment(SKY), view)
    for times in (2, 32):
        finer = np.repeat(np.repeat(SKY, times, axis=0), times, axis=1)
        assert _relative(_surface(relighter, jr.environment(finer), view), plain) < 1e-5
