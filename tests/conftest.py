"""A hostile session: warnings are errors (pyproject.toml), no state may leak, random examples are always the same."""

import os
from typing import Any

import hypothesis
import jax
import pytest

hypothesis.settings.register_profile("repeatable", derandomize=True, database=None, deadline=None, max_examples=40)
hypothesis.settings.load_profile("repeatable")

# Neither this process nor its children read or write the user's compiled programs.
os.environ["JAXRELIGHT_COMPILATION_CACHE"] = "off"


@pytest.fixture
def x64():
    """Float64 in JAX for the length of a test."""
    with jax.enable_x64(True):
        yield


@pytest.fixture
def strict_ranks():
    """No silent broadcasting between arrays of different rank."""
    with jax.numpy_rank_promotion("raise"):
        yield


@pytest.fixture(autouse=True)
def _same_configuration_afterwards():
    config: Any = jax.config
    before = config.jax_enable_x64, config.jax_numpy_rank_promotion
    yield
    assert (config.jax_enable_x64, config.jax_numpy_rank_promotion) == before
