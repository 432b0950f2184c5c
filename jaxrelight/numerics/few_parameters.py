"""Functions of a few parameters that many items share: differentiated in those in forward mode, also in reverse."""

from collections.abc import Callable
from typing import Any, TypeVar

import jax
import jax.numpy as jnp
from jax.custom_derivatives import SymbolicZero
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float, PyTree

ParametersT = TypeVar("ParametersT")
OthersT = TypeVar("OthersT")


def of_few_parameters(
    function: Callable[[ParametersT, OthersT], Float[Array, " c"]],
) -> Callable[[ParametersT, OthersT], Float[Array, " c"]]:
    """The same function of (parameters, others), whose derivative in the parameters is its written-out Jacobian.

    Reverse mode through a long chain of steps keeps all of them for every item, and sums over the items at every use of
    a parameter. The Jacobian of c results in q parameters costs q forward derivatives, which share the steps, and is
    all that is kept: c q numbers an item. Both modes and all orders are those of the function.

    Args:
        function: of a pytree of few numbers and one of anything else; gives one array. vmap it over items.
    """

    @jax.custom_jvp
    def wrapped(parameters: Any, others: Any) -> Array:
        return function(parameters, others)

    def rule(primals: tuple[Any, Any], tangents: tuple[Any, Any]) -> tuple[Array, Array]:
        (parameters, others), (along_parameters, along_others) = primals, tangents
        moved, put_parameters = _moved(parameters, along_parameters)
        moved_others, put_others = _moved(others, along_others)
        tangent = None
        if moved_others:
            starts, ways = zip(*moved_others, strict=True)
            value, tangent = jax.jvp(lambda *some: function(parameters, put_others(some)), starts, ways)
        if moved:
            starts, ways = zip(*moved, strict=True)
            flat, shaped = ravel_pytree(starts)

            def of_flat(numbers):
                result = function(put_parameters(shaped(numbers)), others)
                return result, result

            jacobian, value = jax.jacfwd(of_flat, has_aux=True)(flat)
            own = jnp.matmul(jacobian, ravel_pytree(ways)[0], precision="highest")
            tangent = own if tangent is None else tangent + own
        elif tangent is None:
            value = function(parameters, others)
            tangent = jnp.zeros_like(value)
        return value, tangent

    wrapped.defjvp(rule, symbolic_zeros=True)
    return wrapped


def _moved(tree: PyTree, along: PyTree) -> tuple[list[tuple[Array, Array]], Callable[[Any], PyTree]]:
    """The leaves that have a tangent, with it, and what puts others in their places."""
    leaves, structure = jax.tree.flatten(tree)
    ways = jax.tree.leaves(along, is_leaf=lambda of: isinstance(of, SymbolicZero))
    is_moved = [not isinstance(way, SymbolicZero) and way.dtype != jax.dtypes.float0 for way in ways]
    chosen = [number for number, moves in enumerate(is_moved) if moves]

    def put(some: Any) -> PyTree:
        replaced = list(leaves)
        for number, leaf in zip(chosen, some, strict=True):
            replaced[number] = leaf
        return jax.tree.unflatten(structure, replaced)

    return [(leaves[number], ways[number]) for number in chosen], put
