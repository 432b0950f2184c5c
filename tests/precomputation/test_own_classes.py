"""Stores of BRDFs and lights of classes outside of the package: opened again, and what is said where they cannot be."""

import json
import pathlib
import subprocess
import sys
from typing import Any

import jax
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import InputError
from jaxrelight.lights.local import point
from jaxrelight.precomputation import placing
from tests.precomputation.own_classes import Ggx, Striped

OMEGA: Any = np.asarray([0.6, 0, 0.8], np.float32)
SETTINGS = jr.Settings("pixels", gather_samples=64, bounces=1)
MODULE = Ggx.__module__


def scene(skin, light) -> jr.Scene:
    floor = jr.Part(jr.plane((2, 2), 4), "skin")
    camera = jr.Camera((0, 1, 0.5), (0, 0, 0), width=6, height=5)
    return jr.Scene([floor], {"skin": skin}, camera, lights=[light])


@pytest.fixture(scope="module")
def made(tmp_path_factory) -> tuple[pathlib.Path, Ggx, Striped]:
    """A store, not to be written to, and what it was made of."""
    skin = Ggx("red", 0.4)
    light = Striped(point([0, 1, 0], [1, 2, 3]), jax.device_put(np.float32(0.3)), 0)
    folder = tmp_path_factory.mktemp("own") / "store"
    jr.precompute(scene(skin, light), SETTINGS, folder)
    return folder, skin, light


def equal(one, other) -> bool:
    same = jax.tree.map(lambda a, b: type(a) is type(b) and bool(np.array_equal(a, b)), one, other)
    return all(jax.tree.leaves(same))


def test_a_store_of_own_classes_opens_in_the_same_process(made):
    folder, skin, light = made
    opened = jr.load(folder)
    (block,), (lamp,) = opened.blocks, opened.lights
    assert type(block.brdf) is Ggx
    assert type(lamp) is Striped
    assert equal(block.brdf, skin)
    assert equal(lamp, light)
    assert (block.brdf.power, lamp.axis) == (5, 0)
    np.testing.assert_array_equal(block.brdf.evaluate(OMEGA, OMEGA), skin.evaluate(OMEGA, OMEGA))


OPEN = f"""
import sys
import jaxrelight as jr
from jaxrelight.brdf.record import import_classes
try:
    jr.load(sys.argv[1])
except jr.InputError as error:
    print(error)
assert "{MODULE}" not in sys.modules
import_classes("{MODULE}")
opened = jr.load(sys.argv[1])
print(opened.blocks[0].brdf.evaluate(*[sys.modules["numpy"].asarray({OMEGA.tolist()}, "float32")] * 2).tolist())
print(type(opened.lights[0]).__name__, opened.lights[0].lamp.intensity.tolist())
"""


def test_a_new_process_opens_it_once_their_module_is_imported(made):
    """Without, nothing is imported: one line says what to do."""
    folder, skin, _ = made
    done = subprocess.run(
        [sys.executable, "-c", OPEN, str(folder)], capture_output=True, text=True, cwd=pathlib.Path(__file__).parents[2]
    )
    assert done.returncode == 0, done.stderr
    refused, values, light = done.stdout.splitlines()
    assert refused == (
        f"the store's material 'skin' is of the class 'Ggx' of the module '{MODULE}', which is not imported, and a "
        f"store does not import modules, since that runs their code; import {MODULE} before the store is opened, on "
        f"the command line by --import {MODULE}"
    )
    np.testing.assert_allclose(json.loads(values), skin.evaluate(OMEGA, OMEGA), rtol=1e-6)
    assert light == "Striped [1.0, 2.0, 3.0]"


@pytest.mark.parametrize("of", ["material", "light"])
def test_what_no_store_can_hold_is_refused_before_a_ray_is_traced(of, monkeypatch, tmp_path):
    monkeypatch.setattr(placing, "Tracer", None)
    function: Any = np.sin
    skin, light = Ggx("red", function), Striped(point([0, 1, 0], 1), function, 0)
    given = (skin, point([0, 1, 0], 1)) if of == "material" else (jr.lambert(0.5), light)
    what = "material 'skin' is of the class 'Ggx'" if of == "material" else "light 1 is of the class 'Striped'"
    with pytest.raises(InputError, match=f"{what}, which a store cannot hold: its field '.*' holds a function; fields"):
        jr.precompute(scene(*given), SETTINGS, tmp_path)


def test_a_class_that_has_changed_since_is_told(made, monkeypatch):
    folder, _, _ = made
    fields = {"diffuse": None, "power": None}
    monkeypatch.setattr(Ggx, "__dataclass_fields__", {name: Ggx.__dataclass_fields__[name] for name in fields})
    with pytest.raises(InputError, match=r"has the fields diffuse, power, and had diffuse, f0, .* when it was stored"):
        jr.load(folder)
