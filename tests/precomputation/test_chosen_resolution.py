"""Resolution by need: what asks for more, what does not, and that it is measured once."""

import dataclasses
import os
import pathlib
import re

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.files import store as stores
from jaxrelight.geometry.receivers import vertex_receivers
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.precomputation import chosen_resolution
from jaxrelight.precomputation.chosen_resolution import Resolved, with_resolution
from jaxrelight.precomputation.precompute import precompute
from jaxrelight.transport.resolution_error import (
    ChosenResolution,
    PointRows,
    chosen_from,
    draw_slots,
    light_of,
    points_of,
    radiance,
    resolution_error,
)
from tests.scenes import block_aside

CAMERA = jr.Camera((0.4, 1.2, 2.2), (0.1, 0.2, 0), fov_y=50, width=10, height=8)
# Fewer texels than those of 256 take less time.
COARSER, FINEST = (8, 16, 32), 64
AUTO = jr.Transport(receiver_tolerance=0, resolution="auto")
GLOSS = jr.lambert([0.3, 0.2, 0.1])


def _sky(kind: str) -> jr.Environment:
    pixels = np.ones((8, 16, 3), np.float32)
    if kind == "gradient":
        pixels[:4] *= 3
    if kind == "noise":
        pixels = np.random.default_rng(0).random((64, 128, 3)).astype(np.float32) ** 8
    if kind == "sun":
        # Low, so that where it is within a texel makes a difference.
        pixels = np.full((64, 128, 3), 0.01, np.float32)
        pixels[26, 30] = 1e5
    return jr.Environment(pixels)


def _scene(sky: jr.Environment | None, gloss=GLOSS) -> jr.Scene:
    return dataclasses.replace(block_aside(gloss), camera=CAMERA, lights=jr.Lights(sky))


def _resolved(scene: jr.Scene, method: jr.Transport, folder: pathlib.Path) -> Resolved:
    return with_resolution(scene, method, folder, lambda *progress: None, {})


def _chosen(scene: jr.Scene, method: jr.Transport, folder: pathlib.Path) -> ChosenResolution:
    chosen = _resolved(scene, method, folder).chosen
    assert chosen is not None
    return chosen


@pytest.fixture(scope="module", autouse=True)
def few_texels():
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(chosen_resolution, "RESOLUTIONS_BY_NEED", (*COARSER, FINEST))
        yield


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> pathlib.Path:
    """The store in which what the scene's pixels see is traced once."""
    folder = tmp_path_factory.mktemp("store")
    assert _resolved(_scene(_sky("constant")), AUTO, folder).rays > 0
    return folder


def _named(folder: pathlib.Path, kind: str) -> dict[str, bytes]:
    return {str(file.relative_to(folder)): file.read_bytes() for file in folder.glob(f"{kind}-*/*")}


# What asks for more.


def test_a_point_like_sun_asks_for_more_than_a_gradient_and_that_for_no_less_than_a_constant_sky(folder):
    method = dataclasses.replace(AUTO, compression_tolerance=0.05)
    chosen = [_chosen(_scene(_sky(kind)), method, folder) for kind in ("constant", "gradient", "sun")]
    assert chosen[0].resolution == COARSER[0]
    assert chosen[0].resolution <= chosen[1].resolution < chosen[2].resolution
    assert chosen[0].errors[8] < chosen[2].errors[8]


def test_finer_resolutions_are_closer_under_smooth_light(folder):
    errors = list(_chosen(_scene(_sky("gradient")), AUTO, folder).errors.values())
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 0.5 * errors[0]


def test_the_least_that_is_within_the_tolerance_is_chosen(folder):
    for tolerance in (0.0, 0.003, 0.02, 0.5):
        chosen = _chosen(_scene(_sky("gradient")), dataclasses.replace(AUTO, compression_tolerance=tolerance), folder)
        enough = [side for side, error in chosen.errors.items() if error <= tolerance]
        assert chosen.resolution == (enough[0] if enough else FINEST)
    assert chosen.resolution == 8


def test_errors_do_not_depend_on_how_bright_the_light_is(folder):
    dim, bright = (_chosen(_scene(_sky("gradient").with_(scale=by)), AUTO, folder) for by in (1e-4, 1e4))
    assert dim == bright


def test_rows_have_room_for_their_coefficients(folder):
    method = dataclasses.replace(AUTO, coefficients=6 * 32**2, compression_tolerance=0.5)
    assert _resolved(_scene(_sky("constant")), method, folder).method == dataclasses.replace(method, resolution=32)


