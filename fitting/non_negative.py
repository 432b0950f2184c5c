"""Linear least squares with non-negative unknowns, of which there are few."""

import itertools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fitting.small_systems import solve_positive


@jax.jit
def solve_non_negative(gram: Float[Array, "m m"], moment: Float[Array, " m"]) -> Float[Array, " m"]:
    """A ≥ 0 that minimises aᵀ gram a − 2 aᵀ moment, for gram = GᵀG and moment = Gᵀy of m ≤ 4 columns G.

    The optimum is the unconstrained one of some set of columns: all 2^m sets are tried, which vectorises over a
    batch. Which set is best is held fixed in derivatives; they are those of the optimum wherever it changes smoothly.
    A column of zeros gets 0. How columns that are multiples of each other share is not defined.
    """
    # Unit columns, and a ridge of rounding's size that decides between dependent ones.
    length = jnp.sqrt(jnp.where(jnp.diagonal(gram) > 0, jnp.diagonal(gram), 1))
    ridge = 10 * float(jnp.finfo(gram.dtype).eps)
    gram = gram / (length[:, None] * length[None]) + ridge * jnp.eye(len(length), dtype=gram.dtype)
    moment = moment / length

    def optimum(among):
        both = among[:, None] & among[None]
        A = jnp.where(both, gram, 0) + jnp.diag(jnp.where(among, 0, 1).astype(gram.dtype))
        return solve_positive(A, jnp.where(among, moment, 0))

    sets = jnp.asarray(np.array(list(itertools.product([False, True], repeat=len(length)))))
    candidates = jax.lax.stop_gradient(jax.vmap(optimum)(sets))
    explained = candidates @ jax.lax.stop_gradient(moment)
    feasible = jnp.all(candidates >= 0, axis=-1)
    best = jnp.argmax(jnp.where(feasible, explained, -jnp.inf))
    return optimum(sets[best]) / length
