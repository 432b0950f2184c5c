"""What every transport operator offers."""

import abc
from typing import Protocol

import equinox as eqx
import jax
import jax.numpy as jnp
import lineax as lx
import numpy as np
from jaxtyping import Array, Float, Int


class Basis(Protocol):
    """An orthonormal basis of functions on d texels: `decode` is the inverse, and the transpose, of `encode`."""

    def encode(self, texels: Float[Array, "... d"]) -> Float[Array, "... d"]: ...  # noqa: D102

    def decode(self, coefficients: Float[Array, "... d"]) -> Float[Array, "... d"]: ...  # noqa: D102


class Operator(eqx.Module):
    """A linear map from light x[d, c] to radiance y[r, c], acting on every colour channel by itself.

    Axes: r rows, d light coefficients, c channels. Operators are pytrees: pass them to jitted functions as
    arguments. `apply` supports both modes of differentiation; where the gradient with respect to light is all that
    is wanted, `transpose` gives it without a scatter through autodiff.
    """

    @property
    @abc.abstractmethod
    def shape(self) -> tuple[int, int, int]:
        """(r, d, c)."""

    @property
    @abc.abstractmethod
    def nbytes(self) -> int:
        """Bytes that the operator holds."""

    @abc.abstractmethod
    def apply(self, light: Float[Array, "d c"]) -> Float[Array, "r c"]:
        """Radiance of every row: y[r, c] = Σ_d T[r, c, d] x[d, c]."""

    def apply_many(self, lights: Float[Array, "n d c"]) -> Float[Array, "n r c"]:
        """Radiance of every row under each of n lights, where one product for all of them costs less than n."""
        return jax.vmap(self.apply)(lights)

    @abc.abstractmethod
    def transpose(self, radiance: Float[Array, "r c"]) -> Float[Array, "d c"]:
        """The adjoint: x[d, c] = Σ_r T[r, c, d] y[r, c]."""

    @abc.abstractmethod
    def rows(self, indices: Int[Array, " i"]) -> Float[Array, "i c d"]:
        """The chosen rows, written out."""

    def to_matrix(self) -> Float[Array, "r c d"]:
        """All rows, written out: for small operators and for tests."""
        return self.rows(jax.device_put(np.arange(self.shape[0], dtype=np.int32)))


def as_lineax(operator: Operator, dtype=jnp.float32) -> lx.FunctionLinearOperator:
    """The operator as a lineax operator from [d, c] to [r, c], for its solvers and its algebra."""
    _, d, c = operator.shape
    return lx.FunctionLinearOperator(operator.apply, jax.ShapeDtypeStruct((d, c), dtype))
