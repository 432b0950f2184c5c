"""BRDFs as JSON and back, to the last bit."""

import dataclasses
import json
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.brdf.ashikhmin_shirley import ashikhmin_shirley
from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.lobes import lambert, lobe, lobe_sum, phong
from jaxrelight.brdf.parametrisation import POLAR
from jaxrelight.brdf.record import from_record, to_record
from jaxrelight.brdf.separable import Separable
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.brdf.tabulated import Tabulated
from jaxrelight.errors import InputError
from tests.brdf.test_spatial import maps

BRDFS = {
    "lambert": lambda dtype: lobe_sum([0.1, 1 / 3, 0.7], [], dtype),
    "phong": lambda dtype: lobe_sum(0.1, [lobe([-1, -1, 1], 16600 / 3, peak=1e5 / 7)], dtype),
    "lafortune": lambda dtype: lobe_sum(
        [0.1, 0.2, 0.3],
        [lobe(np.array([[-0.9, -0.9, 0.7], [-1.1, -1, 0.5], [0.3, 0.2, 0.8]]), [5, 10, 2.5], peak=[1e-30, 2, 3])],
        dtype,
    ),
    "tabulated": lambda dtype: Tabulated(jnp.asarray(np.random.default_rng(0).random((2, 3, 4, 3)).astype(dtype))),
    "separable": lambda dtype: Separable(
        jnp.asarray(np.random.default_rng(0).random((2, 1, 4, 4)).astype(dtype)),
        jnp.asarray(np.random.default_rng(1).random((2, 3, 4, 4)).astype(dtype)),
        POLAR,
    ),
    "spatial": lambda dtype: jax.tree.map(lambda x: jnp.asarray(np.asarray(x, dtype)), with_level()),
    "ashikhmin_shirley": lambda dtype: ashikhmin_shirley([0.1, 1 / 3, 0.7], 0.2, 10 / 3, 1e4, dtype),
}


def with_level() -> SpatialLobes:
    return dataclasses.replace(maps(3, 4), coarser=(maps(2, 2, seed=1),))


def equal(one, other) -> bool:
    """To the last bit, and of the same types."""
    pairs = zip(jax.tree.leaves(one), jax.tree.leaves(other), strict=True)
    return jax.tree.structure(one) == jax.tree.structure(other) and all(
        a.dtype == b.dtype and a.shape == b.shape and np.array_equal(np.asarray(a), np.asarray(b)) for a, b in pairs
    )


def round_trip(brdf, dtype):
    kept = []

    def keep(array):
        kept.append(array)
        return str(len(kept) - 1)

    record = json.loads(json.dumps(to_record(brdf, keep), allow_nan=False))
    return from_record(record, lambda name: kept[int(name)], dtype)


@pytest.mark.parametrize("name", BRDFS)
def test_round_trip_is_exact(name):
    brdf = BRDFS[name](jnp.float32)
    assert equal(round_trip(brdf, jnp.float32), brdf)


@pytest.mark.parametrize("name", BRDFS)
def test_round_trip_is_exact_in_float64(x64, name):
    brdf = BRDFS[name](jnp.float64)
    assert {leaf.dtype for leaf in jax.tree.leaves(brdf)} == {np.dtype(np.float64)}
    assert equal(round_trip(brdf, jnp.float64), brdf)


def test_what_comes_back_is_a_brdf():
    for brdf in (lambert(0.5), phong(0.1, 0.5, 20), ashikhmin_shirley(0.5, 0.75, 10, 100)):
        back = round_trip(brdf, jnp.float32)
        assert back.is_constant == brdf.is_constant
        assert isinstance(back, Brdf)
        assert back.channels == 3
        omega = jnp.asarray(np.asarray([0.6, 0, 0.8], np.float32))
        np.testing.assert_array_equal(back.evaluate(omega, omega), brdf.evaluate(omega, omega))


def no_layers(array):
    raise AssertionError("short arrays stand in the record")


def test_other_values_have_another_record():
    assert to_record(phong(0.1, 0.5, 20), no_layers) != to_record(phong(0.1, 0.5, 21), no_layers)
    assert to_record(phong(0.1, 0.5, 20), no_layers) == to_record(phong(0.1, 0.5, 20), no_layers)


def test_long_arrays_stand_elsewhere():
    table = Tabulated(jnp.asarray(np.ones((12, 12, 12, 3), np.float32)))
    record = to_record(table, lambda array: f"table of {array.size}")
    assert record == {"kind": "Tabulated", "arrays": {"values": {"layer": "table of 5184"}}}
    assert equal(from_record(record, lambda name: np.asarray(table.values)), table)


@pytest.mark.parametrize("name", BRDFS)
def test_types_are_kept_unless_another_is_asked_for(x64, name):
    brdf = BRDFS[name](jnp.float64)
    assert equal(round_trip(brdf, None), brdf)
    single = BRDFS[name](jnp.float32)
    assert equal(round_trip(single, None), single)


class Own(Brdf):
    """Somebody's, made of another BRDF, a short and a long table."""

    base: Brdf
    short: jax.Array
    table: np.ndarray
    power: int = eqx.field(static=True)

    def evaluate(self, omega_i, omega_o):
        return self.base.evaluate(omega_i, omega_o) * omega_i[2] ** self.power

    @property
    def channels(self) -> int:
        return self.base.channels

    @property
    def is_constant(self) -> bool:
        return False


def test_a_class_of_ones_own_comes_back():
    """Its long arrays stand elsewhere, beside those of the package's BRDFs; its values change the record."""
    own = Own(lambert(0.3), jnp.arange(3), np.ones(5000, np.float32), 2)
    restored: Any = round_trip(own, None)
    assert type(restored) is Own
    assert type(restored.base) is type(own.base)
    assert (restored.power, restored.short.dtype) == (2, own.short.dtype)
    omega: Any = np.asarray([0.6, 0, 0.8], np.float32)
    np.testing.assert_array_equal(restored.evaluate(omega, omega), own.evaluate(omega, omega))
    record = to_record(own, lambda array: f"table of {array.size}")
    assert record["arrays"]["table"] == {"layer": "table of 5000"}
    other = Own(lambert(0.3), jnp.arange(3), np.ones(5000, np.float32), 3)
    assert to_record(other, lambda array: f"table of {array.size}") != record


def test_a_class_that_is_not_known_is_named():
    record = {"kind": "my_brdfs:Ggx", "arrays": {}, "fields": {}}
    with pytest.raises(InputError, match="the store's material 'skin' is of the class 'Ggx' of the module 'my_brdfs'"):
        from_record(record, str, what="the store's material 'skin'")  # pyright: ignore[reportArgumentType]
