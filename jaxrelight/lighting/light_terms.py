"""Light terms: what the operators of precomputed transport make of light, or of the largest error of it."""

import functools

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrelight.geometry.receivers import GROUP
from jaxrelight.operators.clustered import Clustered
from jaxrelight.operators.contract import Operator, Summed
from jaxrelight.operators.sparse_rows import SparseRows
from jaxrelight.transport.compression import padded_receivers
from jaxrelight.transport.model import Block

# Light terms [receivers, k, c] of every block; with a leading axis where they are of many lights.
LightTerms = tuple[Float[Array, "*n _ _ _"], ...]


def light_terms(operator: Operator, light: Float[Array, "*n d c"], block: Block) -> Float[Array, "*n v k c"]:
    """One block's light terms of a light or many, compiled unless the operator reads a store as it goes."""
    receivers = padded_receivers(block.group_count * GROUP)
    if isinstance(operator, Summed):
        first, *others = (light_terms(part, light, block) for part in operator.operators)
        return sum(others, first)
    if isinstance(operator, SparseRows):
        return _compiled_terms(operator.with_filling(), light, receivers, block.reflection.terms)
    if isinstance(operator, Clustered):
        filled = operator.with_filling(receivers // GROUP)
        return _compiled_terms(filled, light, receivers, block.reflection.terms)
    return _product(operator, light, receivers, block.reflection.terms)


def with_emitted(terms: Float[Array, "*n v k c"], block: Block) -> Float[Array, "*n v k c"]:
    """Light terms of the sky, and of what surfaces emit."""
    return terms if block.emitted is None else _padded_sum(terms, block.emitted)


@jax.jit
def _padded_sum(terms, emitted):
    emitted = jnp.pad(emitted, ((0, terms.shape[-3] - len(emitted)), (0, 0), (0, 0)))
    # The terms are those of one light or of many.
    return terms + jnp.broadcast_to(emitted, terms.shape)


def _product(operator: Operator, light: Float[Array, "*n d c"], receivers: int, terms: int) -> Float[Array, "*n v k c"]:
    """The product, its rows by receiver; cut, or followed by zeros, to a number of receivers."""
    radiance = operator.apply(light) if light.ndim == 2 else operator.apply_many(light)
    more = max(receivers * terms - radiance.shape[-2], 0)
    radiance = jnp.pad(radiance, [*[(0, 0)] * (radiance.ndim - 2), (0, more), (0, 0)])[..., : receivers * terms, :]
    return radiance.reshape(*radiance.shape[:-2], receivers, terms, radiance.shape[-1])


_compiled_terms = jax.jit(_product, static_argnames=("receivers", "terms"))


def largest_errors(
    dropped: Float[Array, "r c1"] | None, light: Float[Array, "d c"], block: Block
) -> Float[Array, "v k c"]:
    """Of each light term, the largest error that a light may have by what rows leave out."""
    receivers, terms, channels = padded_receivers(block.group_count * GROUP), block.reflection.terms, light.shape[1]
    if dropped is None:
        return jnp.zeros((receivers, terms, channels), light.dtype)
    return _products_of_lengths(dropped, light, receivers, terms)


@functools.partial(jax.jit, static_argnames=("receivers", "terms"))
def _products_of_lengths(dropped, light, receivers: int, terms: int):
    lengths = jnp.sqrt(jnp.sum(jnp.square(light), axis=0))
    rows = jnp.broadcast_to(jnp.sqrt(dropped), (len(dropped), len(lengths))) * lengths[None]
    padded = jnp.pad(rows, ((0, max(receivers * terms - len(rows), 0)), (0, 0)))[: receivers * terms]
    return padded.reshape(receivers, terms, -1)
