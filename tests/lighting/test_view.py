"""Views: which receivers each pixel shows, from anywhere or from one place only."""

import dataclasses

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import InputError, Part, Scene
from jaxrelight.geometry import mesh as meshes
from jaxrelight.lighting.prepare import open_store
from jaxrelight.lighting.transport import TransportRelighter
from jaxrelight.methods import Transport
from jaxrelight.precomputation.precompute import precompute

SKY = jr.environment(np.random.default_rng(6).gamma(0.4, size=(4, 8, 3)))
CAMERA = jr.Camera((0.3, 1.4, 2.2), (0, 0.2, 0), fov_y=45, width=14, height=12)


@pytest.fixture(scope="module")
def scene() -> Scene:
    up = np.eye(4)
    up[1, 3] = 0.4
    parts = [Part(jr.plane((2, 2), 4), "floor"), Part(meshes.transformed(jr.sphere(0.35, 4), up), "ball")]
    return Scene(parts, {"floor": jr.lambert([0.7, 0.6, 0.5]), "ball": jr.lambert(0.3)}, CAMERA)


@pytest.fixture(scope="module")
def free(scene, tmp_path_factory) -> TransportRelighter:
    folder = tmp_path_factory.mktemp("vertices")
    precompute(scene, Transport("vertices", resolution=8, coefficients=48), folder)
    return open_store(folder)


@pytest.fixture(scope="module")
def fixed(scene, tmp_path_factory) -> TransportRelighter:
    folder = tmp_path_factory.mktemp("pixels")
    precompute(scene, Transport("pixels", resolution=8, coefficients=48), folder)
    return open_store(folder)


def _shown(view) -> np.ndarray:
    """Number of the material that each pixel shows, −1 for none; every pixel is shown once."""
    image = np.full(view.covered.size, -1)
    for number, material in enumerate(view.materials):
        pixel = np.asarray(material.pixel)
        inside = pixel < view.covered.size
        assert (image[pixel[inside]] == -1).all()
        image[pixel[inside]] = number
    return image.reshape(view.shape)


@pytest.mark.parametrize("receivers", ["free", "fixed"])
def test_every_covered_pixel_belongs_to_one_material(request, receivers: str):
    relighter = request.getfixturevalue(receivers)
    view = relighter.view()
    shown = _shown(view)
    np.testing.assert_array_equal(shown >= 0, view.covered)
    assert view.shape == (12, 14)
    ball, floor = relighter.transport.names.index("ball"), relighter.transport.names.index("floor")
    # The middle of the image shows the ball, the row below it the floor in front.
    assert shown[6, 7] == ball
    assert shown[9, 7] == floor
    for material, block in zip(view.materials, relighter.transport.blocks, strict=True):
        assert len(material.pixel) == 1024
        seen = np.asarray(material.pixel) < view.covered.size
        assert np.asarray(material.receivers)[seen].max() < 128 * len(block.groups)
        assert np.asarray(material.receivers).min() >= 0
        np.testing.assert_allclose(np.asarray(material.weights)[seen].sum(axis=1), 1, atol=1e-6)
        np.testing.assert_allclose(np.linalg.norm(np.asarray(material.omega_o)[seen], axis=1), 1, atol=1e-6)


def test_corners_lie_around_the_point_that_is_seen(free: TransportRelighter):
    """Corner positions, weighed, lie on the pixel's ray."""
    view, transport = free.view(), free.transport
    directions = CAMERA.directions().reshape(-1, 3)
    for material, block in zip(view.materials, transport.blocks, strict=True):
        positions = transport.receivers.positions[block.groups].reshape(-1, 3) * transport.surfaces.radius
        positions += transport.surfaces.centre
        seen = np.asarray(material.pixel) < view.covered.size
        corners = positions[np.asarray(material.receivers)[seen]]
        point = np.einsum("pb,pbx->px", np.asarray(material.weights)[seen], corners)
        towards = point - np.array(CAMERA.origin)
        towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
        np.testing.assert_allclose(towards, directions[np.asarray(material.pixel)[seen]], atol=1e-4)


