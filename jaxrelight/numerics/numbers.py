"""Numbers as users give them: what is known is checked and computed with on the host, what is traced passes to JAX.

Constructors take numbers of Python and arrays of NumPy or JAX. `jax.grad`, `jax.jit` and `jax.vmap` hand them tracers:
those have shapes, which are checked, but no values that could be. Whatever is known is converted by NumPy, for which
nothing is compiled, see `as_array`.
"""

import functools
from collections.abc import Callable, Sequence
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jaxtyping import Array, Real

# One number.
Number = Real[Array | np.ndarray, ""] | np.number | float
# Three numbers.
Vector = Real[Array | np.ndarray, "3"] | Sequence[Number]
# A number, or an array or nested sequences of them, of the shapes that a docstring names.
Numbers = Number | Real[Array | np.ndarray, "..."] | Sequence[Number] | Sequence[Sequence[Number]]


def is_known(*values: Any) -> bool:
    """Whether none of the numbers is traced."""
    return not any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(values))


def as_numbers(values: Numbers) -> Any:
    """Numbers as an array to check and to compute with: of NumPy in float64 where they are known, else of JAX."""
    return np.asarray(values, float) if is_known(values) else jnp.asarray(values, float_dtype(values))


def module_of(*arrays: Any) -> Any:
    """The module whose functions compute with arrays of `as_numbers`: `numpy` where all are known, else `jax.numpy`."""
    return np if is_known(*arrays) else jnp


def holds(condition: Callable[..., Any], *arrays: Any) -> bool:
    """Whether a condition on arrays is true of all their components; traced ones are taken to meet it."""
    return not is_known(*arrays) or bool(np.all(condition(*arrays)))


def given_dtype(*values: Any) -> np.dtype:
    """The floating type that numbers ask for: at least float32.

    It is that of the arrays among them, as JAX promotes types; numbers of Python, and arrays of integers, leave it to
    them, and ask for float64 where there are no others.
    """
    leaves = [leaf for leaf in jax.tree.leaves(values) if hasattr(leaf, "dtype")]
    # A number of Python that is traced is an array, too, but for its type.
    typed = [leaf.dtype for leaf in leaves if not getattr(leaf, "weak_type", False)]
    floating = [dtype for dtype in typed if jnp.issubdtype(dtype, jnp.floating)]
    return np.dtype(functools.reduce(jnp.promote_types, floating, jnp.float32) if floating else np.float64)


def float_dtype(*values: Any) -> np.dtype:
    """`given_dtype` as JAX is set: float32 unless float64 is enabled. Also of the arrays of a whole BRDF or light."""
    return jax.dtypes.canonicalize_dtype(given_dtype(*values))


def shown(values: Any) -> str:
    """Numbers as a message quotes them."""
    if is_known(values):
        return f"{values:g}" if isinstance(values, float) else repr(values)
    return f"a traced array of the shape {as_numbers(values).shape}"
