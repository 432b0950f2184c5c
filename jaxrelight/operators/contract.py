"""What every transport operator and every basis offers."""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int

from jaxrelight.operators.lineax_adapter import LineaxOperator


class Basis(eqx.Module):
    """An orthonormal basis of functions on d texels: `decode` is the inverse, and the transpose, of `encode`.

    A subclass defines `size`, `_encode` and `_decode`; the public methods check shapes and call those.
    """

    @property
    @abc.abstractmethod
    def size(self) -> int:
        """The number d of texels, which is that of coefficients."""

    def encode(self, texels: Float[Array, "... d"]) -> Float[Array, "... d"]:
        """Coefficients of texel values, in the precision of those.

        Raises:
            ValueError: for another number of texels than the basis has.
        """
        self._check("texels", np.shape(texels))
        return self._encode(texels)

    def decode(self, coefficients: Float[Array, "... d"]) -> Float[Array, "... d"]:
        """Texel values of coefficients, in the precision of those.

        Raises:
            ValueError: for another number of coefficients than the basis has.
        """
        self._check("coefficients", np.shape(coefficients))
        return self._decode(coefficients)

    @abc.abstractmethod
    def _encode(self, texels: Float[Array, "... d"]) -> Float[Array, "... d"]:
        """`encode`, of texels whose number has been checked."""

    @abc.abstractmethod
    def _decode(self, coefficients: Float[Array, "... d"]) -> Float[Array, "... d"]:
        """`decode`, of coefficients whose number has been checked."""

    def _check(self, name: str, shape: tuple[int, ...]) -> None:
        if shape[-1:] != (self.size,):
            raise ValueError(f"{name} of shape {shape} do not end in the {self.size} of the basis")


class Operator(eqx.Module):
    """A linear map from light x[d, c] to radiance y[r, c], acting on every colour channel by itself.

    Axes: r rows, d light coefficients, c channels. An operator of one channel (grey) acts on light of any number of
    channels, on all of them alike. Radiance has the precision of the light that is given, and the adjoint's light that
    of the radiance.

    Operators are pytrees: pass them to jitted functions as arguments. `apply` supports both modes of differentiation;
    where the gradient with respect to light is all that is wanted, `transpose` gives it without a scatter through
    autodiff.

    A subclass defines `shape`, `nbytes`, `_apply`, `_transpose` and `_rows`, and `_apply_many` where one product for
    many lights costs less than many products. The public methods check shapes and call those.
    """

    @property
    @abc.abstractmethod
    def shape(self) -> tuple[int, int, int]:
        """(r, d, c)."""

    @property
    @abc.abstractmethod
    def nbytes(self) -> int:
        """Bytes that the operator holds."""

    def apply(self, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        """Radiance of every row: y[r, c] = Σ_d T[r, c, d] x[d, c].

        Raises:
            ValueError: for light of another shape than the operator takes.
        """
        check_light(light, self.shape)
        return _in_precision_of(light, self._apply(light))

    def apply_many(self, lights: Float[Array, "n d c"]) -> Float[Array, "n r c"]:
        """Radiance of every row under each of n lights, where one product for all of them costs less than n.

        Raises:
            ValueError: for lights of another shape than the operator takes.
        """
        check_light(lights, self.shape, ("lights",))
        return _in_precision_of(lights, self._apply_many(lights))

    def transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
        """The adjoint: x[d, c] = Σ_r T[r, c, d] y[r, c].

        Raises:
            ValueError: for radiance of another shape than the operator gives.
        """
        rows, _, channels = self.shape
        _check_shape("radiance", np.shape(radiance), ("rows", "channels"), (rows, channels))
        return _in_precision_of(radiance, self._transpose(radiance))

    def rows(self, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
        """The chosen rows, written out: T[indices], of as many channels as the operator has.

        Rows are in the precision of the operator's numbers. Indices may be traced, in any order, and repeat; what an
        index outside of 0 … r − 1 gives is not defined.

        Raises:
            ValueError: for indices that are not integers along one axis.
        """
        shape, dtype = np.shape(indices), jnp.result_type(indices)
        if len(shape) != 1 or not jnp.issubdtype(dtype, jnp.integer):
            raise ValueError(f"row indices are integers along one axis, not {dtype} of shape {shape}")
        return self._rows(indices)

    def to_matrix(self) -> Float[Array, "r c d"]:
        """All rows, written out: for small operators and for tests."""
        return self.rows(jax.device_put(np.arange(self.shape[0], dtype=np.int32)))

    @abc.abstractmethod
    def _apply(self, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        """`apply`, of light whose shape has been checked."""

    def _apply_many(self, lights: Float[Array, "n d c"]) -> Float[Array, "n r c"]:
        """`apply_many`, of lights whose shape has been checked."""
        return jax.vmap(self._apply)(lights)

    @abc.abstractmethod
    def _transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
        """`transpose`, of radiance whose shape has been checked."""

    @abc.abstractmethod
    def _rows(self, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
        """`rows`, of indices whose shape has been checked."""


def as_lineax(operator: Operator, dtype: DTypeLike = jnp.float32) -> LineaxOperator:
    """The operator as a lineax operator from [d, c] to [r, c], for its solvers and its algebra.

    Its transpose is the operator's own. It has no mark, such as being symmetric: `lineax.TaggedLinearOperator` gives
    one.

    Args:
        operator: of c channels; one channel stays one.
        dtype: of the light and the radiance.
    """
    return LineaxOperator(operator, np.dtype(dtype))


def check_light(light: Float[Array, "*n d c"], shape: tuple[int, int, int], leading: tuple[str, ...] = ()) -> None:
    """Refuses light that an operator of a shape (r, d, c) does not take.

    Args:
        light: coefficients, behind as many axes as are named.
        shape: of the operator.
        leading: names of the axes before those of coefficients and channels.

    Raises:
        ValueError: for another number of axes, coefficients or channels.
    """
    _, coefficients, channels = shape
    _check_shape("light", np.shape(light), (*leading, "coefficients", "channels"), (coefficients, channels))


def _check_shape(name: str, shape: tuple[int, ...], axes: tuple[str, ...], wanted: tuple[int, int]) -> None:
    """Refuses an array that has not the axes, or not the lengths of the last two; one channel of an operator fits all.

    Shapes are known while a function is traced: nothing is computed.
    """
    if len(shape) != len(axes):
        raise ValueError(f"{name} of shape {shape} has not the axes {', '.join(axes)}")
    for axis, given, own in zip(axes[-2:], shape[-2:], wanted, strict=True):
        if given != own and (axis, own) != ("channels", 1):
            raise ValueError(f"{name} has {given} {axis}, the operator {own}")


def _in_precision_of(given: Array, found: Array) -> Array:
    """What was computed, in the floating-point type of what was given."""
    dtype = jnp.result_type(given)
    return found.astype(dtype) if jnp.issubdtype(dtype, jnp.floating) else found
