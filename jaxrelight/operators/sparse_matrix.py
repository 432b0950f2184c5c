"""Sparse matrices of fixed numbers, held by rows and by columns, so that both products are gathers."""

import dataclasses
from collections.abc import Sequence

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jax.typing import DTypeLike
from jaxtyping import Array, Float, Int, PyTree
from scipy import sparse

from jaxrelight.operators.multilinear import Multilinear
from jaxrelight.operators.sparse_rows import SparseRows, sparse_rows


class _Gathers(eqx.Module):
    """The rows of a matrix, those of about as many numbers held together.

    Attributes:
        groups: rows by how many numbers they hold, filled up to a power of two.
        order: where each row is found in the concatenated groups.
    """

    groups: tuple[SparseRows, ...]
    order: Int[Array, " r"]

    def apply(self, x: Float[Array, "d c"]) -> Float[Array, "r c"]:
        """The product."""
        rows = jnp.concatenate([group.apply(x) for group in self.groups])
        return rows.at[self.order].get(mode="promise_in_bounds")


class SparseMatrix(eqx.Module):
    """A matrix of r rows and d columns, the same for all channels. Made by `sparse_matrix`; a pytree.

    Its numbers are held fixed: products are differentiable in what is multiplied. They are there twice, by rows and by
    columns, since a gather takes a quarter of the time of a scatter to as many places.
    """

    rows: _Gathers
    columns: _Gathers

    @jax.jit
    def apply(self, x: Float[Array, "d c"]) -> Float[Array, "r c"]:
        """The product."""
        return _PRODUCT((self.rows, self.columns), x)

    @jax.jit
    def transpose(self, y: Float[Array, "r c"]) -> Float[Array, "d c"]:
        """The product with the transposed matrix."""
        like = jax.ShapeDtypeStruct((len(self.columns.order), y.shape[1]), y.dtype)
        return _PRODUCT.partial(0, (self.rows, self.columns), (None, y), like)


@dataclasses.dataclass(frozen=True)
class _Product(Multilinear):
    """A matrix times what it is given."""

    def product(self, fixed: PyTree, x: Float[Array, "d c"]) -> Float[Array, "r c"]:
        """By rows."""
        return fixed[0].apply(x)

    def adjoint(self, number: int, fixed: PyTree, arguments: Sequence[PyTree], like: PyTree) -> PyTree:
        """By columns."""
        return fixed[1].apply(arguments[1])


_PRODUCT = _Product()


def sparse_matrix(matrix: sparse.csr_array, dtype: DTypeLike = np.float32) -> SparseMatrix:
    """A matrix of SciPy, its numbers of a type. Put together by NumPy, also while something is traced."""
    with jax.ensure_compile_time_eval():
        return SparseMatrix(_gathers(matrix, dtype), _gathers(matrix.T.tocsr(), dtype))


def _gathers(matrix: sparse.csr_array, dtype: DTypeLike) -> _Gathers:
    starts, counts = matrix.indptr, np.diff(matrix.indptr)
    assert matrix.shape is not None
    columns = matrix.shape[1]
    capacities = 2 ** np.ceil(np.log2(np.maximum(counts, 1))).astype(int)
    groups, members = [], []
    for capacity in np.unique(capacities):
        rows = np.flatnonzero(capacities == capacity)
        slot = np.arange(capacity)
        inside = slot < counts[rows, None]
        entry = np.where(inside, starts[rows, None] + slot, 0)
        values = np.where(inside, matrix.data[entry], 0)[:, None].astype(dtype)
        indices = np.where(inside, matrix.indices[entry], 0).astype(np.int32)
        groups.append(sparse_rows(indices, values, columns))
        members.append(rows)
    order = np.argsort(np.concatenate(members), kind="stable").astype(np.int32)
    return _Gathers(tuple(groups), jax.device_put(order))
