"""RGL files against Mitsuba's `measured` plugin, whose numbers are kept here, and faulty ones."""

import json
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jax.test_util import check_grads
from jax.typing import ArrayLike

from jaxrelight.brdf.files import load_brdf
from jaxrelight.errors import InputError
from tests.brdf.files import writers
from tests.shared_data import shared

# f(ω_i, ω_o) cosθ_i by Mitsuba 3.9.1, scalar_rgb, in which si.wi is our ω_o; written by `mitsuba_oracle.py`.
ORACLE = json.loads(Path(__file__, "../mitsuba_oracle.json").resolve().read_text())
OMEGA_I, OMEGA_O = np.array(ORACLE["omega_i"], np.float32), np.array(ORACLE["omega_o"], np.float32)


def evaluate(brdf, omega_i: ArrayLike = OMEGA_I, omega_o: ArrayLike = OMEGA_O) -> np.ndarray:
    return np.asarray(jax.jit(jax.vmap(brdf.evaluate))(jnp.asarray(omega_i), jnp.asarray(omega_o)))


def made(folder: Path, name: str) -> Path:
    """A file that Mitsuba has evaluated: one of the shared ones, or one made by code."""
    if name.endswith(".bsdf"):
        return shared("data", "brdf", name)
    path = folder / f"{name}.bsdf"
    path.write_bytes(writers.rgl(**ORACLE["made"][name]))
    return path


@pytest.mark.parametrize("name", ORACLE["values"])
def test_values_are_those_of_mitsuba(tmp_path, name):
    found = evaluate(load_brdf(made(tmp_path, name)).brdf) * OMEGA_I[:, 2:]
    np.testing.assert_allclose(found, np.array(ORACLE["values"][name]), rtol=2e-4, atol=2e-5)


def test_values_and_gradients_are_finite_for_any_directions(tmp_path):
    path = tmp_path / "a.bsdf"
    axes = np.array([[0, 0, 1], [1, 0, 0], [-1, 0, 0], [0, 1, 0], [0.6, 0, 0.8], [-0.6, 0, 0.8], [0, 0.6, -0.8]])
    pairs = jnp.asarray([(a, b) for a in [*axes, [0, 0, -1]] for b in [*axes, [0, 0, -1]]], jnp.float32)
    for azimuths, derivative in ((1, jax.jacrev), (5, jax.jacfwd)):
        path.write_bytes(writers.rgl(azimuths))
        brdf = load_brdf(path).brdf
        slopes = jax.jit(jax.vmap(derivative(brdf.evaluate, argnums=(0, 1))))(pairs[:, 0], pairs[:, 1])
        assert all(np.isfinite(slope).all() for slope in slopes)
        assert np.isfinite(evaluate(brdf, pairs[:, 0], pairs[:, 1])).all()


def test_gradients_are_right(tmp_path, x64):
    path = tmp_path / "a.bsdf"
    path.write_bytes(writers.rgl())
    brdf = jax.tree.map(lambda x: x.astype(jnp.float64), load_brdf(path).brdf)
    omega_i, omega_o = jnp.asarray([-0.44, 0.37, 0.8]), jnp.asarray([0.3, -0.4, 0.85])
    check_grads(jax.jit(lambda i, o: brdf.evaluate(i, o)), (omega_i, omega_o), 1, ["fwd", "rev"], eps=1e-6, rtol=1e-4)


def test_negative_values_are_taken_as_0_and_counted(tmp_path):
    fields = writers.rgl_fields()
    fields["rgb"][0, 1, :, 2, 2:4] = -0.01
    path = tmp_path / "a.bsdf"
    path.write_bytes(writers.tensor_file(fields))
    found = load_brdf(path)
    assert found.notes == ("a.bsdf: 6 of 432 values were negative, down to -0.01, and are taken as 0",)
    assert evaluate(found.brdf).min() >= 0


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