def test_without_an_environment_light_is_natural(folder):
    chosen = _chosen(_scene(None), AUTO, folder)
    assert chosen.environment is None
    assert "under natural light, as the scene has no environment" in str(chosen)
    assert 0 < chosen.errors[32] < chosen.errors[8] < 0.5


# What does not.


def test_lobes_narrower_than_texels_ask_for_nothing(folder):
    """Filtered, they have no rows; at 32 these have some."""
    plain = _chosen(_scene(_sky("noise")), AUTO, folder).errors
    sharp = _chosen(_scene(_sky("noise"), jr.phong([0.3, 0.2, 0.1], 0.5, 300)), AUTO, folder).errors
    assert [sharp[side] for side in (8, 16)] == pytest.approx([plain[side] for side in (8, 16)], rel=1e-5)
    assert sharp[32] > 1.1 * plain[32]


def test_lobes_that_vertices_filter_ask_for_nothing_and_those_in_factors_do(tmp_path):
    scene = _scene(_sky("noise"), jr.phong([0.3, 0.2, 0.1], 0.8, 20))
    method = dataclasses.replace(AUTO, receivers="vertices")
    filtered = _chosen(scene, method, tmp_path).errors
    plain = _chosen(_scene(_sky("noise")), method, tmp_path).errors
    assert filtered == pytest.approx(plain, rel=1e-5)
    factors = _chosen(scene, dataclasses.replace(method, reflection="factors"), tmp_path).errors
    assert factors[8] > 1.1 * plain[8]


def test_vertices_are_drawn_by_what_is_seen_of_them():
    """Those of a part that the camera does not see are not, unless it sees nothing."""
    scene = _scene(None)
    surfaces = scene.surfaces()
    receivers, tracer = vertex_receivers(surfaces, np.array([0, 1])), Tracer(surfaces)
    mesh_of_slot = np.full(receivers.positions.shape[0] * receivers.positions.shape[1], -1)
    mesh_of_slot[receivers.slot_of] = surfaces.mesh_of_vertex
    for target, seen in (((-0.8, 0, -0.2), {0}), ((0.1, 0.2, 0), {0, 1}), ((0.1, 9, 0), {0, 1})):
        camera = jr.Camera((-0.4, 1.2, 0.3), target, fov_y=30, width=32, height=32)
        slots = draw_slots(receivers, surfaces, tracer, camera, count=1000)
        assert set(mesh_of_slot[slots]) == seen


# Once.


def test_nothing_is_traced_again(folder, monkeypatch):
    scene = _scene(_sky("gradient"))
    first, before = _resolved(scene, AUTO, folder), _named(folder, "sample") | _named(folder, "resolution")
    monkeypatch.setattr(Tracer, "occluded", lambda *_: pytest.fail("a ray was cast"))
    assert _resolved(scene, AUTO, folder) == first._replace(rays=0)
    assert _named(folder, "sample") | _named(folder, "resolution") == before
    for other in (_scene(_sky("gradient").with_(90.0)), _scene(_sky("sun"), jr.lambert(0.9))):
        assert _resolved(other, AUTO, folder).rays == 0


def test_the_choice_does_not_depend_on_the_number_of_threads(folder, tmp_path, monkeypatch):
    monkeypatch.setattr(os, "cpu_count", lambda: 1)
    alone = _chosen(_scene(_sky("sun")), AUTO, tmp_path)
    assert alone == _chosen(_scene(_sky("sun")), AUTO, folder)
    assert _named(tmp_path, "sample").items() <= _named(folder, "sample").items()


def test_a_number_is_taken_as_it_is(folder):
    given = jr.Transport(resolution=8)
    assert _resolved(_scene(None), given, folder) == Resolved(given)


# What is measured.


