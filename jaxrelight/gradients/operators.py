"""Entries of `jaxrelight.operators`."""

# Examples are arrays of NumPy, which functions of arrays of JAX take.
# pyright: reportArgumentType=false

import functools

import numpy as np
from scipy import sparse

from jaxrelight.basis.haar import HaarFaces
from jaxrelight.gradients.entry import CHOICE, Entries, Entry, Example, Exempt, named
from jaxrelight.gradients.examples import numbers
from jaxrelight.operators.clustered import Clustered, clustered
from jaxrelight.operators.clustering import cluster
from jaxrelight.operators.contract import InBasis, Operator, as_lineax
from jaxrelight.operators.dense import Dense
from jaxrelight.operators.lineax_adapter import LineaxOperator
from jaxrelight.operators.quantised import Quantised, quantised
from jaxrelight.operators.sparse_matrix import SparseMatrix, sparse_matrix
from jaxrelight.operators.sparse_rows import SparseRows, sparse_rows
from jaxrelight.operators.stacked import Stacked

_FIXED = "which coefficients are kept; codes of quantised numbers, whose scales are differentiable"
# Of six rows, five each.
_INDICES = np.tile(np.arange(5, dtype=np.int32) * 4, (6, 1)) + np.arange(6, dtype=np.int32)[:, None] % 4


@functools.cache
def _clustered() -> Clustered:
    """Three groups of four rows."""
    groups = [cluster(group, np.ones(24), 1e-3)[0] for group in numbers(3, 4, 3, 24).astype(np.float32)]
    return clustered(groups, 24)


@functools.cache
def _sparse() -> SparseRows:
    return sparse_rows(_INDICES, numbers(6, 3, 5).astype(np.float32), 24)


@functools.cache
def _quantised() -> SparseRows:
    return sparse_rows(_INDICES, quantised(numbers(6, 3, 5).astype(np.float32), 8), 24)


def _dense(rows: int = 6) -> Dense:
    return Dense(numbers(rows, 3, 24).astype(np.float32))


@functools.cache
def _kinds() -> tuple[Operator, ...]:
    """One of every kind, on 24 coefficients."""
    kept, dense = _sparse(), _dense()
    square = Dense(numbers(5, 3, 6).astype(np.float32))
    return (
        *(dense, kept, _quantised(), _clustered(), Stacked((dense, kept))),
        *(dense + kept, square @ kept, 2.5 * kept, InBasis(kept, HaarFaces(2))),
    )


def _matrix(dtype) -> SparseMatrix:
    """Five rows of eight columns."""
    return sparse_matrix(sparse.csr_array(numbers(5, 8) * (numbers(5, 8) > 0.4)), dtype)


def _transposed(operators, light, radiance):
    return sum(one.transpose(y) for one, y in zip(operators, radiance, strict=True))


