"""BRDFs and materials made of traced numbers, and the types of what is made: as of known numbers, derivatives too."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import InputError
from jaxrelight.brdf.albedo import largest_albedo, mean_albedo
from jaxrelight.brdf.factored import Factored
from jaxrelight.brdf.lobe_sampling import LobeSampler
from jaxrelight.brdf.lobes import LobeSum, lambert, lobe, lobe_sum, phong
from jaxrelight.brdf.material import (
    Component,
    Material,
    as_material,
    textured_lambert,
    textured_phong,
    white_phong,
)
from jaxrelight.brdf.pairs import spread_pairs
from jaxrelight.brdf.sampling import CellSampler, directional_albedo
from jaxrelight.brdf.separable import separable
from jaxrelight.brdf.texture import Texture, constant
from tests.compilations import compilations

OMEGA_I, OMEGA_O = np.array([-0.48, 0.36, 0.8]), np.array([0.36, 0.48, 0.8])

# Of a number near 1, as it may stand in every argument.
MADE: dict[str, Any] = {
    "lambert": lambda k: lambert(0.4 * k),
    "lambert by channel": lambda k: lambert([0.4 * k, 0.2, 0.1]),
    "phong, diffuse": lambda k: phong([0.1, 0.3 * k, 0.1], 0.5, 10.0),
    "phong, specular": lambda k: phong(0.2, 0.5 * k, 10.0),
    "phong, exponent": lambda k: phong(0.2, [0.5, 0.4, 0.3], 10 * k),
    "phong, exponent by channel": lambda k: phong(0.2, 0.5, [10 * k, 3, 4 * k]),
    "lobe, C": lambda k: lobe_sum(0.1, [lobe([-k, -1.2, 0.9 * k], 5, specular=0.3)]),
    "lobe, C by channel": lambda k: lobe_sum(0.1, [lobe([[-k, -1.2, 0.9], [-1, -k, 1], [1, 1, k]], 5, peak=0.3)]),
    "lobe, all": lambda k: lobe_sum(k / 9, [lobe([-0.9, -0.8, 0.7 * k], 3 * k, peak=k), lobe([1, 1, -1], 2, peak=k)]),
    "lobes, turn": lambda k: lobe_sum(0.1, [lobe([-1, -0.5, 0.9], 5, specular=k)], turn=k),
    "ashikhmin_shirley": lambda k: jr.ashikhmin_shirley(0.3 * k, [0.2, 0.1 * k, 0.3], 10 * k, 20 * k),
    "constant": lambda k: Material((Component(lambert(0.5 * k), (constant([k, 0.5, 0.1]), constant(k))),)),
    "textured_lambert": lambda k: textured_lambert(constant(0.3 * k)),
    "textured_phong": lambda k: textured_phong(constant([0.1, 0.2 * k, 0.3]), constant(0.4 * k), 8 * k),
    "white_phong": lambda k: white_phong([3 * k, 4.0, 5.0]),
    "separable": lambda k: separable(Factored(jnp.ones((1, 1, 1, 1)) * k, jnp.ones((1, 3, 1, 1)))),
    "factor": lambda k: separable(jr.factor(lambert(0.3 * k))),
}


def content(made) -> Any:
    """All numbers of what was made, each with a weight of its own, together."""
    leaves = [leaf.ravel() for leaf in jax.tree.leaves(made)]
    return sum((leaf * (1 + np.arange(len(leaf)) / 7 + i)).sum() for i, leaf in enumerate(leaves))


def test_traced_numbers_make_what_known_ones_make_and_have_its_derivatives(x64):
    """Under `jit` and `vmap`, and by reverse mode against central differences of what is made outside of JAX."""

    def total(numbers):
        made = {name: make(numbers[name]) for name, make in MADE.items()}
        return sum(map(content, made.values())), made

    places, step = np.array([0.8, 1.1]), 1e-6
    slopes, made = jax.jit(jax.vmap(jax.grad(total, has_aux=True)))(dict.fromkeys(MADE, places))
    for name, make in MADE.items():
        for i, k in enumerate(places.tolist()):
            for traced, wanted in zip(jax.tree.leaves(made[name]), jax.tree.leaves(make(k)), strict=True):
                np.testing.assert_allclose(traced[i], wanted, rtol=1e-13, err_msg=name)
            high, low = (content(jax.tree.map(np.asarray, make(k + by))) for by in (step, -step))
            assert slopes[name][i] == pytest.approx((high - low) / (2 * step), rel=1e-6), name
            assert slopes[name][i] != 0, name


def test_a_lobe_is_differentiated_in_what_it_is_made_of():
    """A Phong lobe is linear in its specular albedo."""
    omega_i, omega_o = OMEGA_I.astype(np.float32), OMEGA_O.astype(np.float32)
    slope = jax.jit(jax.grad(lambda k: jr.phong(0.2, k, 10.0).evaluate(omega_i, omega_o).sum()))(0.5)
    lobe_alone = 3 * 12 / (2 * np.pi) * np.dot(OMEGA_I * [-1, -1, 1], OMEGA_O) ** 10
    assert slope == pytest.approx(lobe_alone, rel=1e-4)


def test_materials_pass_through_jax():
    material = jax.jit(lambda k: textured_phong(constant(k), constant([k, 0.1, 0.2]), 10 * k))(0.5)
    assert [type(part.brdf) for part in material.components] == [LobeSum, LobeSum]
    np.testing.assert_allclose(material.components[1].weight[0].pixels[0, 0], [0.5, 0.1, 0.2])
    np.testing.assert_allclose(material.components[1].brdf.exponent, 5)


@pytest.mark.usefixtures("wrong_types")
@pytest.mark.parametrize(
    ("make", "what"),
    [
        (lambda k: lobe([k, 1], 2, peak=1), "three numbers"),
        (lambda k: lobe([k, 1, 1], -1, peak=1), "at least 0"),
        (lambda k: lobe([k, 1, 1], 1, peak=np.nan), "must be finite"),
        (lambda k: lobe([k, 1, 1], 1), "exactly one of"),
        (lambda k: jr.ashikhmin_shirley(k, 1.5, 1, 1), "'ks' must be from 0 to 1"),
        (lambda k: jr.ashikhmin_shirley(k, 0.5, k, -1), "'nv' must be one finite number of at least 0"),
        (lambda k: jr.ashikhmin_shirley(0.5, 0.5, [k, k], 1), "'nu' must be one finite number"),
    ],
)
def test_beside_traced_numbers_shapes_and_known_numbers_are_checked(make, what):
    with pytest.raises(InputError, match=what):
        jax.eval_shape(lambda k: (make(k), None)[1], 1.0)


def test_known_numbers_compile_nothing():
    five = [lobe(np.full((3, 3), 0.1 * i + 0.2), [1, 2, 3], specular=0.3) for i in range(5)]
    given = jax.device_put(np.full(3, 0.3, np.float32))
    with compilations() as compiled:
        lobe_sum(given, five, turn=0.2)
        lobe_sum(0.2, [])
        phong(0.2, given, [1, 2, 3])
        jr.ashikhmin_shirley(given, 0.2, 3, 4.0)
        textured_phong(constant(np.arange(7.0)), constant(given), np.arange(7))
    assert not compiled


# Types: what is asked of shapes only is not compiled.


def typed(dtype) -> dict[str, Any]:
    """BRDFs of arrays of a type, beside which stand numbers of Python."""
    k = np.ones((), dtype)
    rows = np.linspace(0.1, 1, 16, dtype=dtype).reshape(1, 1, 4, 4)
    made = {name: make(k) for name, make in MADE.items() if name not in ("separable", "factor")}
    return made | {"separable": separable(Factored(rows, np.concatenate([rows] * 3, axis=1)))}  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_all_that_is_made_has_the_type_of_the_arrays_given(x64, dtype):
    omega_i: Any = OMEGA_I.astype(dtype)
    omega_o: Any = OMEGA_O.astype(dtype)
    key = jax.random.key(0)
    for name, surface in typed(dtype).items():
        assert {leaf.dtype for leaf in jax.tree.leaves(surface)} == {np.dtype(dtype)}, name
        brdf: Any = as_material(surface).components[-1].brdf

        def outcomes(brdf=brdf):
            cells = CellSampler(brdf, omega_o, 2, 4)
            results = [brdf.evaluate(omega_i, omega_o), directional_albedo(brdf, omega_o, 2, 4)]
            results += [cells.sample(key), cells.pdf(omega_i)]
            if isinstance(brdf, LobeSum):
                sampler = LobeSampler(brdf, omega_o)
                results += [brdf.peak(omega_o), brdf.normal_albedo, sampler.sample(key), sampler.pdf(omega_i)]
            return results

        assert {leaf.dtype for leaf in jax.tree.leaves(jax.eval_shape(outcomes))} == {np.dtype(dtype)}, name


def test_numbers_of_python_have_the_type_that_jax_is_set_to():
    assert {leaf.dtype for make in MADE.values() for leaf in jax.tree.leaves(make(1.0))} == {np.dtype(np.float32)}
    with jax.enable_x64(True):
        assert {leaf.dtype for make in MADE.values() for leaf in jax.tree.leaves(make(1.0))} == {np.dtype(np.float64)}
        assert {side.dtype for side in spread_pairs(3)} == {np.dtype(np.float64)}


@jax.jit
def _pairs(brdfs, omega_i, omega_o):
    return [jax.vmap(brdf.evaluate)(omega_i, omega_o) for brdf in brdfs]


def test_in_float64_reciprocity_and_energy_hold_to_a_trillionth(x64):
    """At the normal the share that a lobe cos^n reflects is a polynomial's integral, which Gauss's rule has exactly."""
    diffuse, specular = np.array([0.1, 0.3, 0.7]), np.array([0.6, 0.1, 0.2])
    brdfs = [
        lambert(diffuse),
        phong(diffuse, specular, 7),
        lobe_sum(diffuse, [lobe([-1, -1, 1], 7.0, peak=specular * 9 / (2 * np.pi))]),
        jr.ashikhmin_shirley(0.3, 0.7, 10, 100),
    ]
    node, weight = np.polynomial.legendre.leggauss(32)
    z = (node + 1) / 2
    omega_i = np.stack([np.sqrt(1 - z * z), 0 * z, z], axis=1)
    up = np.tile([0.0, 0, 1], (32, 1))
    for brdf, albedo, values in zip(
        brdfs, [diffuse, diffuse + specular, diffuse + specular], _pairs(brdfs, omega_i, up), strict=False
    ):
        np.testing.assert_allclose(np.pi * (weight * z) @ values, albedo, rtol=1e-12)
        np.testing.assert_allclose(brdf.normal_albedo if isinstance(brdf, LobeSum) else albedo, albedo, rtol=1e-12)
    one, other = (np.asarray(side) for side in spread_pairs(32))
    for there, back in zip(_pairs(brdfs, one, other), _pairs(brdfs, other, one), strict=True):
        np.testing.assert_allclose(there, back, rtol=1e-12)
    white = textured_lambert(Texture(diffuse[None, None]))  # pyright: ignore[reportArgumentType]
    assert largest_albedo(white) == pytest.approx(0.7, rel=1e-12)
    np.testing.assert_allclose(mean_albedo(brdfs[0]), diffuse, rtol=1e-12)
