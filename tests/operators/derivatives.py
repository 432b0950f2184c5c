"""Derivatives in both modes against central differences, with one compiled program for all of it."""

from collections.abc import Callable

import jax
import numpy as np
from jax.test_util import check_jvp, check_vjp


def derivatives(function: Callable) -> Callable:
    """The program of arguments, a direction and a cotangent, that gives the value and both modes' derivatives.

    These are the value, its derivative in the direction, and the gradients of its product with the cotangent.
    """

    @jax.jit
    def everything(primals, tangents, cotangent):
        value, along = jax.jvp(function, primals, tangents)
        _, pull = jax.vjp(function, *primals)
        return value, along, pull(cotangent)

    return everything


def check_derivatives(function: Callable, arguments: tuple) -> Callable:
    """What `check_grads` checks of both modes, to first order: within 1e-5 in float64.

    Every value, numerical differences too, comes from the program that has the derivatives: compiling is what takes
    time. Arguments become arrays of NumPy, so that nothing else is compiled.

    Args:
        function: of arrays, to a tree of arrays.
        arguments: where it is differentiated.

    Returns:
        The program of `derivatives`.
    """
    everything = derivatives(function)
    arguments = jax.tree.map(np.asarray, arguments)
    nothing = jax.tree.map(lambda x: np.zeros(x.shape, x.dtype), jax.eval_shape(function, *arguments))

    def value(*primals):
        return everything(primals, primals, nothing)[0]

    def forward(primals, tangents):
        return everything(primals, tangents, nothing)[:2]

    def backward(*primals):
        return value(*primals), lambda cotangent: everything(primals, primals, cotangent)[2]

    check_jvp(value, forward, arguments)
    check_vjp(value, backward, arguments)
    return everything
