"""One battery for every transport operator."""

import functools
from typing import Any

import equinox as eqx
import jax
import numpy as np
import pytest
from jax.sharding import Mesh

from jaxrelight.basis import cubemap
from jaxrelight.basis.haar import HaarFaces
from jaxrelight.brdf.factored import Factored
from jaxrelight.operators.clustered import Cluster, Clustered, clustered, quantised_clusters
from jaxrelight.operators.clustering import cluster
from jaxrelight.operators.contract import Operator, as_lineax
from jaxrelight.operators.dense import Dense
from jaxrelight.operators.quantised import Quantised, quantised
from jaxrelight.operators.sharded import sharded
from jaxrelight.operators.sparse_rows import _BLOCK, _FEW, _MANY, SparseRows, smallest_index_type, sparse_rows
from jaxrelight.operators.stacked import Stacked
from jaxrelight.transport import bake
from jaxrelight.transport.streamed import Streamed
from tests.operators.derivatives import check_derivatives

D = 96  # texels of a 6×4² cube map


def dense(r: int, c: int, dtype) -> tuple[Operator, np.ndarray]:
    matrix = np.random.default_rng(r).normal(size=(r, c, D)).astype(dtype)
    return Dense(jax.device_put(matrix)), matrix.astype(float)


def sparse(r: int, c: int, dtype, n: int = 5, bits: int | None = None) -> tuple[SparseRows, np.ndarray]:
    """With bits, quantised in runs of 3, and the matrix that of the quantised rows."""
    rng = np.random.default_rng(r)
    indices = np.sort(rng.random((r, D)).argsort(axis=-1)[:, :n], axis=-1)
    values = rng.normal(size=(r, c, n)).astype(dtype)
    values = quantised(values, bits, 3) if bits else values
    matrix = np.zeros((r, c, D))
    np.put_along_axis(matrix, np.broadcast_to(indices[:, None], values.shape), by_hand(values), axis=-1)
    return sparse_rows(indices, values, D), matrix


def by_hand(values) -> np.ndarray:
    """The numbers of an array that may be quantised, by the formula."""
    if not isinstance(values, Quantised):
        return np.asarray(values, float)
    scale = np.repeat(np.asarray(values.scale, float), values.run, axis=-1)
    return np.asarray(values.codes) * scale[..., : values.shape[-1]]


def in_clusters(
    c: int, dtype, groups: int = 3, m: int = 4, q: int = 2, s: int = 9, bits: int | None = None
) -> tuple[Clustered, np.ndarray]:
    """Rows that are mixtures of up to q over up to s coefficients, the last group's black: which `cluster` finds.

    With bits, quantised, and the matrix that of the quantised mixtures.
    """
    rng = np.random.default_rng(c)
    matrix = np.zeros((groups, m, c, D))
    for fewer, group in enumerate(matrix[:-1]):
        chosen = rng.permutation(D)[: s - fewer]
        group[..., chosen] = rng.normal(size=(m, c, q)) @ rng.normal(size=(q, s - fewer))
    operator = clustered([cluster(group, np.ones(D), 1e-6)[0] for group in matrix], D)
    if bits:
        operator = quantised_clusters(operator, bits)
    if bits or dtype == np.float64:
        # Clusters are made in float32.
        matrix = mixtures(operator)
    arrays = jax.tree.map(lambda x: np.asarray(x, dtype if x.dtype == np.float32 else x.dtype), operator)
    return jax.device_put(arrays), matrix.reshape(-1, c, D)


def mixtures(operator: Clustered) -> np.ndarray:
    """The rows of quantised clusters, by the formula."""
    out = np.zeros((len(operator.place), operator.group_rows, operator.channels, D))
    for part in operator.buckets:
        basis, weights = (by_hand(values) for values in (part.basis, part.weights))
        support = np.eye(D)[np.asarray(part.support)]
        # groups b, coefficients s
        out[np.asarray(part.groups)] = np.einsum("bcqr,bqs,bsd->brcd", weights, basis, support)
    return out


def stacked(dtype) -> tuple[Operator, np.ndarray]:
    parts = [in_clusters(3, dtype), sparse(4, 1, dtype), dense(5, 3, dtype)]
    return Stacked(tuple(part for part, _ in parts)), np.concatenate([spread(matrix) for _, matrix in parts])


