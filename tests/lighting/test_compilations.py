"""What is compiled anew, and what is not: shapes come in few sizes."""

import dataclasses
import functools

import numpy as np
import pytest
from jaxrelight.lighting.adaptive.shader import AdaptiveShader

import jaxrelight as jr
from jaxrelight import Part, Scene
from jaxrelight.lighting.prefiltered import look_at
from jaxrelight.lighting.transport import TransportRelighter
from jaxrelight.lights.pyramid import light_pyramid
from jaxrelight.methods import Transport
from jaxrelight.precomputation.load import load
from jaxrelight.precomputation.precompute import precompute
from tests.compilations import compilations

SKY = jr.environment(np.random.default_rng(6).uniform(0.1, 1, size=(8, 16, 3)))
CAMERA = jr.Camera((0.3, 1.4, 2.2), (0, 0.2, 0), fov_y=45, width=24, height=20)
SETTINGS = Transport("vertices", resolution=8, terms=2, coefficients=24, factor_resolution=8)


def _scene(ball: int, floor: int, camera=CAMERA) -> Scene:
    parts = [Part(jr.plane((2, 2), floor), "floor"), Part(jr.sphere(0.35, ball), "ball")]
    return Scene(parts, {"floor": jr.lambert([0.7, 0.6, 0.5]), "ball": jr.phong(0.2, 0.3, 6)}, camera, SKY)


def _picture(scene: Scene, settings: Transport, folder) -> np.ndarray:
    made = precompute(scene, settings, folder)
    relighter = TransportRelighter(load(made.folder, made.header))
    return relighter.image(SKY, relighter.view())


@pytest.mark.parametrize("receivers", ["vertices", "pixels"])
def test_another_mesh_of_similar_size_compiles_nothing(tmp_path, receivers: str):
    settings = dataclasses.replace(SETTINGS, receivers=receivers)
    with compilations() as first:
        one = _picture(_scene(13, 30), settings, tmp_path / "one")
    assert first
    with compilations() as second:
        other = _picture(_scene(12, 28), settings, tmp_path / "other")
    assert not second
    assert np.abs(one - other).max() > 0
    # Not because all is one size: a far larger mesh, or a far larger picture, does.
    larger = _scene(40, 28) if receivers == "vertices" else _scene(12, 28, dataclasses.replace(CAMERA, width=90))
    with compilations() as third:
        _picture(larger, settings, tmp_path / "larger")
    assert third


def test_another_view_light_and_turn_compile_nothing(tmp_path):
    made = precompute(_scene(13, 30), SETTINGS, tmp_path)
    relighter = TransportRelighter(load(made.folder, made.header))
    first = relighter.image(SKY, relighter.view())
    with compilations() as compiled:
        brighter = jr.environment(SKY.pixels[::-1] + 1, rotate_y=50, scale=2.5)
        second = relighter.image(brighter, relighter.view(dataclasses.replace(CAMERA, origin=(-1.0, 1.2, 2.0))))
    assert not compiled
    assert np.abs(first - second).max() > 0.1


def test_another_sun_compiles_nothing(tmp_path):
    """Of however many texels: turned, it lies in more of them."""
    made = precompute(_scene(13, 30), SETTINGS, tmp_path)
    relighter = TransportRelighter(load(made.folder, made.header))

    def light(rows: int, turn: float):
        pixels = SKY.pixels.copy()
        pixels[1 : 1 + rows, 3] = 1e4
        return np.asarray(relighter.light(jr.environment(pixels, rotate_y=turn))[0])

    first = light(1, 0.0)
    with compilations() as compiled:
        second = light(2, 7.0)
    assert not compiled
    assert np.abs(first - second).max() > 1


def test_opening_the_store_again_compiles_nothing(tmp_path):
    scene = _scene(13, 30)
    one = _picture(scene, SETTINGS, tmp_path)
    with compilations() as compiled:
        other = _picture(scene, SETTINGS, tmp_path)
    assert not compiled
    np.testing.assert_array_equal(one, other)


@functools.cache
def _shader() -> AdaptiveShader:
    return AdaptiveShader(look_at(_scene(13, 30)), CAMERA)


def test_shaded_again_shadows_compile_nothing():
    """However many batches their rays come in."""
    light = light_pyramid(SKY)
    few = np.asarray(_shader().uniform(light, 16, shadows=True))
    with compilations() as compiled:
        many = np.asarray(_shader().uniform(light, 1024, shadows=True))
    assert not compiled
    assert 0 < np.abs(few - many).max() < 1


def test_pictures_of_about_a_size_are_planned_and_shaded_by_the_same_programs():
    """But for what puts pixels where they are in the picture, and reads the view's numbers of them."""

    def picture(shader: AdaptiveShader, seed: int, tolerance: float) -> np.ndarray:
        light = light_pyramid(jr.environment(np.random.default_rng(seed).uniform(0.1, 1, size=(8, 16, 3))))
        return np.asarray(shader.shade(shader.plan(light, tolerance=tolerance), light))

    first = picture(_shader(), 0, 0.02)
    with compilations() as compiled:
        second = picture(_shader(), 1, 0.01)
    assert not compiled
    assert np.abs(first - second).max() > 0
    narrower = dataclasses.replace(CAMERA, width=23)
    with compilations() as compiled:
        other = picture(AdaptiveShader(look_at(_scene(13, 30, narrower)), narrower), 0, 0.02)
    assert set(compiled) <= {"jit(assembled)"}
    assert other.shape[1] == 23
