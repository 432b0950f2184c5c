"""Rows of what is gathered: against form factors in closed form, whole rows, and the energy of closed rooms."""

import jax
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.basis.haar import HaarFaces
from jaxrelight.brdf.material import white_lambert
from jaxrelight.brdf.reflection import FixedView
from jaxrelight.gather.final_gather import FinalGather
from jaxrelight.gather.gather_cloud import gather_cloud
from jaxrelight.geometry.receivers import Receivers
from jaxrelight.geometry.surfaces import join
from jaxrelight.geometry.tracer import OFFSET, Tracer
from tests.scenes import inside_out, raised

FRAME = np.array([[1.0, 0, 0], [0, 0, 1], [0, 1, 0]])  # of a surface that looks up


def white(count: int) -> FixedView:
    return FixedView(white_lambert(), jax.device_put(np.tile(np.array([0, 0, 1], np.float32), (count, 1))))


def inside(size=(1, 1, 1), resolution: int = 8):
    return inside_out(jr.box(size, resolution))


def upwards(positions) -> Receivers:
    """One group that looks up, from places in scene space."""
    positions = np.asarray(positions, float)[None]
    up, none = np.broadcast_to([0.0, 1, 0], positions.shape), np.zeros_like(positions)
    filled = np.array([positions.shape[1]])
    places = positions, up, up, positions + OFFSET * up, none, None, None, None
    return Receivers(*places, np.zeros(1, int), filled, np.arange(positions.shape[1]))


def gathered(surfaces, count: int, positions, light=None, **dials) -> np.ndarray:
    """What receivers in scene space that look up get of a light of 1, or of one given at the points."""
    cloud = gather_cloud(surfaces, count)
    gather = FinalGather(cloud, Tracer(surfaces), **dials)
    # One alone is given twice: of two, it gets the same, and there are fewer shapes.
    m, places = max(len(positions), 2), np.resize(positions, (max(len(positions), 2), 3))
    ((columns, rows, _),) = gather.rows(upwards(places), 0, np.tile(FRAME, (m, 1, 1)), [white(m)])
    light = np.ones(count, np.float32) if light is None else light(cloud)
    return rows[: len(positions), 0, 0] @ encoded(light, cloud)[columns]


def encoded(light, cloud) -> np.ndarray:
    """Light at the points in coefficients."""
    return np.asarray(HaarFaces(cloud.side, 1).encode(jax.device_put(np.asarray(light, np.float32))))


def test_a_square_overhead():
    """The form factor of a parallel square, from a point below its middle (Howell's catalogue, B-3, four times)."""
    surfaces = join([raised(inside_out(jr.plane((2, 2), 8)), 1.0), raised(jr.plane((0.1, 0.1), 1), -1)])
    place = surfaces.to_scene([[0, 0.3, 0], [0, -0.4, 0]])
    form_factors = gathered(surfaces, 4096, place)
    for y, value in zip((0.3, -0.4), form_factors, strict=True):
        x = 1 / (1 - y)
        root = np.sqrt(1 + x * x)
        wanted = 4 / (2 * np.pi) * 2 * (x / root) * np.arctan(x / root)
        assert value == pytest.approx(wanted, rel=5e-3)


@pytest.mark.parametrize("threshold", [0.0, pytest.param(0.01, marks=pytest.mark.slow), 0.1])
def test_a_closed_room_gives_all_around(threshold):
    """No more than 1 in the mean, and hardly less, in the middle of the floor and elsewhere."""
    surfaces = join([inside()])
    random = np.random.default_rng(0)
    places = np.column_stack([random.uniform(-0.9, 0.9, 64), np.full(64, -1.0), random.uniform(-0.9, 0.9, 64)])
    form_factors = gathered(surfaces, 4096, places, threshold=threshold)
    np.testing.assert_allclose(form_factors, 1, atol=0.1)
    assert abs(form_factors.mean() - 1) < 0.01
    assert form_factors.max() <= 1 + 1e-5


def test_along_edges_energy_is_kept_better_than_by_the_clamp():
    surfaces = join([inside()])
    along = np.random.default_rng(1).uniform(-0.9, 0.9, 64)
    places = np.column_stack([np.full(64, -0.97), np.full(64, -1.0), along])
    disc, clamp = (gathered(surfaces, 1024, places, near=near) for near in ("disc", "clamp"))
    assert disc.max() <= 1 + 1e-5
    assert disc.mean() > 0.85
    assert clamp.mean() < disc.mean()


def kernel_at_parts(cloud, tracer, place, normal) -> np.ndarray:
    """What a diffuse white receiver gets from each point, by the parts that it stands for."""
    away = cloud.parts.reshape(-1, 3) - place
    square = np.sum(away**2, axis=1)
    omega = away / np.sqrt(square)[:, None]
    facing = np.maximum(-np.sum(omega * cloud.part_normals.reshape(-1, 3), axis=1), 0)
    cosines = np.maximum(omega @ normal, 0) * facing * cloud.part_areas.reshape(-1)
    start = np.tile(place + OFFSET * normal, (len(away), 1))
    ends = (cloud.parts + OFFSET * cloud.part_normals).reshape(-1, 3)
    hidden = tracer.blocked(start, ends - start, np.full(len(away), 1 - 1e-4))
    share = np.where(hidden, 0, cosines / (np.pi * square + cosines))
    return share.reshape(cloud.parts.shape[:2]).sum(axis=1) / max(share.sum(), 1)


