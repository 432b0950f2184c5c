"""What every transport operator and every basis offers, and the operators that are made of others."""

import abc
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import ArrayLike, DTypeLike
from jaxtyping import Array, Float, Int

from jaxrelight.numerics.arrays import as_array
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

    Operators form an algebra: `A @ B` applies B, an operator or a basis, and then A; `A + B` is their sum; `s * A` is
    A times a number, or times one number for each channel.

    Operators are pytrees: pass them to jitted functions as arguments. `apply` supports both modes of differentiation;
    where the gradient with respect to light is all that is wanted, `transpose` gives it without a scatter through
    autodiff.

    A subclass defines `shape`, `nbytes`, `_apply`, `_transpose` and `_rows`, and `_apply_many` where one product for
    many lights costs less than many products. The public methods check shapes and call those.
    """

    # NumPy leaves `array * operator` to the operator.
    __array_ufunc__ = None

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

    def __matmul__(self, other: "Operator | Basis") -> "Operator":
        if isinstance(other, Basis):
            return InBasis(self, other)
        return Composed(self, other) if isinstance(other, Operator) else NotImplemented

    def __add__(self, other: "Operator") -> "Operator":
        return Summed((*parts_of(self), *parts_of(other))) if isinstance(other, Operator) else NotImplemented

    def __mul__(self, factor: ArrayLike) -> "Operator":
        return NotImplemented if isinstance(factor, Operator | Basis) else Scaled(self, factor)

    def __rmul__(self, factor: ArrayLike) -> "Operator":
        return self * factor


class Summed(Operator):
    """The sum of operators of one shape, but for channels: each has one, or as many as the others.

    Raises:
        ValueError: for operators of other rows, coefficients or channels than the first.
    """

    operators: tuple[Operator, ...]

    def __check_init__(self) -> None:
        first = self.operators[0].shape
        for operator in self.operators[1:]:
            if operator.shape[:2] != first[:2]:
                raise ValueError(f"operators of shapes {first} and {operator.shape} cannot be added")
        check_channels("added", self.operators)

    @property
    def shape(self) -> tuple[int, int, int]:
        """(r, d, c): c of the one that has most."""
        r, d, _ = self.operators[0].shape
        return r, d, max(operator.shape[2] for operator in self.operators)

    @property
    def nbytes(self) -> int:
        """Bytes of all of them."""
        return sum(operator.nbytes for operator in self.operators)

    def _apply(self, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        first, *others = (operator.apply(light) for operator in self.operators)
        return sum(others, first)

    def _apply_many(self, lights: Float[Array, "n d c"]) -> Float[Array, "n r c"]:
        first, *others = (operator.apply_many(lights) for operator in self.operators)
        return sum(others, first)

    def _transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
        first, *others = (operator.transpose(radiance) for operator in self.operators)
        return sum(others, first)

    def _rows(self, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
        first, *others = (operator.rows(indices) for operator in self.operators)
        return sum(others, first)


class Composed(Operator):
    """An operator applied to the radiance of another: the coefficients of `outer` are the rows of `inner`.

    Raises:
        ValueError: where the one has not as many coefficients as the other has rows, or other channels.
    """

    outer: Operator
    inner: Operator

    def __check_init__(self) -> None:
        if self.outer.shape[1] != self.inner.shape[0]:
            raise ValueError(f"operators of shapes {self.outer.shape} and {self.inner.shape} cannot be composed")
        check_channels("composed", (self.outer, self.inner))

    @property
    def shape(self) -> tuple[int, int, int]:
        """(r, d, c): r of the outer one, d of the inner one, c of the one that has most."""
        (r, _, c), (_, d, inner_c) = self.outer.shape, self.inner.shape
        return r, d, max(c, inner_c)

    @property
    def nbytes(self) -> int:
        """Bytes of both."""
        return self.outer.nbytes + self.inner.nbytes

    def _apply(self, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        return self.outer.apply(self.inner.apply(light))

    def _apply_many(self, lights: Float[Array, "n d c"]) -> Float[Array, "n r c"]:
        return self.outer.apply_many(self.inner.apply_many(lights))

    def _transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
        return self.inner.transpose(self.outer.transpose(radiance))

    def _rows(self, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
        # The i-th row of A B is the adjoint of B, applied to the i-th row of A.
        rows = jnp.swapaxes(self.outer.rows(indices), 1, 2)
        rows = jnp.broadcast_to(rows, (*rows.shape[:2], self.shape[2]))
        return jnp.swapaxes(jax.vmap(self.inner.transpose)(rows), 1, 2)


class Scaled(Operator):
    """An operator times a number, or times one number for each channel.

    Attributes:
        operator: what is scaled.
        factor: the number; those of n channels make an operator of one channel one of n.

    Raises:
        ValueError: for factors of other channels than the operator's.
    """

    operator: Operator
    factor: Float[Array, ""] | Float[Array, " c"] = eqx.field(
        # Numbers of Python leave the precision to the operator.
        converter=lambda factor: jnp.asarray(factor) if isinstance(factor, int | float) else as_array(factor)
    )

    def __check_init__(self) -> None:
        channels, shape = self.operator.shape[2], self.factor.shape
        if len(shape) > 1 or (shape and shape[0] != channels and 1 not in (channels, *shape)):
            raise ValueError(f"a factor of shape {shape} cannot scale an operator of shape {self.operator.shape}")

    @property
    def shape(self) -> tuple[int, int, int]:
        """(r, d, c)."""
        r, d, c = self.operator.shape
        return r, d, max(c, *self.factor.shape, 1)

    @property
    def nbytes(self) -> int:
        """Bytes of the operator and its factor."""
        return self.operator.nbytes + self.factor.nbytes

    def _apply(self, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        return self._along(0) * self.operator.apply(light)

    def _apply_many(self, lights: Float[Array, "n d c"]) -> Float[Array, "n r c"]:
        return self._along(0, 1) * self.operator.apply_many(lights)

    def _transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
        return self._along(0) * self.operator.transpose(radiance)

    def _rows(self, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
        return self._along(0, 2) * self.operator.rows(indices)

    def _along(self, *others: int) -> Array:
        """The factor, with axes of length one beside its channels; a single number as it is."""
        return jnp.expand_dims(self.factor, others) if self.factor.ndim else self.factor


class InBasis(Operator):
    """An operator on coefficients of an orthonormal basis, as one on the numbers that the basis encodes.

    Raises:
        ValueError: for a basis of another number of coefficients than the operator has.
    """

    operator: Operator
    basis: Basis

    def __check_init__(self) -> None:
        if self.basis.size != self.operator.shape[1]:
            raise ValueError(f"a basis of {self.basis.size} does not fit an operator of shape {self.operator.shape}")

    @property
    def shape(self) -> tuple[int, int, int]:
        """The shape of the operator."""
        return self.operator.shape

    @property
    def nbytes(self) -> int:
        """Bytes of the operator."""
        return self.operator.nbytes

    def _apply(self, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        return self.operator.apply(self.basis.encode(light.T).T)

    def _apply_many(self, lights: Float[Array, "n d c"]) -> Float[Array, "n r c"]:
        return self.operator.apply_many(jnp.swapaxes(self.basis.encode(jnp.swapaxes(lights, 1, 2)), 1, 2))

    def _transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
        # Decoding is the transpose of encoding.
        return self.basis.decode(self.operator.transpose(radiance).T).T

    def _rows(self, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
        return self.basis.decode(self.operator.rows(indices))


def parts_of(operator: Operator) -> tuple[Operator, ...]:
    """The operators of a sum; of any other, itself."""
    return operator.operators if isinstance(operator, Summed) else (operator,)


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


def check_channels(action: str, operators: Sequence[Operator]) -> None:
    """Refuses operators unless each has one channel, or as many as the others.

    Args:
        action: what is done with the operators, for the message: they cannot be "added".
        operators: one or more.

    Raises:
        ValueError: for operators of two numbers of channels, both above 1.
    """
    widest = max(operators, key=lambda operator: operator.shape[2])
    for operator in operators:
        if operator.shape[2] not in (1, widest.shape[2]):
            raise ValueError(
                f"operators of shapes {operator.shape} and {widest.shape} cannot be {action}: their channels differ"
            )


def _check_shape(name: str, shape: tuple[int, ...], axes: tuple[str, ...], wanted: tuple[int, int]) -> None:
    """Refuses an array that has not the axes, or not the lengths of the last two; one channel of an operator fits all.

    Shapes are known while a function is traced: nothing is computed.
    """
    if len(shape) != len(axes):
        raise ValueError(f"{name} of shape {shape} has not the axes {', '.join(axes)}")
    for axis, given, own in zip(axes[-2:], shape[-2:], wanted, strict=True):
        if given != own and (axis, own) != ("channels", 1):
            raise ValueError(f"{name} has {given} {axis}, the operator {own}")


def _in_precision_of(reference: Array, result: Array) -> Array:
    """The result in the floating-point type of the reference; a reference of whole numbers leaves it as it is."""
    dtype = jnp.result_type(reference)
    return result.astype(dtype) if jnp.issubdtype(dtype, jnp.floating) else result
