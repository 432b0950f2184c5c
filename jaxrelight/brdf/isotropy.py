"""Whether a BRDF depends on how a surface is turned about its normal."""

import equinox as eqx
import jax
import numpy as np

from jaxrelight.brdf.contract import Brdf
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.numbers import float_dtype


def is_isotropic(brdf: Brdf) -> bool:
    """Whether turning both directions about the normal changes f by no more than a thousandth at 64 random pairs."""
    rng = np.random.default_rng(0)
    z, phi = rng.uniform(0.1, 1, (2, 64)), rng.uniform(0, 2 * np.pi, (3, 64))

    def at(turn):
        sine = np.sqrt(1 - z**2)
        both = zip(sine, phi[:2] + turn, z, strict=True)
        pair = (np.stack([s * np.cos(p), s * np.sin(p), c], axis=1) for s, p, c in both)
        return np.asarray(_pairs(brdf, *(as_array(side, float_dtype(brdf)) for side in pair)), float)

    unturned, turned = at(0), at(phi[2])
    return bool(np.all(np.abs(unturned - turned) <= 1e-3 * np.abs(unturned).max()))


@eqx.filter_jit
def _pairs(brdf, omega_i, omega_o):
    return jax.vmap(brdf.evaluate)(omega_i, omega_o)
