"""Indirect light where it is hardest: sizes, strengths, and lights and cameras in bad places."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import InputError, Part, Scene
from jaxrelight.lighting.shadows import all_visible, group_lights
from jaxrelight.lights.local import point, spot
from jaxrelight.lights.projector import projector
from jaxrelight.lights.shaped import shaped
from tests.lighting.test_indirect import CAMERA, LAMP, inside, opened, picture, reflected, room


def moved(mesh: jr.Mesh, by, scale: float = 1.0) -> jr.Mesh:
    return dataclasses.replace(mesh, vertices=np.add(np.multiply(mesh.vertices, scale), by))


def scaled(scale: float) -> Scene:
    place = [tuple(scale * x for x in where) for where in (CAMERA.origin, CAMERA.target)]
    camera = dataclasses.replace(CAMERA, origin=place[0], target=place[1])
    return Scene([Part(moved(inside(), (0, 0, 0), scale), "wall")], {"wall": jr.lambert([0.7, 0.6, 0.5])}, camera)


@pytest.fixture(scope="module")
def usual(tmp_path_factory):
    return opened(scaled(1), tmp_path_factory.mktemp("usual"), bounces=2)


@pytest.mark.parametrize("scale", [pytest.param(1e-3, marks=pytest.mark.slow), 1e3])
def test_size_does_not_matter(usual, tmp_path, scale):
    lamp = point(scale * np.asarray(LAMP.position), scale**2 * np.asarray(LAMP.intensity))
    radiance = reflected(opened(scaled(scale), tmp_path, bounces=2), lamp)
    np.testing.assert_allclose(radiance, reflected(usual, LAMP), rtol=2e-2, atol=2e-3)


def test_strong_lights_are_weak_ones_times_their_strength(usual):
    strong = point(LAMP.position, 1e6 * np.asarray(LAMP.intensity))
    np.testing.assert_allclose(picture(usual, strong), 1e6 * picture(usual, LAMP), rtol=1e-4)


@pytest.fixture(scope="module")
def slopes(usual):
    """The gradient, in a lamp, of all light of the cloud, of which pixels get fixed shares."""

    def bright(lamp):
        return jnp.sum(usual.add_bounces(usual.direct_light_at_cloud([lamp], shadows=False)))

    return jax.jit(jax.grad(bright))


PLACES = {"on": [0.1, -0.5, 0.1], "in": [0.1, -0.55, 0.1], "corner": [0.5, 0.5, 0.5], "outside": [5, 5, 5]}


@pytest.mark.parametrize(
    "name", ["on", *(pytest.param(other, marks=pytest.mark.slow) for other in ("in", "corner", "outside"))]
)
def test_lights_in_bad_places_give_finite_light_and_gradients(usual, slopes, name):
    place = PLACES[name]
    image = usual.picture(point(place, 1.0))
    assert np.isfinite(image).all()
    if name == "outside":
        assert image[..., :3].max() == 0

    gradient = slopes(spot(place, [0, 0, 0], 1.0, 60.0))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(gradient))


def test_a_light_at_a_point_of_the_cloud(usual):
    place = np.asarray(usual.points.positions)[7]
    assert np.isfinite(usual.picture(point(place, 1.0))).all()


@pytest.mark.slow
def test_rooms_that_no_light_reaches_are_black(tmp_path):
    """Another closed room beside this one, which is lit; with importance, too, which has no use for it."""
    beside = Part(moved(inside(), (3, 0, 0)), "wall")
    for importance in (False, True):
        relighter = opened(room([0.7, 0.6, 0.5], None, (beside,)), tmp_path, bounces=2, importance=importance)
        assert np.abs(reflected(relighter, point([3, 0.2, 0], 1.0))).max() < 1e-6
        assert reflected(relighter, LAMP).max() > 0.1


def test_a_camera_inside_an_object_sees_its_dark_inside(tmp_path):
    around = Part(moved(jr.sphere(0.2, 3), CAMERA.origin), "wall")
    image = opened(Scene([around], {"wall": jr.lambert(0.5)}, CAMERA), tmp_path).picture(LAMP)
    np.testing.assert_allclose(image[..., :3], 0, atol=1e-6)


def test_a_camera_that_sees_nothing_is_refused(tmp_path):
    away = Part(moved(jr.sphere(0.2, 3), (0, 0, 9)), "wall")
    with pytest.raises(InputError, match="the camera sees no surface"):
        opened(Scene([away], {"wall": jr.lambert(0.5)}, CAMERA), tmp_path)


def wide(tree):
    """The same in double precision."""
    return jax.tree.map(lambda x: jnp.asarray(x, jnp.float64), tree)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["spot", "projector", "shaped"])
def test_double_precision_gradients_of_the_picture(usual, kind):
    """In all that lights have, a projector's image too, and in albedos; shadows held fixed; against differences."""
    random = np.random.default_rng(0)
    place, target = [0.1, 0.2, 0.05], [-0.3, -0.5, 0.1]
    made = {
        "spot": lambda: spot(place, target, [1.0, 0.8, 0.6], 70.0, 30.0),
        "projector": lambda: projector(place, target, random.uniform(0.5, 1, (3, 4, 3)), 100.0),
        "shaped": lambda: shaped(place, target, [1.0, 0.8, 0.6], 20.0, 60.0, far=(0.4, 2.0)),
    }
    lamp = made[kind]()
    with jax.enable_x64(True):
        given, view = wide((lamp, usual.precomputed.cloud.albedo)), usual.view()
        weights = jnp.asarray(random.uniform(size=(*view.shape, 3)))
        lit = usual.light(lamp)

        def bright(given):
            lamp, albedo = given
            light = usual.direct_light_at_cloud([lamp], albedo, shadows=False)
            groups = group_lights([lamp], usual.precomputed.stored.geometry.surfaces.centre)
            mine = lit._replace(cloud=usual.add_bounces(light, albedo=albedo), groups=groups)
            image = usual.shade(mine, view, all_visible(view.samples.points, groups))
            return jnp.sum(weights * image.radiance)

        gradient = jax.grad(bright)(given)
        # No light begins or ends at infinity, and no shape is told to turn inside out.
        along = jax.tree.map(lambda x: jnp.where(jnp.isfinite(x), random.normal(size=x.shape), 0) * 0.1, given)
        step = 1e-5
        ends = [bright(jax.tree.map(lambda x, a, s=s: x + s * step * a, given, along)) for s in (1, -1)]
        slope = sum(jnp.sum(g * a) for g, a in zip(jax.tree.leaves(gradient), jax.tree.leaves(along), strict=True))
        assert all(np.isfinite(g).all() for g in jax.tree.leaves(gradient))
        assert float(slope) == pytest.approx(float(ends[0] - ends[1]) / (2 * step), rel=1e-5)
