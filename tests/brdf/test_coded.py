"""Compact storage of lobes: what rounding does to them, and what there is no place for."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.brdf.coded import decode, encode
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.errors import InputError
from tests.brdf.test_spatial import maps


def lobes_of(exponent: float, texels: int = 64, lobes: int = 1) -> SpatialLobes:
    made = maps(1, texels, lobes, seed=int(exponent))
    return dataclasses.replace(made, exponent=jnp.asarray(np.full(made.exponent.shape, exponent, np.float32)))


def values(spatial: SpatialLobes, count: int = 300) -> tuple[np.ndarray, np.ndarray]:
    """Of every texel: what its lobes reflect in some directions [t, p, c], and the most that they reflect [t, 1, 1]."""
    rng = np.random.default_rng(0)
    omega = rng.normal(size=(2, count, 3))
    omega[0] = np.concatenate([omega[1, : count // 2] * [-1, -1, 1], omega[0, count // 2 :]])
    omega /= np.linalg.norm(omega, axis=-1, keepdims=True)
    omega[..., 2] = np.abs(omega[..., 2])
    scale = np.asarray(spatial.scale)
    arrays = (np.asarray(x)[0] for x in (spatial.diffuse, spatial.C, spatial.exponent, scale))
    reflected = np.asarray(_values(*omega.astype(np.float32), *arrays))
    return reflected, scale.sum(axis=2)[0].max(axis=-1)[:, None, None]


@jax.jit
def _values(omega_i, omega_o, *arrays):
    def of_texel(diffuse, C, exponent, scale):
        brdf = LobeSum(diffuse, C[:, None], exponent[:, None], scale)
        return jax.vmap(brdf.evaluate)(omega_i, omega_o)

    return jax.vmap(of_texel)(*arrays)


@pytest.mark.parametrize("exponent", [1, 20, 200, 5000])
@pytest.mark.parametrize(("storage", "most"), [("half", 6e-4), ("8bit", 0.02)])
def test_rounding_moves_no_lobe_far_from_its_peak(storage, most, exponent):
    lobes = lobes_of(exponent)
    rounded, peak = values(decode(encode(lobes, storage), 1))
    wanted, _ = values(lobes)
    assert np.abs(wanted).max() > 0.1
    assert (np.abs(rounded - wanted) / (peak + 1)).max() < most


@pytest.mark.parametrize("exponent", [0, 0.3])
@pytest.mark.parametrize(("storage", "most"), [("half", 1e-3), ("8bit", 2e-3)])
def test_rounding_moves_c_little_where_its_power_is_flat(storage, most, exponent):
    lobes = lobes_of(exponent)
    np.testing.assert_allclose(decode(encode(lobes, storage), 1).C, lobes.C, atol=most)


def test_float_is_exact():
    lobes = maps(3, 4, 3)
    jax.tree.map(np.testing.assert_array_equal, decode(encode(lobes, "float"), 3), lobes)


@pytest.mark.parametrize(("storage", "number", "bytes_of_lobe"), [("half", np.float16, 14), ("8bit", np.float16, 9)])
def test_what_a_lobe_takes(storage, number, bytes_of_lobe):
    planes = encode(maps(2, 2, 1), storage)
    assert {plane.dtype for plane in planes.values()} == {np.dtype(number)}
    mine = [plane for name, plane in planes.items() if name.startswith("lobe0")]
    assert len(mine) * (2 if storage == "half" else 1) == bytes_of_lobe
    if storage == "8bit":
        for plane in planes.values():
            np.testing.assert_array_equal(plane, np.clip(np.rint(plane), 0, 255))


@pytest.mark.parametrize("storage", ["half", "8bit"])
def test_extremes_come_back(storage):
    """C of signs, zeros and no direction at all; black lobes; exponents 0 and 1e4; no lobe."""
    C = np.array([[1, 0, -1], [0, 0, 0], [-1, -0.999, 1], [0, -1, 1e-30], [-1, -1, 0.5], [-1, -1, 1e-3]], np.float32)
    n = np.array([10, 3, 1e4, 2, 0, 1e4], np.float32)
    scale = np.array([[1, 0, 1e-6], [1, 1, 1], [500, 10, 1], [0, 0, 0], [1, 2, 3], [4000, 1, 0]], np.float32)
    axis = np.tile([np.cos(1), np.sin(1)], (6, 1))
    arrays = np.full((6, 3), 0.25), C[:, None], n[:, None], scale[:, None], axis
    lobes = SpatialLobes(*(jnp.asarray(a[None].astype(np.float32)) for a in arrays))
    back = jax.tree.map(np.asarray, decode(encode(lobes, storage), 1))
    assert all(np.isfinite(leaf).all() for leaf in jax.tree.leaves(back))
    np.testing.assert_array_equal(np.sign(back.C[0, [0, 1, 2, 4], 0]), np.sign(C[[0, 1, 2, 4]]))
    np.testing.assert_allclose(np.abs(back.C[0, [0, 2, 3, 4, 5], 0]).max(axis=-1), 1, rtol=1e-6)
    np.testing.assert_allclose(back.exponent[0, :, 0], n, rtol=0.04)
    off = np.abs(np.asarray(back.scale[0, :, 0]) - scale) / np.maximum(scale.max(axis=-1), 1e-9)[:, None]
    assert off.max() < 0.02 + (0.02 if storage == "8bit" else 0)
    np.testing.assert_allclose(back.diffuse, 0.25, atol=2e-3)
    np.testing.assert_allclose(back.axis, lobes.axis, atol=1e-3)
    assert decode(encode(maps(2, 3, 0), storage), 0).C.shape == (2, 3, 0, 3)


@pytest.mark.parametrize(("storage", "most"), [("half", 65504), ("8bit", 1e5)])
def test_exponents_beyond_the_largest_are_held_and_reflect_what_they_did(storage, most):
    lobes = lobes_of(3e5, 8)
    back, lobes = (jax.tree.map(np.asarray, one) for one in (decode(encode(lobes, storage), 1), lobes))
    np.testing.assert_allclose(back.exponent, most, rtol=1e-3)
    held, given = (np.asarray(one.scale / (one.exponent + 2)[..., None]) for one in (back, lobes))
    np.testing.assert_allclose(held, given, atol=given.max() / 200)


@pytest.mark.parametrize(
    ("storage", "change", "message"),
    [
        ("8bit", {"diffuse": 1e5}, r"diffuse reaches 100,000, and 8bit storage holds 65,504 at most; use float"),
        ("half", {"scale": 1e6, "exponent": 1.0}, r"scale/\(n \+ 2\) reaches 333,333"),
    ],
)
def test_what_has_no_place_is_refused(storage, change, message):
    lobes = maps(2, 2, 1)
    arrays = {name: jnp.asarray(np.full_like(getattr(lobes, name), value)) for name, value in change.items()}
    with pytest.raises(InputError, match=message):
        encode(dataclasses.replace(lobes, **arrays), storage)
