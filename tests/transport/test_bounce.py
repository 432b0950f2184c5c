"""Bounced light: closed forms, its linearity against light gathered without compression, what is reused and refused."""

import dataclasses
from typing import Any

import jax
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import InputError, Part, Scene
from jaxrelight.basis import cubemap
from jaxrelight.basis.haar import HaarFaces
from jaxrelight.brdf.material import Component, Material
from jaxrelight.brdf.reflection import of_group
from jaxrelight.lighting.transport import TransportRelighter
from jaxrelight.methods import Transport
from jaxrelight.precomputation.precompute import precompute
from jaxrelight.transport import bake, bounce
from jaxrelight.transport.model import PrecomputedTransport, frames_of
from jaxrelight.transport.rebake import exact, rebake
from tests import scenes
from tests.transport.scenes import ball_on_floor
from tests.transport.stores import block_of, load_transport, precomputed, reflections_of

SMALL = Transport(
    "vertices",
    receiver_tolerance=0,
    reflection="factors",
    resolution=8,
    terms=2,
    factor_resolution=12,
    compression_tolerance=0.0,
    bounces=1,
    gather_resolution=8,
)
ROOM = dataclasses.replace(SMALL, resolution=4, gather_resolution=16)
UP: Any = np.array([0, 0, 1], np.float32)
LIGHT: Any = np.random.default_rng(0).gamma(0.5, size=(6 * 8**2, 3)).astype(np.float32)


def emitting(albedo: float, radiance: float = 1.0) -> Material:
    colour = jr.lambert([albedo] * 3)
    return Material((Component(colour),), emission=np.full(3, radiance, np.float32))


def room(albedo: float, radiance: float = 1.0) -> Scene:
    """A box seen from inside, whose walls all emit."""
    camera = jr.Camera((0, 0, 0.4), (0, 0, -1), fov_y=60.0, width=8, height=8)
    return scenes.room(emitting(albedo, radiance), camera)


def radiance_at_vertices(transport: PrecomputedTransport) -> np.ndarray:
    """Radiance of the walls, by the light that they emit alone."""
    (block,) = transport.blocks
    assert block.emission is not None
    assert block.emitted is not None
    view = np.asarray(block.reflection.view_side(UP))
    return (block.emission[None] + np.sum(block.emitted * view[None], axis=1))[transport.receivers.slot_of]


def picture(transport: PrecomputedTransport, light: np.ndarray = LIGHT) -> np.ndarray:
    """Of the surfaces, under light over texels."""
    relighter = TransportRelighter(transport)
    if transport.method.coefficients != "all":
        light = np.asarray(encoded(light.T)).T
    return np.asarray(relighter.shade_terms(relighter.terms(light), relighter.view()))


encoded = jax.jit(HaarFaces(8).encode)


def relative(actual, wanted) -> float:
    return float(np.linalg.norm(np.subtract(actual, wanted)) / np.linalg.norm(wanted))


@pytest.fixture(scope="module")
def scene() -> Scene:
    return ball_on_floor()


@pytest.fixture(scope="module")
def direct(scene, tmp_path_factory) -> PrecomputedTransport:
    return precomputed(scene, dataclasses.replace(SMALL, bounces=0), tmp_path_factory.mktemp("direct"))


def test_a_closed_box_is_its_series_at_each_bounce(tmp_path):
    for bounces in (1, 2, 3):
        radiance = radiance_at_vertices(precomputed(room(0.5), dataclasses.replace(ROOM, bounces=bounces), tmp_path))
        # Rays through the corners of texels cover every direction, so that no light is lost at edges or corners.
        np.testing.assert_allclose(radiance, sum(0.5**i for i in range(bounces + 1)), rtol=1e-3)


def test_bounces_end_where_the_rest_is_below_the_tolerance(tmp_path):
    method = dataclasses.replace(ROOM, bounces=50, compression_tolerance=0.1)
    build = precompute(room(0.8, 3.0), method, tmp_path)
    transport = load_transport(build.folder, build.header)
    assert transport.method.bounces < 15
    assert "of 50 bounces were made" in build.notes[-1]
    radiance = radiance_at_vertices(transport)
    assert 3 / (1 - 0.8) * (1 - 0.1) < radiance.min() <= radiance.max() < 3 / (1 - 0.8)