def test_other_camera_is_refused_where_receivers_are_pixels(fixed: TransportRelighter):
    for change in ({"origin": (0.3, 1.5, 2.2)}, {"fov_y": 46.0}, {"width": 15}):
        with pytest.raises(InputError, match="for other views precompute with --receivers vertices") as caught:
            fixed.view(dataclasses.replace(fixed.transport.camera, **change))
        assert len(str(caught.value).splitlines()) == 1
    assert fixed.view(fixed.transport.camera).covered.any()


def test_any_camera_is_allowed_where_receivers_are_vertices(free: TransportRelighter):
    for origin in ((2, 1, 0), (0, 3, 0.1), (-1, 0.5, -2)):
        view = free.view(dataclasses.replace(CAMERA, origin=origin, width=9, height=7))
        image = free.image(SKY, view)
        assert image.shape == (7, 9, 4)
        assert (image[..., :3] > 0).all()
        assert view.covered.sum() > 0


def test_own_camera_is_the_default(free: TransportRelighter):
    np.testing.assert_array_equal(free.image(SKY, free.view()), free.image(SKY, free.view(CAMERA)))


def test_diffuse_surface_looks_the_same_from_everywhere(free: TransportRelighter):
    """The floor's centre, straight through the middle of the image."""
    number = free.transport.names.index("floor")
    radiance = []
    for origin in ((1.2, 2, 0.9), (-1.2, 1, 1.5), (0.9, 3, 1.1)):
        camera = jr.Camera(origin, (0.7, 0, 0.7), fov_y=20, width=5, height=5)
        view = free.view(camera)
        assert _shown(view)[2, 2] == number
        radiance.append(free.image(SKY, view)[2, 2, :3])
    np.testing.assert_allclose(radiance, np.broadcast_to(radiance[0], (3, 3)), rtol=1e-5)


@pytest.mark.parametrize(("target", "visible"), [((0, -1.4, 0), "floor"), ((0.0, 2.2, 0), None)])
def test_material_that_is_not_visible(free: TransportRelighter, target, visible):
    """A camera close to the floor that sees it alone, or looks over all: nothing is drawn of the others."""
    camera = jr.Camera((0.8, 1.0, 0.8), target, fov_y=10, width=6, height=5)
    if visible:
        camera = jr.Camera((0.8, 0.3, 0.8), (0.8, 0, 0.7), fov_y=20, width=6, height=5)
    view = free.view(camera)
    shown = _shown(view)
    wanted = free.transport.names.index(visible) if visible else -1
    assert (shown == wanted).all()
    image = free.image(SKY, view)
    np.testing.assert_array_equal(image[..., 3], 1 if visible else 0)
    assert np.isfinite(image).all()
    assert (image[..., :3] > 0).all()


def test_camera_that_sees_nothing_shows_the_sky(free: TransportRelighter):
    camera = jr.Camera((0, 5, 0), (0, 9, 0.1), fov_y=60, width=8, height=6)
    view = free.view(camera)
    assert not view.covered.any()
    image = free.image(SKY, view)
    assert not image[..., 3].any()
    np.testing.assert_array_equal(image[..., :3], np.asarray(free.background(SKY, view)))
    assert set(np.unique(image[..., 0])) <= set(np.unique(SKY.pixels[..., 0]))
    assert not free.image(SKY, view, background=False).any()


def test_back_of_a_surface_is_black(free: TransportRelighter):
    """Surfaces are one-sided: the floor from below hides what is above it and gives nothing."""
    view = free.view(jr.Camera((0.1, -2, 0), (0, 0, 0), fov_y=20, width=5, height=5))
    assert view.covered.all()
    image = free.image(SKY, view)
    assert not image[..., :3].any()
    assert (image[..., 3] == 1).all()
