"""Lobes at vertices by filtered light and filtered visibility, and by rays: against exact transport and quadrature."""

import dataclasses
import pathlib

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import InputError, Scene
from jaxrelight.basis import latlong
from jaxrelight.brdf.texture import Texture
from jaxrelight.images import image_error
from jaxrelight.lighting.transport import TransportRelighter
from jaxrelight.precomputation.precompute import precompute
from tests.scenes import ball_over_floor

METHOD = jr.Transport(
    "vertices", receiver_tolerance=0, resolution=16, coefficients=64, terms=2, factor_resolution=12, gather_resolution=8
)
CAMERA = jr.Camera((0.4, 1.0, 2.0), (0, 0.3, 0), fov_y=45, width=32, height=24)
GLOSS = jr.phong([0.2, 0.1, 0.05], [0.5, 0.4, 0.3], 60)


def sky() -> jr.Environment:
    """A bright window in a dim room, both wider than a texel."""
    u, v = np.meshgrid((np.arange(64) + 0.5) / 64, (np.arange(32) + 0.5) / 32)
    window = np.exp(-20 * (1 - latlong.directions(u, v) @ np.array([0.6, 0.64, 0.48])))
    return jr.environment((0.1 + 3 * window[..., None] * np.array([1, 0.8, 0.6])).astype(np.float32), rotate_y=30)


def scene(gloss=GLOSS, **given) -> Scene:
    return ball_over_floor(gloss, CAMERA, sky(), quads=(12, 12), height=0.36, **given)


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> pathlib.Path:
    return tmp_path_factory.mktemp("filtered")


@pytest.fixture(scope="module")
def relighter(folder) -> TransportRelighter:
    return prepared(scene(), METHOD, folder)


def prepared(of: Scene, method: jr.Transport, folder: pathlib.Path) -> TransportRelighter:
    relighter = jr.prepare(of, method, folder)
    assert isinstance(relighter, TransportRelighter)
    return relighter


def ball_error(of: Scene, method: jr.Transport, folder: pathlib.Path) -> float:
    """How far the ball, whose reflections alone are bright, is from exact transport of every pixel."""
    pixels = dataclasses.replace(METHOD, receivers="pixels", coefficients="all")
    actual, wanted = (prepared(of, one, folder).picture(background=False) for one in (method, pixels))
    ball = wanted[..., :3].max(axis=-1) > 0
    return image_error(actual[ball][None], wanted[ball][None]).trimmed


@pytest.fixture(scope="module")
def dark(folder) -> Scene:
    """A ball that reflects only what its lobe does, over a black floor."""
    return scene(jr.phong(0.0, [0.5, 0.4, 0.3], 60), paper=jr.lambert(0.0))


@pytest.mark.parametrize(("reflection", "within"), [("filtered", 0.06), ("traced", 0.04)])
def test_it_is_near_exact_transport(dark, folder, reflection: str, within: float):
    assert ball_error(dark, dataclasses.replace(METHOD, reflection=reflection), folder) < within


def test_few_factors_are_not(dark, folder):
    assert ball_error(dark, dataclasses.replace(METHOD, reflection="factors"), folder) > 0.2


def test_lobes_have_no_rows_and_another_material_costs_nothing(relighter, folder):
    transport = relighter.transport
    assert [part.material for part in transport.lobes] == ["gloss"]
    assert {block.reflection.terms for block in transport.blocks} == {1}
    before = {path.name for path in folder.iterdir() if path.is_dir()}
    build = precompute(scene(jr.phong([0.2, 0.1, 0.05], 0.9, 7)), METHOD, folder)
    assert build.rays == 0
    assert {path.name for path in folder.iterdir() if path.is_dir()} == before


