"""Reflectance samples as a solve wants them: all finite, of order 1."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int


class Samples(eqx.Module):
    """What one BRDF is fitted to, made by `prepare`.

    Attributes:
        products: ω_i ∘ ω_o, all that a diagonal C sees of two directions.
        values: f over `scale`; 0 where it is masked.
        root_weight: square roots of the weights, which sum to 1; 0 where a sample is masked.
        scale: weighted root mean square of f, or 1 where that is 0.
        masked: how many samples of positive weight were not finite in some channel or direction.
        below: how many others of positive weight have a direction below the surface.
        used: how many samples have any weight.
    """

    products: Float[Array, "3 s"]
    values: Float[Array, "c s"]
    root_weight: Float[Array, " s"]
    scale: Float[Array, ""]
    masked: Int[Array, ""]
    below: Int[Array, ""]
    used: Int[Array, ""]


def prepare(
    omega_i: Float[Array, "s 3"],
    omega_o: Float[Array, "s 3"],
    values: Float[Array, "s c"],
    weight: Float[Array, " s"],
) -> Samples:
    """Masks samples that are not finite or have no weight, and scales the others.

    A sample below the surface, on either side, is masked like one without weight.
    """
    products = omega_i * omega_o
    above = (omega_i[:, 2] >= 0) & (omega_o[:, 2] >= 0)
    finite = jnp.all(jnp.isfinite(values), axis=-1) & jnp.all(jnp.isfinite(products), axis=-1) & jnp.isfinite(weight)
    wanted = ~(weight <= 0)
    used = finite & wanted & above
    weight = jnp.where(used, weight, 0)
    # Divided by the largest before it is summed or squared: no product leaves float32's range.
    weight = weight / _or_one(jnp.max(weight))
    weight = weight / _or_one(jnp.sum(weight))
    values = jnp.where(used[:, None], values, 0).T
    # The scale is a unit: a fit in other units is the same fit, so it takes no part in derivatives.
    largest = _or_one(jnp.max(jnp.abs(jax.lax.stop_gradient(values))))
    rms = _or_one(jnp.sqrt(jnp.sum(weight[None] * jnp.square(jax.lax.stop_gradient(values) / largest))))
    scale = jax.lax.stop_gradient(largest * rms)
    return Samples(
        products=jnp.where(used[:, None], products, 0).T,
        values=values / scale,
        root_weight=jnp.where(weight > 0, jnp.sqrt(jnp.where(weight > 0, weight, 1)), 0),
        scale=scale,
        masked=jnp.sum(wanted & ~finite),
        below=jnp.sum(wanted & finite & ~above),
        used=jnp.sum(used),
    )


def _or_one(x):
    return jnp.where(x > 0, x, 1)
