"""Lambert, Phong and Lafortune: one constant and a sum of cosine lobes (Lafortune 1997; McAllister 2002 eq. 2)."""

import math
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float

from jaxrelight.brdf.contract import Brdf
from jaxrelight.errors import InputError
from jaxrelight.numerics import safe
from jaxrelight.numerics.arrays import as_array
from jaxrelight.numerics.numbers import Number, Numbers, as_numbers, float_dtype, given_dtype, holds, module_of

# C with max|C| = 1, the exponent and the scale of one lobe, as `lobe` makes them.
Lobe = tuple[
    Float[Array | np.ndarray, "_ 3"],
    Float[Array | np.ndarray, " _"],
    Float[Array | np.ndarray, " _"],
]


class LobeSum(Brdf):
    """f = diffuse/π + Σ_l scale_l · max(0, ω_oᵀ C_l ω_i)^exponent_l with C diagonal in axes turned about the normal.

    C and exponent have one entry per channel, or a single one shared by all. `lobe` builds lobes in which max|C| = 1:
    then the power is at most 1 and neither overflows nor underflows to nothing at any exponent.

    `turn` is the direction of anisotropy: by how many radians, counter-clockwise seen from above, the axes of C are
    turned from the tangent; None for none. With Cx = Cy it changes nothing.
    """

    diffuse: Float[Array, "*p c"]
    C: Float[Array, "*p l c1 3"]
    exponent: Float[Array, "*p l c1"]
    scale: Float[Array, "*p l c"]
    turn: Float[Array, "*p"] | None = None

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
    def integral(
        self, omega_i: Float[Array, "3 t"], omega_o: Float[Array, "3"], weights: Float[Array, "b t"]
    ) -> Float[Array, " b"]:
        """Σ_t f(ω_t, ω_o) weights_t, as of every BRDF: all sums over directions are products of matrices.

        So are their derivatives, which as sums over neighbours would take ten times as long.
        """
        count, (lobes, width, _) = weights.shape[1], self.C.shape
        whole = jnp.matmul(weights, jnp.ones((count, 1), weights.dtype), precision="highest")[:, 0]
        if self.is_constant:
            return self.diffuse / math.pi * whole
        along = self._in_axes(omega_i.T) * self._in_axes(omega_o)[None]
        cosines = jnp.matmul(self.C.reshape(lobes * width, 3), along.T, precision="highest")
        powers = safe.power(cosines, self.exponent.reshape(-1, 1))
        if width == 1:
            shares = jnp.matmul(powers, weights.T, precision="highest")
        else:
            # Lobes l, channels c, directions t.
            by_channel = powers.reshape(lobes, width, count)
            shares = jnp.einsum("lct,ct->lc", by_channel, weights, precision="highest")
        return self.diffuse / math.pi * whole + jnp.sum(self.scale * shares, axis=0)

    @jax.jit
    def peak(self, omega_o: Float[Array, "3"]) -> tuple[Float[Array, "l c1 3"], Float[Array, "l c1"]]:
        """Where each lobe is largest, the unit vector along Cᵀω_o (McAllister 2002 eq. 4), and the length |Cᵀω_o|.

        The direction may lie below the surface; where C is nothing it is the zero vector.
        """
        omega = self._in_axes(omega_o)[None, None]
        along = self.C * omega
        peak = safe.normalize(along)
        # Of unit directions |Cᵀω|² is 1 − Σ (1 − C²) ω²: 1 to the last digit where |C| is 1, as large powers need it.
        missing = jnp.sum((1 - self.C**2) * omega**2, axis=-1)
        near = missing < 0.5
        length = jnp.where(near, jnp.sqrt(jnp.where(near, 1 - missing, 1)), safe.norm(along))
        return peak if self.turn is None else turned(peak, self.turn), length

    def _in_axes(self, omega: Float[Array, "*t 3"]) -> Float[Array, "*t 3"]:
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
def turned(vectors: Float[Array, "*p 3"], angle: Float[Array, "*#p"] | Float[Array, ""]) -> Float[Array, "... 3"]:
    """Vectors turned about z by an angle in radians, counter-clockwise seen from above."""
    cosine, sine = jnp.cos(angle), jnp.sin(angle)
    x, y, z = vectors[..., 0], vectors[..., 1], vectors[..., 2]
    return jnp.stack([cosine * x - sine * y, sine * x + cosine * y, z], axis=-1)


def lambert(albedo: Numbers) -> LobeSum:
    """Albedo/π in every direction; albedo one number or one per channel, traced or not."""
    return lobe_sum(albedo, [])