def test_rows_are_those_of_every_part_when_nothing_is_taken_together():
    """A threshold of 0 is the kernel at each part of each point, in Haar coefficients."""
    surfaces = join([inside(), jr.sphere(0.2, 3)])
    cloud = gather_cloud(surfaces, 256)
    tracer = Tracer(surfaces)
    gather = FinalGather(cloud, tracer, threshold=0.0)
    place = np.array([[0.3, -1, 0.2], [-0.7, -1, 0.5]])
    ((columns, rows, _),) = gather.rows(upwards(place), 0, np.tile(FRAME, (2, 1, 1)), [white(2)])
    whole = np.zeros((2, 256))
    whole[:, columns] = rows[:, 0, 0]
    kernels = np.asarray(HaarFaces(16, 1).decode(jax.device_put(whole.astype(np.float32))))
    for receiver in range(2):
        wanted = kernel_at_parts(cloud, tracer, place[receiver], np.array([0.0, 1, 0]))
        assert (wanted == 0).any()
        np.testing.assert_allclose(kernels[receiver], wanted, atol=1e-6)


def test_far_points_are_taken_together():
    """Fewer nodes for a larger threshold; light of a smooth kind is nearly the same."""
    surfaces = join([inside()])
    cloud = gather_cloud(surfaces, 4096)
    place, up = np.array([[0.1, -1, 0.2]]), np.array([[0.0, 1, 0]])
    counts = [
        len(FinalGather(cloud, Tracer(surfaces), threshold).links(place, up).nodes) for threshold in (0, 0.02, 0.1)
    ]
    assert counts[0] > 2 * counts[1] > 4 * counts[2]

    def smooth(cloud):
        return 1 + cloud.positions[:, 0]

    all_of_them, some = (gathered(surfaces, 4096, place, smooth, threshold=threshold) for threshold in (0, 0.02))
    np.testing.assert_allclose(some, all_of_them, rtol=0.01)


def mirrored(cloud, surfaces, place, light, **dials) -> float:
    """What a sharp lobe reflects of a light, straight back."""
    reflection = FixedView(jr.phong(0.0, 1.0, 2000.0), jax.device_put(np.array([[0, 0, 1]], np.float32)))
    gather = FinalGather(cloud, Tracer(surfaces), **dials)
    ((columns, rows, _),) = gather.rows(upwards(place), 0, FRAME[None], [reflection])
    return float(rows[0, 0, 0] @ encoded(light(cloud), cloud)[columns])


def test_points_in_a_peak_are_told_apart():
    """Of stripes overhead, a sharp lobe shows those that it looks at, not the mean of a node: in the mean of clouds."""
    surfaces = join([inside((2, 2, 2), 12)])
    place = surfaces.to_scene([[0.11, -0.7, 0.07]])
    edge = place[0, 0]

    def stripes(cloud):
        return (np.floor((cloud.positions[:, 0] - edge) * 8 + 0.5) % 2 == 0).astype(float)

    clouds = [gather_cloud(surfaces, 4096, seed=seed) for seed in range(3)]
    every, blurred, sharp = (
        np.array([mirrored(cloud, surfaces, place, stripes, **dials) for cloud in clouds])
        for dials in ({"threshold": 0.0}, {"threshold": 0.2, "peak": 1.0}, {"threshold": 0.2, "peak": 0.01})
    )
    assert np.abs(sharp - every).mean() < 0.1 * every.mean()
    assert np.abs(blurred - every).mean() > 2 * np.abs(sharp - every).mean()


def test_nothing_comes_from_behind_or_through():
    """A floor under the receiver, a square whose back is seen, and one behind another."""
    below, back = raised(jr.plane((2, 2), 4), -1), raised(jr.plane((2, 2), 4), 1)
    assert gathered(join([below, back]), 64, join([below, back]).to_scene([[0, 0, 0]])) == 0
    lid, shield = raised(inside_out(jr.plane((1, 1), 4)), 1), raised(jr.plane((6, 6), 4), 0.5)
    surfaces = join([lid, shield])
    assert gathered(surfaces, 64, surfaces.to_scene([[0, 0, 0]])) == 0


def test_terms_and_channels_are_those_of_each_reflection():
    surfaces = join([inside()])
    gather = FinalGather(gather_cloud(surfaces, 64), Tracer(surfaces), peak=1.0)
    glossy = FixedView(jr.phong([0.1, 0.2, 0.3], 0.5, 20.0), jax.device_put(np.array([[0, 0, 1]], np.float32)))
    one, other = gather.rows(upwards([[0, -1, 0]]), 0, FRAME[None], [white(1), glossy])
    assert one.rows.shape == (1, 1, 1, len(one.columns))
    assert other.rows.shape == (1, 1, 3, len(one.columns))
    np.testing.assert_allclose(other.rows[0, 0, 2] - other.rows[0, 0, 0], 0.2 * one.rows[0, 0, 0], atol=1e-5)
    (grey,) = gather.rows(upwards([[0, -1, 0]]), 0, FRAME[None], [white(1)], [3])
    np.testing.assert_array_equal(grey.rows, np.broadcast_to(one.rows, (1, 1, 3, len(one.columns))))
