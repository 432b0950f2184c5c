"""Systems of a few unknowns, written out entry by entry so that a batch of them vectorises."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


@jax.jit
def solve_positive(A: Float[Array, "k k"], b: Float[Array, " k"]) -> Float[Array, " k"]:
    """X with A x = b for a symmetric positive definite A, by Cholesky's factorisation.

    LAPACK is called once for every matrix of a batch; up to about ten unknowns the written-out form is faster.
    A pivot that rounding made negative counts as the smallest number of its type.
    """
    k = b.shape[0]
    least = jnp.finfo(A.dtype).tiny
    L = [[A[i, j] for j in range(k)] for i in range(k)]
    x = [b[i] for i in range(k)]
    for j in range(k):
        pivot = L[j][j] - sum(L[j][m] * L[j][m] for m in range(j))
        inverse = 1 / jnp.sqrt(jnp.maximum(pivot, least))
        L[j][j] = inverse
        for i in range(j + 1, k):
            L[i][j] = (L[i][j] - sum(L[i][m] * L[j][m] for m in range(j))) * inverse
    for i in range(k):
        x[i] = (x[i] - sum(L[i][m] * x[m] for m in range(i))) * L[i][i]
    for i in reversed(range(k)):
        x[i] = (x[i] - sum(L[m][i] * x[m] for m in range(i + 1, k))) * L[i][i]
    return jnp.stack(x)
