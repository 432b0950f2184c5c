"""Lambert, Phong and Lafortune: one constant and a sum of cosine lobes (Lafortune 1997; McAllister 2002 eq. 2)."""

import math

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from jaxrelight.brdf.contract import Brdf
from jaxrelight.errors import InputError
from jaxrelight.numerics import safe
from jaxrelight.numerics.arrays import as_array


class LobeSum(Brdf):
    """f = diffuse/π + Σ_l scale_l · max(0, ω_oᵀ C_l ω_i)^exponent_l with C diagonal in axes turned about the normal.

    C and exponent have one entry per channel, or a single one shared by all. `lobe` builds lobes in which max|C| = 1:
    then the power is at most 1 and neither overflows nor underflows to nothing at any exponent.

    `turn` is the direction of anisotropy: by how many radians, counter-clockwise seen from above, the axes of C are
    turned from the tangent; None for none. With Cx = Cy it changes nothing.
    """

    diffuse: Float[Array, " c"]
    C: Float[Array, "l c1 3"]
    exponent: Float[Array, "l c1"]
    scale: Float[Array, "l c"]
    turn: Float[Array, ""] | None = None

    @jax.jit
    def evaluate(self, omega_i: Float[Array, "3"], omega_o: Float[Array, "3"]) -> Float[Array, " c"]:
        """f(ω_i, ω_o) of every channel."""
        if self.is_constant:
            return self.diffuse / math.pi
        powers = safe.power(self.cosines(omega_i, omega_o), self.exponent)
        return self.diffuse / math.pi + jnp.sum(self.scale * powers, axis=0)

    @jax.jit
    def cosines(self, omega_i: Float[Array, "3"], omega_o: Float[Array, "3"]) -> Float[Array, "l c1"]:
        """ω_oᵀ C_l ω_i, whose powers the lobes are."""
        x, y, z = self._in_axes(omega_i) * self._in_axes(omega_o)
        return self.C[..., 0] * x + self.C[..., 1] * y + self.C[..., 2] * z

    @jax.jit
    def peak(self, omega_o: Float[Array, "3"]) -> tuple[Float[Array, "l c1 3"], Float[Array, "l c1"]]:
        """Where each lobe is largest, the unit vector along Cᵀω_o (McAllister 2002 eq. 4), and the length |Cᵀω_o|.

        The direction may lie below the surface; where C is nothing it is the zero vector.
        """
        along = self.C * self._in_axes(omega_o)
        peak = safe.normalize(along)
        return peak if self.turn is None else turned(peak, self.turn), safe.norm(along)

    def _in_axes(self, omega: Float[Array, "3"]) -> Float[Array, "3"]:
        return omega if self.turn is None else turned(omega, -self.turn)

    @property
    def channels(self) -> int:
        """c, the number of colour channels."""
        return self.diffuse.shape[-1]

    @property
    def is_constant(self) -> bool:
        """True without lobes."""
        return self.C.shape[-3] == 0

    @property
    @jax.jit
    def normal_albedo(self) -> Float[Array, " c"]:
        """The share of light along the normal that is reflected: diffuse + Σ_l 2π scale_l max(0, C_z)ⁿ / (n + 2)."""
        share = safe.power(self.C[..., 2], self.exponent) / (self.exponent + 2)
        return self.diffuse + 2 * math.pi * jnp.sum(self.scale * share, axis=0)


@jax.jit
def turned(vectors: Float[Array, "... 3"], angle: Float[Array, ""]) -> Float[Array, "... 3"]:
    """Vectors turned about z by an angle in radians, counter-clockwise seen from above."""
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return jnp.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=-1)


def lambert(albedo) -> LobeSum:
    """Albedo/π in every direction; albedo per channel."""
    return lobe_sum(albedo, [])


def phong(diffuse, specular, exponent) -> LobeSum:
    """diffuse/π + specular·(n + 2)/(2π)·max(0, cos α)ⁿ, α from the mirror direction: C = (−1, −1, 1)."""
    n = np.asarray(exponent, float)
    scale = (n + 2) / (2 * np.pi) * np.asarray(specular, float)
    return lobe_sum(diffuse, [lobe([-1, -1, 1], exponent, specular=scale)])


def lobe(C, exponent, *, specular=None, peak=None) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """One Lafortune lobe: specular·max(0, ω_oᵀCω_i)ⁿ, or peak·max(0, ω_oᵀCω_i / max|C|)ⁿ.

    Args:
        C: three numbers, or three for every channel.
        exponent: n ≥ 0, one number or one per channel.
        specular: factor of the lobe as it is written in the literature, one number or one per channel.
        peak: factor of the lobe normalised by max|C|: the form for large exponents, where max|C|ⁿ leaves the floats.

    Returns:
        (C [c1, 3] with max|C| = 1 in each channel, exponent [c1], scale [c]) in float64.

    Raises:
        InputError: if neither or both factors are given, or max|C|ⁿ · specular is no finite number.
    """
    if (specular is None) == (peak is None):
        raise InputError("a lobe needs exactly one of 'specular' and 'peak'")
    C, factor = np.atleast_2d(np.asarray(C, float)), np.asarray(peak if specular is None else specular, float)
    if C.shape[-1] != 3 or C.ndim != 2:
        raise InputError(f"a lobe's C needs three numbers, or three for every channel, not the shape {C.shape}")
    if not all(np.isfinite(part).all() for part in (C, factor, np.asarray(exponent, float))):
        raise InputError("a lobe's C, exponent and factor must be finite")
    n = np.broadcast_to(np.atleast_1d(np.asarray(exponent, float)), (max(len(C), np.size(exponent)),))
    if (n < 0).any():
        raise InputError("a lobe's exponent must be at least 0")
    C = np.broadcast_to(C, (len(n), 3))
    largest = np.abs(C).max(axis=-1)
    normal = np.where(largest[:, None] > 0, C / np.where(largest > 0, largest, 1)[:, None], 0)
    if peak is not None:
        return normal, n, np.atleast_1d(factor)
    with np.errstate(over="ignore", divide="ignore"):
        scale = factor * np.exp(n * np.log(np.where(largest > 0, largest, 1)))
    if not (np.abs(scale) < np.finfo(np.float32).max).all():
        raise InputError("a lobe's specular · max|C|^exponent is too large; give 'peak', its largest value, instead")
    return normal, n, np.atleast_1d(scale)


def lobe_sum(diffuse, lobes, dtype=jnp.float32, *, turn=None) -> LobeSum:
    """A BRDF of a diffuse albedo and lobes made by `lobe`; single numbers are spread over the channels.

    `turn` is the direction of anisotropy in radians from the tangent.
    """
    diffuse = np.atleast_1d(np.asarray(diffuse, float))
    channels = max([3, diffuse.size, *(part.size for _, n, scale in lobes for part in (n, scale))])
    shared = all(len(n) == 1 for _, n, _ in lobes)
    width = 1 if shared else channels

    def stack(parts, *shape):
        spread = [np.broadcast_to(part, shape) for part in parts]
        return as_array(np.stack(spread) if spread else np.zeros((0, *shape)), dtype)

    return LobeSum(
        diffuse=as_array(np.broadcast_to(diffuse, (channels,)), dtype),
        C=stack([C for C, _, _ in lobes], width, 3),
        exponent=stack([n for _, n, _ in lobes], width),
        scale=stack([scale for _, _, scale in lobes], channels),
        turn=None if turn is None else as_array(turn, dtype),
    )
