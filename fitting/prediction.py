"""Images that a fitted surface should give, and how far they are from those it gave."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from fitting.sbrdf import prepared
from fitting.stack import Stack
from jaxrelight.brdf.files.sbrdf import SbrdfLevel
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.geometry.frame import tangent_frame
from jaxrelight.numerics.arrays import as_array


def predicted(level: SbrdfLevel, stack: Stack) -> Float[np.ndarray, "n h w 3"]:
    """The images of a stack as the fit has them: f · cosθ_i, 0 where the light or the eye is below the surface."""
    mask = stack.mask
    lobes = jax.tree.map(lambda a: a[mask], level.lobes)
    # Texels as rows of one column each, so that they are not interpolated.
    alone = jax.tree.map(lambda a: a[:, None, None], lobes)
    normals = as_array(level.normals[mask], jnp.float32)
    images = np.zeros((*stack.usable.shape, 3), np.float32)
    lights = np.broadcast_to(stack.towards_lights(mask), (len(normals), *stack.lights.shape))
    for number, view in enumerate(stack.views):
        light = as_array(lights[:, number], jnp.float32)
        images[number, mask] = np.asarray(_radiance(alone, normals, light, as_array(view, jnp.float32)))
    return images


@jax.jit
def _radiance(alone: SpatialLobes, normals, light, view):
    def one(texel, normal, light):
        frame = tangent_frame(normal)
        omega_i, omega_o = frame @ light, frame @ view
        value = texel.at(jnp.full(2, 0.5)).evaluate(omega_i, omega_o) * omega_i[2]
        return jnp.where((omega_i[2] > 0) & (omega_o[2] > 0), value, 0)

    return jax.vmap(one)(alone, normals, light)


def relative_error(images: np.ndarray, stack: Stack) -> float:
    """Root mean square of images − stack over that of the stack, over the usable samples of the mask."""
    counted = stack.usable & stack.mask
    apart, whole = images[counted] - stack.images[counted], stack.images[counted]
    return float(np.sqrt(np.sum(apart.astype(float) ** 2) / np.sum(whole.astype(float) ** 2)))


def lambert_only(stack: Stack, normals: Float[np.ndarray, "h w 3"]) -> SbrdfLevel:
    """Albedos of least squared error, what any lobe must do better than."""
    mask = stack.mask
    values = stack.images[:, mask].swapaxes(0, 1), stack.usable[:, mask].T
    directions = (as_array(a, jnp.float32) for a in (normals[mask], stack.towards_lights(mask), stack.views))
    _, _, f, weight = prepared(*values, *directions)
    total = jnp.sum(weight, axis=1, keepdims=True)
    albedo = np.zeros((*mask.shape, 3), np.float32)
    albedo[mask] = np.asarray(jnp.pi * jnp.sum(weight[..., None] * f, axis=1) / jnp.where(total > 0, total, 1))
    none = np.zeros((*mask.shape, 0, 3), np.float32)
    axis = np.broadcast_to(np.array([1, 0], np.float32), (*mask.shape, 2))
    maps = albedo, none, none[..., 0], none, axis
    return SbrdfLevel(
        SpatialLobes(*map(as_array, maps)),
        normals,
        np.zeros(mask.shape, int),
        np.full(mask.shape, np.nan, np.float32),
    )
