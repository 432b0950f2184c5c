"""The tangent frame of a shading normal (Wang 2006 §3.3.2)."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.numerics import safe
from jaxrelight.numerics.buckets import filled_up
from jaxrelight.numerics.numbers import float_dtype

# Points whose frames are made at once.
_PART = 4096


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


def frames_of_points(
    normals: Float[np.ndarray, "p 3"], tangents: Float[np.ndarray, "p 3"]
) -> Float[np.ndarray, "p 3 3"]:
    """`tangent_frame` of points on the host: in parts of one shape, so that one program serves any number of them.

    Frames are of the dtype of the points, as JAX is set: float32 unless float64 is enabled.
    """
    dtype = float_dtype(normals, tangents)
    frames = np.empty((len(normals), 3, 3), dtype)
    # This runs on the host also where a caller is being traced.
    with jax.ensure_compile_time_eval():
        for start in range(0, len(frames), _PART):
            rows = slice(start, start + _PART)
            part_frames = tangent_frame(
                *(filled_up(points[rows], _PART, dtype=dtype) for points in (normals, tangents))
            )
            frames[rows] = np.asarray(part_frames)[: len(frames[rows])]
    return frames


def to_local(frames: Float[np.ndarray, "*p 3 3"], directions: Float[np.ndarray, "*p 3"]) -> Float[np.ndarray, "*p 3"]:
    """World directions in the frames of their points, on the host, of the frames' dtype."""
    return np.einsum("...xy,...y->...x", frames, directions.astype(frames.dtype))