def test_emission_is_seen_and_lights_what_does_not_emit(tmp_path):
    ball = jr.sphere(0.3, 4)
    lamp = dataclasses.replace(ball, vertices=np.add(ball.vertices, [0, 0.8, 0]))
    camera = jr.Camera((0, 1, 3), (0, 0.3, 0), fov_y=50.0, width=16, height=16)
    parts = [Part(jr.plane((4, 4), 6), "floor"), Part(lamp, "lamp")]
    warm = Material((Component(jr.lambert([0.0] * 3)),), emission=np.array([4, 2, 1], np.float32))
    scene = Scene(parts, {"floor": jr.lambert([0.5] * 3), "lamp": warm}, camera)
    pictures = []
    for bounces in (0, 1):
        for receivers in ("pixels", "vertices"):
            given = {"bounces": bounces, "receivers": receivers, "gather_resolution": 16, "coefficients": "all"}
            method = dataclasses.replace(SMALL, **given)
            transport = precomputed(scene, method, tmp_path)
            pictures.append(picture(transport, 0 * LIGHT))
    lamp_seen = pictures[0].max(axis=-1) > 0
    assert 0 < lamp_seen.sum() < 100
    np.testing.assert_allclose(pictures[0][lamp_seen], np.broadcast_to([4, 2, 1], (lamp_seen.sum(), 3)), rtol=1e-6)
    np.testing.assert_array_equal(pictures[0], pictures[1])
    # A sphere of radius r at height h lights what lies under it with E = π L (r/h)².
    floor = block_of(transport, "floor")
    assert floor.emitted is not None
    below = floor.emitted[:, 0].max(axis=0) * np.asarray(floor.reflection.view_side(UP))[0]
    np.testing.assert_allclose(below, 0.5 * np.array([4, 2, 1]) * (0.3 / 0.8) ** 2, rtol=0.05)
    assert pictures[2][~lamp_seen].max() > 0.1
    assert relative(pictures[3], pictures[2]) < 0.1


@pytest.mark.parametrize("two_sided", [False, pytest.param(True, marks=pytest.mark.slow)])
def test_only_fronts_emit(tmp_path, two_sided):
    """A lamp that faces up over a floor: its back is dark unless it is a surface, too."""
    lamp = jr.plane((1, 1), 2)
    lamp = dataclasses.replace(lamp, vertices=np.add(lamp.vertices, [0, 0.5, 0]), two_sided=two_sided)
    parts = [Part(jr.plane((2, 2), 4), "floor"), Part(lamp, "lamp")]
    scene = Scene(parts, {"floor": jr.lambert([0.5] * 3), "lamp": emitting(0.5)}, jr.Camera((0, 1, 3), (0, 0, 0)))
    transport = precomputed(scene, dataclasses.replace(SMALL, resolution=4), tmp_path)
    floor = block_of(transport, "floor")
    assert floor.emitted is not None
    assert (floor.emitted.max() > 0.1) == two_sided
    assert floor.emitted.min() >= 0


def test_each_side_is_seen_by_what_is_before_it(tmp_path):
    sheet = jr.plane((1, 1), 2)
    sheet = dataclasses.replace(sheet, vertices=np.add(sheet.vertices, [0, 0.5, 0]), two_sided=True)
    parts = [Part(jr.plane((2, 2), 4), "floor"), Part(sheet, "sheet")]
    grey = jr.lambert([0.5] * 3)
    scene = Scene(parts, {"floor": grey, "sheet": grey}, jr.Camera((0, 1, 3), (0, 0, 0)))
    transport = precomputed(scene, dataclasses.replace(SMALL, resolution=4, bounces=0), tmp_path)
    gather = bounce.Gather(transport, "key", 8)
    floor, above = (block_of(transport, name) for name in ("floor", "sheet"))
    hits = gather.hits(transport.receivers, int(floor.groups[0]))
    slots = transport.receivers.slot_of - above.groups[0] * 128
    front, back = slots[25:34], slots[34:]
    for lit, is_seen in ((front, False), (back, True)):
        terms = np.zeros((128 * len(above.groups), 1, 3), np.float32)
        terms[lit] = 1
        of_block = [terms if block is above else None for block in transport.blocks]
        radiance = gather.light(hits, jax.device_put(np.ones((6 * 8**2, 128, 1, 1), np.float32)), of_block)
        assert (radiance.max() > 0.1) == is_seen


