"""Arrays kept as small integers with scales: uniform, symmetric quantisation (Wang 2006 §4.1.2, §4.3)."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int


class Quantised(eqx.Module):
    """Numbers as codes times scales; one scale for every run of neighbours on the last axis. Made by `quantised`.

    Attributes:
        codes: signed, of 8 or 16 bits.
        scale: what a step of the codes is worth, by run.
        run: how many codes share a scale; the last run may be shorter.
    """

    codes: Int[Array | np.ndarray, "... n"]
    scale: Float[Array | np.ndarray, "... s"]
    run: int = eqx.field(static=True)

    @property
    def shape(self) -> tuple[int, ...]:
        """[..., n]."""
        return self.codes.shape

    @property
    def nbytes(self) -> int:
        """Bytes of codes and scales."""
        return self.codes.nbytes + self.scale.nbytes

    def decoded(self) -> Float[Array, "... n"]:
        """The numbers, in the precision of the scale."""
        return jnp.multiply(self.codes, _by_code(jnp, self.scale, self.run, self.codes.shape[-1]))


def decoded(values: Float[Array, "... n"] | Quantised) -> Float[Array, "... n"]:
    """The numbers of an array that may be quantised."""
    return values.decoded() if isinstance(values, Quantised) else values


def decoded_type(values: Float[Array, "... n"] | Quantised) -> np.dtype:
    """The precision of what `decoded` gives."""
    return values.scale.dtype if isinstance(values, Quantised) else values.dtype


def quantised(values: Float[Array | np.ndarray, "... n"], bits: int, run: int | None = None) -> Quantised:
    """Numbers in steps of scale = max|values| / (2^(bits − 1) − 1) over a run, rounded to the nearest.

    No number is off by more than half its scale, and the largest of every run is kept to rounding. Runs whose scale
    would be subnormal become zeros, as XLA would make them; a run that holds NaN or an infinity decodes to NaN. NumPy
    arrays are coded by NumPy, so that nothing is compiled for their shapes.

    Args:
        values: float32 or float64.
        bits: 8 or 16.
        run: how many neighbours on the last axis share a scale; by default all of them.

    Raises:
        ValueError: for another number of bits.
    """
    if bits not in (8, 16):
        raise ValueError(f"codes have 8 or 16 bits, not {bits}")
    return _quantised(values, bits, run) if isinstance(values, np.ndarray) else _compiled(values, bits, run)


def _quantised(values: Float[Array | np.ndarray, "... n"], bits: int, run: int | None) -> Quantised:
    xp: Any = np if isinstance(values, np.ndarray) else jnp
    n, real = values.shape[-1], xp.finfo(values.dtype)
    length = n if run is None else min(run, n)
    filling = [(0, 0)] * (values.ndim - 1) + [(0, -n % length)]
    runs = xp.pad(values, filling).reshape(*values.shape[:-1], -1, length)
    # A hair more than the largest code, which times the scale must not overflow.
    steps = (2 ** (bits - 1) - 1) * (1 + float(real.eps))
    scale = xp.max(xp.abs(runs), axis=-1) / steps
    scale = xp.where(scale < real.tiny, 0, scale)
    by_code = _by_code(xp, scale, length, n)
    usable = (by_code > 0) & xp.isfinite(by_code)
    codes = xp.rint(xp.where(usable, values, 0) / xp.where(usable, by_code, 1))
    return Quantised(codes.astype(f"int{bits}"), scale, length)


_compiled = jax.jit(_quantised, static_argnames=("bits", "run"))


def _by_code(xp: Any, scale: Float[Array | np.ndarray, "... s"], run: int, n: int) -> Any:
    """The scale of each of n codes."""
    return xp.repeat(scale, run, axis=-1)[..., :n]