def spread(matrix: np.ndarray, c: int = 3) -> np.ndarray:
    """Rows of one channel, the same in c channels; others as they are."""
    return np.broadcast_to(matrix, (len(matrix), c, matrix.shape[-1]))


def summed(dtype) -> tuple[Operator, np.ndarray]:
    (grey, one), (other, two) = sparse(6, 1, dtype), dense(6, 3, dtype)
    return grey + other, spread(one) + two


def composed(dtype) -> tuple[Operator, np.ndarray]:
    """The outer one is grey, the inner one is not."""
    inner, one = sparse(6, 3, dtype)
    outer = np.random.default_rng(1).normal(size=(5, 1, 6)).astype(dtype)
    return Dense(jax.device_put(outer)) @ inner, np.einsum("rj,jcd->rcd", outer[:, 0].astype(float), one)


def scaled(dtype) -> tuple[Operator, np.ndarray]:
    """By a number for each channel, which a grey operator has one of."""
    operator, matrix = sparse(7, 1, dtype)
    factor = np.array([0.5, -2, 3], dtype)
    return factor * operator, factor[:, None] * spread(matrix)


def in_basis(dtype) -> tuple[Operator, np.ndarray]:
    """The matrix of encoding has as rows the coefficients of each texel, by `decode` of each coefficient."""
    operator, matrix = sparse(7, 3, dtype)
    units: Any = np.eye(D, dtype=dtype)
    decoded = np.asarray(HaarFaces(4).decode(units), float)
    return operator @ HaarFaces(4), matrix @ decoded


def on_one_device(dtype) -> tuple[Operator, np.ndarray]:
    operator, matrix = sparse(7, 3, dtype)
    return sharded(operator, Mesh(np.array(jax.devices()[:1]), ("rows",))), matrix


@jax.jit
def _light_side(reflection: Factored, directions: jax.Array) -> jax.Array:
    return jax.vmap(reflection.light_side)(directions)


