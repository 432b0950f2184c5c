"""Shadow rays: where they start, what is kept of them, and that they hide what stands in the way."""

import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Array

import jaxrelight as jr
from jaxrelight.geometry.surfaces import join
from jaxrelight.geometry.tracer import OFFSET, Tracer
from jaxrelight.lighting import shadows as module
from jaxrelight.lighting.shadows import Shadows
from jaxrelight.lights.area import area
from jaxrelight.lights.local import Incident, Punctual, directional, point, spot
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


class Counting:
    """A tracer that counts rays."""

    def __init__(self, tracer):
        self.tracer, self.rays = tracer, 0

    def blocked(self, origins, directions, distance):
        self.rays += len(origins)
        return self.tracer.blocked(origins, directions, distance)


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
def floor():
    """Points of a floor, half of which face down, around a ball; 100 more are padding."""
    surfaces = join([jr.sphere(0.2, 8)])
    random = np.random.default_rng(0)
    places = random.uniform(-1, 1, (COUNT, 3)) * [1, 0, 1] - [0, 0.3, 0]
    padded = jnp.asarray(np.pad(places, ((0, 100), (0, 0))), jnp.float32)
    normals = jnp.asarray(np.where(np.arange(COUNT + 100)[:, None] % 2, UP, -UP), jnp.float32)
    tracer = Counting(Tracer(surfaces))
    return Shadows(tracer, surfaces.to_scene(places) + OFFSET * UP, padded, normals, surfaces.radius), tracer  # pyright: ignore[reportArgumentType]


def test_rays_go_where_light_comes_from_in_front(floor):
    shadows, tracer = floor
    _, found = shadows.arriving(LIGHTS["directional"])
    assert tracer.rays == COUNT // 2
    assert not found[:COUNT:2].any()
    assert not found[COUNT:].any()
    # The shadow of the ball, as parallel light throws it.
    places = np.asarray(shadows.positions)[1:COUNT:2]
    towards = np.array([-0.2, 1, -0.1]) / np.sqrt(1.05)
    apart = np.linalg.norm(np.cross(places, towards), axis=1)
    hidden = ~np.asarray(found)[1:COUNT:2].astype(bool)
    assert hidden[apart < 0.19].all()
    assert not hidden[apart > 0.2].any()


@pytest.mark.parametrize("name", LIGHTS)
def test_rays_of_another_colour_are_none(floor, name):
    shadows, tracer = floor
    first = shadows.arriving(LIGHTS[name])[1]
    traced = tracer.rays
    assert 0 < traced <= COUNT // 2
    again = {"point": point([0.3, 1, 0.1], [1, 0, 3]), "spot": spot([0, 1, 0], [0.2, 0, 0.1], 9, 20, 10)}
    second = shadows.arriving(again.get(name, LIGHTS[name]))[1]
    assert tracer.rays == traced
    np.testing.assert_array_equal(first, second)


@pytest.mark.parametrize("name", ["spot", "projector", "shaped", "patch"])
def test_where_light_cannot_arrive_is_left_out_and_nothing_else(floor, name):
    shadows, tracer = floor
    incident, found = shadows.arriving(LIGHTS[name])
    within = tracer.rays
    _, everywhere = shadows.arriving(Everywhere(LIGHTS[name]))
    assert within < 0.7 * (tracer.rays - within)
    lit = np.asarray(incident.irradiance).any(axis=1)
    np.testing.assert_array_equal(np.asarray(found)[lit], np.asarray(everywhere)[lit])
    assert not ((found > 0) & (everywhere == 0)).any()


def test_only_so_much_is_kept(floor, monkeypatch):
    shadows, tracer = floor
    monkeypatch.setattr(module, "_KEPT", 3 * (COUNT // 16 + 300))
    lamps = [point([0.1 * i, 1, 0], 1) for i in range(5)]
    for lamp in lamps:
        shadows.arriving(lamp)
    once = tracer.rays
    shadows.arriving(lamps[4])
    assert tracer.rays == once
    shadows.arriving(lamps[0])
    assert tracer.rays == once + COUNT // 2


def test_a_light_from_the_same_direction_but_nearer_is_another(floor):
    shadows, _ = floor
    far, near = (np.asarray(shadows.arriving(Overhead(jnp.asarray(d, jnp.float32)))[1]) for d in (5.0, 0.05))
    assert far.sum() < near.sum() == COUNT // 2
