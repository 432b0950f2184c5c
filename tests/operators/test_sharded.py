"""Operators on several devices say what they say on one: in a process of four, and in two processes of two."""

import pathlib
import socket
import subprocess
import sys
from collections.abc import Iterable

import equinox as eqx
import jax
import numpy as np
import pytest
from jax.sharding import Mesh

from jaxrelight.operators.clustered import Cluster, clustered
from jaxrelight.operators.contract import Basis
from jaxrelight.operators.dense import Dense
from jaxrelight.operators.sharded import Sharded, sharded
from jaxrelight.operators.sparse_rows import sparse_rows
from tests.operators.sharded_child import CASES, MULTIPROCESS_CASES, D, check, clusters, random, rows

ROOT = pathlib.Path(__file__).parents[2]


def _mesh() -> Mesh:
    return Mesh(np.array(jax.devices()[:1]), ("groups",))


def _start(devices: int, names: Iterable[str], *arguments: object) -> subprocess.Popen:
    given = devices, ";".join(names), *arguments
    command = [sys.executable, "-m", "tests.operators.sharded_child", *map(str, given)]
    return subprocess.Popen(command, cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def _finish(*children: subprocess.Popen) -> list[str]:
    """What they print, unless one of them fails; none outlives this."""
    try:
        said = [child.communicate(timeout=300) for child in children]
    finally:
        for child in children:
            child.kill()
    for child, (_, errors) in zip(children, said, strict=True):
        assert child.returncode == 0, errors
    return [output for output, _ in said]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["rows in 8 bits, grey", "stacked"])
def test_one_device(name):
    check(CASES[name](), _mesh())


@pytest.mark.parametrize("names", [("clusters",), pytest.param(tuple(CASES), marks=pytest.mark.slow)])
def test_four_devices(names):
    (output,) = _finish(_start(4, names))
    assert output.splitlines() == list(names)


@pytest.mark.slow
def test_two_processes_of_two_devices():
    with socket.socket() as held:
        # Held without listening, so that nobody else is given the port until the first process listens at it.
        held.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
        held.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{held.getsockname()[1]}"
        outputs = _finish(*(_start(2, MULTIPROCESS_CASES, address, 2, process) for process in range(2)))
    for output in outputs:
        assert output.splitlines()[-len(MULTIPROCESS_CASES) :] == list(MULTIPROCESS_CASES)


def test_black_groups_alone():
    nothing = Cluster(np.zeros(0, int), np.zeros((0, 0), np.float32), np.zeros((3, 0, 4), np.float32))
    operator = sharded(clustered([nothing] * 3, D), _mesh())
    np.testing.assert_array_equal(operator.apply(random(D, 3)), np.zeros((12, 3)))
    np.testing.assert_array_equal(operator.transpose(random(12, 3)), np.zeros((D, 3)))
    np.testing.assert_array_equal(operator.to_matrix(), np.zeros((12, 3, D)))


def test_filling_of_one_device_is_none():
    for whole in (rows(101, 3), clusters(3, 8)):
        assert sharded(whole, _mesh()).nbytes < 1.05 * whole.nbytes


class _Reversed(Basis):
    """The basis of the same texels from last to first."""

    @property
    def size(self):
        return D

    def _encode(self, texels):
        return texels[..., ::-1]

    def _decode(self, coefficients):
        return coefficients[..., ::-1]


@pytest.mark.slow
def test_sums_and_operators_in_a_basis_are_spread_by_parts():
    square = rows(200, 3) @ sparse_rows(np.arange(D)[:, None], np.full((D, 1, 1), 2, np.float32), D)
    whole = rows(200, 1) + clusters(3) @ _Reversed() + np.array([1, 2, 3], np.float32) * square
    operator = sharded(whole, _mesh())
    assert len(jax.tree.leaves(operator, is_leaf=lambda one: isinstance(one, Sharded))) == 5
    light, radiance = random(D, 3), random(200, 3)
    np.testing.assert_allclose(operator.apply(light), whole.apply(light), rtol=1e-4, atol=1e-4)
    np.testing.assert_allclose(operator.transpose(radiance), whole.transpose(radiance), rtol=1e-4, atol=1e-4)


def test_mesh_of_explicit_axes():
    """As `jax.make_mesh` makes them."""
    whole = rows(101, 3)
    operator = sharded(whole, jax.make_mesh((1,), ("anything",)))
    np.testing.assert_allclose(operator.apply(random(D, 3)), whole.apply(random(D, 3)), rtol=1e-5, atol=1e-5)


def test_what_cannot_be_spread_is_refused():
    with pytest.raises(ValueError, match="the mesh has 2"):
        sharded(rows(8, 1), Mesh(np.array(jax.devices()[:1]).reshape(1, 1), ("one", "two")))
    with pytest.raises(ValueError, match="Dense cannot be spread"):
        sharded(Dense(random(3, 1, D)), _mesh())


def test_other_values_are_not_traced_again():
    traces = []

    @jax.jit
    def product(operator, light):
        traces.append(operator)
        return operator.apply(light)

    whole = rows(101, 3)
    twice = eqx.tree_at(lambda one: one.values, whole, replace_fn=lambda values: jax.tree.map(lambda x: 2 * x, values))
    one, two = (product(sharded(operator, _mesh()), random(D, 3)) for operator in (whole, twice))
    assert len(traces) == 1
    np.testing.assert_allclose(2 * one, two, rtol=1e-6, atol=1e-6)
