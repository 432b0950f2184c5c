"""What light terms are closed with at a surface point that is seen: view side and weight (Wang 2006 eq. 4)."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from jaxrelight.brdf.reflection import Reflection
from jaxrelight.brdf.texture import PixelWeight, look_up


def outgoing(
    reflection: Reflection,
    weight: PixelWeight,
    omega_o: Float[Array, "p 3"],
    uv: Float[Array, "p u"],
    footprint: Float[Array, " p"],
) -> Float[Array, "p k c"]:
    """The factor on each of the k light terms in the radiance that leaves points in local directions ω_o.

    One-sided: 0 from below the shading normal.

    Args:
        reflection: of the points.
        weight: on it, over the surface.
        omega_o: local directions to the eye.
        uv: surface coordinates of the points.
        footprint: the area in the first set of texture coordinates that each stands for.
    """
    view = jax.vmap(reflection.view_side_at)(omega_o, uv, footprint)
    factor = jax.vmap(look_up, in_axes=(None, 0, 0))(weight, uv, footprint)
    return jnp.where(omega_o[:, 2:, None] <= 0, 0, view * factor[:, None])
