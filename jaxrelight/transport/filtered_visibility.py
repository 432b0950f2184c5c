"""Visibility filtered by lobes: how much of a lobe around any direction reaches a receiver, from a few dozen bytes.

Glossy light is nearly the lobe's mean radiance times the share of the lobe that nothing blocks: filtered light ×
filtered visibility. Visibility is kept as spherical harmonics in world space, a property of geometry alone, so that a
material is changed without it, and receivers are interpolated linearly. Wang et al. 2009 keep signed distances to what
blocks instead.

Axes: r receivers, m receivers of a group, h = (order + 1)² harmonics, b = order + 1 bands.
"""

import functools
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int, Int8, UInt8

from jaxrelight.basis.spherical_harmonics import by_function, count, filtered_by_lobe, harmonics
from jaxrelight.transport.bake import Directions, unpack

# The order that is kept by default: 81 numbers a receiver. Narrower lobes are blocked as wider ones are.
ORDER = 8
_MAX_CODE = 127


@functools.partial(jax.jit, static_argnames="order")
def project_visibility(
    bits: UInt8[Array | np.ndarray, "m bytes"],
    frames: Float[Array | np.ndarray, "m 3 3"],
    directions: Directions,
    order: int = ORDER,
) -> Float[Array, "m h"]:
    """Harmonics of what each receiver sees: c_lm = ∫ V Y_lm dω over the directions that were traced.

    Below a receiver's horizon nothing is known, and nothing is reflected; V is continued there by its mean over the
    hemisphere, weighted by the cosine, so that lobes at the horizon are not darkened by it.

    Args:
        bits: visibility of the directions, lowest bit first.
        frames: whose third row is the normal.
        directions: that were traced.
        order: the largest l.
    """
    basis = harmonics(directions.vectors, order) * directions.solid_angles[:, None]

    def project(receiver):
        bits, normal = receiver
        cosine = jnp.maximum(jnp.matmul(directions.vectors, normal, precision="highest"), 0)
        visible, weight = unpack(bits, cosine.dtype), cosine * directions.solid_angles
        mean = jnp.sum(visible * weight) / jnp.maximum(jnp.sum(weight), jnp.finfo(cosine.dtype).tiny)
        return jnp.matmul(jnp.where(cosine > 0, visible, mean), basis, precision="highest")

    return jax.lax.map(project, (bits, frames[:, 2]), batch_size=8)


class FilteredVisibility(eqx.Module):
    """Harmonics of many receivers' visibility, in codes of 8 bits with one scale for each band.

    Attributes:
        codes: of each receiver's harmonics.
        scale: of a band's codes.
    """

    codes: Int8[Array, "r h"]
    scale: Float[Array, " b"]

    @property
    def nbytes(self) -> int:
        """Bytes that are held."""
        return self.codes.nbytes + self.scale.nbytes

    @property
    def order(self) -> int:
        """The largest l."""
        return math.isqrt(self.codes.shape[-1]) - 1

    def at(
        self, receivers: Int[Array | np.ndarray, "*p k"], weights: Float[Array | np.ndarray, "*p k"]
    ) -> Float[Array, "*p h"]:
        """Harmonics between some receivers: their weighted sum. Differentiable in the weights and the scale.

        Args:
            receivers: numbers of k receivers.
            weights: theirs.
        """
        codes = self.codes.at[receivers].get(mode="promise_in_bounds").astype(weights.dtype)
        scale = by_function(self.scale)
        return jnp.einsum("...k,...kh,h->...h", weights, codes, scale, precision="highest")


def coded(coefficients: Float[np.ndarray, "r h"]) -> FilteredVisibility:
    """Harmonics in codes; a code is off by half a step at most, 1/254 of the band's largest number."""
    order = math.isqrt(coefficients.shape[-1]) - 1
    if count(order) != coefficients.shape[-1]:
        raise ValueError(f"harmonics come in squares, not by {coefficients.shape[-1]}")
    bands = [np.abs(coefficients[:, degree**2 : (degree + 1) ** 2]).max(initial=0.0) for degree in range(order + 1)]
    scale = np.maximum(np.asarray(bands, np.float32) / _MAX_CODE, np.finfo(np.float32).tiny)
    codes = np.rint(coefficients / np.repeat(scale, [2 * degree + 1 for degree in range(order + 1)]))
    return FilteredVisibility(*jax.device_put((codes.astype(np.int8), scale)))


def visible_share(
    coefficients: Float[Array, " h"], peak: Float[Array, "3"], exponent: Float[Array, ""]
) -> Float[Array, ""]:
    """v(p, n): the share of the lobe max(0, p·ω)ⁿ that reaches a receiver, from 0 to 1.

    Args:
        coefficients: of the receiver's visibility.
        peak: p, a unit vector in world space.
        exponent: n.
    """
    return jnp.clip(filtered_by_lobe(coefficients, peak, exponent), 0, 1)
