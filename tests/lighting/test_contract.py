"""Four methods by one contract: all parts are pytrees, rays and plans are traced apart, gradients, like pictures."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import Adaptive, Indirect, InputError, Part, Prefiltered, Scene, Transport
from jaxrelight.basis import latlong
from jaxrelight.geometry.mesh import transformed
from jaxrelight.lights.local import Point
from tests.scenes import ball_over_floor

METHODS = {
    "transport": Transport(resolution=8),
    "indirect": Indirect(gather_samples=64, bounces=2, sky_samples=8),
    "prefiltered": Prefiltered(map_rows=32, receiver_tolerance=0),
    "adaptive": Adaptive(samples=16),
}
# Those whose relighters are of any camera, and have no store.
ANYWHERE = {"prefiltered", "adaptive"}
CAMERA = jr.Camera((0.3, 1.4, 2.2), (0, 0.2, 0), fov_y=45, width=12, height=10)
# Degrees that skies are turned: between pixels of their maps, where pictures are differentiable.
TURN = 10.3
# What takes long to compile.
DEAR = [pytest.param(name, marks=pytest.mark.slow) for name in ("indirect", "prefiltered", "adaptive")]


def scene() -> Scene:
    """A glossy ball over a floor of the same."""
    paint = jr.phong([0.7, 0.6, 0.5], 0.2, 8.0)
    return ball_over_floor(paint, CAMERA, lights(0), paper=paint, quads=(1, 8))


def sky(seed: int = 0) -> np.ndarray:
    """Brighter to one side; of the size that adaptive shading is tested with, for which is compiled already."""
    u = (np.arange(16) + 0.5) / 16
    pixels = np.random.default_rng(seed).uniform(0.2, 0.4, (8, 16, 3)) + np.sin(np.pi * (u - 0.25))[:, None] ** 2
    return pixels.astype(np.float32).repeat(32, axis=0).repeat(32, axis=1)


def lights(seed: int) -> list:
    lamp = jr.point([1 + seed, 2, 1], np.array([3.0, 2, 1], np.float32))
    return [jr.environment(sky(seed), TURN + 30.0 * seed, 1.0 + seed), lamp]


def store(name: str, root):
    return None if name in ANYWHERE else root / name


@pytest.fixture(scope="module", params=METHODS)
def name(request) -> str:
    return request.param


@pytest.fixture(scope="module")
def root(tmp_path_factory):
    return tmp_path_factory.mktemp("contract")


@pytest.fixture(scope="module")
def relighter(name, root) -> jr.Relighter:
    return jr.prepare(scene(), METHODS[name], store(name, root))


@pytest.fixture(scope="module")
def traced_once(relighter):
    """A view, light, what is traced of both, and the picture."""
    view, lit = relighter.view(), relighter.light(lights(0))
    traced = relighter.trace(lit, view)
    return view, lit, traced, np.asarray(relighter.shade(lit, view, traced).radiance)


def test_all_parts_are_arguments_of_a_function_that_is_traced_once(name, root, relighter, traced_once):
    """By arrays and numbers alone; prepared again, lit otherwise, and seen from elsewhere."""
    traces = []

    @jax.jit
    def shaded(relighter, lit, view, traced):
        traces.append(name)
        return relighter.shade(lit, view, traced).radiance

    view, lit, traced, image = traced_once
    for part in (relighter, view, lit, traced):
        leaves = jax.tree.leaves(part)
        assert {type(leaf) for leaf in leaves} <= {float, int, bool, np.ndarray, type(jnp.zeros(()))}
        rebuilt = jax.tree.unflatten(jax.tree.structure(part), leaves)
        assert jax.tree.structure(rebuilt) == jax.tree.structure(part)
    np.testing.assert_allclose(shaded(relighter, lit, view, traced), image, rtol=1e-5, atol=1e-5)
    other = jr.prepare(scene(), METHODS[name], store(name, root))
    elsewhere = jr.Camera((-0.4, 1.3, 2.3), CAMERA.target, fov_y=45, width=12, height=10)
    view, lit = other.view(elsewhere if name in ANYWHERE else None), other.light(lights(1))
    traced = other.trace(lit, view)
    wanted = np.asarray(other.shade(lit, view, traced).radiance)
    np.testing.assert_allclose(shaded(other, lit, view, traced), wanted, rtol=1e-5, atol=1e-5)
    assert len(traces) == 1
    assert np.abs(wanted - image).max() > 0.1
    if name not in ANYWHERE:
        assert isinstance(jr.open_store(store(name, root)), type(relighter))
        with pytest.raises(InputError, match="camera"):
            other.view(elsewhere)


def test_the_steps_are_the_picture(relighter, traced_once):
    """Of the scene's own lights and camera, where none are given; traced before, or on the way."""
    view, lit, _, image = traced_once
    whole = relighter.picture()
    assert whole.shape == (10, 12, 4)
    background = np.asarray(relighter.background(lit, view))
    np.testing.assert_allclose(whole[..., :3], image + background, rtol=1e-4, atol=1e-5)
    alpha = np.asarray(relighter.shade(lit, view).alpha)
    np.testing.assert_array_equal(whole[..., 3], alpha)
    assert not background[alpha == 1].any()
    assert (background[alpha == 0] > 0).all()
    np.testing.assert_allclose(relighter.picture(background=False)[..., :3], image, rtol=1e-4, atol=1e-5)
    np.testing.assert_array_equal(relighter.picture([]), np.concatenate([0 * image, alpha[..., None]], axis=2))


