"""What hides the environment under prefiltered lighting: against exact transport, and where nothing hides it."""

import pathlib

import jax
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import Scene
from jaxrelight.images import image_error
from jaxrelight.precomputation.vertex_occlusion import with_stored_vertices
from tests.scenes import ball_over_floor

CAMERA = jr.Camera((0.4, 1.0, 2.0), (0, 0.2, 0), fov_y=45, width=32, height=24)


def sky() -> jr.Environment:
    """Brighter to one side, and smooth."""
    longitude = (np.arange(32) + 0.5) * (2 * np.pi / 32)
    rows = np.linspace(1, 0.3, 16)[:, None] * (1.2 + np.cos(longitude - 1))[None]
    return jr.environment((rows[..., None] * [1, 0.9, 0.8]).astype(np.float32))


def scene(gloss) -> Scene:
    return ball_over_floor(gloss, CAMERA, sky(), quads=(12, 8), height=0.36)


def picture(of: Scene, resolution: int, tolerance: float = 0.0) -> np.ndarray:
    method = jr.Prefiltered(map_rows=64, occlusion_resolution=resolution, receiver_tolerance=tolerance)
    return jr.prepare(of, method).picture(background=False)


@pytest.mark.parametrize(
    "gloss",
    [jr.lambert([0.7, 0.5, 0.3]), pytest.param(jr.phong(0.2, 0.5, 40), marks=pytest.mark.slow)],
    ids=["lambert", "phong"],
)
def test_shadows_are_near_exact_transport(gloss, tmp_path: pathlib.Path):
    pixels = jr.Transport("pixels", resolution=16, coefficients="all")
    exact = jr.prepare(scene(gloss), pixels, tmp_path).picture(background=False)
    without, coarse = (image_error(picture(scene(gloss), resolution), exact) for resolution in (0, 8))
    assert coarse.trimmed < 0.05
    assert coarse.trimmed < 0.5 * without.trimmed


def test_shadows_fall_on_a_floor_of_two_triangles():
    """As on one of many squares, where vertices are added to it."""
    fine, coarse = (ball_over_floor(jr.lambert(0.5), CAMERA, sky(), quads=(of, 8), height=0.36) for of in (24, 1))
    shadowed = picture(fine, 8)
    without, default = (image_error(picture(coarse, 8, tolerance), shadowed) for tolerance in (0.0, 0.2))
    assert without.trimmed > 0.1
    assert default.trimmed < 0.01


def test_where_nothing_hides_it_nothing_changes():
    ball = Scene([jr.Part(jr.sphere(0.5, 8), "gloss")], {"gloss": jr.phong(0.3, 0.4, 30)}, CAMERA, sky())
    np.testing.assert_allclose(picture(ball, 8), picture(ball, 0), rtol=5e-3, atol=1e-3)


@pytest.mark.slow
def test_it_is_reported_in_vertices_and_is_an_argument_of_jitted_functions():
    told = []
    relighter = jr.prepare(
        scene(jr.phong(0.2, 0.5, 40)),
        jr.Prefiltered(map_rows=64, receiver_tolerance=0),
        report=lambda *of: told.append(of),
    )
    assert {stage for stage, _, _ in told} == {"occlusion"}
    assert told[-1][1] == told[-1][2] == sum(len(part.mesh.vertices) for part in scene(jr.lambert(0)).parts)
    view, lit = relighter.view(), relighter.light(sky())
    traced = relighter.trace(lit, view)
    shaded = jax.jit(lambda relighter, lit, view: relighter.shade(lit, view, traced).radiance)(relighter, lit, view)
    np.testing.assert_allclose(shaded, relighter.shade(lit, view, traced).radiance, rtol=1e-4, atol=1e-5)

    def total(scale):
        light = jr.Environment(sky().pixels, 0.0, scale)
        return relighter.shade(relighter.light(light), view, traced).radiance.sum()

    value, slope = jax.value_and_grad(total)(2.0)
    np.testing.assert_allclose(2 * slope, value, rtol=1e-4)


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """A store of transport with filtered visibility."""
    folder = tmp_path_factory.mktemp("occlusion") / "store"
    jr.prepare(scene(jr.phong(0.2, 0.5, 40)), jr.Transport("vertices", resolution=16), folder)
    return folder


@pytest.mark.slow
def test_a_store_of_transport_has_it(stored: pathlib.Path):
    """Of another material as well, and without a ray."""
    told, method = [], jr.Prefiltered(map_rows=64, occlusion_resolution=16)
    for gloss in (jr.phong(0.2, 0.5, 40), jr.lambert([0.7, 0.5, 0.3])):
        of = scene(gloss)
        from_store = jr.prepare(of, method, stored, lambda *of: told.append(of)).picture(background=False)
        # The store's vertices are those of the scene, and others where light needed them.
        finer = with_stored_vertices(of, stored)
        assert len(finer.surfaces().vertices) > len(of.surfaces().vertices)
        traced = jr.prepare(finer, method).picture(background=False)
        assert image_error(from_store, traced).untrimmed < 1e-5
    assert not told


def test_stores_without_it_are_refused(stored: pathlib.Path, tmp_path: pathlib.Path):
    glossy = scene(jr.phong(0.2, 0.5, 40))
    other = Scene([jr.Part(jr.sphere(0.5, 4), "gloss")], {"gloss": jr.phong(0.3, 0.4, 30)}, CAMERA, sky())
    with pytest.raises(jr.InputError, match="another geometry than scene"):
        jr.prepare(other, jr.Prefiltered(), stored)
    with pytest.raises(jr.InputError, match="leave one of them out"):
        jr.prepare(glossy, jr.Prefiltered(occlusion_resolution=0), stored)
    with pytest.raises(jr.InputError, match="store"):
        jr.prepare(glossy, jr.Prefiltered(), tmp_path / "none")
    jr.prepare(
        other,
        jr.Transport("vertices", receiver_tolerance=0, resolution=4, reflection="factors", factor_resolution=8),
        tmp_path / "s",
    )
    with pytest.raises(jr.InputError, match="no filtered visibility; precompute vertices"):
        jr.prepare(other, jr.Prefiltered(), tmp_path / "s")
