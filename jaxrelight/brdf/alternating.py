"""Factors as a differentiable function of the BRDF: one step of alternating least squares."""

import functools

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.factored import Factored
from jaxrelight.brdf.factors import COSINE


@functools.partial(jax.jit, static_argnames="cosine")
def refactored(brdf: Brdf, start: Factored, cosine: tuple[float, float] = COSINE) -> Factored:
    """The light maps that are best for the view maps of `start`, and the view maps that are best for those.

    Pure and differentiable, also in the BRDF's parameters; `start` is held fixed. At `start = factor(brdf, …)` the
    values stay what they are, and the derivative of the products is that of the best approximation but for what is
    left out of it. Singular value decomposition has no such derivative: Phong's singular values come in equal pairs.

    Args:
        brdf: what to factor.
        start: factors of it, or of one like it, by the same powers of the cosine.
        cosine: powers of cosθ_i and of cosθ_o in the error that is minimised, as for `factor`.
    """
    if brdf.is_constant:
        up = jnp.asarray([0.0, 0.0, 1.0], start.view_maps.dtype)
        return Factored(
            jnp.ones_like(start.light_maps), brdf.evaluate(up, up)[None, :, None, None], start.parametrisation
        )
    side, dtype = start.light_maps.shape[-1], start.light_maps.dtype
    every, inside = start.parametrisation.directions(side)
    root = np.sqrt(start.parametrisation.measure(side)[inside])
    squares = [jnp.asarray((root * every[inside, 2] ** power) ** 2, dtype) for power in cosine]
    omega, inner = jnp.asarray(every, dtype), np.flatnonzero(inside)

    def best(other: Float[Array, "k c t"], square: Float[Array, " m"], swapped: bool) -> Float[Array, "k c t"]:
        """Maps of one side by weighted least squares, given those of the other side: normal equations of k × k."""
        held = other[..., inner]
        weighted = held * square[None, None]
        gram = jnp.einsum("kcm,jcm->ckj", weighted, held, precision="highest")
        # A term that has died leaves its row 0; of a black channel all have, and its maps are 0.
        trace = jnp.trace(gram, axis1=1, axis2=2)[:, None, None]
        floor = jnp.where(trace > 0, jnp.finfo(dtype).eps * trace, 1)
        gram = gram + floor * jnp.eye(len(held), dtype=dtype)[None]

        @jax.checkpoint
        def row(one):
            evaluate = (lambda o: brdf.evaluate(o, one)) if swapped else (lambda o: brdf.evaluate(one, o))
            values = jax.vmap(evaluate)(omega[inner])
            return jnp.einsum("mc,kcm->ck", values, weighted, precision="highest")

        products = jax.lax.map(row, omega, batch_size=32)
        return jax.vmap(_solve_positive, out_axes=1)(gram, jnp.moveaxis(products, 0, -1))

    def flat(maps):
        return maps.reshape(*maps.shape[:2], side * side)

    light = best(flat(jax.lax.stop_gradient(start.view_maps)), squares[1], swapped=False)
    view = best(light, squares[0], swapped=True)
    shape = light.shape[0], -1, side, side
    return Factored(light.reshape(shape), view.reshape(shape), start.parametrisation)


def _solve_positive(gram: Float[Array, "k k"], products: Float[Array, "k t"]) -> Float[Array, "k t"]:
    return jax.scipy.linalg.solve(gram, products, assume_a="pos")
