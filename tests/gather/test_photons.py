"""Photons: their energy, where they land, and what stops them."""

from typing import Any

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.gather.photons import shoot
from jaxrelight.geometry.mesh import with_back
from jaxrelight.geometry.surfaces import join
from jaxrelight.geometry.tracer import Tracer
from tests.scenes import inside_out, moved


def of(albedo):
    return lambda face, weights, back: np.broadcast_to(np.asarray(albedo, float), (len(face), 3))


def shot(meshes, place, albedo: Any = 0.5, each=4096, length: int | None = 1, **more):
    surfaces = join(meshes)
    where = surfaces.to_scene([place])
    return shoot(surfaces, Tracer(surfaces), where, np.array([[0.0, 1, 0]]), of(albedo), each, length, **more)


ROOM = [inside_out(jr.box((1, 1, 1), 4))]
FLOOR = 0.0, -0.5, 0.0


def test_in_a_closed_room_each_lands_as_often_as_it_may():
    photons = shot(ROOM, FLOOR, [0.2, 0.5, 1.0], each=1000, length=3)
    assert len(photons.origins) == 3000
    assert (photons.origins == 0).all()
    powers, counts = np.unique(photons.power, axis=0, return_counts=True)
    np.testing.assert_allclose(powers, [[0.04, 0.25, 1], [0.2, 0.5, 1], [1, 1, 1]])
    np.testing.assert_array_equal(counts, 1000)
    assert np.abs(np.abs(photons.positions).max(axis=1) - 1).max() < 1e-3
    assert (np.sum(photons.positions * photons.normals, axis=1) < 0).all()


def test_roulette_keeps_energy():
    """1 + ρ + ρ² + …, in every channel."""
    photons = shot(ROOM, FLOOR, [0.3, 0.6, 0.8], each=20_000, length=None)
    np.testing.assert_allclose(photons.power.sum(axis=0) / 20_000, 1 / (1 - np.array([0.3, 0.6, 0.8])), rtol=0.03)
    assert not len(shot(ROOM, FLOOR, 0.0, each=10, length=None).origins) - 10


def test_they_leave_by_the_cosine():
    """As many reach a square overhead as its form factor says."""
    x = 1.0
    share = x / np.sqrt(1 + x * x)
    wanted = 4 / (2 * np.pi) * 2 * share * np.arctan(share)
    photons = shot(
        [moved(inside_out(jr.plane((2, 2), 4)), (0, 1, 0)), jr.plane((0.1, 0.1), 1)], (0, 0.001, 0), each=20_000
    )
    assert len(photons.origins) / 20_000 == pytest.approx(wanted, abs=0.02)


def test_backs_stop_them_unless_they_are_surfaces():
    lid = moved(jr.plane((2, 2), 2), (0, 0.2, 0))
    assert not len(shot([lid], (0, 0, 0)).origins)
    photons = shot([with_back(lid)], (0, 0, 0))
    assert len(photons.origins) > 1000
    np.testing.assert_allclose(photons.normals, np.tile([0, -1.0, 0], (len(photons.origins), 1)), atol=1e-12)


def test_seeds():
    one, same, other = (shot(ROOM, FLOOR, seed=seed, each=16) for seed in (3, 3, 4))
    np.testing.assert_array_equal(one.positions, same.positions)
    assert np.abs(one.positions - other.positions).max() > 1e-3


def test_more_than_are_traced_at_once(monkeypatch):
    monkeypatch.setattr("jaxrelight.gather.photons._RAY_CHUNK", 10)
    surfaces = join(ROOM)
    places = np.array([[0, -1, 0], [0.5, -1, 0.5], [-0.5, -1, 0]])
    photons = shoot(surfaces, Tracer(surfaces), places, np.tile([0.0, 1, 0], (3, 1)), of(0.5), 7, 1)
    np.testing.assert_array_equal(np.bincount(photons.origins), 7)
