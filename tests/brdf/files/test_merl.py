"""MERL files: the table's own entries, invalid ones, and faulty files. All files are made by code."""

import importlib.util

import jax
import numpy as np
import pytest

from jaxrelight.brdf.files import load_brdf
from jaxrelight.brdf.files.merl import SHAPE, SIZE
from jaxrelight.brdf.tabulated import Tabulated, entry_angles, least_cosine
from jaxrelight.errors import InputError
from tests.brdf.files import writers
from tests.shared_data import shared

ABOVE = least_cosine(SHAPE) > 0


def smooth() -> np.ndarray:
    """Reflectance that falls off with θ_h, rises with θ_d, depends on φ_d a little and has a colour: [h, d, p, 3]."""
    theta_h, theta_d, phi_d = np.meshgrid(*entry_angles(SHAPE), indexing="ij")
    grey = np.exp(-3 * theta_h) * (1 + theta_d**2) * (1 + 0.2 * np.sin(theta_h) * np.sin(theta_d) * np.cos(2 * phi_d))
    return grey[..., None] * [0.3, 0.2, 0.1]


def _table(brdf) -> np.ndarray:
    assert isinstance(brdf, Tabulated)
    return np.asarray(brdf.values)


def pair(theta_h, theta_d, phi_d) -> tuple[np.ndarray, np.ndarray]:
    """ω_i and ω_o that have these angles."""
    i = np.stack([np.sin(theta_d) * np.cos(phi_d), np.sin(theta_d) * np.sin(phi_d), np.cos(theta_d)], axis=-1)
    cosine, sine = np.cos(theta_h), np.sin(theta_h)

    def turned(v):  # about y, then by some azimuth about z
        x, y, z = cosine * v[..., 0] + sine * v[..., 2], v[..., 1], cosine * v[..., 2] - sine * v[..., 0]
        return np.stack([0.6 * x - 0.8 * y, 0.8 * x + 0.6 * y, z], axis=-1)

    return turned(i), turned(i * [-1, -1, 1])


def at_entries(brdf, places: np.ndarray) -> np.ndarray:
    angles = [axis[places[:, n]] for n, axis in enumerate(entry_angles(SHAPE))]
    return evaluate(brdf, *pair(*angles))


def evaluate(brdf, omega_i, omega_o) -> np.ndarray:
    """Between up to 4000 pairs: the same program for all."""
    pairs = [np.pad(np.asarray(v, np.float32), [(0, 4000 - len(v)), (0, 0)], mode="edge") for v in (omega_i, omega_o)]
    return np.asarray(_evaluate(brdf, *pairs))[: len(omega_i)]


@jax.jit
def _evaluate(brdf, omega_i, omega_o):
    return jax.vmap(brdf.evaluate)(omega_i, omega_o)


@pytest.fixture(scope="module")
def file(tmp_path_factory):
    path = tmp_path_factory.mktemp("merl") / "smooth.binary"
    path.write_bytes(writers.merl(np.where(ABOVE[..., None], smooth(), -1)))
    return path


def test_at_its_entries_a_table_is_what_is_written(file):
    """Those of which all neighbours are valid, too."""
    loaded = load_brdf(file)
    assert (loaded.kind, loaded.notes) == ("MERL", ())
    places = np.argwhere(least_cosine(SHAPE) > 0.05)[::4111]
    values = at_entries(loaded.brdf, places)
    np.testing.assert_allclose(values, smooth()[tuple(places.T)], rtol=2e-3)
    assert _table(loaded.brdf).shape == (*SHAPE, 3)


def test_no_invalid_mark_is_left_in_any_value(file):
    brdf = load_brdf(file).brdf
    assert _table(brdf).min() > 0
    chance = np.random.default_rng(0)
    omega = chance.normal(size=(2, 4000, 3))
    omega[..., 2] = np.abs(omega[..., 2]) * 0.02  # near the horizon
    omega /= np.linalg.norm(omega, axis=-1, keepdims=True)
    values = evaluate(brdf, *omega)
    assert 0 < values.min() <= values.max() < 1


def test_invalid_entries_above_the_surface_are_filled_and_counted(tmp_path):
    values = np.where(ABOVE[..., None], smooth(), -1)
    values[10, 10, 20:23, 1] = -0.5
    path = tmp_path / "holes.binary"
    path.write_bytes(writers.merl(values))
    loaded = load_brdf(path)
    assert loaded.notes == ("holes.binary: 3 entries above the surface are invalid; the nearest is taken",)
    np.testing.assert_allclose(_table(loaded.brdf)[10, 10, 21], smooth()[10, 10, 21], rtol=0.2)


def test_a_surrogate_is_what_its_writer_writes(tmp_path):
    """Neural surrogates of measured materials, by the functions that made them; never to be called measured."""
    script = shared("data", "brdf", "nbrdf_to_merl_binary.py")
    spec = importlib.util.spec_from_file_location("writer", script)
    assert spec is not None
    assert spec.loader is not None
    writer = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(writer)
    network = np.load(shared("data", "brdf", "merl_nbrdf.npz"))
    name = str(network["names"][0])
    table = writer.table(network, name)
    path = tmp_path / "surrogate.binary"
    path.write_bytes(writers.merl(table))
    brdf = load_brdf(path).brdf
    places = np.argwhere(least_cosine(SHAPE) > 0.05)[::4111]
    angles = [axis[places[:, n]] for n, axis in enumerate(entry_angles(SHAPE))]
    wanted = writer.nbrdf(network, name, *angles)
    np.testing.assert_allclose(at_entries(brdf, places), wanted, rtol=5e-3, atol=1e-5)


@pytest.mark.parametrize("size", [0, 11, 12, 1000, SIZE // 2, SIZE - 1, SIZE + 1])
def test_files_of_another_length_are_refused(tmp_path, size):
    path = tmp_path / "a.binary"
    path.write_bytes(np.array(SHAPE, "<i4").tobytes()[:size])
    with path.open("r+b") as stream:
        stream.truncate(size)
    with pytest.raises(InputError, match=r"is cut short|is too long|is empty|is no BRDF file"):
        load_brdf(path)


@pytest.mark.parametrize("dimensions", [(90, 90, 360), (0, 0, 0), (-1, 90, 180), (2**31 - 1, 2**31 - 1, 2**31 - 1)])
def test_other_dimensions_are_refused_before_memory_is_taken(tmp_path, dimensions):
    path = tmp_path / "a.binary"
    path.write_bytes(np.array(dimensions, "<i4").tobytes() + bytes(64))
    with pytest.raises(InputError, match=r"has the dimensions .*, not \(90, 90, 180\)"):
        load_brdf(path)


@pytest.mark.parametrize(("value", "what"), [(np.nan, "not finite"), (np.inf, "not finite"), (-1, "no valid value")])
def test_values_that_are_none_are_refused(tmp_path, value, what):
    values = np.full((*SHAPE, 3), -1.0 if value == -1 else 0.5)
    values[3, 4, 5, 1] = value
    path = tmp_path / "a.binary"
    path.write_bytes(writers.merl(values))
    with pytest.raises(InputError, match=what):
        load_brdf(path)
