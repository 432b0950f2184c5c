"""Rays that bounced light is gathered along: none where visibility is open, and what is hit stays what it is."""

import functools

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.basis import cubemap
from jaxrelight.geometry.receivers import vertex_receivers
from jaxrelight.geometry.surfaces import Surfaces, join
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.transport.hits import GatherRays, Hits, may_hit, trace_hits
from jaxrelight.transport.visibility import trace_visibility
from tests.scenes import inside_out, raised

GATHERED = 16


@functools.cache
def ball_and_floor() -> Surfaces:
    return join([jr.plane([2, 2], 8), raised(jr.sphere(0.3, 8), 0.4)])


def both_of(surfaces: Surfaces, resolution: int, group: int = 0) -> tuple[Hits, Hits]:
    """Of a group: by all rays, and by those that visibility at a resolution leaves."""
    receivers, tracer = vertex_receivers(surfaces, np.arange(len(surfaces.two_sided))), Tracer(surfaces)
    given = receivers.origins[group], receivers.normals[group]
    bits, _ = trace_visibility(tracer, *given, cubemap.directions(resolution))
    return (
        trace_hits(surfaces, tracer, *given, GATHERED),
        trace_hits(surfaces, tracer, *given, GATHERED, bits),
    )


def numbers_of(hits: Hits) -> np.ndarray:
    return hits.receiver * 6 * GATHERED**2 + hits.texel


@pytest.mark.parametrize("resolution", [8, 16, 20, 32, 48])
def test_a_body_on_a_floor_is_hit_along_fewer_rays(resolution):
    every, some = both_of(ball_and_floor(), resolution)
    assert every.rays.traced == every.rays.above == some.rays.above
    # Wider texels than those of the gathering spare rays only where a receiver sees nothing but sky.
    assert some.rays.traced <= (1 if resolution < GATHERED else 0.3) * every.rays.traced
    kept = np.isin(numbers_of(every), numbers_of(some))
    assert kept.mean() > 0.995
    np.testing.assert_array_equal(numbers_of(every)[kept], numbers_of(some))
    for name in ("face", "barycentric", "normals", "positions", "omega_o"):
        np.testing.assert_array_equal(getattr(every.points, name)[kept], getattr(some.points, name))


@pytest.mark.parametrize("resolution", [GATHERED, 3 * GATHERED])
def test_no_hit_is_lost_where_visibility_has_the_same_directions(resolution):
    every, some = both_of(ball_and_floor(), resolution)
    np.testing.assert_array_equal(numbers_of(every), numbers_of(some))


@pytest.mark.parametrize("resolution", [8, 32])
def test_an_object_alone_casts_no_ray(resolution):
    for mesh in (jr.sphere(1, 6), jr.box([1, 2, 3], 2)):
        _, some = both_of(join([mesh]), resolution)
        assert some.rays.traced == len(some.texel) == 0
        assert some.rays.above > 0


def test_a_closed_room_needs_all_rays():
    every, some = both_of(join([inside_out(jr.box((1, 1, 1), 4))]), 32)
    assert some.rays.traced == every.rays.traced
    np.testing.assert_array_equal(numbers_of(every), numbers_of(some))


def test_directions_are_open_where_all_around_them_are():
    """A single hidden texel, of the finer cube map's, is one of those around a direction."""
    normals, seen = np.array([[0.0, 1, 0]]), np.ones((6, 32, 32), bool)
    # The face +y, and of its 32 by 32 texels the first of the middle four of texel (2, 3).
    for hidden, wanted in (((2, 5, 7), (2, 2, 3)), ((2, 6, 6), (2, 3, 3))):
        bits = seen.copy()
        bits[hidden] = False
        bits = np.packbits(bits.reshape(1, -1), axis=1, bitorder="little")
        found = may_hit(bits, normals, GATHERED).reshape(6, GATHERED, GATHERED)
        np.testing.assert_array_equal(np.argwhere(found), [wanted])
    # What is hidden under the horizon is not asked for.
    under = np.packbits(np.arange(6 * 32**2) // 32**2 != 3, bitorder="little")[None]
    assert not may_hit(under, normals, GATHERED).any()


def test_rays_are_added():
    assert GatherRays.total([]) == (0, 0)
    assert GatherRays.total([GatherRays(1, 2), GatherRays(10, 20)]) == GatherRays(11, 22)