def test_every_picture_measures_its_error(relighter, traced_once, monkeypatch):
    """Of rays that are cast once a view; a picture that is wrong by a half is told to be."""
    monkeypatch.setattr("jaxrelight.lighting.prefiltered._REFERENCE_RESOLUTION", 8)
    view, lit, traced, _ = traced_once
    picture = relighter.shade(lit, view, traced)
    error = picture.error
    assert error is not None
    assert 0 <= error.trimmed.low <= error.trimmed.value <= error.trimmed.high < 0.3
    assert error.trimmed.value <= error.untrimmed.value <= error.untrimmed.high
    assert error.parts
    assert error.reference in str(error)
    assert 50 < error.samples <= np.count_nonzero(picture.alpha)
    assert picture.measure(0) is None
    if not isinstance(relighter.method, Indirect):
        wrong = relighter.error(jr.Image(1.5 * picture.radiance, picture.alpha), lit, view)
        assert 0.3 < wrong.untrimmed.value < 0.7
    # A jitted function gives a picture that was never measured.
    through = jax.jit(lambda of: of)(picture)
    with pytest.raises(InputError, match=r"ask relighter\.error for it"):
        through.error  # noqa: B018
    assert relighter.error(through, lit, view) == error
    # Another light casts no rays of the reference, and where there is none nothing is wrong.
    reference = view.__dict__["_reference"].reference
    assert relighter.shade(relighter.light(lights(1)), view).error.samples == error.samples
    assert view.__dict__["_reference"].reference is reference
    assert relighter.shade(relighter.light([]), view).error.untrimmed.value == 0


def test_rays_inside_of_jit_are_those_outside(relighter, traced_once):
    """Shadow rays towards local lights are one callback."""
    view, lamps = traced_once[0], [lights(0)[1], jr.directional([0.3, -1, 0.2], 1.0), jr.point([-1, 1, 0], 2.0)]
    lit = relighter.light(lamps)
    outside = relighter.trace(lit, view)
    traced, image = jax.jit(lambda lit, view: (relighter.trace(lit, view), relighter.shade(lit, view).radiance))(
        lit, view
    )
    for inside, wanted in zip(jax.tree.leaves(traced), jax.tree.leaves(outside), strict=True):
        np.testing.assert_array_equal(inside, wanted)
    np.testing.assert_allclose(image, relighter.shade(lit, view, outside).radiance, rtol=1e-5, atol=1e-5)


