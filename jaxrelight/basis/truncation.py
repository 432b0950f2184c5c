"""Non-linear approximation: each row keeps the coefficients that count most (Wang 2006 §4.1.1)."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int, Integer


class Truncated(eqx.Module):
    """Rows of which only n coefficients were kept, the same n for all channels.

    Attributes:
        indices: which coefficients, ascending.
        values: their values.
        dropped: energy (sum of squares) left out, by channel. By Cauchy–Schwarz the error of a row's product
            with light x is at most ‖x‖·√dropped.
        total: energy of the whole row, by channel.
    """

    indices: Integer[Array, "*r n"]
    values: Float[Array, "*r c n"]
    dropped: Float[Array, "*r c"]
    total: Float[Array, "*r c"]


def keep_largest(rows: Float[Array, "r c d"], count: int, deviations: Float[Array, " d"] | None = None) -> Truncated:
    """Keeps, in every row, the `count` coefficients whose squares summed over the channels are largest.

    With an orthonormal basis this choice leaves out the least energy. Where it is known how much light's coefficients
    vary, those are kept that count most under such light: in its mean square, the least is left out of a row's product
    with it. The energy left out is summed over what is left out, not found as a small difference of large sums.

    Args:
        rows: by channel.
        count: of coefficients of each.
        deviations: standard deviations of light's coefficients, relative to each other.
    """
    counting = rows if deviations is None else rows * deviations[None, None]
    energy = jnp.sum(counting * counting, axis=1)
    # The values of top_k must stay unused: XLA would sort whole rows for them, thirty times slower.
    indices = jnp.sort(jax.lax.top_k(energy, count)[1], axis=-1)
    values = gather(rows, indices)
    left = jax.vmap(lambda row, kept: row.at[:, kept].set(0, unique_indices=True, indices_are_sorted=True))(
        rows, indices
    )
    dropped = jnp.sum(left * left, axis=-1)
    return Truncated(indices, values, dropped, dropped + jnp.sum(values * values, axis=-1))


def gather(rows: Float[Array, "r c d"], indices: Int[Array, "r n"]) -> Float[Array, "r c n"]:
    """The coefficients at given indices: truncation with the kept sets held fixed, linear and differentiable."""
    return jax.vmap(lambda row, kept: row.at[:, kept].get(mode="promise_in_bounds"))(rows, indices)
