"""What points get by photons: the series of a closed room, and the same as by gathering."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import InputError, Part
from jaxrelight.gather.gather_cloud import gather_cloud
from jaxrelight.gather.photon_gather import PhotonGather
from jaxrelight.geometry.surfaces import join
from jaxrelight.geometry.tracer import Tracer
from jaxrelight.lights.local import point
from tests.lighting.test_indirect import ball, opened, room

PHOTONS = {"gather_samples": 1024, "photons": 100_000, "bounces": 3}


@pytest.mark.slow
@pytest.mark.parametrize("bounces", [2, 3])
def test_a_closed_room_is_its_series(tmp_path, bounces):
    """Of light 1 everywhere, ρ + ρ² … in each channel, energy kept within two percent; a point within some."""
    albedo = np.array([0.5, 0.4, 0.8])
    relighter = opened(room(albedo), tmp_path, **PHOTONS | {"bounces": bounces})
    light = jnp.ones((1024, 3))
    more = np.asarray(relighter.add_bounces(light)) - light
    wanted = np.sum([albedo**n for n in range(1, bounces)], axis=0)
    areas = np.asarray(relighter.precomputed.points.areas)
    np.testing.assert_allclose(areas @ more / areas.sum(), wanted, rtol=0.02)
    assert np.quantile(np.abs(more / wanted[None] - 1), 0.9) < 0.15


@pytest.mark.slow
def test_a_picture_is_that_of_gathering(tmp_path):
    scene = room([0.7, 0.6, 0.5], None, (ball("gloss"),), gloss=jr.phong(0.2, 0.5, 20.0))
    lamp = [point([0.1, 0.2, 0.05], [1.0, 0.8, 0.6])]
    dials = PHOTONS | {"gather_samples": 1024}
    photons, gathered = (opened(scene, tmp_path, **dials | {"photons": count}) for count in (100_000, 0))
    view = gathered.view()

    def indirect(relighter, bounces=None) -> np.ndarray:
        return np.asarray(relighter.final_gather(relighter.light(lamp, bounces).cloud, view))

    one, other = indirect(photons), indirect(gathered)
    assert np.linalg.norm(one - other) < 0.03 * np.linalg.norm(other)
    with pytest.raises(InputError, match="photons were shot for 3 bounces, not 2"):
        photons.add_bounces(photons.direct_light_at_cloud(lamp), 2)
    with pytest.raises(InputError, match="its photons met the albedos they were shot with"):
        photons.add_bounces(photons.direct_light_at_cloud(lamp), albedo=photons.precomputed.cloud.albedo)
    np.testing.assert_array_equal(indirect(photons, 1), indirect(gathered, 1))


def test_outdoors_nothing_comes_back(tmp_path):
    """Of a floor alone, no photon lands anywhere."""
    scene = jr.Scene(
        [Part(jr.plane((1, 1), 4), "gloss")],
        {"gloss": jr.lambert(0.5)},
        dataclasses.replace(jr.Camera((0, 1, 1), (0, 0, 0)), width=8, height=8),
    )
    relighter = opened(scene, tmp_path, **PHOTONS)
    light = jnp.ones((1024, 3))
    np.testing.assert_array_equal(relighter.add_bounces(light), light)


def test_area_at_an_edge_is_what_the_surface_has_there():
    """Within a distance of a rectangle's middle, edge and corner: a disc, half of one and a quarter."""
    surfaces = join([jr.plane((2, 2), 4)])
    gather = PhotonGather(gather_cloud(surfaces, 4096), surfaces, Tracer(surfaces), lambda *_: np.ones(3), 1, 1)
    places = surfaces.to_scene(np.array([[0.0, 0, 0], [1, 0, 0], [1, 0, 1]]))
    radius = 0.3
    areas = gather._areas(places, np.tile([0.0, 1, 0], (3, 1)), np.full(3, radius))
    np.testing.assert_allclose(areas / (np.pi * radius**2), [1, 0.5, 0.25], rtol=0.08)