def test_plans_inside_of_jit_are_refused():
    relighter = jr.prepare(scene(), METHODS["adaptive"])
    view, lit = relighter.view(), relighter.light(lights(0))
    for step in (relighter.trace, relighter.shade):
        with pytest.raises(InputError, match="call trace outside and pass its result to shade") as caught:
            jax.jit(lambda lit, step=step: jax.tree.leaves(step(lit, view)))(lit)
        assert len(str(caught.value).splitlines()) == 1


class Bright:
    """The weighed sum of a picture as a function of all that lights have; `names` says in which order."""

    names = "pixels", "rotate_y", "scale", "position", "intensity"

    def __init__(self, relighter, view, shape):
        self._relighter, self._view = relighter, view
        self.weights = np.asarray(np.random.default_rng(3).uniform(size=shape), np.float32)

    def __call__(self, numbers, traced):
        lit = self._relighter.light([jr.Environment(*numbers[:3]), Point(*numbers[3:])])
        return jnp.sum(self.weights * self._relighter.shade(lit, self._view, traced).radiance)

    @staticmethod
    def numbers():
        environment, lamp = lights(0)
        return (
            environment.pixels,
            jnp.float32(environment.rotate_y),
            jnp.float32(environment.scale),
            lamp.position,
            lamp.intensity,
        )


@pytest.mark.parametrize("name", ["transport", *DEAR], indirect=True)
def test_gradients_inside_of_jit(relighter, traced_once):
    """In all that lights have: exact where light is linear, and as differences have it, what is traced held fixed."""
    view, _, traced, image = traced_once
    bright = Bright(relighter, view, image.shape)
    numbers, compiled = bright.numbers(), jax.jit(jax.value_and_grad(bright))
    value, slopes = compiled(numbers, traced)
    assert float(value) == pytest.approx(float(np.sum(bright.weights * image)), rel=1e-4)
    slope = dict(zip(bright.names, map(np.asarray, slopes), strict=True))
    assert all(np.isfinite(of).all() for of in slope.values())
    sky_light, lamp_light = (
        float(np.vdot(slope[of], numbers[bright.names.index(of)])) for of in ("pixels", "intensity")
    )
    assert min(sky_light, lamp_light) > 1
    assert sky_light + lamp_light == pytest.approx(float(value), rel=1e-4)
    assert float(slope["scale"]) == pytest.approx(sky_light, rel=1e-4)
    for of, along, step in (("rotate_y", 1.0, 0.2), ("position", [0.6, -0.3, 0.7], 0.01)):
        way, number = np.asarray(along, np.float32), bright.names.index(of)
        ends = []
        for by in (step, -step):
            moved: list[Any] = list(numbers)
            moved[number] = numbers[number] + np.float32(by) * way
            ends.append(float(compiled(tuple(moved), traced)[0]))
        assert float(np.vdot({**slope}[of], way)) == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=0.03)


@pytest.mark.slow
def test_gradients_outside_of_jit_are_those_inside(relighter, traced_once):
    """Without anything traced before: rays are cast, and samples planned, on the way."""
    view, _, traced, image = traced_once
    bright = Bright(relighter, view, image.shape)
    inside = jax.jit(jax.grad(bright))(bright.numbers(), traced)
    outside = jax.grad(lambda numbers: bright(numbers, None))(bright.numbers())
    for one, other in zip(outside, inside, strict=True):
        assert np.isfinite(one).all()
        np.testing.assert_allclose(one, other, rtol=1e-3, atol=1e-4 * np.abs(one).max())


