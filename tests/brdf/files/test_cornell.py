"""Cornell files: colours by CIE's tables, the stored pairs, and faulty files."""

import jax
import numpy as np
import pytest

from jaxrelight.brdf.files import load_brdf
from jaxrelight.brdf.files.content import Content
from jaxrelight.brdf.files.cornell import Pairs, interpolated, read_pairs
from jaxrelight.brdf.files.spectra import WAVELENGTHS, to_rec709_weights
from jaxrelight.errors import InputError
from tests.brdf.files import writers
from tests.shared_data import shared

ANGLES, SPECTRA, WAVES = writers.cornell_pairs()
SMALL = 24, 18, 20


# Spectra integrated by colour-science 0.4.7: CIE 1931 2°, D65, 400 to 700 nm by 10, its own matrix of sRGB.
COLOURS = np.array(
    [
        [0.69818, 0.70073, 0.69856],
        [0.90632, 0.02353, 0.03595],
        [-0.01806, -0.00645, 0.8937],
        [-0.07396, 0.60632, 0.65046],
    ]
)


def test_colours_are_those_of_an_independent_program():
    """Its white, the first of the spectra, is not quite white in this range; ours is."""
    wl = WAVELENGTHS
    spectra = [
        np.full(31, 0.7),
        0.05 + 0.9 * (wl > 590),
        np.exp(-(((wl - 450) / 40) ** 2)),
        0.5 + 0.4 * np.sin(wl / 35),
    ]
    wanted = COLOURS * 0.7 / COLOURS[0]
    np.testing.assert_allclose(np.array(spectra) @ to_rec709_weights(wl), wanted, atol=3e-4)


def test_white_is_white_whatever_the_wavelengths():
    for wavelengths in (WAVELENGTHS, np.array([390.0, 550, 731]), np.arange(380.0, 781, 5)):
        np.testing.assert_allclose(to_rec709_weights(wavelengths).sum(axis=0), 1, rtol=1e-12)


def file(folder, data: bytes):
    path = folder / "a.brdf"
    path.write_bytes(data)
    return path


def test_the_pairs_are_read_whatever_ends_the_lines(tmp_path):
    for end in ("\n", "\r\n"):
        pairs = read_pairs(Content(file(tmp_path, writers.cornell(ANGLES, SPECTRA, WAVES, end))))
        assert len(pairs.values) == 60
        assert not pairs.notes
        np.testing.assert_allclose(pairs.omega_i[:, 2], np.cos(ANGLES[:, 0]), atol=1e-6)
        np.testing.assert_allclose(pairs.omega_o[:, 1], np.sin(ANGLES[:, 2]) * np.sin(ANGLES[:, 3]), atol=1e-5)
        np.testing.assert_allclose(pairs.values, SPECTRA @ to_rec709_weights(WAVES), atol=1e-5)


def evaluate(brdf, omega_i, omega_o) -> np.ndarray:
    """Between pairs, a hundred at a time."""
    pairs = [np.pad(np.asarray(v, np.float32), [(0, -len(v) % 100), (0, 0)], mode="edge") for v in (omega_i, omega_o)]
    parts = [_evaluate(brdf, *(v[start : start + 100] for v in pairs)) for start in range(0, len(pairs[0]), 100)]
    return np.concatenate(parts)[: len(omega_i)]


@jax.jit
def _evaluate(brdf, omega_i, omega_o):
    return jax.vmap(brdf.evaluate)(omega_i, omega_o)


def test_the_interpolation_goes_through_the_pairs_and_is_reciprocal_and_its_own_mirror_image(tmp_path):
    pairs = read_pairs(Content(file(tmp_path, writers.cornell(ANGLES, SPECTRA, WAVES))))
    brdf, note = interpolated(pairs, SMALL)
    assert note.startswith("goes through 100.0% of their values")
    i, o = pairs.omega_i, pairs.omega_o
    at_pairs = evaluate(brdf, i, o)
    np.testing.assert_allclose(at_pairs, pairs.values, rtol=0.01)
    np.testing.assert_allclose(evaluate(brdf, o, i), at_pairs, rtol=1e-4)
    np.testing.assert_allclose(evaluate(brdf, i * [1, -1, 1], o * [1, -1, 1]), at_pairs, rtol=1e-2)
    values = np.asarray(brdf.values)
    assert pairs.values.min() * 0.5 < values.min() <= values.max() < pairs.values.max() * 2


def test_pairs_left_out_are_predicted():
    angles, spectra, _ = writers.cornell_pairs(600)
    i, o = (
        np.stack([np.sin(t) * np.cos(p), np.sin(t) * np.sin(p), np.cos(t)], axis=1)
        for t, p in (angles[:, :2].T, angles[:, 2:].T)
    )
    values = spectra[:, [0, 8, 15]]
    brdf, _ = interpolated(Pairs(i[:500], o[:500], values[:500], []), SMALL)
    apart = np.abs(evaluate(brdf, i[500:], o[500:]) / values[500:] - 1)
    assert np.median(apart) < 0.03
    assert np.percentile(apart, 95) < 0.3


@pytest.mark.slow
def test_a_measured_file_goes_through_its_pairs():
    path = shared("data", "brdf", "cornell_garnet_red.brdf")
    loaded = load_brdf(path)
    pairs = read_pairs(Content(path))
    assert loaded.kind == "Cornell"
    assert len(pairs.values) == 1439
    assert "144 of 4,317 Rec.709 values were negative" in loaded.notes[0]
    assert "interpolated from 1,439 pairs" in loaded.notes[1]
    apart = np.abs(evaluate(loaded.brdf, pairs.omega_i, pairs.omega_o) - pairs.values) / (pairs.values + 1e-3)
    assert np.mean(apart < 0.01) > 0.9
    assert np.mean(apart < 0.1) > 0.99


WHOLE = writers.cornell(ANGLES, SPECTRA, WAVES)


@pytest.mark.parametrize(
    ("data", "what"),
    [
        (WHOLE[: WHOLE.rindex(b" ")] + b"\n", "a line has 19 numbers instead of 20"),
        (WHOLE.replace(b"num wls\n16", b"num wls\n17"), "a line has 20|does not have 17 ascending"),
        (WHOLE.replace(b"num wls\n16", b"num wls\n1000000000"), "does not start with a number of wavelengths"),
        (WHOLE.replace(b"400 420", b"420 400"), "does not have 16 ascending wavelengths"),
        (WHOLE[:-9] + b"nan\n", "are not finite"),
        (WHOLE[:-9] + b"what\n", "something else than numbers"),
        (WHOLE[: WHOLE.index(b"\n", 2000) + 1], "pairs of directions, fewer than 32"),
        (writers.cornell(ANGLES + np.array([2, 0, 0, 0]), SPECTRA, WAVES), "an angle is out of range"),
        (writers.cornell(np.tile(ANGLES[:1], (60, 1)), SPECTRA, WAVES), "too much alike"),
    ],
)
def test_faulty_files_are_refused(tmp_path, data, what):
    with pytest.raises(InputError, match=what):
        load_brdf(file(tmp_path, data))


def test_negative_values_are_taken_as_0_and_an_open_end_is_told(tmp_path):
    spectra = SPECTRA.copy()
    spectra[3, 2:4] = -0.001
    pairs = read_pairs(Content(file(tmp_path, writers.cornell(ANGLES, spectra, WAVES).rstrip())))
    assert pairs.notes[0] == "a.brdf: 2 of 960 measured values were negative, down to -0.001, and are taken as 0"
    assert "may be cut short" in pairs.notes[1]
