"""Equinox modules as JSON and arrays: everything that may stand in a field, and whose classes may not come back."""

import json
import sys
import types
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrelight.lights.local  # noqa: F401 - a module that is imported already
from jaxrelight.brdf.contract import Brdf
from jaxrelight.errors import InputError
from jaxrelight.files.class_record import (
    find_class,
    from_fields,
    import_classes,
    qualified_name,
    register,
    to_fields,
)


class Inner(eqx.Module):
    weights: dict
    kind: str = eqx.field(static=True)


class Outer(eqx.Module):
    anything: Any
    fixed: Any = eqx.field(static=True, default=())


def back(module) -> Any:
    fields, arrays = to_fields(module, "it")
    cls = find_class(qualified_name(type(module)), eqx.Module, "it")
    return from_fields(cls, json.loads(json.dumps(fields)), arrays.__getitem__, "it")


def test_all_that_a_field_may_hold_comes_back(x64):
    leaves = [np.float32(1.5), np.float64(1 / 3), np.arange(3), np.array([True, False]), jnp.ones((2, 0))]
    inner = Inner({"a.b": jnp.asarray(1.0), "a": {"b": np.arange(2.0)}}, "soft")
    given = Outer((leaves, inner, None, 3, 0.1, "text", True, {}), (1, (2.5, "x"), None, 4))
    restored = back(given)
    assert jax.tree.structure(restored) == jax.tree.structure(given)
    assert restored.fixed == (1, (2.5, "x"), None, 4)
    for one, other in zip(jax.tree.leaves(restored), jax.tree.leaves(given), strict=True):
        np.testing.assert_array_equal(one, other)
        assert np.asarray(one).dtype == np.asarray(other).dtype


@pytest.mark.parametrize(
    ("module", "what"),
    [
        (Outer(jnp.sin), "its field 'anything' holds a function"),
        (Outer([1, {"f": len}]), r"its field 'anything.1.f' holds a function"),
        (Outer(object()), "its field 'anything' holds an object of the type 'object'"),
        (Outer({1: 2}), "its field 'anything' holds an object of the type 'dict'"),
        (Outer(jax.random.key(0)), "its field 'anything' holds an object"),
        (Outer(np.array(["a"])), "its field 'anything' holds an object of the type 'ndarray'"),
        (Outer(1, (frozenset(),)), r"its static field 'fixed.0' holds an object of the type 'frozenset'"),
    ],
)
def test_what_a_field_must_not_hold_is_named(module, what):
    with pytest.raises(
        InputError, match=f"it is of the class 'Outer', which a store cannot hold: {what}.*; fields must"
    ):
        to_fields(module, "it")


def test_a_class_of_a_function_comes_back_where_it_is_known():
    class Local(Brdf):
        value: float

        def evaluate(self, omega_i, omega_o):
            raise NotImplementedError

        @property
        def channels(self):
            return 1

        @property
        def is_constant(self):
            return True

    name = qualified_name(Local)
    with pytest.raises(InputError, match=r"^it is of the class '.*Local', which a script, a notebook or"):
        find_class(name, Brdf, "it")
    assert register(Local) is Local
    assert find_class(name, Brdf, "it") is Local
    assert back(Local(0.5)).value == 0.5


class Hidden(types.ModuleType):
    """A module that runs code when it is asked for what it has not."""

    def __getattr__(self, name):
        raise AssertionError("code was run")


@pytest.mark.parametrize(
    ("name", "what"),
    [
        ("os:system", "cannot be one of what a store holds"),
        ("subprocess:Popen", "cannot be one of what a store holds"),
        ("jaxrelight.brdf.contract:Brdf", "cannot be one of what a store holds"),
        ("jaxrelight.lights.local:Point", "cannot be one of what a store holds"),
        ("jaxrelight.brdf.contract:Nothing", "which has no such class"),
        ("hidden_module:Anything", "which has no such class"),
        ("this.module.is.none:Class", "which is not imported"),
        ("antigravity:Class", "which is not imported.*; import antigravity before the store is opened"),
        ("__main__:Class", "which a script, a notebook or a function defined"),
        ("Nothing", "the kind 'Nothing', which is not known"),
    ],
)
def test_records_run_no_code_and_make_nothing_but_what_is_wanted(name, what, monkeypatch):
    monkeypatch.setitem(sys.modules, "hidden_module", Hidden("hidden_module"))
    before = set(sys.modules)
    with pytest.raises(InputError, match=f"^the store's material 'x' is of .*{what}"):
        find_class(name, Brdf, "the store's material 'x'")
    assert set(sys.modules) == before


def test_modules_that_a_user_names_are_imported(tmp_path, monkeypatch):
    (tmp_path / "own_brdfs.py").write_text("import equinox\nclass Own(equinox.Module):\n    pass\n")
    (tmp_path / "broken_brdfs.py").write_text("1 / 0\n")
    monkeypatch.syspath_prepend(tmp_path)
    import_classes("own_brdfs")
    assert find_class("own_brdfs:Own", eqx.Module, "it").__name__ == "Own"
    monkeypatch.delitem(sys.modules, "own_brdfs")
    with pytest.raises(InputError, match=r"'no_such_module' cannot be imported \(No module named"):
        import_classes("no_such_module")
    with pytest.raises(InputError, match=r"'broken_brdfs' cannot be imported \(division by zero\)"):
        import_classes("broken_brdfs")


def test_only_equinox_modules_are_registered():
    with pytest.raises(InputError, match="derive it from Brdf or Light"):
        register(int)
