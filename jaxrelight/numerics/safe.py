"""Powers, norms and angles whose values and gradients stay finite where the plain formulas do not.

What is not a number stays so, value and gradient, and makes nothing beside it so.
"""

import functools
import math

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike
from jaxtyping import Array, Float

# Numbers that a vector has at most; longer ones are arrays.
_VECTOR = 4
# exp() of more overflows float32; a lobe that would is held at this logarithm instead.
_MAX_LOG = 80.0


def power(base: Float[Array, "..."], exponent: Float[Array, "..."]) -> Float[Array, "..."]:
    """Computes max(0, base)**exponent as exp(exponent · log base), and 0 where base ≤ 0, also for exponent 0.

    The input of the logarithm is masked, not only its result, so gradients are finite for every base; a power
    beyond exp(80) is held there, and a base nearer to 0 than float's smallest^¾ counts as that.
    """
    # Not `base > 0`, which a NaN is not either: it has to pass on.
    nothing = base <= 0
    smallest = float(jnp.finfo(jnp.result_type(base, jnp.float32)).tiny) ** 0.75
    logarithm = exponent * jnp.log(jnp.where(nothing, 1, jnp.maximum(base, smallest)))
    return jnp.where(nothing, jnp.where(jnp.isnan(exponent), exponent, 0), jnp.exp(jnp.minimum(logarithm, _MAX_LOG)))


def clamp(values: Float[Array, "..."], least: ArrayLike, most: ArrayLike = math.inf) -> Float[Array, "..."]:
    """`values` held within `least` … `most`; at either end the slope is that inside, where `jnp.clip` has half of it.

    Ends do not lie at random: exponent 0, texels' centres and the normal are ends, and functions are smooth there.
    """
    return jnp.where(values < least, least, jnp.where(values > most, most, values))


def root(values: Float[Array, "..."]) -> Float[Array, "..."]:
    """√max(0, values), whose slope, infinite at 0, is 0 there."""
    nothing = values <= 0
    return jnp.where(nothing, 0, jnp.sqrt(jnp.where(nothing, 1, values)))


def norm(vector: Float[Array, "... n"]) -> Float[Array, "..."]:
    """Euclidean length over the last axis: 0 with a zero gradient at the zero vector, no overflow before 1e38."""
    # The scale changes nothing but rounding, so it has no derivative.
    largest = jax.lax.stop_gradient(_over_last(jnp.maximum, jnp.abs(vector)))
    zero = largest == 0
    scaled = jnp.where(zero[..., None], 1, vector) / jnp.where(zero, 1, largest)[..., None]
    return jnp.where(zero, 0, jnp.sqrt(_over_last(jnp.add, scaled * scaled)) * largest)


def normalize(vector: Float[Array, "... n"]) -> Float[Array, "... n"]:
    """The unit vector along `vector`; the zero vector stays zero, with a zero gradient."""
    largest = jax.lax.stop_gradient(_over_last(jnp.maximum, jnp.abs(vector)))
    zero = largest == 0
    scaled = jnp.where(zero[..., None], 0, vector) / jnp.where(zero, 1, largest)[..., None]
    # The largest component is 1 now.
    length = jnp.sqrt(_over_last(jnp.add, jnp.where(zero[..., None], 1, scaled * scaled)))
    return scaled / length[..., None]


def _over_last(of_two, values: Float[Array, "... n"]) -> Float[Array, "..."]:
    """A sum or maximum over the last axis; written out for vectors, where XLA's takes several times as long."""
    if values.shape[-1] > _VECTOR:
        return of_two.reduce(values, axis=-1)
    return functools.reduce(of_two, jnp.moveaxis(values, -1, 0))


def angle(a: Float[Array, "... 3"], b: Float[Array, "... 3"]) -> Float[Array, "..."]:
    """Angle between two vectors in radians, as atan2(|a × b|, a · b): accurate near 0 and π, where arccos is not."""
    a, b = normalize(a), normalize(b)
    sine, cosine = norm(jnp.cross(a, b)), jnp.sum(a * b, axis=-1)
    undefined = (sine == 0) & (cosine == 0)
    return jnp.where(undefined, 0, jnp.arctan2(sine, jnp.where(undefined, 1, cosine)))