def test_other_lobes_are_those_of_another_scene(relighter, folder):
    """Of about the same width, so that both are divided into as many narrower ones."""
    there = prepared(scene(jr.phong([0.2, 0.1, 0.05], [0.1, 0.6, 0.2], 70)), METHOD, folder)
    other = jr.phong(0.0, [0.1, 0.6, 0.2], 70)
    np.testing.assert_allclose(relighter.replace_lobes([other]).picture(), there.picture(), rtol=1e-5, atol=1e-6)
    with pytest.raises(InputError, match="2 BRDFs of lobes were given, but 1 are filtered"):
        relighter.replace_lobes([other, other])


@pytest.mark.parametrize(
    ("receivers", "resolution", "exponent"),
    [
        *(("vertices", 8, exponent) for exponent in (0, 50, 1e5)),
        *(pytest.param("vertices", 8, exponent, marks=pytest.mark.slow) for exponent in (1, 8, 1000)),
        ("pixels", 8, 1000),
        *(pytest.param("pixels", 8, exponent, marks=pytest.mark.slow) for exponent in (60, 1e5)),
        # What texels of 11° sum of a lobe's own horizon is 3 % off.
        ("pixels", 32, 0),
        ("pixels", 32, 8),
    ],
)
def test_a_white_furnace_reflects_the_albedo_of_each_angle(tmp_path, receivers: str, resolution: int, exponent: float):
    """A ball alone under a constant sky, against quadrature, from above and at grazing angles."""
    # Of faces so small that what they hide of the smooth ball does not show.
    ball = Scene(
        [jr.Part(jr.sphere(0.5, 10 if receivers == "vertices" else 48), "gloss")],
        {"gloss": jr.phong(0, 0.4, exponent)},
        CAMERA,
    )
    method = dataclasses.replace(METHOD, receivers=receivers, resolution=resolution, coefficients="all")
    relighter = prepared(ball, method, tmp_path)
    view = relighter.view()
    image = relighter.shade(relighter.light(jr.environment(np.ones((4, 8, 3), np.float32))), view).radiance
    pixels = view.surfaces.parts[0].pixels
    shown = np.asarray(pixels.pixel) < image.shape[0] * image.shape[1]
    height = np.asarray(pixels.omega_o)[shown, 2]
    some = np.flatnonzero(height > 0.05)[:: max(1, len(height) // 12)]
    actual = np.asarray(image).reshape(-1, 3)[np.asarray(pixels.pixel)[shown][some], 0]
    np.testing.assert_allclose(actual, _albedo(exponent, height[some]), rtol=0.01)


def _albedo(exponent: float, height: np.ndarray) -> np.ndarray:
    """∫ 0.4 (n + 2)/2π max(0, p·ω)ⁿ ω_z dω above the surface, p the mirror direction: by azimuth in closed form."""
    place, weight = np.polynomial.legendre.leggauss(800)
    cosine = ((place + 1) / 2) ** (1 / (exponent + 1))
    sine, side = np.sqrt(1 - cosine**2), np.sqrt(1 - height**2)
    along, across = height[:, None] * cosine, side[:, None] * sine
    reach = np.arccos(np.clip(-along / np.maximum(across, 1e-300), -1, 1))
    mass = (along * reach + across * np.sin(reach)) / np.pi
    return 0.4 * (exponent + 2) / (exponent + 1) * (mass * weight / 2).sum(axis=1)


def test_it_is_linear_in_light_and_a_turned_sky_is_a_turned_look_up(relighter):
    view, pixels = relighter.view(), np.asarray(sky().pixels)
    one, two = (jr.environment(part.astype(np.float32), rotate_y=30) for part in (pixels, pixels[::-1]))
    both = jr.environment((pixels + 2 * pixels[::-1]).astype(np.float32), rotate_y=30)
    first, second, sum_ = (np.asarray(relighter.shade_lobes(relighter.light(of), view)) for of in (one, two, both))
    np.testing.assert_allclose(sum_, first + 2 * second, rtol=1e-4, atol=1e-5)
    rolled = jr.environment(np.roll(pixels, -8, axis=1), rotate_y=30 - 45)
    again = np.asarray(relighter.shade_lobes(relighter.light(rolled), view))
    np.testing.assert_allclose(again, first, rtol=2e-3, atol=2e-4)


@pytest.mark.slow
def test_slopes_in_light_turn_and_lobes_are_those_of_differences(relighter):
    view, pixels = relighter.view(), np.asarray(sky().pixels)
    aim = np.random.default_rng(0).random((24, 32, 3)).astype(np.float32)

    def total(scale, turn, exponent, strength):
        light = relighter.light(jr.Environment(jnp.asarray(pixels) * scale, turn))
        lobes = relighter.transport.lobes[0].brdf
        lobes = dataclasses.replace(
            lobes, exponent=jnp.full_like(lobes.exponent, exponent), scale=lobes.scale * strength
        )
        return jnp.sum(aim * relighter.replace_lobes([lobes]).shade_lobes(light, view))

    total = jax.jit(total)
    place, steps = [1.0, 30.0, 60.0, 1.0], [0.01, 0.2, 0.5, 0.01]
    slopes = jax.jit(jax.grad(total, argnums=(0, 1, 2, 3)))(*place)
    _, forward = jax.jit(lambda *at: jax.jvp(total, at, tuple(steps)))(*place)
    np.testing.assert_allclose(np.dot(slopes, steps), forward, rtol=1e-3)
    for number, step in enumerate(steps):
        ends = [total(*(x + by * (i == number) for i, x in enumerate(place))) for by in (step, -step)]
        np.testing.assert_allclose(slopes[number], (ends[0] - ends[1]) / (2 * step), rtol=0.03)


def test_a_normal_map_is_seen_in_every_pixel(folder, tmp_path):
    """Between vertices as well: near exact transport of the bent pixels."""
    rows = np.random.default_rng(3).normal(0, 0.25, (16, 16, 2))
    normals = np.concatenate([rows, np.ones((16, 16, 1))], axis=-1)
    normals /= np.linalg.norm(normals, axis=-1, keepdims=True)
    bumps = Texture(jnp.asarray((normals + 1) / 2, jnp.float32)).minified()
    bumpy = jr.Material((jr.Component(jr.phong(0.0, 0.5, 60)),), bumps)
    of = scene(bumpy, paper=jr.lambert(0.0))
    ball = dataclasses.replace(of.parts[1].mesh, uv=of.parts[1].mesh.vertices[:, :2] * 4)
    of = Scene([of.parts[0], jr.Part(ball, "gloss")], of.materials, CAMERA, sky())
    assert ball_error(of, METHOD, tmp_path) < 0.1


@pytest.mark.slow
def test_bounces_are_of_factors_beside_filtered_lobes(folder, relighter):
    """What a bounce adds is the same whichever way direct light is reflected."""
    pictures = {}
    for reflection in ("filtered", "factors"):
        for bounces in (0, 1):
            method = dataclasses.replace(METHOD, reflection=reflection, bounces=bounces, split_sun=False)
            pictures[reflection, bounces] = prepared(scene(), method, folder).picture()[..., :3]
    added, wanted = (pictures[way, 1] - pictures[way, 0] for way in ("filtered", "factors"))
    assert wanted.max() > 0.01
    assert np.linalg.norm(added - wanted) < 0.1 * np.linalg.norm(wanted)


def test_a_material_may_be_reflected_in_its_own_way(folder):
    own = Scene(scene().parts, scene().materials, CAMERA, sky(), reflections={"gloss": "factors"})
    relighter = prepared(own, METHOD, folder)
    assert not relighter.transport.lobes
    wrong = Scene(scene().parts, scene().materials, CAMERA, sky(), reflections={"gloss": "mirrored"})
    with pytest.raises(InputError, match="material 'gloss': reflection is 'mirrored'; it must be 'filtered'"):
        precompute(wrong, METHOD, folder)


def test_what_is_traced_needs_no_filtered_layer(tmp_path):
    build = precompute(scene(), dataclasses.replace(METHOD, reflection="traced"), tmp_path)
    assert not list(build.folder.glob("filtered-*"))
