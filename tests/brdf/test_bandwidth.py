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
from jaxrelight.brdf.spatial import PackedLobes, SpatialLobes


def test_square_and_back():
    a, b = np.random.default_rng(0).random((2, 256))
    omega = from_square(a, b)
    assert (omega[:, 2] >= 0).all()
    np.testing.assert_allclose(np.linalg.norm(omega, axis=1), 1, rtol=1e-12)
    found = jax.vmap(to_square)(jnp.asarray(omega, jnp.float32))
    np.testing.assert_allclose(np.stack(found), np.stack([a, b]), atol=1e-6)
    # Cells differ in solid angle by no more than a few times.
    areas = np.linalg.norm(np.cross(from_square(a + 1e-5, b) - omega, from_square(a, b + 1e-5) - omega), axis=1) * 1e10
    assert areas.min() > 1.5
    assert areas.max() < 11


def test_lambert_has_none():
    table = bandwidth_table(lambert(0.5), 64)
    assert table.isotropic
    assert not np.asarray(table.values).any()
    up = jnp.asarray([0.0, 0, 1])
    assert float(lobe_bandwidth(lambert(0.5), up, up)) == 0


@pytest.mark.parametrize(
    "exponent", [pytest.param(4, marks=pytest.mark.slow), 20, pytest.param(100, marks=pytest.mark.slow), 500]
)
def test_lobes_by_wavelets_are_near_their_closed_form(exponent: int):
    """Within what the square stretches angles, √3, and half an octave, which is what a wavelet's level tells."""
    brdf = phong(0, 0.5, exponent)
    omega_o = jnp.asarray([0.6, 0, 0.8])
    mirror = jnp.asarray([-0.6, 0, 0.8])
    table = bandwidth_table(brdf, 256)
    found, wanted = float(table.look_up(mirror, omega_o)), float(lobe_bandwidth(brdf, mirror, omega_o))
    assert wanted / 2.45 <= found <= 2.45 * wanted


def test_sharper_lobes_have_more():
    up = jnp.asarray([0.0, 0, 1])
    found = [float(bandwidth_table(phong(0, 0.5, n), 64).look_up(up, up)) for n in (2, 20, 200)]
    assert found == sorted(found)
    assert found[2] > 3 * found[0]


def test_an_isotropic_table_turns():
    table = bandwidth_table(phong(0, 0.5, 50), 64)
    one = table.look_up(jnp.asarray([-0.6, 0, 0.8]), jnp.asarray([0.6, 0, 0.8]))
    other = table.look_up(jnp.asarray([0, -0.6, 0.8]), jnp.asarray([0, 0.6, 0.8]))
    assert float(one) == float(other) > 0


def test_principal_components_hold_most():
    table = bandwidth_table(phong(0.1, 0.4, 30), 64)
    errors = [compressed(table, k)[1] for k in (0, 2, 4, 8, 16)]
    assert errors == sorted(errors, reverse=True)
    assert errors[-1] < 1e-5
    assert errors[3] < 0.5 * errors[0]


def spatial(exponent) -> PackedLobes:
    """Maps that differ by texel in their exponents alone."""
    h, w = exponent.shape

    def everywhere(value):
        value = jnp.asarray(value, jnp.float32)
        return jnp.broadcast_to(value, (h, w, *value.shape))

    return SpatialLobes(
        diffuse=everywhere([0.2] * 3),
        C=everywhere([[-1, -1, 1]]),
        exponent=jnp.asarray(exponent[..., None], jnp.float32),
        scale=everywhere([[0.3] * 3]),
        axis=everywhere([1, 0]),
    ).packed()


def test_maps_vary_where_any_of_their_parameters_does():
    exponent = np.full((64, 64), 20.0)
    exponent[:32, :32] = np.where(np.indices((32, 32)).sum(axis=0) % 2, 5, 200)
    found = np.asarray(texture_bandwidth(spatial(exponent)).pixels)[..., 0]
    assert found[4:28, 4:28].min() > 0.3
    assert found[44:52, 44:52].max() < 0.1
    assert not np.asarray(texture_bandwidth(spatial(np.full((16, 16), 20.0))).pixels).any()


@pytest.mark.parametrize("shape", [(1, 64), (1, 1), (40, 24)])
def test_maps_of_any_size_have_a_bandwidth(shape):
    found = texture_bandwidth(spatial(np.random.default_rng(0).uniform(1, 100, shape)))
    assert found.shape == shape
    assert np.isfinite(found.pixels).all()
