"""Views: which receivers each pixel shows, from anywhere or from one place only."""

import dataclasses

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import InputError, Scene
from jaxrelight.lighting.transport import TransportRelighter
from jaxrelight.lighting.transport_view import TransportView
from jaxrelight.methods import Transport
from jaxrelight.precomputation.precompute import precompute
from tests.opening import open_transport
from tests.scenes import ball_over_floor

SKY = jr.environment(np.random.default_rng(6).gamma(0.4, size=(4, 8, 3)))
CAMERA = jr.Camera((0.3, 1.4, 2.2), (0, 0.2, 0), fov_y=45, width=14, height=12)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return ball_over_floor(jr.lambert(0.3), CAMERA)


@pytest.fixture(scope="module")
def free(scene, tmp_path_factory) -> TransportRelighter:
    folder = tmp_path_factory.mktemp("vertices")
    precompute(scene, Transport("vertices", receiver_tolerance=0, resolution=8, coefficients=48), folder)
    return open_transport(folder)


@pytest.fixture(scope="module")
def fixed(scene, tmp_path_factory) -> TransportRelighter:
    folder = tmp_path_factory.mktemp("pixels")
    precompute(scene, Transport("pixels", resolution=8, coefficients=48), folder)
    return open_transport(folder)


def _shown(view: TransportView) -> np.ndarray:
    """Number of the material that each pixel shows, −1 for none; every pixel is shown once."""
    image = np.full(view.surfaces.covered.size, -1)
    for part in view.surfaces.parts:
        pixel = np.asarray(part.pixels.pixel)
        inside = pixel < image.size
        assert (image[pixel[inside]] == -1).all()
        image[pixel[inside]] = part.material
    return image.reshape(view.shape)


def _number(relighter: TransportRelighter, material: str) -> int:
    return [one.name for one in relighter.materials].index(material)


@pytest.mark.parametrize("receivers", ["free", "fixed"])
def test_every_covered_pixel_belongs_to_one_material(request, receivers: str):
    relighter = request.getfixturevalue(receivers)
    view = relighter.view()
    shown = _shown(view)
    np.testing.assert_array_equal(shown >= 0, view.surfaces.covered)
    assert view.shape == (12, 14)
    # The middle of the image shows the ball, the row below it the floor in front.
    assert shown[6, 7] == _number(relighter, "gloss")
    assert shown[9, 7] == _number(relighter, "paper")
    groups = {block.material: len(block.groups) for block in relighter.transport.blocks}
    for part, corners in zip(view.surfaces.parts, view.corners, strict=True):
        assert len(part.pixels.pixel) == 1024
        seen = np.asarray(part.pixels.pixel) < shown.size
        count = 128 * groups[relighter.materials[part.material].name]
        assert np.asarray(corners.receivers)[seen].max() < count
        assert np.asarray(corners.receivers).min() >= 0
        np.testing.assert_allclose(np.asarray(corners.weights)[seen].sum(axis=1), 1, atol=1e-6)
        np.testing.assert_allclose(np.linalg.norm(np.asarray(part.pixels.omega_o)[seen], axis=1), 1, atol=1e-6)


def test_corners_lie_around_the_point_that_is_seen(free: TransportRelighter):
    """Corner positions, weighed, lie on the pixel's ray, and where the view has the surface."""
    view, transport = free.view(), free.transport
    directions = CAMERA.directions().reshape(-1, 3)
    blocks = {block.material: block for block in transport.blocks}
    for part, corners in zip(view.surfaces.parts, view.corners, strict=True):
        groups = blocks[free.materials[part.material].name].groups
        positions = transport.receivers.positions[groups].reshape(-1, 3) * transport.surfaces.radius
        seen = np.asarray(part.pixels.pixel) < view.surfaces.covered.size
        of_corners = positions[np.asarray(corners.receivers)[seen]]
        point = np.einsum("pb,pbx->px", np.asarray(corners.weights)[seen], of_corners)
        np.testing.assert_allclose(np.asarray(part.positions(view.surfaces.points))[seen], point, atol=1e-4)
        towards = point + transport.surfaces.centre - np.array(CAMERA.origin)
        towards /= np.linalg.norm(towards, axis=-1, keepdims=True)
        np.testing.assert_allclose(towards, directions[np.asarray(part.pixels.pixel)[seen]], atol=1e-4)


