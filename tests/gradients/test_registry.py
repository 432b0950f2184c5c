"""Every public function that takes or returns arrays has one entry, and every entry is of such a function."""

import collections
import importlib.util

from fitting import gradients as of_fitting
from jaxrelight.gradients.registry import entries
from tests.gradients.public_functions import ROOT, holding_arrays, modules, parsed, public_functions

ALL = (*entries(), *of_fitting.ENTRIES)
# Folders whose functions have no entries yet.
NOT_YET: tuple[str, ...] = ()


def test_every_function_of_arrays_has_an_entry():
    lacking = {one.name for one in public_functions(modules())} - {name for entry in ALL for name in entry.names}
    lacking = {name for name in lacking if not name.startswith(tuple(f"{module}." for module in NOT_YET))}
    assert not lacking, f"enter in jaxrelight/gradients, or fitting/gradients.py: {sorted(lacking)}"


def test_every_entry_is_of_a_function_of_arrays():
    left = {name for entry in ALL for name in entry.names} - {one.name for one in public_functions(modules())}
    assert not left, f"no such functions, or none of arrays: {sorted(left)}"


def test_no_function_has_two_entries():
    count = collections.Counter(name for entry in ALL for name in entry.names)
    assert {name for name, times in count.items() if times > 1} == set()


_SOURCE = """
import jax
import numpy as np
from jaxtyping import Array, Float

Numbers = float | Float[Array, "n"]

class Base: ...
class Holder(Base):
    field: Float[np.ndarray, "n"]
    def fact(self) -> int: ...
    def other(self) -> "Holder": ...
    def _own(self, a: Array) -> None: ...

def takes(a: Numbers) -> int: ...
def gives() -> tuple[int, "Float[jax.Array, 'n']"]: ...
def through_base(one: Base) -> str: ...
def neither(a: int) -> list[str]: ...
def _private(a: Array) -> Array: ...
"""


def test_functions_of_arrays_are_found_through_names_fields_and_bases():
    module = parsed("m", _SOURCE)
    assert {"m.Numbers", "m.Holder", "m.Base"} < holding_arrays({"m": module}, {"jaxtyping.Array", "numpy.ndarray"})
    found = {one.name: one.jax for one in public_functions({"m": module})}
    assert found == {"m.Holder.other": False, "m.takes": True, "m.gives": True, "m.through_base": False}


def test_the_guide_has_all_entries():
    """`gradients.md` is what `write_gradients.py` makes of the registry."""
    path = ROOT / "notebooks" / "guide" / "write_gradients.py"
    spec = importlib.util.spec_from_file_location("write_gradients", path)
    assert spec is not None
    assert spec.loader is not None
    writer = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(writer)
    assert writer.PAGE.read_text(encoding="utf-8") == writer.page(), "run python notebooks/guide/write_gradients.py"
