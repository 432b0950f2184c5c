"""The tangent frame of a shading normal (Wang 2006 §3.3.2)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrelight import safe


@jax.jit
def tangent_frame(
    normal: Float[Array, "... 3"], tangent: Float[Array, "... 3"] | None = None
) -> Float[Array, "... 3 3"]:
    """Rows tangent s, binormal t = n × s and normal n, so that `frame @ world` is a local direction.

    s is the part of `tangent` across the normal. Where that is nothing, or none is given, s is from the stereographic
    projection of the sphere of normals: smooth everywhere but at n = −y, where s = +x.
    """
    x, y, z = normal[..., 0], normal[..., 1], normal[..., 2]
    s = jnp.stack([(y + 1) ** 2 + z**2 - x**2, -2 * (y + 1) * x, -2 * x * z], axis=-1)
    opposite = safe.norm(s) <= 1e-6
    across = jnp.stack([1 - x**2, -x * y, -x * z], axis=-1)
    s = safe.normalize(jnp.where(opposite[..., None], across, s))
    if tangent is not None:
        asked = tangent - jnp.sum(tangent * normal, axis=-1, keepdims=True) * normal
        s = jnp.where(safe.norm(asked)[..., None] > 1e-6, safe.normalize(asked), s)
    # Near −y rounding tilts s.
    s = safe.normalize(s - jnp.sum(s * normal, axis=-1, keepdims=True) * normal)
    return jnp.stack([s, jnp.cross(normal, s), normal], axis=-2)


@jax.jit
def to_local(
    normal: Float[Array, "... 3"], tangent: Float[Array, "... 3"], direction: Float[Array, "... 3"]
) -> Float[Array, "... 3"]:
    """World directions in the tangent frames of their normals and tangents."""
    return jnp.einsum("...xy,...y->...x", tangent_frame(normal, tangent), direction, precision="highest")
