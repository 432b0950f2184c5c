"""Functions of a few shared parameters: the derivatives of the function as it is, in both modes and arguments."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxrelight.numerics.few_parameters import of_few_parameters
from tests.operators.derivatives import derivatives


def lobe(parameters, others):
    """A few numbers, and an item with an index, which has no derivative."""
    (table, x), index = others
    power = jnp.exp(parameters["n"] * jnp.log(x[0] ** 2 + 0.5))
    return parameters["scale"] * (power + table[index])


def total(function):
    def of(parameters, table, x):
        return jax.vmap(lambda x, index: function(parameters, ((table, x), index)))(x, jnp.arange(5) % 3)

    return of


@pytest.mark.usefixtures("x64")
def test_derivatives_are_those_of_the_function():
    generator = np.random.default_rng(0)
    at = {"n": np.array(3.0), "scale": np.array([0.5, 0.2, 0.1])}, generator.random((3, 3)), generator.random((5, 2))
    along = jax.tree.map(lambda of: generator.normal(size=of.shape), at)
    cotangent = generator.normal(size=(5, 3))
    plain, wrapped = (derivatives(total(one))(at, along, cotangent) for one in (lobe, of_few_parameters(lobe)))
    for one, other in zip(jax.tree.leaves(wrapped), jax.tree.leaves(plain), strict=True):
        np.testing.assert_allclose(one, other, rtol=1e-12)


@pytest.mark.slow
@pytest.mark.usefixtures("x64")
def test_second_derivatives_and_those_of_others_alone():
    generator = np.random.default_rng(1)
    table, x = jnp.asarray(generator.random((3, 3))), generator.random((5, 2))

    def loss(function):
        def of(n):
            return jnp.sum(total(function)({"n": n, "scale": jnp.ones(3)}, table, x) ** 2)

        return of

    curvature, wanted = (jax.grad(jax.grad(loss(one)))(2.0) for one in (of_few_parameters(lobe), lobe))
    np.testing.assert_allclose(curvature, wanted, rtol=1e-12)
    fixed = {"n": np.array(2.0), "scale": np.ones(3)}

    def of_table(one):
        return jax.grad(lambda t: jnp.sum(total(one)(fixed, t, x) ** 2))(table)

    slopes, wanted = of_table(of_few_parameters(lobe)), of_table(lobe)
    np.testing.assert_allclose(slopes, wanted, rtol=1e-12)
