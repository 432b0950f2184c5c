"""Shadow rays: where they start, what is kept of them, and that they hide what stands in the way."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

import jaxrelight as jr
from jaxrelight.geometry.surfaces import join
from jaxrelight.geometry.tracer import OFFSET, Tracer
from jaxrelight.lighting import shadows as module
from jaxrelight.lighting.shadows import SurfacePoints, all_visible, group_lights, surface_points, trace_visibility
from jaxrelight.lights.area import area
from jaxrelight.lights.local import Incident, Light, Punctual, directional, point, spot
from jaxrelight.lights.projector import projector
from jaxrelight.lights.shaped import shaped

COUNT = 30_000
UP = np.array([0.0, 1, 0])
LIGHTS = {
    "point": point([0.3, 1, 0.1], 2),
    "directional": directional([0.2, -1, 0.1], 1),
    "spot": spot([0, 1, 0], [0.2, 0, 0.1], 1, 20, 10),
    "projector": projector([0, 1, 0], [0.2, 0, 0.1], np.zeros((3, 3, 3)), 30),
    "shaped": shaped([0, 1, 0], [0.2, 0, 0.1], 1, 10, 20),
    "patch": area([0, 0.5, 0], [0.1, 0, 0], [0, 0.1, 0.02], 1, 1).parts()[0],
}


class Counting(Tracer):
    """A tracer that counts rays."""

    def __init__(self, tracer):
        self.tracer, self.rays = tracer, 0
        # What another one has traced is not remembered for it.
        self.key = f"{tracer.key} {id(self)}"

    def blocked(self, origins, directions, distance):
        self.rays += len(origins)
        return self.tracer.blocked(origins, directions, distance)

    def occluded(self, origins, directions):
        self.rays += len(origins)
        return self.tracer.occluded(origins, directions)

    def distances(self, origins, directions):
        self.rays += len(origins)
        return self.tracer.distances(origins, directions)


class Everywhere(Punctual):
    """Another light, that does not say where its light can arrive."""

    other: Punctual

    def at(self, positions) -> Incident:
        return self.other.at(positions)._replace(within=None)


class Overhead(Punctual):
    """A light straight above every point, so far away."""

    far: Array

    def at(self, positions) -> Incident:
        above = jnp.broadcast_to(jnp.asarray(UP, jnp.float32), positions.shape)
        return Incident(above, jnp.broadcast_to(self.far, positions.shape[:1]), above)


@pytest.fixture
def floor() -> tuple[SurfacePoints, Counting]:
    """Points of a floor, half of which face down, around a ball; followed by padding."""
    surfaces = join([jr.sphere(0.2, 8)])
    random = np.random.default_rng(0)
    places = random.uniform(-1, 1, (COUNT, 3)) * [1, 0, 1] - [0, 0.3, 0]
    normals = np.where(np.arange(COUNT)[:, None] % 2, UP, -UP)
    tracer = Counting(Tracer(surfaces))
    positions = surfaces.to_scene(places)
    given = positions, positions + OFFSET * UP, normals, surfaces.radius
    return surface_points(tracer, *given), tracer  # pyright: ignore[reportArgumentType]


def reached(points: SurfacePoints, light: Light) -> np.ndarray:
    """Which points a light reaches."""
    (bits,) = trace_visibility(points, group_lights([light], np.zeros(3)))
    return np.unpackbits(np.asarray(bits)[0], count=len(points.positions)).astype(bool)


def test_points_lie_where_they_were_given_and_are_followed_by_padding(floor):
    points, _ = floor
    places = np.asarray(points.positions)
    assert len(places) > COUNT
    assert np.asarray(points.normals)[:COUNT].any(axis=1).all()
    assert not np.asarray(points.normals)[COUNT:].any()
    np.testing.assert_allclose(places[:COUNT, 1], -0.3, atol=1e-6)
    assert np.abs(places[:COUNT]).max() < 1


def test_rays_go_where_light_comes_from_in_front(floor):
    points, tracer = floor
    visible = reached(points, LIGHTS["directional"])
    assert tracer.rays == COUNT // 2
    assert not visible[:COUNT:2].any()
    assert not visible[COUNT:].any()
    # The shadow of the ball, as parallel light throws it.
    places = np.asarray(points.positions)[1:COUNT:2]
    towards = np.array([-0.2, 1, -0.1]) / np.sqrt(1.05)
    apart = np.linalg.norm(np.cross(places, towards), axis=1)
    hidden = ~visible[1:COUNT:2]
    assert hidden[apart < 0.19].all()
    assert not hidden[apart > 0.2].any()


@pytest.mark.parametrize("name", LIGHTS)
def test_rays_of_another_colour_are_none(floor, name):
    points, tracer = floor
    first = reached(points, LIGHTS[name])
    traced = tracer.rays
    assert 0 < traced <= COUNT // 2
    again = {"point": point([0.3, 1, 0.1], [1, 0, 3]), "spot": spot([0, 1, 0], [0.2, 0, 0.1], 9, 20, 10)}
    second = reached(points, again.get(name, LIGHTS[name]))
    assert tracer.rays == traced
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("name", ["spot", "projector", "shaped", "patch"])
def test_where_light_cannot_arrive_is_left_out_and_nothing_else(floor, name):
    points, tracer = floor
    visible = reached(points, LIGHTS[name])
    within = tracer.rays
    everywhere = reached(points, Everywhere(LIGHTS[name]))
    assert within < 0.7 * (tracer.rays - within)
    lit = np.asarray(LIGHTS[name].at(points.positions).irradiance).any(axis=1)
    np.testing.assert_array_equal(visible[lit], everywhere[lit])
    assert not (visible & ~everywhere).any()


def test_only_so_much_is_remembered(floor, monkeypatch):
    points, tracer = floor
    monkeypatch.setattr(module, "_MAX_REMEMBERED", 3 * (len(points.positions) // 8 + 300))
    lamps = [point([0.1 * i, 1, 0], 1) for i in range(5)]
    for lamp in lamps:
        reached(points, lamp)
    once = tracer.rays
    reached(points, lamps[4])
    assert tracer.rays == once
    reached(points, lamps[0])
    assert tracer.rays == once + COUNT // 2


def test_a_light_from_the_same_direction_but_nearer_is_another(floor):
    points, _ = floor
    far, near = (reached(points, Overhead(jnp.asarray(d, jnp.float32))) for d in (5.0, 0.05))
    assert far.sum() < near.sum() == COUNT // 2


def test_lights_of_a_kind_are_one_group_of_few_sizes(floor):
    """Filling is traced towards by no ray, and changes nothing of the others."""
    points, tracer = floor
    lamps = [point([0.1 * i - 0.5, 1, 0], 1) for i in range(17)]
    of_points, of_suns = group_lights([*lamps[:4], LIGHTS["directional"], *lamps[4:]], np.zeros(3))
    assert (len(of_points.is_real), len(of_suns.is_real)) == (18, 1)
    np.testing.assert_array_equal(of_points.is_real, np.arange(18) < 17)
    bits, _ = trace_visibility(points, (of_points, of_suns))
    assert tracer.rays == 18 * COUNT // 2
    seventh = np.unpackbits(np.asarray(bits)[7], count=len(points.normals))
    np.testing.assert_array_equal(seventh, reached(points, lamps[7]))
    assert not np.asarray(bits)[17:].any()
    every, of_sun = map(np.asarray, all_visible(points, (of_points, of_suns)))
    assert every.shape == bits.shape
    assert (every == np.where(np.arange(18) < 17, 255, 0)[:, None]).all()
    assert (of_sun == 255).all()


def test_a_directional_light_without_light_casts_no_rays(floor):
    points, tracer = floor
    assert not reached(points, directional([0.2, -1, 0.1], 0.0)).any()
    assert tracer.rays == 0


def test_rays_inside_of_jit_are_those_outside(floor):
    """By one callback for all kinds of lights, and held fixed in derivatives."""
    points, _ = floor
    groups = group_lights(list(LIGHTS.values()), np.zeros(3))

    @jax.jit
    def traced(points, groups):
        return trace_visibility(points, groups)

    for inside, outside in zip(traced(points, groups), trace_visibility(points, groups), strict=True):
        np.testing.assert_array_equal(inside, outside)


def test_what_hides_distant_light_is_at_a_distance(floor):
    points, _ = floor
    chosen, towards = np.arange(1, COUNT, 200), np.tile(UP, (COUNT // 200, 1))
    far = np.hypot(*np.asarray(points.positions)[chosen][:, ::2].T) > 0.2
    near = np.hypot(*np.asarray(points.positions)[chosen][:, ::2].T) < 0.15
    occluded, distance = points.is_occluded(chosen, towards), points.distances(chosen, towards)
    assert near.any()
    assert occluded[near].all()
    assert not occluded[far].any()
    np.testing.assert_array_equal(np.isfinite(distance), occluded)
    # The ball of radius 0.2 hangs 0.3 above the floor.
    assert ((distance[near] > 0.09) & (distance[near] < 0.2)).all()