@pytest.mark.parametrize(
    ("coefficients", "nearest"), [pytest.param(6 * 8**2, True, marks=pytest.mark.slow), ("shared", False)]
)
def test_gathered_rows_are_gathered_light(scene, tmp_path_factory, direct, coefficients, nearest):
    """G (T x) = (G T) x, for glossy and diffuse receivers and what they see of both; rows with all coefficients."""
    transport = direct
    if coefficients != "shared":
        method = dataclasses.replace(SMALL, bounces=0, coefficients=coefficients)
        transport = precomputed(scene, method, tmp_path_factory.mktemp("rows"))
    gather = bounce.Gather(transport, "key", 8, nearest)
    light = np.random.default_rng(0).normal(size=(6 * 8**2, 3)).astype(np.float32)
    terms = [np.asarray(part) for part in TransportRelighter(transport).terms(light)]
    for block in transport.blocks:
        frames, group = frames_of(transport.receivers, block.groups), int(block.groups[0])
        (gathered_rows,) = gather.rows(transport.receivers, group, frames[0], [of_group(block.reflection, 0)])
        assert gathered_rows.emitted is None
        assert gathered_rows.rows.shape == (128, block.reflection.terms, 3, len(gathered_rows.columns))
        assert (np.diff(gathered_rows.columns) > 0).all()
        hits = gather.hits(transport.receivers, group)
        seen = np.zeros((128, 6 * 8**2), bool)
        seen[hits.receiver, hits.texel] = True
        bits = np.packbits(seen, axis=1, bitorder="little")
        side = bake.bake_rows(bits, frames[0], block.reflection, bake.directions_for(8), cubemap.Texels(8))
        gathered = gather.light(hits, np.moveaxis(side, -1, 0), terms)
        assert np.abs(gathered).max() > 0.01
        assert relative(np.einsum("mkcn,nc->mkc", gathered_rows.rows, light[gathered_rows.columns]), gathered) < 2e-3


def test_reflections_gather_together_what_each_gathers(scene, direct):
    """Receivers look around once for all that they reflect."""
    gather, (one, other, *_) = bounce.Gather(direct, "key", 8), direct.blocks
    frames, group = frames_of(direct.receivers, one.groups)[0], int(one.groups[0])
    reflections = [of_group(block.reflection, 0) for block in (one, other)]
    both = gather.rows(direct.receivers, group, frames, reflections)
    for gathered, reflection in zip(both, reflections, strict=True):
        (alone,) = gather.rows(direct.receivers, group, frames, [reflection])
        np.testing.assert_array_equal(gathered.columns, alone.columns)
        np.testing.assert_allclose(gathered.rows, alone.rows, rtol=1e-5, atol=1e-6)


def test_rays_where_visibility_is_open_are_spared(direct):
    """Adaptive rays hit what all rays hit, are counted, and make other layers."""
    every, some = (bounce.Gather(direct, "key", 8, rays=rays) for rays in ("all", "adaptive"))
    assert every.key == bounce.Gather(direct, "key", 8).key != some.key
    visibility, block = direct.stored.visibility, direct.blocks[0]
    assert visibility is not None
    frames, group = frames_of(direct.receivers, block.groups)[0], int(block.groups[0])
    sides = [gather.with_visibility(visibility) for gather in (every, some)]
    rows = [gather.rows(direct.receivers, group, frames, [of_group(block.reflection, 0)])[0].rows for gather in sides]
    np.testing.assert_array_equal(rows[0], rows[1])
    assert np.abs(rows[0]).max() > 0
    assert every.rays == some.rays == (0, 0)
    all_rays, fewer = (gather.rays for gather in sides)
    assert 0 < fewer.traced < 0.5 * all_rays.traced
    assert all_rays.traced == all_rays.above == fewer.above


