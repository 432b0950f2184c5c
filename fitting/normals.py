"""Normals from images under known lights, where none are given: photometric stereo (Woodham 1980), made robust."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from fitting.stack import Stack
from fitting.stack_checks import check_lights

# The darkest images of a pixel may lie in shadow and the brightest in a highlight: these shares are left out.
DARK, BRIGHT = 0.15, 0.15
_SWEEPS = 8


def estimated_normals(stack: Stack) -> Float[np.ndarray, "h w 3"]:
    """Unit normals that explain a pixel's grey values as Lambert's law; towards the camera where nothing can be said.

    Least squares over the images that are usable and neither among a pixel's darkest nor its brightest. Values below a
    fit's own terminator count as shadow in the next sweep.

    Raises:
        InputError: all lights lie in one plane with the surface, or there are fewer than three.
    """
    check_lights(stack)
    grey = stack.images[:, stack.mask].mean(axis=-1)
    usable = stack.usable[:, stack.mask]
    normals = np.broadcast_to([0.0, 0.0, 1.0], (*stack.mask.shape, 3)).copy()
    lights = stack.towards_lights(stack.mask)
    normals[stack.mask] = np.asarray(_stereo(jnp.asarray(grey.T), jnp.asarray(usable.T), jnp.asarray(lights)))
    return normals


@jax.jit
def _stereo(grey: Float[Array, "p n"], usable, lights: Float[Array, "*p n 3"]) -> Float[Array, "p 3"]:
    """Of far lights, or of directions that every texel has for itself."""
    lights = lights.astype(grey.dtype)
    products = "pn,pna,pnb->pab" if lights.ndim == 3 else "pn,na,nb->pab"
    sums, shading = ("pn,pna->pa", "pa,pna->pn") if lights.ndim == 3 else ("pn,na->pa", "pa,na->pn")
    count = jnp.maximum(usable.sum(axis=1, keepdims=True), 1)
    # Ranks among the usable ones, from the darkest.
    order = jnp.argsort(jnp.where(usable, grey, jnp.inf), axis=1)
    rank = jnp.argsort(order, axis=1)
    kept = usable & (rank >= jnp.floor(DARK * count)) & (rank < count - jnp.floor(BRIGHT * count))
    few = kept.sum(axis=1, keepdims=True) < 4
    kept = jnp.where(few, usable & (rank >= jnp.maximum(count - 3, 0)), kept)

    def sweep(scaled, _):
        lit = kept & (jnp.einsum(shading, scaled, lights) > 0)
        lit = jnp.where(lit.sum(axis=1, keepdims=True) >= 3, lit, kept)
        gram = jnp.einsum(products, lit.astype(grey.dtype), lights, lights)
        moment = jnp.einsum(sums, jnp.where(lit, grey, 0), lights)
        ridge = 1e-5 * jnp.trace(gram, axis1=1, axis2=2)[:, None, None] + jnp.finfo(grey.dtype).tiny
        return jnp.linalg.solve(gram + ridge * jnp.eye(3, dtype=grey.dtype)[None], moment[..., None])[..., 0], None

    facing = jnp.broadcast_to(jnp.asarray([0, 0, 1], grey.dtype), (len(grey), 3))
    scaled, _ = jax.lax.scan(sweep, facing, None, length=_SWEEPS)
    length = jnp.sqrt(jnp.sum(scaled**2, axis=1, keepdims=True))
    good = (length > 0) & (scaled[:, 2:] > 0) & jnp.isfinite(length)
    return jnp.where(good, scaled / jnp.where(good, length, 1), facing)