def test_points_reflect_what_pictures_show(folder):
    """All pixels are drawn, and each has the radiance that uncompressed transport of that resolution gives it."""
    gloss = jr.phong([0.3, 0.2, 0.1], 0.4, 12)
    scene, method = _scene(_sky("gradient"), gloss), jr.Transport(resolution=8, coefficients="all")
    relighter = jr.prepare(scene, method, folder)
    assert isinstance(relighter.method, jr.Transport)
    stored, chosen = relighter.transport.stored, _chosen(scene, AUTO, folder)
    slots = stores.open_layer(folder / chosen.sample).read("slots", 0)
    points = points_of(stored.geometry.receivers, stored.geometry.surfaces, slots, CAMERA.origin)
    group = points.slots // 128
    rows = [
        PointRows(np.flatnonzero(np.isin(group, of.groups)), of.brdf, of.weight) for of in relighter.transport.blocks
    ]
    bits = stores.open_layer(folder / chosen.sample).read("bits", 0)
    reflected = radiance(points, rows, bits, light_of(scene.lights.environment, FINEST), 8)
    image = relighter.shade(relighter.light(scene.lights), relighter.view())
    pictured = np.asarray(image.radiance)[np.asarray(image.alpha) > 0]
    slot_of = stored.geometry.receivers.slot_of
    np.testing.assert_allclose(reflected, pictured[np.argsort(slot_of)], rtol=2e-3, atol=1e-4)


@pytest.mark.slow
def test_the_error_is_that_of_pictures(folder, tmp_path):
    scene = _scene(_sky("sun"), jr.phong([0.3, 0.2, 0.1], 0.4, 12))
    chosen, pictures = _chosen(scene, AUTO, folder), {}
    for side in (16, FINEST):
        relighter = jr.prepare(scene, jr.Transport(resolution=side, coefficients="all"), tmp_path)
        pictures[side] = relighter.shade(relighter.light(scene.lights), relighter.view()).rgba()
    error = jr.image_error(pictures[16], pictures[FINEST])
    assert (chosen.errors[16], chosen.untrimmed[16]) == pytest.approx((error.trimmed, error.untrimmed), rel=0.05)


def test_black_points_have_no_error():
    black = np.zeros((4, 3))
    assert resolution_error(black, black) == (0, 0)


# What is told.


def test_stores_tell_the_number_and_how_it_was_chosen(folder):
    scene = _scene(_sky("gradient"))
    build = precompute(scene, AUTO, folder)
    chosen = chosen_from(build.header["chosen_resolution"])
    assert chosen is not None
    assert chosen == _chosen(scene, AUTO, folder)
    assert build.header["method"]["dials"]["resolution"] == chosen.resolution == 8
    assert build.rays < 10_000, "rays of the visibility alone: the sample was there"
    assert str(chosen) in build.notes
    assert re.fullmatch(r"resolution 8 was chosen: 0\.\d% off of 64 on \d+ points", str(chosen))
    assert {chosen.sample, chosen.layer} <= set(stores.layers_of(build.header))
    assert {"sample", "resolution"} <= set(build.nbytes)
    relighter = jr.open_store(folder)
    assert relighter.method == dataclasses.replace(AUTO, resolution=8)


def test_what_is_said_when_no_resolution_is_enough(folder):
    chosen = _chosen(_scene(_sky("sun")), dataclasses.replace(AUTO, compression_tolerance=0.0), folder)
    assert chosen.resolution == FINEST
    assert re.fullmatch(
        r"resolution 64 was chosen: 32 would be [\d.]+% off of it on \d+ points, and the tolerance is 0.0%",
        str(chosen),
    )


def test_a_sharper_environment_is_told_and_no_ray_is_cast_for_that(folder, monkeypatch):
    scene = _scene(_sky("gradient"))
    precompute(scene, AUTO, folder)
    relighter = jr.open_store(folder)
    assert relighter.notes_on(scene.lights) == relighter.notes_on(None) == ()
    monkeypatch.setattr(Tracer, "occluded", lambda *_: pytest.fail("a ray was cast"))
    assert relighter.notes_on(_sky("constant")) == ()
    (line,) = relighter.notes_on(_sky("sun"))
    told = re.fullmatch(
        r"this environment is sharper than the one that resolution 8 was chosen for: it is ([\d.]+)% off of 64 on "
        r"\d+ points, more than 2\.0%; precompute with this environment, or with --resolution (\d+)",
        line,
    )
    assert told
    other = _chosen(_scene(_sky("sun")), AUTO, folder)
    assert float(told[1]) == pytest.approx(100 * other.errors[8], rel=1e-2)
    assert int(told[2]) == other.resolution


def test_a_resolution_that_was_given_is_not_judged(folder):
    relighter = jr.prepare(_scene(_sky("gradient")), jr.Transport(resolution=8), folder)
    assert relighter.notes_on(_sky("sun")) == ()
    assert relighter.resolution_errors(_sky("sun")) == {}
