"""What is compiled anew, and what is not: shapes come in few sizes."""

import dataclasses
import functools

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import Scene
from jaxrelight.lighting.adaptive.relighter import AdaptiveRelighter
from jaxrelight.methods import Adaptive, Transport
from tests.compilations import compilations
from tests.scenes import ball_over_floor

SKY = jr.environment(np.random.default_rng(6).uniform(0.1, 1, size=(8, 16, 3)))
CAMERA = jr.Camera((0.3, 1.4, 2.2), (0, 0.2, 0), fov_y=45, width=24, height=20)
SETTINGS = Transport("vertices", receiver_tolerance=0, resolution=8, terms=2, coefficients=24, factor_resolution=8)


def _scene(ball: int, floor: int, camera=CAMERA) -> Scene:
    return ball_over_floor(jr.phong(0.2, 0.3, 6), camera, SKY, quads=(floor, ball), height=0.0)


def _picture(scene: Scene, settings: Transport, folder) -> np.ndarray:
    return jr.prepare(scene, settings, folder).picture()


@pytest.mark.parametrize("receivers", [pytest.param("vertices", marks=pytest.mark.slow), "pixels"])
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
    relighter = jr.prepare(_scene(13, 30), SETTINGS, tmp_path)
    first = relighter.picture(SKY)
    with compilations() as compiled:
        brighter = jr.environment(np.asarray(SKY.pixels)[::-1] + 1, rotate_y=50, scale=2.5)
        second = relighter.picture(brighter, dataclasses.replace(CAMERA, origin=(-1.0, 1.2, 2.0)))
    assert not compiled
    assert np.abs(first - second).max() > 0.1


def test_another_sun_compiles_nothing(tmp_path):
    """Of however many texels: turned, it lies in more of them."""
    relighter = jr.prepare(_scene(13, 30), SETTINGS, tmp_path)

    def light(rows: int, turn: float):
        pixels = np.array(SKY.pixels)
        pixels[1 : 1 + rows, 3] = 1e4
        return np.asarray(relighter.light(jr.environment(pixels, rotate_y=turn)).terms[0])

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
def _adaptive(camera: jr.Camera = CAMERA) -> AdaptiveRelighter:
    relighter = jr.prepare(_scene(13, 30, camera), Adaptive(tolerance=0.02))
    assert isinstance(relighter, AdaptiveRelighter)
    return relighter


def test_shaded_again_shadows_compile_nothing():
    """However many batches their rays come in."""
    relighter = _adaptive()
    lit, view = relighter.light(SKY), relighter.view()
    few = np.asarray(relighter.shade_uniform(lit, view, 16))
    with compilations() as compiled:
        many = np.asarray(relighter.shade_uniform(lit, view, 1024))
    assert not compiled
    assert 0 < np.abs(few - many).max() < 1


@pytest.mark.slow
def test_pictures_of_about_a_size_are_planned_and_shaded_by_the_same_programs():
    """But for what puts pixels where they are in the picture, and adds it up."""

    def picture(seed: int, tolerance: float, camera: jr.Camera = CAMERA) -> np.ndarray:
        relighter = dataclasses.replace(_adaptive(camera), method=Adaptive(tolerance=tolerance))
        pixels = np.random.default_rng(seed).uniform(0.1, 1, size=(8, 16, 3))
        image = relighter.shade(relighter.light(jr.environment(pixels)), relighter.view())
        return np.asarray(image.radiance)

    first = picture(0, 0.02)
    with compilations() as compiled:
        second = picture(1, 0.01)
    assert not compiled
    assert np.abs(first - second).max() > 0
    narrower = dataclasses.replace(CAMERA, width=23)
    with compilations() as compiled:
        other = picture(0, 0.02, narrower)
    assert set(compiled) <= {"jit(assembled)", "jit(image_of)"}
    assert other.shape[1] == 23
