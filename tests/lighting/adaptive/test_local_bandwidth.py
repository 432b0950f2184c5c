"""Bandwidth through the operators of Bagher 2011, figure 4: against geometry that can be worked out by hand."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.lighting.adaptive.local_bandwidth import Bandwidth, reflected, travelled

DISTANT = Bandwidth(jnp.asarray(0.0), jnp.asarray(3.0))
SHARP, PLAIN = 1e6, 0.0


def _seen(light=DISTANT, *, cosine_i=1.0, cosine_o=1.0, curvature=0.0, brdf=SHARP, texture=PLAIN, distance=2.0):
    return travelled(reflected(light, cosine_i, cosine_o, curvature, brdf, texture), distance)


def test_flat_mirror_shows_the_sky_as_it_is():
    assert _seen() == (0, 3)
    assert _seen(cosine_i=0.3, cosine_o=0.3) == (0, 3)


@pytest.mark.parametrize("radius", [0.1, 1.0, 50.0])
@pytest.mark.parametrize("distance", [0.5, 7.0])
def test_mirror_ball_shows_it_smaller(radius, distance):
    """A step of an angle α across the view turns the normal by α·d/R, and the mirror direction by twice that and α."""
    _, angular = _seen(curvature=1 / radius, distance=distance)
    np.testing.assert_allclose(angular, 3 * (1 + 2 * distance / radius), rtol=1e-6)


def test_diffuse_surface_is_as_smooth_as_its_normal():
    """Whatever the sky: the BRDF's bandwidth is that of what a turn of the normal changes."""
    for light in (3.0, 1e4):
        _, angular = _seen(Bandwidth(jnp.asarray(0.0), jnp.asarray(light)), curvature=2.0, brdf=0.4)
        np.testing.assert_allclose(angular, 0.4 * (1 + 2 * 2 * 2.0), rtol=1e-6)


def test_texture_is_seen_smaller_from_afar_and_aslant():
    one = _seen(curvature=0.0, texture=5.0, brdf=0.0)
    np.testing.assert_allclose(one.a, 5 * 2.0)
    np.testing.assert_allclose(_seen(texture=5.0, brdf=0.0, distance=6.0).a, 3 * one.a)
    np.testing.assert_allclose(_seen(texture=5.0, brdf=0.0, cosine_o=0.5).a, 2 * one.a)


def test_near_lamp_is_spatial_after_its_way():
    """A lamp of so many cycles per metre, at a distance, is so many per radian times that."""
    light = travelled(Bandwidth(jnp.asarray(4.0), jnp.asarray(0.0)), 3.0)
    assert light == (4, 12)


def test_more_is_never_less():
    given = [0.5, 0.7, 0.6, 1.5, 2.0, 1.0]
    for number, change in enumerate((0.4, None, None, 1.0, 1.0, 1.0)):
        if change is not None:
            more = [x + change * (i == number) for i, x in enumerate(given)]
            one, other = (
                reflected(Bandwidth(jnp.asarray(s), jnp.asarray(3.0)), *map(jnp.asarray, rest))
                for s, *rest in (given, more)
            )
            assert other.s >= one.s
            assert other.a >= one.a


def test_finite_where_nothing_varies_and_at_grazing_angles():
    for zero in (Bandwidth(jnp.asarray(0.0), jnp.asarray(0.0)), DISTANT):
        for cosine in (0.0, 1e-6, 1.0):
            bandwidth = _seen(zero, cosine_i=cosine, cosine_o=cosine, curvature=3.0, brdf=0.0)
            assert np.isfinite(bandwidth).all()
    slopes = jax.grad(lambda a: travelled(reflected(Bandwidth(0.0 * a, a), 1.0, 1.0, 1.0, 0.0, 0.0), 1.0).a)(0.0)
    assert np.isfinite(slopes)