@pytest.mark.parametrize("name", ["transport", "prefiltered", *DEAR[::2]], indirect=True)
def test_many_lights_are_shaded_in_one_batch(relighter, traced_once):
    """By what is traced for one of them: lamps stand where they stood."""
    view, lit, traced, image = traced_once
    (environment, lamp), turned = lights(0), np.ascontiguousarray(sky()[:, ::-1])
    dim = jr.point(lamp.position, 0.5 * np.asarray(lamp.intensity))
    others = [jr.environment(turned), dim], [environment.with_(scale=2.0), dim]
    several = [lit, *map(relighter.light, others)]
    stacked = jax.tree.map(lambda *each: jnp.stack(each), *several)
    images = jax.vmap(lambda lit: relighter.shade(lit, view, traced).radiance)(stacked)
    np.testing.assert_allclose(images[0], image, rtol=1e-4, atol=1e-5)
    for one, each in zip(images, several, strict=True):
        np.testing.assert_allclose(one, relighter.shade(each, view, traced).radiance, rtol=1e-4, atol=1e-5)
    assert np.abs(images[1] - images[2]).max() > 0.1


# One plane by four methods.

FLAT = {
    "transport": Transport(resolution=32, coefficients="all"),
    "indirect": Indirect(gather_samples=64, bounces=1, sky_samples=2304, compression_tolerance=0.0),
    "prefiltered": Prefiltered(map_rows=32, receiver_tolerance=0),
    "adaptive": Adaptive(samples=1024),
}
ALBEDO = np.array([0.7, 0.4, 0.2])
# Where the plane's width, normal and height point: it leans, so that it sees skies turn.
AXES = np.array([[0.8, 0.0, -0.6], [0.36, 0.8, 0.48], [0.48, -0.6, 0.64]])


@pytest.fixture(scope="module")
def planes(tmp_path_factory) -> dict[str, jr.Relighter]:
    """A coloured plane alone, by all methods."""
    camera, folder = (
        jr.Camera(1.2 * AXES[1] + 0.2, (0, 0, 0), fov_y=40, width=6, height=5),
        tmp_path_factory.mktemp("p"),
    )
    lean = np.eye(4)
    lean[:3, :3] = AXES.T
    plane = Scene([Part(transformed(jr.plane((4, 4), 1), lean), "paper")], {"paper": jr.lambert(ALBEDO)}, camera)
    return {name: jr.prepare(plane, method, store(name, folder)) for name, method in FLAT.items()}


@pytest.mark.parametrize("name", FLAT)
def test_lambert_under_a_constant_sky_is_albedo_times_radiance(name, planes):
    image = planes[name].picture(jr.environment(np.ones((8, 16, 3)), 70.0, 10.0))
    assert (image[..., 3] == 1).all()
    np.testing.assert_allclose(image[..., :3], np.broadcast_to(10 * ALBEDO, (5, 6, 3)), rtol=1e-3)


@pytest.mark.parametrize("name", FLAT)
def test_all_methods_give_the_same_under_a_sky_that_is_turned_and_scaled(name, planes):
    """As sums over the sky's pixels have it, each cut into many."""
    v, u = (np.indices((8, 16)) + 0.5) / np.array([[[8]], [[16]]])
    glow = np.exp(-40 * ((u - 0.3) ** 2 + (v - 0.25) ** 2))[..., None] * [8, 6, 4]
    grain = np.random.default_rng(0).gamma(0.5, size=(8, 16, 3))
    pixels = (1 - v)[..., None] * [0.5, 0.7, 1] + glow + grain
    fine = pixels.repeat(64, axis=0).repeat(64, axis=1)
    v, u = (np.indices(fine.shape[:2]) + 0.5) / np.array([[[512]], [[1024]]])
    # Counter-clockwise seen from +y.
    towards, area = latlong.directions(u - 70 / 360, v), latlong.solid_angles(512, 1024)[:, None]
    wanted = 10 * ALBEDO / np.pi * np.einsum("hw,hwc->c", np.maximum(towards @ AXES[1], 0) * area, fine)
    image = planes[name].picture(jr.environment(pixels, 70.0, 10.0))[..., :3]
    np.testing.assert_allclose(image, np.broadcast_to(wanted, image.shape), rtol=0.01)
