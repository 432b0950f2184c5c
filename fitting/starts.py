"""Where a fit starts: the best of a grid of lobes, tried beside those that are there already."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fitting.non_negative import solve_non_negative

# Powers of 4, so that each is the fourth power of the one before.
EXPONENTS = 4.0 ** np.arange(0, 7)


def directions(anisotropic: bool) -> Float[np.ndarray, "g 3"]:
    """C of the grid, with max|C| = 1: around the circle Cx = Cy, and beyond it where that is asked for."""
    # The grid is denser where measured materials are: near the mirror direction, (−1, −1, 1).
    degrees = np.concatenate([np.arange(90, 180, 7.5), np.arange(180, 450, 22.5)])
    half, z = np.cos(np.radians(degrees)), np.sin(np.radians(degrees))
    grid = np.stack([half, half, z], axis=-1)
    if anisotropic:
        x, y, z = (
            part.ravel() for part in np.meshgrid([-1, -0.5, 0, 0.5, 1], [-1, -0.5, 0, 0.5, 1], [-1, -0.4, 0.4, 1])
        )
        uneven = x != y
        grid = np.concatenate([grid, np.stack([x, y, z], axis=-1)[uneven]])
    return grid / np.abs(grid).max(axis=-1, keepdims=True)


def best_additions(
    there: Float[Array, "m s"],
    products: Float[Array, "3 s"],
    values: Float[Array, "c s"],
    root_weight: Float[Array, " s"],
    count: int,
    anisotropic: bool,
) -> tuple[Float[Array, "count 3"], Float[Array, " count"]]:
    """C and exponent of the lobes of the grid that, one at a time, leave the least residual beside what is there.

    They are of different exponents: those beside the best one would end where it does.

    Args:
        there: columns that keep their place, weighted.
        products: ω_i ∘ ω_o.
        values: weighted.
        root_weight: of every sample.
        count: how many, at most the number of exponents.
        anisotropic: whether Cx and Cy may differ.
    """
    dtype, m = products.dtype, len(there)
    grid = jnp.asarray(directions(anisotropic), dtype)
    known = jnp.concatenate([there, values])
    inner = jnp.einsum("ps,qs->pq", known, known)

    def explained(C):
        dot = jnp.maximum(C @ products, 0)
        powers = [dot]
        for _ in EXPONENTS[1:]:
            square = powers[-1] * powers[-1]
            powers.append(square * square)
        lobes = jnp.stack(powers) * root_weight[None]
        cross = jnp.einsum("es,ps->ep", lobes, known)
        own = jnp.sum(lobes * lobes, axis=-1)

        def of_lobe(cross, own):
            gram = jnp.concatenate(
                [jnp.concatenate([inner[:m, :m], cross[None, :m]]), jnp.append(cross[:m], own)[:, None]], 1
            )
            moment = jnp.concatenate([inner[m:, :m], cross[m:, None]], axis=1)
            a = jax.vmap(solve_non_negative, in_axes=(None, 0))(gram, moment)
            return jnp.sum(a * moment)

        return jax.vmap(of_lobe)(cross, own)

    scores = jax.lax.map(explained, grid)  # [g, e]
    best, at = jnp.max(scores, axis=0), jnp.argmax(scores, axis=0)
    _, chosen = jax.lax.top_k(best, count)
    return grid[at[chosen]], jnp.asarray(EXPONENTS, dtype)[chosen]