def phong(diffuse: Numbers, specular: Numbers, exponent: Numbers) -> LobeSum:
    """diffuse/π + specular·(n + 2)/(2π)·max(0, cos α)ⁿ, α from the mirror direction: C = (−1, −1, 1).

    Each one number or one per channel, traced or not; types as of `lobe_sum`.

    Raises:
        InputError: as `lobe`.
    """
    n, factor = as_numbers(exponent), as_numbers(specular)
    scale = (n + 2) / (2 * math.pi) * factor
    return lobe_sum(diffuse, [lobe([-1, -1, 1], n, specular=scale)], float_dtype(diffuse, specular, exponent))


def lobe(C: Numbers, exponent: Numbers, *, specular: Numbers | None = None, peak: Numbers | None = None) -> Lobe:
    """One Lafortune lobe: specular·max(0, ω_oᵀCω_i)ⁿ, or peak·max(0, ω_oᵀCω_i / max|C|)ⁿ.

    Arguments may be traced: then their shapes are checked, and not their values.

    Args:
        C: three numbers, or three for every channel.
        exponent: n ≥ 0, one number or one per channel.
        specular: factor of the lobe as it is written in the literature, one number or one per channel.
        peak: factor of the lobe normalised by max|C|: the form for large exponents, where max|C|ⁿ leaves the floats.

    Returns:
        (C [c1, 3] with max|C| = 1 in each channel, exponent [c1], scale [c]): on the host in float64, but in float32 of
        float32 arrays; of JAX where something is traced.

    Raises:
        InputError: if neither or both factors are given, if a number is not finite, the exponent is negative, or
            max|C|ⁿ · specular is no finite number.
    """
    given = peak if specular is None else specular
    if given is None or not (specular is None or peak is None):
        raise InputError("a lobe needs exactly one of 'specular' and 'peak'")
    dtype = given_dtype(C, exponent, given)
    largest_float = np.finfo(float_dtype(C, exponent, given)).max
    directions, n, factor = as_numbers(C), as_numbers(exponent), as_numbers(given)
    if directions.ndim not in (1, 2) or directions.shape[-1] != 3:
        raise InputError(
            f"a lobe's C needs three numbers, or three for every channel, not the shape {directions.shape}"
        )
    if not all(holds(np.isfinite, part) for part in (directions, n, factor)):
        raise InputError("a lobe's C, exponent and factor must be finite")
    if not holds(lambda n: n >= 0, n):
        raise InputError("a lobe's exponent must be at least 0")
    xp = module_of(directions, n, factor)
    directions, n, factor = xp.atleast_2d(directions), xp.atleast_1d(n), xp.atleast_1d(factor)
    n = xp.broadcast_to(n, (max(len(directions), n.size),))
    directions = xp.broadcast_to(directions, (len(n), 3))
    length = xp.abs(directions).max(axis=-1)
    divisor = xp.where(length > 0, length, 1)
    normal = xp.where(length[:, None] > 0, directions / divisor[:, None], 0)
    if peak is not None:
        scale = factor
    else:
        with np.errstate(over="ignore"):
            scale = factor * xp.exp(n * xp.log(divisor))
        if not holds(lambda scale: np.abs(scale) < largest_float, scale):
            raise InputError(
                "a lobe's specular · max|C|^exponent is too large; give 'peak', its largest value, instead"
            )
    if xp is jnp:
        dtype = jax.dtypes.canonicalize_dtype(dtype)
    return normal.astype(dtype), n.astype(dtype), scale.astype(dtype)


def lobe_sum(
    diffuse: Numbers, lobes: Sequence[Lobe], dtype: DTypeLike | None = None, *, turn: Number | None = None
) -> LobeSum:
    """A BRDF of a diffuse albedo and lobes made by `lobe`; single numbers are spread over the channels.

    Differentiable in all numbers; they may be traced.

    Args:
        diffuse: albedo, one number or one per channel.
        lobes: any number of them.
        dtype: of the arrays; by default that of the arrays given, or JAX's own for numbers of Python.
        turn: the direction of anisotropy in radians from the tangent.
    """
    dtype = float_dtype(diffuse, lobes, turn) if dtype is None else dtype
    albedo = as_numbers(diffuse)
    albedo = module_of(albedo).atleast_1d(albedo)
    channels = max([3, albedo.size, *(part.size for _, n, scale in lobes for part in (n, scale))])
    width = 1 if all(len(n) == 1 for _, n, _ in lobes) else channels

    def spread(parts: Sequence, *shape: int) -> Array:
        """One row for each part, of a common shape."""
        if not parts:
            return as_array(np.zeros((0, *shape)), dtype)
        xp = module_of(*parts)
        return as_array(xp.stack([xp.broadcast_to(part, shape) for part in parts]), dtype)

    return LobeSum(
        diffuse=as_array(module_of(albedo).broadcast_to(albedo, (channels,)), dtype),
        C=spread([C for C, _, _ in lobes], width, 3),
        exponent=spread([n for _, n, _ in lobes], width),
        scale=spread([scale for _, _, scale in lobes], channels),
        turn=None if turn is None else as_array(turn, dtype),
    )
