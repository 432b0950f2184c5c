"""Every promise of the registry, kept."""

import jax
import numpy as np
import pytest

from fitting import gradients as of_fitting
from jaxrelight.gradients.entry import FOLLOWS, Entry
from jaxrelight.gradients.registry import entries
from tests.compilations import compilations
from tests.gradients.laws import Batch, Law, check_types

DIFFERENTIABLE = [entry for entry in (*entries(), *of_fitting.ENTRIES) if isinstance(entry, Entry)]
# Those that are checked by the quick suite as well.
QUICK = (
    "jaxrelight.numerics.safe.norm",
    "jaxrelight.brdf.parametrisation.Disc.place",
    "jaxrelight.brdf.sampling.to_disc",
)


@pytest.fixture
def x64():
    """Float64 in all threads: what calls back to the host does so in another one."""
    jax.config.update("jax_enable_x64", True)
    yield
    jax.config.update("jax_enable_x64", False)


def _short(entry: Entry) -> str:
    return entry.names[0].removeprefix("jaxrelight.")


@pytest.fixture(
    params=[
        pytest.param(entry, id=_short(entry), marks=() if entry.names[0] in QUICK else pytest.mark.slow)
        for entry in DIFFERENTIABLE
    ]
)
def entry(request) -> Entry:
    return request.param


def test_gradients(x64, entry: Entry):
    """Both modes against central differences, once and, where that is promised, twice."""
    law = Law(entry)
    law.check_gradients()
    if entry.orders == 2:
        law.check_second_order()
    if law.example.transpose is not None:
        law.check_transpose()


def test_singular_points(x64, entry: Entry):
    law = Law(entry)
    for point in entry.singular():
        law.check_singular(point)


def test_batches(x64, entry: Entry):
    """A batch is its items, compiled or not, and a NaN stays within its item."""
    batch = Batch(Law(entry))
    batch.check_vmap()
    batch.check_jit()
    batch.check_nan()


def test_types(x64, entry: Entry):
    if entry.dtypes == FOLLOWS:
        check_types(entry)


def test_a_second_call_compiles_nothing(entry: Entry):
    law = Law(entry, np.float32)
    given, other = jax.device_put(law.primals), jax.device_put(jax.tree.map(lambda leaf: leaf * 0.999, law.primals))
    law.function(*given)
    with compilations() as programs:
        law.function(*other)
    assert not programs
