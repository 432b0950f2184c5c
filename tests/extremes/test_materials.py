"""Extreme materials: all light or none reflected, lobes of every width."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight.brdf.lobes import phong
from tests.extremes.scenes import METHODS, ONE, ball, by, picture_of, plain


@by()
@pytest.mark.parametrize("albedo", [0.0, 0.99, 1.0])
def test_a_plain_reflects_its_albedo(holds, method, albedo, tmp_path):
    image = picture_of(plain(jr.lambert(albedo)), method, ONE, tmp_path)
    limit = 0.02 if method == "indirect" else 5e-3
    holds(f"{method}: a plain of albedo {albedo:g}", np.abs(image - albedo).max(), limit)


# Indirect lighting has a few directions for a sky, which sharp lobes do not meet.
@pytest.mark.parametrize("method", [name for name in METHODS if name != "indirect"])
@pytest.mark.parametrize("exponent", [0.0, 1e-3, 1e5])
def test_lobes_of_every_width_reflect_no_more_than_they_get(holds, method, exponent, tmp_path):
    """And what they do against the directional albedo, by quadrature, where nothing is hidden."""
    camera = jr.Camera((0, 2, 2), (0, 0, 0), fov_y=1, width=16, height=16)
    image = picture_of(plain(phong(0.0, 0.8, exponent), camera), method, ONE, tmp_path)
    wanted = reflected(0.8, exponent, np.pi / 4)
    limit = 0.03 if method == "adaptive" else 0.012
    holds(f"{method}: a lobe of exponent {exponent:g}", np.abs(image / wanted - 1).max(), limit)


def reflected(albedo: float, exponent: float, angle: float) -> float:
    """∫ f cosθ dω of Phong's lobe at an angle from the normal, in double precision."""
    # Around the peak, whose nearest directions are told apart; u is uniform under the lobe.
    u = (np.arange(4000) + 0.5) / 4000
    cosine = u ** (1 / (exponent + 1))
    azimuth = 2 * np.pi * (np.arange(400) + 0.5) / 400
    sine = np.sqrt(1 - cosine**2)
    z = cosine[:, None] * np.cos(angle) + sine[:, None] * np.cos(azimuth) * np.sin(angle)
    return float(albedo * (exponent + 2) / (exponent + 1) * np.mean(np.maximum(z, 0)))


@pytest.mark.parametrize("exponent", [0.0, 1e-3, 1e5])
@pytest.mark.parametrize("method", ["vertices", "prefiltered"])
def test_slopes_in_lobes_of_every_width_are_finite(holds, method, exponent, tmp_path):
    of = ball(phong(0.2, 0.5, exponent))
    dials = METHODS[method]
    relighter = jr.prepare(of, dials, tmp_path if dials.is_stored else None)
    view = relighter.view()

    def brightness(scale):
        lit = relighter.light(ONE.with_(scale=scale))
        return jnp.mean(relighter.shade(lit, view).radiance)

    slope = jax.grad(brightness)(jnp.float32(1.0))
    holds(f"{method}: slope with a lobe of exponent {exponent:g}", abs(float(slope)), 1e3)
