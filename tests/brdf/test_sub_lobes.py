"""Narrower lobes: they add up to the wide one, wherever it points, and as many as its width asks for."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads

from jaxrelight.basis import cubemap
from jaxrelight.brdf.lobes import lambert, lobe, lobe_sum, phong
from jaxrelight.brdf.sub_lobes import PATTERNS, narrower_exponent, narrower_lobes, narrowest, sub_lobes

OMEGA, AREA = cubemap.directions(32), cubemap.solid_angles(32)
PEAKS = np.array([[0, 0, 1], [0.48, 0.6, 0.64], [-0.8, 0.6, 0], [0.6, 0, -0.8]])
_divided = jax.jit(jax.vmap(sub_lobes, in_axes=(0, None, None)), static_argnums=2)


@pytest.mark.parametrize(("exponent", "tolerance"), [(1.0, 0.07), (3.0, 0.03), (10.0, 0.06), (50.0, 0.07)])
@pytest.mark.parametrize("count", [7, 19])
def test_they_add_up_to_the_wide_lobe(exponent: float, tolerance: float, count: int):
    peaks, narrow, shares = _divided(PEAKS.astype(np.float32), np.float32(exponent), count)
    np.testing.assert_allclose(np.sum(shares, axis=1), 1, atol=1e-5)
    np.testing.assert_allclose(np.linalg.norm(peaks, axis=-1), 1, atol=1e-5)
    np.testing.assert_allclose(narrow, narrower_exponent(exponent, count), rtol=1e-5)
    wide = (exponent + 1) * np.maximum(PEAKS @ OMEGA.T, 0) ** exponent
    each = np.maximum(np.asarray(peaks, float) @ OMEGA.T, 0) ** float(narrow[0]) * (float(narrow[0]) + 1)
    total = np.einsum("pj,pjd->pd", shares, each)
    error = np.sqrt(((total - wide) ** 2 * AREA).sum(axis=1) / (wide**2 * AREA).sum(axis=1))
    assert error.max() < tolerance


def test_a_single_one_is_the_lobe_itself():
    peaks, exponent, shares = sub_lobes(jnp.asarray(PEAKS[1]), jnp.asarray(5.0), 1)
    np.testing.assert_allclose(peaks[0], PEAKS[1], atol=1e-7)
    assert (float(exponent), float(shares[0])) == (5, 1)


def test_wider_lobes_are_divided_into_more():
    counts = [narrower_lobes(phong(0.2, 0.5, n), 0.01) for n in (1, 10, 30, 45, 90, 150, 1e4)]
    assert counts == sorted(counts, reverse=True)
    assert {counts[0], counts[-1]} == {max(PATTERNS), 1}
    assert narrower_lobes(phong(0, 1, 10), 0.2) == 1
    # A faint wide lobe beside a strong sharp one does not count.
    both = lobe_sum(0.1, [lobe([-1, -1, 1], 1000, peak=50.0), lobe([-1, -1, 1], 3, peak=1e-6)])
    assert narrower_lobes(both, 0.01) == 1
    assert narrowest(both) == pytest.approx(1 / 1001)
    assert narrowest(lambert(0.5)) == 1


@pytest.mark.parametrize("count", [7, 19])
def test_slopes_are_those_of_differences_and_finite_everywhere(x64, count: int):
    def total(peak, exponent):
        parts = sub_lobes(peak, exponent, count)
        return jnp.sum(parts.shares @ parts.peaks * jnp.arange(1, 4)) + jnp.log(parts.exponent + 2)

    check_grads(jax.jit(total), (PEAKS[1], 11.0), order=1, modes=["fwd", "rev"], rtol=1e-4)
    slopes = jax.jit(jax.grad(total, argnums=(0, 1)))
    for peak in PEAKS:
        for exponent in (0.0, 1.0, 1e5):
            assert all(np.isfinite(slope).all() for slope in slopes(peak, exponent))
