"""Bandwidth of BRDFs: closed forms against wavelets, and the mapping they lie on."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.brdf.bandwidth import (
    bandwidth_table,
    compressed,
    from_square,
    lobe_bandwidth,
    texture_bandwidth,
    to_square,
)
from jaxrelight.brdf.lobes import lambert, phong
from jaxrelight.brdf.material import white_phong
from jaxrelight.brdf.spatial import PackedLobes, SpatialLobes
from jaxrelight.brdf.texture import Texture

UP = np.asarray([0, 0, 1], np.float32)


@jax.jit
def _looked_up(table, omega_i, omega_o):
    return table.look_up(omega_i, omega_o)


@jax.jit
def _closed_form(brdf, omega_i, omega_o):
    return lobe_bandwidth(brdf, omega_i, omega_o)


def look_up(table, omega_i, omega_o) -> float:
    return float(_looked_up(table, np.asarray(omega_i, np.float32), np.asarray(omega_o, np.float32)))


def test_square_and_back():
    a, b = np.random.default_rng(0).random((2, 256))
    omega = from_square(a, b)
    assert (omega[:, 2] >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(omega, axis=1), 1, rtol=1e-12)
    square = jax.jit(jax.vmap(to_square))(omega.astype(np.float32))
    np.testing.assert_allclose(np.stack(square), np.stack([a, b]), atol=1e-6)
    # Cells differ in solid angle by no more than a few times.
    areas = np.linalg.norm(np.cross(from_square(a + 1e-5, b) - omega, from_square(a, b + 1e-5) - omega), axis=1) * 1e10
    assert areas.min() > 1.5
    assert areas.max() < 11


def test_lambert_has_none():
    table = bandwidth_table(lambert(0.5), 64)
    assert table.isotropic
    assert not np.asarray(table.values).any()
    assert float(_closed_form(lambert(0.5), UP, UP)) == 0


@pytest.mark.parametrize(
    "exponent", [pytest.param(4, marks=pytest.mark.slow), 20, pytest.param(100, marks=pytest.mark.slow), 500]
)
def test_lobes_by_wavelets_are_near_their_closed_form(exponent: int):
    """Within what the square stretches angles, √3, and half an octave, which is what a wavelet's level tells."""
    brdf = white_phong(exponent)
    omega_o, mirror = np.asarray([[0.6, 0, 0.8], [-0.6, 0, 0.8]], np.float32)
    bandwidth, wanted = look_up(bandwidth_table(brdf, 128), mirror, omega_o), float(_closed_form(brdf, mirror, omega_o))
    assert wanted / 2.45 <= bandwidth <= 2.45 * wanted


def test_sharper_lobes_have_more():
    bandwidths = [look_up(bandwidth_table(phong(0, 0.5, n), 64), UP, UP) for n in (2, 20, 200)]
    assert bandwidths == sorted(bandwidths)
    assert bandwidths[2] > 3 * bandwidths[0]


def test_an_isotropic_table_turns():
    table = bandwidth_table(phong(0, 0.5, 50), 64)
    one = look_up(table, [-0.6, 0, 0.8], [0.6, 0, 0.8])
    other = look_up(table, [0, -0.6, 0.8], [0, 0.6, 0.8])
    assert one == other > 0


def test_principal_components_hold_most():
    table = bandwidth_table(phong(0.1, 0.4, 30), 64)
    errors = [compressed(table, k)[1] for k in (0, 4, 8, 16)]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 1e-5
    assert errors[2] < 0.5 * errors[0]


def spatial(exponent) -> PackedLobes:
    """Maps that differ by texel in their exponents alone."""
    h, w = exponent.shape

    def everywhere(value):
        return jnp.asarray(np.broadcast_to(np.asarray(value, np.float32), (h, w, *np.shape(value))))

    return SpatialLobes(
        diffuse=everywhere([0.2] * 3),
        C=everywhere([[-1, -1, 1]]),
        exponent=jnp.asarray(exponent[..., None].astype(np.float32)),
        scale=everywhere([[0.3] * 3]),
        axis=everywhere([1, 0]),
    ).packed()


def test_maps_vary_where_any_of_their_parameters_does():
    exponent = np.full((64, 64), 20.0)
    exponent[:32, :32] = np.where(np.indices((32, 32)).sum(axis=0) % 2, 5, 200)
    bandwidth = np.asarray(texture_bandwidth(spatial(exponent)).pixels)[..., 0]
    assert bandwidth[4:28, 4:28].min() > 0.3
    assert bandwidth[44:52, 44:52].max() < 0.1
    assert not np.asarray(texture_bandwidth(spatial(np.full((64, 64), 20.0))).pixels).any()


@pytest.mark.parametrize("shape", [(1, 64), (1, 1), (40, 24)])
def test_maps_of_any_size_have_a_bandwidth(shape):
    pixels = np.random.default_rng(0).uniform(1, 100, (*shape, 13)).astype(np.float32)
    bandwidth = texture_bandwidth(PackedLobes(Texture(jnp.asarray(pixels)), lobes=1, channels=3))
    assert bandwidth.shape == shape
    assert np.isfinite(np.asarray(bandwidth.pixels)).all()
