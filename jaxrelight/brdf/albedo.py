"""How much of the light that it gets a material reflects."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.brdf.contract import Brdf
from jaxrelight.brdf.lobes import LobeSum
from jaxrelight.brdf.material import Material
from jaxrelight.brdf.sampling import directional_albedo
from jaxrelight.brdf.spatial import SpatialLobes
from jaxrelight.numerics.arrays import as_array, on_host
from jaxrelight.numerics.numbers import float_dtype, module_of

# Angles of ω_o from the normal.
_DEGREES = (0.0, 20.0, 40.0, 60.0, 75.0, 85.0)


def largest_albedo(material: Material) -> float:
    """Directional albedo, the largest over channels and directions to the eye; textures count by their means."""
    angles = np.radians(_DEGREES)
    omega_o = as_array(np.stack([np.sin(angles), 0 * angles, np.cos(angles)], axis=-1), float_dtype(material))
    total = np.zeros((1, 1))
    for component in material.components:
        brdf = component.brdf
        if isinstance(brdf, SpatialLobes):
            brdf = brdf.packed("averaged").at(jnp.full(2, 0.5), 1.0)
        weight = np.prod([factor.mean for factor in component.weight], axis=0)
        total = total + np.asarray(_albedos(brdf, omega_o)) * weight
    return float(total.max())


@jax.jit
def _albedos(brdf: Brdf, omega_o):
    return jax.lax.map(lambda omega: directional_albedo(brdf, omega, 128, 256), omega_o)


def mean_albedo(brdf: Brdf | SpatialLobes) -> Float[Array | np.ndarray, " c"]:
    """The share of light, the same from all directions, that is reflected, by channel; of a spatial BRDF the mean.

    Differentiable in the BRDF; an array of the host where it is known.
    """
    if isinstance(brdf, LobeSum) and brdf.is_constant:
        return on_host(brdf.diffuse)
    if isinstance(brdf, SpatialLobes):
        brdf = brdf.packed("averaged").at(jnp.full(2, 0.5), 1.0)
    square, weight = np.polynomial.legendre.leggauss(4)
    sine, cosine = np.sqrt((1 + square) / 2), np.sqrt((1 - square) / 2)
    turns = np.radians([10.0, 100.0])
    omega = [[s * np.cos(t), s * np.sin(t), c] for t in turns for s, c in zip(sine, cosine, strict=True)]
    albedos = on_host(_albedos(brdf, as_array(omega, float_dtype(brdf))))
    shares = np.tile(weight / 2, len(turns)) / len(turns)
    return module_of(albedos).matmul(shares.astype(albedos.dtype), albedos)