def test_bounced_light_is_direct_light_and_what_is_gathered(scene, direct, tmp_path):
    transport = precomputed(scene, SMALL, tmp_path)
    gather = bounce.Gather(direct, "key", 8)
    block, before, after = transport.blocks[0], direct.operator.operators[0], transport.operator.operators[0]
    frames = frames_of(direct.receivers, block.groups)
    (gathered,) = gather.rows(direct.receivers, int(block.groups[0]), frames[0], [of_group(block.reflection, 0)])
    chosen: Any = np.arange(0, 128 * block.reflection.terms, 17)
    wanted = np.array(np.broadcast_to(before.rows(chosen), (len(chosen), 3, 6 * 8**2)))
    wanted[..., gathered.columns] += gathered.rows.reshape(-1, *gathered.rows.shape[2:])[chosen]
    assert relative(after.rows(chosen), wanted) < 1e-5


@pytest.mark.slow
def test_an_even_sky_grows_no_brighter_than_albedo_allows(scene, direct, tmp_path):
    once, twice = (precomputed(scene, dataclasses.replace(SMALL, bounces=count), tmp_path) for count in (1, 2))
    none, one, two = (picture(each, np.ones_like(LIGHT)) for each in (direct, once, twice))
    first, second = one - none, two - one
    assert first.min() > -0.01
    assert 0.005 < first.mean() < 0.5
    assert second.mean() < 0.5 * first.mean()


@pytest.mark.parametrize("change", [{}, pytest.param({"coefficients": 6 * 8**2}, marks=pytest.mark.slow)])
@pytest.mark.slow
def test_pixels_gather_from_vertices(scene, tmp_path, change):
    """Exact direct light and the bounce of pixels, against the same that is compressed."""
    pictures = []
    for kept in ({"coefficients": "all"}, change):
        method = dataclasses.replace(SMALL, receivers="pixels", compression_tolerance=1e-3, **kept)
        pictures.append(picture(precomputed(scene, method, tmp_path)))
    assert relative(pictures[1], pictures[0]) < 2e-3


def test_what_is_there_is_used_again(tmp_path):
    scene = room(0.5)
    first = precompute(scene, dataclasses.replace(ROOM, bounces=2), tmp_path)
    times = {path: path.stat().st_mtime_ns for path in tmp_path.rglob("0*")}
    again = precompute(scene, dataclasses.replace(ROOM, bounces=2), tmp_path)
    assert again.rays == 0
    assert again.gather_rays == (0, 0)
    # A closed room spares none.
    assert 0 < first.gather_rays.traced == first.gather_rays.above
    assert times == {path: path.stat().st_mtime_ns for path in tmp_path.rglob("0*")}
    assert again.header == first.header
    less = precompute(scene, dataclasses.replace(ROOM, bounces=1), tmp_path)
    assert times == {path: path.stat().st_mtime_ns for path in tmp_path.rglob("0*")}
    assert len(less.header["passes"]) == 1
    # Another look around is another layer.
    precompute(scene, dataclasses.replace(ROOM, bounces=1, gather="nearest"), tmp_path)
    assert len(list(tmp_path.rglob("0*"))) > len(times)


@pytest.mark.parametrize("albedo", [1.0, 1.2])
def test_what_reflects_all_light_is_refused_before_any_ray(albedo, tmp_path):
    with pytest.raises(InputError, match=rf"material 'wall' reflects {albedo:.3f} of the light"):
        precompute(room(albedo), SMALL, tmp_path / "store")
    assert not (tmp_path / "store").exists()


def test_terms_that_cannot_be_had_are_refused_before_any_ray(scene, tmp_path):
    """Those of pixels have one; but their bounces pass through vertices."""
    method = dataclasses.replace(SMALL, receivers="pixels", terms=10_000)
    with pytest.raises(InputError, match="material 'lacquer': 10000 terms cannot be had"):
        precompute(scene, method, tmp_path / "store")
    assert not (tmp_path / "store").exists()


def test_bounced_light_cannot_be_baked_again(scene, tmp_path):
    transport = precomputed(scene, SMALL, tmp_path)
    with pytest.raises(InputError, match="precompute again"):
        rebake(transport, reflections_of(transport))


@pytest.mark.slow
def test_exact_direct_light_keeps_bounced_light(scene, direct, tmp_path):
    """What is not compressed is the streamed rows; what was gathered stays beside them."""
    both = direct, precomputed(scene, SMALL, tmp_path)
    pictures = [picture(each) for transport in both for each in (transport, exact(transport))]
    assert relative(pictures[2], pictures[0]) > 0.01
    np.testing.assert_allclose(pictures[3] - pictures[1], pictures[2] - pictures[0], atol=1e-4)
