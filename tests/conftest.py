"""A hostile session: warnings are errors (pyproject.toml), no state may leak, random examples are always the same."""

import gc
import os
import random
import shutil
import tempfile
from typing import Any

import hypothesis
import jax
import jaxtyping
import numpy as np
import pytest

from tests import runtime_types

# Where a signature asks for an array of JAX, NumPy's will do, as for JAX's own functions.
jaxtyping.Array = jax.Array | np.ndarray  # pyright: ignore[reportAttributeAccessIssue]
# What signatures say of shapes and types is checked at every call (at every trace, of what is jitted).
jaxtyping.install_import_hook(["jaxrelight", "fitting"], "tests.runtime_types.checked")
# No silent broadcasting between arrays of different rank.
jax.config.update("jax_numpy_rank_promotion", "raise")

hypothesis.settings.register_profile("repeatable", derandomize=True, database=None, deadline=None, max_examples=40)
hypothesis.settings.load_profile("repeatable")

# Neither this process nor its children read or write the user's compiled programs. What one worker or child has
# compiled the others need not compile again: all of them share a cache, empty at first.
os.environ["JAXRELIGHT_COMPILATION_CACHE"] = "off"
_CACHE = "JAX_COMPILATION_CACHE_DIR"
_IS_WORKER = "PYTEST_XDIST_WORKER" in os.environ
if not _IS_WORKER:
    os.environ |= {_CACHE: tempfile.mkdtemp(prefix="compiled-"), "JAX_PERSISTENT_CACHE_MIN_COMPILE_TIME_SECS": "0.1"}
jax.config.update("jax_compilation_cache_dir", os.environ[_CACHE])
jax.config.update("jax_persistent_cache_min_compile_time_secs", 0.1)


# Most of the time that quick tests take is compiling: for them, XLA's CPU compiler makes code quickly rather than code
# that is fast. Slow tests, and all of them under `-m ""`, run what users run.
_COMPILED_QUICKLY = "--xla_backend_optimization_level=1 --xla_cpu_use_fusion_emitters=false"


def pytest_configure(config: pytest.Config):
    """Before JAX compiles anything, and before there are workers, which inherit it."""
    if not _IS_WORKER and config.getoption("markexpr") == "not slow":
        os.environ["XLA_FLAGS"] = f"{os.environ.get('XLA_FLAGS', '')} {_COMPILED_QUICKLY}"


# Tracing makes many objects that live long: looking through all of them again and again takes a fifth of the time.
gc.freeze()
gc.set_threshold(50_000, 20, 100)


def pytest_unconfigure():
    if not _IS_WORKER:
        shutil.rmtree(os.environ[_CACHE], ignore_errors=True)


@pytest.fixture
def x64():
    """Float64 in JAX for the length of a test."""
    with jax.enable_x64(True):
        yield


@pytest.fixture
def wrong_types():
    """The test passes what a signature forbids, to see how the function itself refuses it."""
    with runtime_types.ignored():
        yield


@pytest.fixture(autouse=True)
def _same_configuration_afterwards():
    config: Any = jax.config
    # Of a list beartype checks one item, which it draws: the same in every run of a test.
    random.seed(0)
    before = config.jax_enable_x64, config.jax_numpy_rank_promotion
    yield
    assert (config.jax_enable_x64, config.jax_numpy_rank_promotion) == before