def streamed(c: int, dtype) -> tuple[Operator, np.ndarray]:
    """Two groups of four receivers and two terms; the matrix by the formula."""
    rng = np.random.default_rng(c)
    groups, m, k, side = 2, 4, 2, 5
    bits = rng.integers(0, 256, size=(groups, m, D // 8), dtype=np.uint8)
    frames = np.linalg.qr(rng.normal(size=(groups, m, 3, 3)))[0].astype(dtype)
    maps = jax.device_put(rng.uniform(size=(k, c, side, side)).astype(dtype))
    reflection = Factored(maps, maps)
    operator = Streamed(bits.__getitem__, jax.device_put(frames), reflection, bake.directions_for(4, dtype=dtype))
    local = np.einsum("gmij,dj->gmdi", frames.astype(float), cubemap.directions(4))
    seen = np.unpackbits(bits, axis=-1, bitorder="little")
    weight = seen * np.maximum(local[..., 2], 0) * cubemap.solid_angles(4)
    light_side = np.asarray(_light_side(reflection, local.reshape(-1, 3).astype(dtype)), float)
    return operator, np.einsum("gmd,gmdkc->gmkcd", weight, light_side.reshape(groups, m, D, k, c)).reshape(-1, c, D)


CASES = {
    "dense": functools.partial(dense, 6, 3),
    "dense grey": functools.partial(dense, 6, 1),
    "sparse": functools.partial(sparse, 7, 3),
    "sparse grey": functools.partial(sparse, 7, 1),
    "sparse full blocks": functools.partial(sparse, 2 * _BLOCK, 1),
    "sparse over a block": functools.partial(sparse, _BLOCK + 3, 3),
    "sparse in 8 bits": functools.partial(sparse, _BLOCK + 3, 3, bits=8),
    "sparse in 16 bits, grey": functools.partial(sparse, 7, 1, bits=16),
    "clustered": functools.partial(in_clusters, 3),
    "clustered grey": functools.partial(in_clusters, 1),
    "clustered in 8 bits": functools.partial(in_clusters, 3, bits=8),
    "clustered in 16 bits, grey": functools.partial(in_clusters, 1, bits=16),
    "stacked": stacked,
    "summed": summed,
    "composed": composed,
    "scaled": scaled,
    "in a basis": in_basis,
    "on one device": on_one_device,
    "streamed": functools.partial(streamed, 3),
    "streamed grey": functools.partial(streamed, 1),
}
SMALL = ["dense", "sparse", "sparse grey", "sparse in 16 bits, grey", "clustered", "clustered grey"]
SMALL += ["clustered in 8 bits", "clustered in 16 bits, grey", "stacked", "streamed", "streamed grey"]
# Each is a few lines over what it is made of.
MADE_OF_OTHERS = ["summed", "composed", "scaled", "in a basis"]
# `Streamed` reads its bits from the host; all others are plain pytrees. The stacked one holds one of each.
PYTREES = ["sparse grey", "sparse in 16 bits, grey", "clustered", "clustered in 8 bits", "stacked"]
# What other cases have, each by itself: of blocks, "sparse" and "sparse over a block"; grey, those in bits.
COMBINED = ["sparse grey", "sparse full blocks", "clustered grey"]
# What the stacked one holds as it is.
HELD = ["sparse grey", "clustered"]


def cases(names, slow=tuple(COMBINED)) -> list:
    return [pytest.param(name, marks=[pytest.mark.slow] * (name in slow)) for name in names]


@functools.cache
def case(name: str) -> tuple[Operator, np.ndarray]:
    return CASES[name](np.float32)


# What operators answer, in programs that all tests of a case share. Users jit them where they are plain pytrees.


TRACES = []


def both(operator: Operator, light, radiance):
    """The product and its adjoint."""
    TRACES.append(operator)
    return operator.apply(light), operator.transpose(radiance)


def written_out(operator: Operator, indices):
    """The chosen rows, and all."""
    return operator.rows(indices), operator.to_matrix()


def of_many(operator: Operator, several):
    """The product with several lights of different numbers of them, and with the first of those by `vmap`."""
    return jax.vmap(operator.apply)(several[0]), *(operator.apply_many(lights) for lights in several)


_jitted = {function: jax.jit(function) for function in (both, written_out, of_many)}


def ask(function, operator: Operator, *arguments):
    """One of those functions of an operator, as users call it."""
    called = function if isinstance(operator, Streamed) else _jitted[function]
    return jax.tree.map(np.asarray, called(operator, *arguments))


def random(*shape: int, seed: int = 0, dtype: Any = np.float32) -> Any:
    return np.random.default_rng(seed).normal(size=shape).astype(dtype)


def relative(actual, expected) -> float:
    return float(np.linalg.norm(np.asarray(actual, float) - expected) / np.linalg.norm(expected))


def other_values(operator):
    """The same operator with twice the numbers in its rows."""
    if isinstance(operator, Stacked):
        return Stacked(tuple(other_values(part) for part in operator.operators))
    if isinstance(operator, Clustered):
        weights = jax.tree.map(lambda x: 2 * x if eqx.is_inexact_array(x) else x, operator.buckets[0].weights)
        return eqx.tree_at(lambda one: one.buckets[0].weights, operator, weights)
    return jax.tree.map(lambda x: 2 * x if eqx.is_inexact_array(x) else x, operator)


@pytest.mark.parametrize("name", cases(CASES))
def test_is_its_matrix(name):
    operator, matrix = case(name)
    r, d, c = operator.shape
    assert (r, c, d) == matrix.shape
    assert operator.nbytes > 0
    light, radiance = random(d, 3), random(r, 3, seed=1)
    forth, back = ask(both, operator, light, radiance)
    assert (forth.shape, back.shape) == ((r, 3), (d, 3))
    assert forth.dtype == back.dtype == np.float32
    matrix = np.broadcast_to(matrix, (r, 3, d))
    assert relative(forth, np.einsum("rcd,dc->rc", matrix, light.astype(float))) < 1e-6
    assert relative(back, np.einsum("rcd,rc->dc", matrix, radiance.astype(float))) < 2e-6


@pytest.mark.parametrize("name", cases(CASES))
def test_rows_are_rows_of_the_matrix(name):
    operator, matrix = case(name)
    chosen = np.array([len(matrix) - 1, 0, 2, 2, len(matrix) // 2], np.int32)
    rows, whole = ask(written_out, operator, chosen)
    r, d, c = operator.shape
    assert (rows.shape, whole.shape) == ((5, c, d), (r, c, d))
    assert rows.dtype == whole.dtype == np.float32
    np.testing.assert_allclose(rows, whole[chosen], rtol=1e-6, atol=1e-6)
    assert relative(rows, matrix[chosen]) < 1e-6
    assert relative(whole, matrix) < 1e-6


@pytest.mark.parametrize("name", ["stacked", "streamed"])
def test_rows_are_chosen_by_indices_of_any_kind(name):
    """Those of the host, of the device and traced ones; none give no rows."""
    operator, matrix = case(name)
    chosen: Any = np.array([len(matrix) - 1, 0, 2, 2], np.int32)
    traced = jax.jit(lambda indices: operator.rows(indices))(chosen)
    for rows in (operator.rows(chosen), operator.rows(jax.device_put(chosen)), traced):
        assert relative(rows, matrix[chosen]) < 1e-6
    assert operator.rows(chosen[:0]).shape == (0, *matrix.shape[1:])


# What the shape of light and radiance is refused for; operators of one channel take any number of those.
REFUSED = {
    "light has 100 coefficients, the operator 96": lambda operator: operator.apply(random(100, 3)),
    "light has 3 coefficients, the operator 96": lambda operator: operator.apply(random(3, D)),
    "light of shape .96,. has not the axes coefficients, channels": lambda operator: operator.apply(random(D)),
    "light has 95 coefficients, the operator 96": lambda operator: operator.apply_many(random(_MANY, D - 1, 3)),
    "light of shape .96, 3. has not the axes lights, ": lambda operator: operator.apply_many(random(D, 3)),
    "radiance has 1 rows, the operator": lambda operator: operator.transpose(random(1, 3)),
    "radiance of shape .2, 7, 3. has not": lambda operator: operator.transpose(random(2, 7, 3)),
    "along one axis, not int32 of shape .1, 2.": lambda operator: operator.rows(np.zeros((1, 2), np.int32)),
    "are integers along one axis, not float32": lambda operator: operator.rows(np.zeros(2, np.float32)),
}
OTHER_CHANNELS = {
    "light has 2 channels, the operator 3": lambda operator: operator.apply(random(D, 2)),
    "light has 1 channels, the operator 3": lambda operator: operator.apply_many(random(_MANY, D, 1)),
    "radiance has 2 channels, the operator 3": lambda operator: operator.transpose(random(operator.shape[0], 2)),
}


@pytest.mark.usefixtures("wrong_types")
@pytest.mark.parametrize("name", [*SMALL, *MADE_OF_OTHERS, "on one device"])
def test_other_shapes_are_refused(name):
    operator, _ = case(name)
    refused = REFUSED | (OTHER_CHANNELS if operator.shape[2] == 3 else {})
    for message, call in refused.items():
        with pytest.raises(ValueError, match=message) as error:
            call(operator)
        assert "\n" not in str(error.value)
        with pytest.raises(ValueError, match=message):
            jax.eval_shape(lambda call=call: call(operator))


def precisions(operator: Operator, dtype) -> list:
    """Of all that is computed of light and radiance in a precision, and of rows; nothing is compiled."""
    r, d, _ = operator.shape
    first: Any = np.zeros(1, np.int32)
    shapes = [jax.ShapeDtypeStruct(shape, dtype) for shape in ((d, 3), (_MANY, d, 3), (r, 3))]

    def everything(light, lights, radiance):
        products = operator.apply(light), operator.apply_many(lights), operator.transpose(radiance)
        return *products, operator.rows(first)

    return [array.dtype for array in jax.eval_shape(everything, *shapes)]


@pytest.mark.parametrize("name", [*SMALL, *MADE_OF_OTHERS, "on one device"])
def test_results_have_the_precision_of_what_is_given(x64, name):
    """And rows that of the operator's own numbers."""
    operator, _ = case(name)
    for dtype in (np.float32, np.float64):
        assert precisions(operator, dtype) == [*[dtype] * 3, np.float32]


@pytest.mark.parametrize("name", ["dense", "sparse", "clustered", "stacked", "summed", "composed", "scaled"])
def test_an_operator_of_double_precision_takes_light_of_single(x64, name):
    operator, _ = CASES[name](np.float64)
    assert precisions(operator, np.float32) == [*[np.float32] * 3, np.float64]


def test_black_clusters_have_rows_of_single_precision(x64):
    nothing = Cluster(np.zeros(0, int), np.zeros((0, 0), np.float32), np.zeros((3, 0, 4), np.float32))
    assert precisions(clustered([nothing], D), np.float32) == [np.float32] * 4


@pytest.mark.parametrize("name", ["stacked", "streamed", pytest.param("streamed grey", marks=pytest.mark.slow)])
def test_float64(x64, name):
    operator, matrix = CASES[name](np.float64)
    r, d, _ = operator.shape
    light, radiance = random(d, 3, dtype=np.float64), random(r, 3, seed=1, dtype=np.float64)
    forward, back = ask(both, operator, light, radiance)
    rows, whole = ask(written_out, operator, np.array([1, 0], np.int32))
    assert forward.dtype == back.dtype == rows.dtype == np.float64
    assert relative(forward, np.einsum("rcd,dc->rc", np.broadcast_to(matrix, (r, 3, d)), light)) < 1e-14
    assert abs(float(np.vdot(forward, radiance)) - float(np.vdot(light, back))) < 1e-13 * np.linalg.norm(
        forward
    ) * np.linalg.norm(radiance)
    assert relative(rows, matrix[[1, 0]]) < 1e-14
    assert relative(whole, matrix) < 1e-14


@pytest.mark.parametrize("name", cases(["sparse grey", "stacked", "streamed"]))
def test_as_lineax(name):
    operator, matrix = case(name)
    r, d, c = operator.shape
    light, radiance = random(d, c), random(r, c, seed=1)
    adapted = as_lineax(operator)
    assert (adapted.in_structure().shape, adapted.out_structure().shape) == ((d, c), (r, c))
    forth, back = jax.jit(lambda light, radiance: (adapted.mv(light), adapted.T.mv(radiance)))(light, radiance)
    np.testing.assert_allclose(forth, np.einsum("rcd,dc->rc", matrix, light), rtol=1e-5, atol=1e-5)
    np.testing.assert_allclose(back, np.einsum("rcd,rc->dc", matrix, radiance), rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize("name", cases(PYTREES))
def test_jit_does_not_retrace_for_other_values(name):
    operator, _ = case(name)
    r, d, _ = operator.shape
    light, radiance = random(d, 3), random(r, 3, seed=1)
    first = ask(both, operator, light, radiance)
    traced = len(TRACES)
    second = ask(both, other_values(operator), light, radiance)
    assert len(TRACES) == traced
    for one, two in zip(first, second, strict=True):
        np.testing.assert_allclose(2 * one, two, rtol=1e-6, atol=1e-6)


@pytest.mark.parametrize("counts", [(3, _MANY), pytest.param((1,), marks=pytest.mark.slow)])
@pytest.mark.parametrize("name", cases([*SMALL, *MADE_OF_OTHERS], [*COMBINED, "streamed grey"]))
def test_many_lights_are_each_by_itself(name, counts):
    operator, matrix = case(name)
    r, d, _ = operator.shape
    several = [random(count, d, 3) for count in counts]
    first, *rest = ask(of_many, operator, several)
    matrix = np.broadcast_to(matrix, (r, 3, d))
    for lights, many in zip([several[0], *several], [first, *rest], strict=True):
        each = np.stack([ask(both, operator, light, random(r, 3, seed=1))[0] for light in lights])
        assert many.shape == (len(lights), r, 3)
        assert many.dtype == np.float32
        np.testing.assert_allclose(many, each, rtol=1e-5, atol=1e-5)
        assert relative(many, np.einsum("rcd,ndc->nrc", matrix, lights.astype(float))) < 1e-6


@pytest.mark.parametrize("name", cases(PYTREES, HELD))
def test_gradients_in_light_and_values(x64, name):
    """Of both products, and of that with many lights; that of the first in light is the adjoint."""
    operator, _ = CASES[name](np.float64)
    r, d, _ = operator.shape
    values, rest = eqx.partition(operator, eqx.is_inexact_array)
    light, radiance = random(d, 3, dtype=np.float64), random(r, 3, seed=1, dtype=np.float64)
    lights = random(_MANY, d, 3, seed=2, dtype=np.float64)

    def answers(values, light, radiance, lights):
        operator = eqx.combine(values, rest)
        return operator.apply(light), operator.transpose(radiance), operator.apply_many(lights)

    arguments = values, light, radiance, lights
    everything = check_derivatives(answers, arguments)
    value, _, back = everything(arguments, arguments, (radiance, 0 * light, np.zeros((_MANY, r, 3))))
    np.testing.assert_allclose(back[1], value[1], rtol=1e-12, atol=1e-12)


def test_streamed_is_differentiable_in_light_and_maps(x64):
    operator: Any = streamed(3, np.float64)[0]

    def forward(maps, light):
        reflection = Factored(maps, operator.reflection.view_maps)
        return Streamed(operator.read_bits, operator.frames, reflection, operator.directions).apply(light)

    check_derivatives(forward, (operator.reflection.light_maps, random(D, 3, dtype=np.float64)))


def test_streamed_reads_only_the_groups_it_needs():
    operator, matrix = case("streamed")
    assert isinstance(operator, Streamed)
    asked = []

    def read(group):
        asked.append(group)
        return operator.read_bits(group)

    watched = Streamed(read, operator.frames, operator.reflection, operator.directions)
    assert relative(watched.rows(jax.device_put(np.array([9, 15]))), matrix[[9, 15]]) < 1e-6
    assert asked == [1]
    asked.clear()
    watched.apply(random(D, 3))
    assert asked == [0, 1]


def test_stacked_rows_start_where_the_last_operators_end():
    operator, _ = stacked(np.float32)
    assert isinstance(operator, Stacked)
    assert operator.starts == [0, 12, 16, 21]
    assert operator.nbytes == sum(part.nbytes for part in operator.operators)


@pytest.mark.parametrize("rows", [1, 7, _BLOCK, _BLOCK + 1, 3 * _BLOCK - 5])
def test_blocks_are_few_and_hardly_filled_up(rows):
    operator = sparse_rows(np.zeros((rows, 1), np.uint16), np.ones((rows, 1, 1), np.float32), D)
    blocks, size, _ = operator.indices.shape
    assert blocks == -(-rows // _BLOCK)
    assert 0 <= blocks * size - rows < blocks


@pytest.mark.parametrize(("c", "bits"), [(1, None), (3, None), (3, 8)])
@pytest.mark.parametrize("rows", [pytest.param(_FEW, marks=pytest.mark.slow), 3 * _FEW + 5])
def test_many_lights_reach_every_row(rows, c, bits):
    """However many rows are a step's."""
    operator, matrix = sparse(rows, c, np.float32, bits=bits)
    lights = random(_MANY, D, 3)
    wanted = np.einsum("rcd,ndc->nrc", np.broadcast_to(matrix, (rows, 3, D)), lights.astype(float))
    assert relative(operator.apply_many(lights), wanted) < 1e-6


@pytest.mark.parametrize("count", [1, _MANY])
def test_light_has_the_channels_of_the_rows(count):
    operator, _ = case("sparse")
    with pytest.raises(ValueError, match="light has 2 channels, the operator 3"):
        operator.apply(random(D, 2))
    with pytest.raises(ValueError, match="light has 2 channels, the operator 3"):
        operator.apply_many(random(count, D, 2))


@pytest.mark.parametrize(("columns", "dtype"), [(96, np.uint16), (2**16, np.uint16), (2**16 + 1, np.uint32)])
def test_indices_take_the_smallest_type_that_holds_them(columns, dtype):
    assert smallest_index_type(columns) == dtype
    operator = sparse_rows(np.array([[0, columns - 1]]), np.array([[[1.0, 2]]], np.float32), columns)
    assert operator.indices.dtype == dtype
    light = np.zeros((columns, 1), np.float32)
    light[-1] = 3
    assert operator.shape == (1, columns, 1)
    forth, back = ask(both, operator, light, np.ones((1, 1), np.float32))
    np.testing.assert_allclose(forth, [[6]])
    np.testing.assert_array_equal(np.nonzero(back)[0], [0, columns - 1])


def test_values_alone_may_be_many():
    """Rows of several operators under one light."""
    one, _ = sparse(4, 3, np.float32)
    light: Any = np.ones((D, 3), np.float32)
    many = jax.tree.map(lambda leaf: np.stack([leaf, 2 * leaf]), one.values)
    together = jax.jit(jax.vmap(lambda values: eqx.tree_at(lambda of: of.values, one, values).apply(light)))(many)
    alone = np.asarray(one.apply(light))
    np.testing.assert_allclose(together, np.stack([alone, 2 * alone]), rtol=1e-5)
