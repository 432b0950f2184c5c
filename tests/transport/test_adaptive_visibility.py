"""Rays where visibility changes see what all rays see, in fewer of them; and none are cast where nothing can be hit."""

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.basis import cubemap
from jaxrelight.geometry.occluders import Occluders
from jaxrelight.geometry.receivers import vertex_receivers
from jaxrelight.geometry.surfaces import Surfaces, join
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.transport.adaptive_visibility import cells_of, first_cells, trace_adaptively
from jaxrelight.transport.visibility import trace_visibility


def both_of(surfaces: Surfaces, resolution: int, groups: slice = slice(None)):
    """Bits by all rays and by adaptive ones, [g, m, d], their numbers, and the heights of directions over horizons."""
    receivers = vertex_receivers(surfaces, np.arange(len(surfaces.two_sided)))
    tracer, occluders, bits, rays = Tracer(surfaces), Occluders(surfaces), ([], []), np.zeros(2, int)
    for group in np.arange(len(receivers.filled))[groups]:
        given = receivers.origins[group], receivers.normals[group]
        for way, (of, count) in enumerate(
            (
                trace_visibility(tracer, *given, cubemap.directions(resolution)),
                trace_adaptively(tracer, occluders, *given, resolution),
            )
        ):
            bits[way].append(np.unpackbits(of, axis=1, bitorder="little").astype(bool))
            rays[way] += count
    normals = receivers.normals[groups]
    return *(np.array(of) for of in bits), rays, normals @ cubemap.directions(resolution).T


def room() -> Surfaces:
    """A floor, a ball above it, and a wire over both."""
    ball = jr.transformed(jr.sphere(0.3, 8), _moved([0.2, 0.4, 0]))
    wire = jr.transformed(jr.box([2, 0.02, 0.02]), _moved([0, 0.9, 0.1]))
    return join([jr.plane([2, 2], 8), ball, wire])


def _moved(by) -> np.ndarray:
    matrix = np.eye(4)
    matrix[:3, 3] = by
    return matrix


@pytest.mark.parametrize("resolution", [8, 16, 32, 48])
def test_the_same_is_seen_in_fewer_rays(resolution):
    every, some, rays, height = both_of(room(), resolution)
    # On the horizon itself rounding decides.
    differs = (every != some) & (height > 1e-6)
    assert differs.sum() <= 1e-4 * every.size
    assert rays[1] < (0.75 if resolution >= 32 else 1.0) * rays[0]
    assert 0.2 < every[height > 0].mean() < 0.99


def test_small_cube_maps_have_all_rays():
    """But those that geometry spares."""
    every, some, rays, height = both_of(room(), 4)
    np.testing.assert_array_equal(every & (height > 1e-6), some & (height > 1e-6))
    assert rays[1] <= rays[0]


def test_a_convex_body_in_the_open_casts_no_ray():
    for mesh in (jr.sphere(1, 12), jr.box([1, 2, 3])):
        every, some, rays, height = both_of(join([mesh]), 32)
        assert rays[1] == 0
        assert every[height > 1e-6].all()
        # Below horizons, too, so that it takes no bytes in a store.
        assert some.all()


@pytest.mark.parametrize(("width", "lost"), [(0.015, 0.05), (0.03, 0.01)])
def test_wires_as_wide_as_a_texel_are_met(width, lost):
    """Most of the first rays miss them; those that are narrower are dashed lines."""
    wires = [jr.transformed(jr.box([4, width, width]), _moved([0, 1, z])) for z in np.linspace(-1, 1, 7)]
    every, some, rays, height = both_of(join([jr.plane([2, 2], 10), *wires]), 64, slice(1))
    hidden = ~every & (height > 1e-6)
    missed = (hidden & some).sum(axis=2) / hidden.sum(axis=2)
    assert missed.mean() < lost
    assert np.mean(missed > 0.2) < (0.01 if width == 0.03 else 0.02)
    assert rays[1] < 0.65 * rays[0]


def test_what_lies_between_the_middles_of_cells_is_met():
    """A ball that only the corners of four first cells see."""
    surfaces = join([jr.transformed(jr.sphere(0.05, 8), _moved([0, 1, 0])), jr.plane([0.1, 0.1])])
    origin, up = surfaces.to_scene([[0.0, 1e-3, 0.0]]), np.array([[0.0, 1.0, 0.0]])
    tracer, occluders = Tracer(surfaces), Occluders(surfaces)
    every, _ = trace_visibility(tracer, origin, up, cubemap.directions(64))
    some, rays = trace_adaptively(tracer, occluders, origin, up, 64)
    hidden = np.unpackbits(every, bitorder="little").astype(bool) < (cubemap.directions(64)[:, 1] > 0)
    assert 4 <= hidden.sum() <= 24
    assert not np.unpackbits(some, bitorder="little")[hidden].any()
    assert rays < 100


def test_a_gap_above_the_horizon_is_met():
    """Under a wide lid the sky is seen beside it alone, where samples of many cells are below the horizon."""
    lid = jr.transformed(jr.plane([2, 2]), _moved([0, 0.06, 0]) @ np.diag([1.0, -1, -1, 1]))
    every, some, *_ = both_of(join([jr.plane([0.2, 0.2], 2), lid]), 64, slice(1))
    assert every.sum() > 500
    assert np.count_nonzero(every & ~some) < 0.01 * every.sum()


def test_occluders_are_only_where_they_may_be():
    """A ball over one receiver is in its cone of directions, which is not much wider than the ball."""
    ball = jr.transformed(jr.sphere(0.1, 8), _moved([0, 1, 0]))
    occluders, directions = Occluders(join([ball])), cubemap.directions(32)
    surfaces = join([ball])
    middle = surfaces.vertices.mean(axis=0)
    radius = np.linalg.norm(surfaces.vertices - middle, axis=1).max()
    origin = middle - np.array([0, 4 * radius, 0])
    possible = occluders.possible(origin[None], np.array([[0.0, 1, 0]]), directions, 0.02)
    angle = np.arccos(directions[:, 1])
    assert possible[angle < np.arcsin(0.25)].all()
    assert not possible[angle > np.arcsin(0.25) + 0.25].any()
    assert not occluders.possible(origin[None], np.array([[0.0, -1, 0]]), directions, 0.02).any()


def test_cells_have_neighbours_across_edges():
    cells, middles = cells_of(16, 2), cubemap.directions(8)
    apart = np.arccos(np.clip(np.sum(middles[cells.neighbours] * middles[:, None], axis=2), -1, 1))
    assert apart.min() > 0.1
    assert apart.max() < 0.5
    np.testing.assert_array_equal(cells_of(16, 4).corner[cells.parent] // 256, cells.corner // 256)
    assert first_cells(64).side == 4
    assert first_cells(16).side == 1