ENTRIES: Entries = (
    Entry(
        named("jaxrelight.operators.contract", "Operator.apply"),
        differentiable_in="operator, light; linear in either",
        example=lambda: Example(
            lambda operators, light: [one.apply(light) for one in operators], (_kinds(), numbers(24, 3)), _transposed
        ),
        orders=2,
        fixed=_FIXED,
    ),
    Entry(
        named("jaxrelight.operators.contract", "Operator.apply_many"),
        differentiable_in="operator, lights; linear in either",
        example=lambda: Example(
            lambda operators, lights: [one.apply_many(lights) for one in operators], (_kinds(), numbers(2, 24, 3))
        ),
        fixed=_FIXED,
    ),
    Entry(
        named("jaxrelight.operators.contract", "Operator.transpose"),
        differentiable_in="operator, radiance; linear in either",
        example=lambda: Example(
            lambda operator, radiance: operator.transpose(radiance),
            (_sparse(), numbers(_sparse().shape[0], 3)),
            lambda operator, radiance, y: operator.apply(y),
        ),
        orders=2,
        fixed=_FIXED,
    ),
    Entry(
        named("jaxrelight.operators.contract", "Operator.rows Operator.to_matrix"),
        differentiable_in="operator; linear",
        example=lambda: Example(lambda operators: [one.to_matrix() for one in operators], (_kinds(),)),
        fixed=_FIXED,
    ),
    Entry(
        named("jaxrelight.operators.contract", "Basis.encode Basis.decode"),
        differentiable_in="texels, coefficients; linear",
        example=lambda: Example(HaarFaces(2).encode, (numbers(3, 24),), lambda texels, y: HaarFaces(2).decode(y)),
        orders=2,
    ),
    Entry(
        (
            *named("jaxrelight.operators.contract", "as_lineax"),
            *named("jaxrelight.operators.lineax_adapter", "LineaxOperator.mv LinearMap.apply LinearMap.transpose"),
            *named("jaxrelight.operators.lineax_adapter", "LineaxOperator.as_matrix LineaxOperator.as_blocks"),
            *named("jaxrelight.operators.lineax_adapter", "LinearMap.to_matrix"),
        ),
        differentiable_in="operator, vector; linear in either",
        example=lambda: Example(
            lambda operator, light: LineaxOperator(operator, light.dtype).mv(light),
            (_sparse(), numbers(24, 3)),
            lambda operator, light, y: as_lineax(operator, light.dtype).transpose().mv(y),
        ),
        orders=2,
        fixed=_FIXED,
    ),
    Entry(
        named("jaxrelight.operators.quantised", "Quantised.decoded decoded"),
        differentiable_in="scales; linear",
        example=lambda: Example(
            lambda scale: Quantised(np.arange(12, dtype=np.int8).reshape(2, 6), scale, 3).decoded(), (numbers(2, 2),)
        ),
        orders=2,
        fixed="the codes",
    ),
    Entry(
        named("jaxrelight.operators.sparse_rows", "sparse_rows SparseRows.with_filling"),
        differentiable_in="values; linear",
        example=lambda: Example(
            lambda values: sparse_rows(_INDICES, values, 24).apply(np.ones((24, 3), values.dtype)),
            (numbers(6, 3, 5),),
        ),
        orders=2,
        fixed="the indices",
    ),
    Entry(
        named("jaxrelight.operators.sparse_matrix", "SparseMatrix.apply SparseMatrix.transpose"),
        differentiable_in="what is multiplied; linear",
        example=lambda: Example(
            lambda x: _matrix(x.dtype).apply(x), (numbers(8, 3),), lambda x, y: _matrix(y.dtype).transpose(y)
        ),
        orders=2,
        fixed="the matrix",
    ),
    Exempt(
        named(
            "jaxrelight.operators.multilinear",
            "Multilinear.product Multilinear.adjoint Multilinear.product_many Multilinear.partial",
        ),
        "what the derivatives of operators are made of: each operator is tested by its own entry",
    ),
    Exempt(
        named("jaxrelight.operators.column_blocks", "ColumnBlocks.apply"),
        "takes the blocks that the light of the moment needs, on the host: `Clustered` is the same map, differentiable",
    ),
    Exempt(
        (
            *named("jaxrelight.operators.clustered", "Clustered.with_filling Clustered.supports Clustered.clusters"),
            *named("jaxrelight.operators.clustered", "clustered quantised_clusters count_holders find_holders"),
            *named("jaxrelight.operators.clustering", "as_clusters cluster"),
            *named("jaxrelight.operators.quantised", "quantised"),
            *named("jaxrelight.operators.sharded", "sharded"),
            *named("jaxrelight.operators.sparse_matrix", "sparse_matrix"),
        ),
        "host code: makes operators of known numbers, by singular values and by rounding; a sharded operator is "
        "differentiable as its own kind is",
    ),
    Exempt(
        (
            *named("jaxrelight.operators.contract", "parts_of check_light check_channels"),
            *named("jaxrelight.operators.quantised", "decoded_type"),
        ),
        CHOICE,
    ),
)
