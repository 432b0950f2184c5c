"""RGL files against Mitsuba's `measured` plugin, whose numbers are kept here, and faulty ones."""

import json
from pathlib import Path

import jax
import numpy as np
import pytest
from jax.typing import ArrayLike

from jaxrelight.brdf.files import load_brdf
from jaxrelight.errors import InputError
from tests.brdf.files import writers
from tests.shared_data import shared

# f(ω_i, ω_o) cosθ_i by Mitsuba 3.9.1, scalar_rgb, in which si.wi is our ω_o; written by `mitsuba_oracle.py`.
ORACLE = json.loads(Path(__file__, "../mitsuba_oracle.json").resolve().read_text())
OMEGA_I, OMEGA_O = np.array(ORACLE["omega_i"], np.float32), np.array(ORACLE["omega_o"], np.float32)


def evaluate(brdf, omega_i: ArrayLike = OMEGA_I, omega_o: ArrayLike = OMEGA_O) -> np.ndarray:
    """Of no more pairs than Mitsuba has evaluated: the program is the same for as many."""
    pairs = [np.concatenate([np.asarray(side), OMEGA_I])[: len(OMEGA_I)] for side in (omega_i, omega_o)]
    return np.asarray(_evaluate(brdf, *pairs))[: len(np.asarray(omega_i))]


@jax.jit
def _evaluate(brdf, omega_i, omega_o):
    return jax.vmap(brdf.evaluate)(omega_i, omega_o)


def made(folder: Path, name: str) -> Path:
    """A file that Mitsuba has evaluated: one of the shared ones, or one made by code."""
    if name.endswith(".bsdf"):
        return shared("data", "brdf", name)
    path = folder / f"{name}.bsdf"
    path.write_bytes(writers.rgl(**ORACLE["made"][name]))
    return path


@pytest.mark.parametrize("name", ORACLE["values"])
def test_values_are_those_of_mitsuba(tmp_path, name):
    values = evaluate(load_brdf(made(tmp_path, name)).brdf) * OMEGA_I[:, 2:]
    np.testing.assert_allclose(values, np.array(ORACLE["values"][name]), rtol=2e-4, atol=2e-5)


@pytest.mark.parametrize(
    ("name", "derivative"), [("isotropic", jax.jacfwd), ("half a circle", jax.jacrev)], ids=["forwards", "backwards"]
)
def test_values_and_gradients_are_finite_for_any_directions_and_right(tmp_path, name, derivative):
    """Right by central differences in double precision."""
    brdf = load_brdf(made(tmp_path, name)).brdf
    axes = [[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0.6, 0, 0.8], [-0.6, 0, 0.8], [0, 0.6, -0.8], [0, 0, -1]]
    place = np.array([[-0.44, 0.37, 0.8], [0.3, -0.4, 0.85]])
    pairs = np.array([place, *((a, b) for a in axes for b in axes)], np.float32).swapaxes(0, 1)
    assert np.isfinite(evaluate(brdf, *pairs)).all()
    slopes = jax.jit(jax.vmap(derivative(brdf.evaluate, argnums=(0, 1))))(*pairs)
    slopes = np.concatenate([np.asarray(slope) for slope in slopes], axis=-1)
    assert np.isfinite(slopes).all()
    steps = 1e-6 * np.concatenate([np.eye(6), -np.eye(6)]).reshape(12, 2, 3)
    with jax.enable_x64(True):
        exact = jax.tree.map(lambda x: np.asarray(x, float), brdf)
        above, below = np.split(np.asarray(_evaluate(exact, *(place + steps).swapaxes(0, 1))), 2)
    np.testing.assert_allclose(slopes[0].T, (above - below) / 2e-6, rtol=1e-4)


def test_negative_values_are_taken_as_0_and_counted(tmp_path):
    fields = writers.rgl_fields()
    fields["rgb"][0, 1, :, 2, 2:4] = -0.01
    path = tmp_path / "a.bsdf"
    path.write_bytes(writers.tensor_file(fields))
    loaded = load_brdf(path)
    assert loaded.notes == ("a.bsdf: 6 of 432 values were negative, down to -0.01, and are taken as 0",)
    assert evaluate(loaded.brdf).min() >= 0


def changed(name: str, change) -> bytes:
    fields = writers.rgl_fields()
    fields[name] = change(fields[name].copy())
    return writers.tensor_file(fields)


def with_one(value):
    def change(array):
        array.flat[1] = value
        return array

    return change


WHOLE = writers.rgl()


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (WHOLE[:-9], "is cut short|not where its header says"),
        (WHOLE + b"\0" * 8, "not where its header says"),
        (WHOLE[:12] + b"\2" + WHOLE[13:], "version 2.0"),
        (b"tenser" + WHOLE[6:], "is no BRDF file"),
        (changed("rgb", with_one(np.nan)), "1 of 432 numbers of 'rgb' are not finite"),
        (changed("vndf", with_one(-1)), "a density is negative"),
        (changed("ndf", with_one(np.inf)), "'ndf' are not finite"),
        (changed("theta_i", lambda a: a[::-1]), "do not ascend"),
        (changed("theta_i", lambda a: a[:3]), "do not fit together"),
        (changed("sigma", lambda a: a[0]), "'sigma' has the wrong dimensions"),
        (writers.tensor_file({k: v for k, v in writers.rgl_fields().items() if k != "ndf"}), "no field 'ndf'"),
        (
            writers.tensor_file({k.replace("rgb", "spectra"): v for k, v in writers.rgl_fields().items()}),
            "holds spectra; use the variant",
        ),
    ],
)
def test_faulty_files_are_refused(tmp_path, data, what):
    path = tmp_path / "a.bsdf"
    path.write_bytes(data)
    with pytest.raises(InputError, match=what):
        load_brdf(path)


def test_files_that_are_none_are_refused(tmp_path):
    with pytest.raises(InputError, match="cannot be read"):
        load_brdf(tmp_path / "absent.bsdf")
    with pytest.raises(InputError, match="not a regular file"):
        load_brdf(tmp_path)
    empty = tmp_path / "empty.binary"
    empty.write_bytes(b"")
    with pytest.raises(InputError, match="is empty"):
        load_brdf(empty)