def test_other_camera_is_refused_where_receivers_are_pixels(fixed: TransportRelighter):
    for change in ({"origin": (0.3, 1.5, 2.2)}, {"fov_y": 46.0}, {"width": 15}):
        with pytest.raises(InputError, match=r"for other views .* \(--receivers vertices\)") as caught:
            fixed.view(dataclasses.replace(fixed.camera, **change))
        assert len(str(caught.value).splitlines()) == 1
    assert np.asarray(fixed.view(fixed.camera).surfaces.covered).any()


def test_any_camera_is_allowed_where_receivers_are_vertices(free: TransportRelighter):
    for origin in ((2, 1, 0), (0, 3, 0.1), (-1, 0.5, -2)):
        camera = dataclasses.replace(CAMERA, origin=origin, width=9, height=7)
        image = free.picture(SKY, camera)
        assert image.shape == (7, 9, 4)
        assert (image[..., :3] > 0).all()
        assert image[..., 3].sum() > 0


def test_own_camera_is_the_default(free: TransportRelighter):
    np.testing.assert_array_equal(free.picture(SKY), free.picture(SKY, CAMERA))


def test_diffuse_surface_looks_the_same_from_everywhere(free: TransportRelighter):
    """The floor's centre, straight through the middle of the image."""
    radiance = []
    for origin in ((1.2, 2, 0.9), (-1.2, 1, 1.5), (0.9, 3, 1.1)):
        camera = jr.Camera(origin, (0.7, 0, 0.7), fov_y=20, width=5, height=5)
        assert _shown(free.view(camera))[2, 2] == _number(free, "paper")
        radiance.append(free.picture(SKY, camera)[2, 2, :3])
    np.testing.assert_allclose(radiance, np.broadcast_to(radiance[0], (3, 3)), rtol=1e-5)


@pytest.mark.parametrize(("target", "visible"), [((0, -1.4, 0), "paper"), ((0.0, 2.2, 0), None)])
def test_material_that_is_not_visible(free: TransportRelighter, target, visible):
    """A camera close to the floor that sees it alone, or looks over all: nothing is drawn of the others."""
    camera = jr.Camera((0.8, 1.0, 0.8), target, fov_y=10, width=6, height=5)
    if visible:
        camera = jr.Camera((0.8, 0.3, 0.8), (0.8, 0, 0.7), fov_y=20, width=6, height=5)
    wanted = _number(free, visible) if visible else -1
    assert (_shown(free.view(camera)) == wanted).all()
    image = free.picture(SKY, camera)
    np.testing.assert_array_equal(image[..., 3], 1 if visible else 0)
    assert np.isfinite(image).all()
    assert (image[..., :3] > 0).all()


def test_camera_that_sees_nothing_shows_the_sky(free: TransportRelighter):
    camera = jr.Camera((0, 5, 0), (0, 9, 0.1), fov_y=60, width=8, height=6)
    view, lit = free.view(camera), free.light(SKY)
    assert not np.asarray(view.surfaces.covered).any()
    image = free.picture(SKY, camera)
    assert not image[..., 3].any()
    np.testing.assert_array_equal(image[..., :3], np.asarray(free.background(lit, view)))
    sky = np.asarray(SKY.pixels[..., 0])
    assert sky.min() <= image[..., 0].min() < image[..., 0].max() <= sky.max()
    assert not free.picture(SKY, camera, background=False).any()


def test_back_of_a_surface_is_black(free: TransportRelighter):
    """Surfaces are one-sided: the floor from below hides what is above it and gives nothing."""
    camera = jr.Camera((0.1, -2, 0), (0, 0, 0), fov_y=20, width=5, height=5)
    image = free.picture(SKY, camera)
    assert not image[..., :3].any()
    assert (image[..., 3] == 1).all()
