"""Rows that are baked whenever they are used: those that baking writes out, for every way in which rows are kept."""

import dataclasses
from typing import Any

import jax
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import Transport
from jaxrelight.numerics.arrays import as_array
from jaxrelight.transport.from_visibility import from_visibility
from jaxrelight.transport.rebake import rebake
from tests.transport.scenes import ball_on_floor
from tests.transport.stores import number_of, precomputed, reflections_of

METHOD = Transport("pixels", resolution=4)
SCENE = dataclasses.replace(ball_on_floor(), camera=dataclasses.replace(ball_on_floor().camera, width=10, height=8))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    return tmp_path_factory.mktemp("visibility")


def baked_at_use(transport, block):
    stored = transport.stored.visibility, transport.receivers, transport.method, transport.basis
    return from_visibility(block.operator, block.reflection, block, *stored)


@pytest.mark.parametrize("kept", [*(pytest.param(kept, marks=pytest.mark.slow) for kept in (24, "shared")), "all"])
def test_products_are_those_of_written_rows(folder, kept):
    method = dataclasses.replace(METHOD, coefficients=kept, visibility_samples=4 if kept == "all" else 1)
    transport = precomputed(SCENE, method, folder)
    block = transport.blocks[number_of(transport, "lacquer")]
    rows = rebake(transport, reflections_of(transport)).blocks[number_of(transport, "lacquer")].operator
    again = baked_at_use(transport, block)
    light: Any = np.random.default_rng(0).normal(size=(96, 3)).astype(np.float32)
    wanted = rows.apply(light)
    np.testing.assert_allclose(again.apply(light), wanted, rtol=1e-4, atol=1e-5 * np.abs(wanted).max())
    assert again.shape == rows.shape
    assert again.nbytes > 0


def test_the_adjoint_and_single_rows(folder):
    transport = precomputed(SCENE, dataclasses.replace(METHOD, coefficients=24), folder)
    operator = baked_at_use(transport, transport.blocks[number_of(transport, "lacquer")])
    generator = np.random.default_rng(1)
    r, d, c = operator.shape
    x: Any
    y: Any
    x, y = (generator.normal(size=(n, c)).astype(np.float32) for n in (d, r))
    there, back = float(np.vdot(operator.apply(x), y)), float(np.vdot(x, operator.transpose(y)))
    assert there == pytest.approx(back, rel=1e-4)
    row = np.asarray(operator.rows(as_array(np.array([5, 3], np.int32))))
    np.testing.assert_allclose(
        np.einsum("icd,dc->ic", row, x), np.asarray(operator.apply(x))[[5, 3]], rtol=1e-3, atol=1e-4
    )


def test_a_traced_operator_is_refused_in_one_line(folder):
    transport = precomputed(SCENE, dataclasses.replace(METHOD, coefficients=24), folder)
    with pytest.raises(jr.InputError, match="call with_materials once outside of jit") as caught:
        jax.jit(lambda of: baked_at_use(of, of.blocks[1]).frames)(transport)
    assert len(str(caught.value).splitlines()) == 1
