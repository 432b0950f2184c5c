"""Numbers of the host as arrays of the device, without compiling anything for them."""

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer
from jax.typing import ArrayLike, DTypeLike
from jaxtyping import Array


def as_array(values: ArrayLike | list | tuple, dtype: DTypeLike | None = None) -> Array:
    """What `jnp.asarray` makes of numbers, which NumPy converts: JAX would compile a program for each of their shapes.

    Arrays of JAX pass through, also while they are traced.
    """
    if isinstance(values, jax.Array):
        return jnp.asarray(values, dtype)
    host = np.asarray(values)
    # The dtype is as JAX is set: float64 only if it is enabled.
    wanted = jax.dtypes.canonicalize_dtype(host.dtype if dtype is None else dtype)
    # What NumPy does not copy is not copied here either, as by `jnp.asarray`.
    return jnp.asarray(host.astype(wanted, copy=False), wanted)


def is_traced(tree: object) -> bool:
    """Whether any array of a pytree is traced, so that its numbers are not known."""
    return any(isinstance(leaf, Tracer) for leaf in jax.tree.leaves(tree))


def on_host(values: Array | np.ndarray) -> Array | np.ndarray:
    """NumPy's array of numbers that are known, whose steps compile nothing; a traced one as it is."""
    return values if isinstance(values, Tracer) else np.asarray(values)
