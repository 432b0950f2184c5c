"""Cornell's .brdf files: spectral reflectance of pairs of directions, anywhere on the hemisphere, as text.

Numbers between lines that start with #: how many wavelengths; the wavelengths in nm; then a line for each pair, with
θ_i φ_i θ_s φ_s in radians and a value for every wavelength.
"""

import functools
import math
import re
from typing import NamedTuple

import jax
import numpy as np
from jaxtyping import Float
from scipy.sparse import csr_array

from jaxrelight.brdf.files.content import Content
from jaxrelight.brdf.files.spectra import to_rec709_weights
from jaxrelight.brdf.tabulated import HalfDifference, Tabulated, corners, entry_angles, half_difference
from jaxrelight.errors import InputError
from jaxrelight.numerics.arrays import as_array

# The shape of the table that pairs are interpolated to.
SHAPE = (90, 60, 60)
_NEIGHBOURS = 30
_MIN_PAIRS = 32
_ROUNDS = 300


class Pairs(NamedTuple):
    """Reflectance in linear Rec.709 of scattered pairs of unit directions, and notes."""

    omega_i: Float[np.ndarray, "n 3"]
    omega_o: Float[np.ndarray, "n 3"]
    values: Float[np.ndarray, "n 3"]
    notes: list[str]


def is_cornell(content: Content) -> bool:
    """Whether the file starts as text of such a file does: with lines of # and a number."""
    return re.match(rb"\s*(#[^\n]*\n\s*)*\d+\s", content.data[:4096]) is not None


def read_pairs(content: Content) -> Pairs:
    """The pairs of a file. Colours too saturated for Rec.709 are negative in it; that is taken as 0 and counted.

    Nothing in a file says how many pairs there are: a note tells if the last line has no end.

    Raises:
        InputError: if a line does not hold what it should, an angle is out of range or a number not finite.
    """
    lines = [line for line in content.data.split(b"\n") if line.strip() and not line.lstrip().startswith(b"#")]
    head = _numbers(content, lines[0]) if lines else np.zeros(0)
    count = int(head[0]) if len(head) == 1 and 2 <= head[0] <= 1000 and head[0] == int(head[0]) else 0
    if not count:
        raise content.fault("does not start with a number of wavelengths from 2 to 1,000")
    wavelengths, used = np.zeros(0), 1
    while len(wavelengths) < count and used < len(lines):
        wavelengths, used = np.concatenate([wavelengths, _numbers(content, lines[used])]), used + 1
    if (
        len(wavelengths) != count
        or (np.diff(wavelengths) <= 0).any()
        or not 200 < wavelengths[0] < wavelengths[-1] < 2000
    ):
        raise content.fault(f"does not have {count} ascending wavelengths in nanometres")
    rows = [_numbers(content, line) for line in lines[used:]]
    lengths = {len(row) for row in rows}
    if lengths - {4 + count}:
        raise content.fault(f"a line has {max(lengths - {4 + count})} numbers instead of {4 + count}")
    if len(rows) < _MIN_PAIRS:
        raise content.fault(f"has {len(rows)} pairs of directions, fewer than {_MIN_PAIRS}")
    table = np.array(rows)
    content.check_finite(table, "numbers")
    if not ((table[:, [0, 2]] >= 0) & (table[:, [0, 2]] < math.pi / 2)).all() or np.abs(table[:, [1, 3]]).max() > 7:
        raise content.fault("an angle is out of range: θ must be from 0 to π/2, φ from −2π to 2π")
    spectra, notes = content.without_negative(table[:, 4:], "measured values")
    values, more = content.without_negative(spectra @ to_rec709_weights(wavelengths), "Rec.709 values")
    if not content.data.endswith(b"\n"):
        notes.append(f"{content.path.name}: its last line has no end, the file may be cut short")
    return Pairs(_direction(*table[:, :2].T), _direction(*table[:, 2:4].T), values, notes + more)


def _numbers(content: Content, line: bytes) -> np.ndarray:
    try:
        return np.array([float(word) for word in line.split()])
    except ValueError:
        shown = line.strip()[:40].decode("ascii", "replace")
        raise content.fault(f"has something else than numbers in the line '{shown}'") from None


def _direction(theta, phi):
    return np.stack([np.sin(theta) * np.cos(phi), np.sin(theta) * np.sin(phi), np.cos(theta)], axis=-1)


def read_cornell(content: Content) -> tuple[Tabulated, list[str]]:
    """The file's pairs, interpolated."""
    pairs = read_pairs(content)
    try:
        brdf, left = interpolated(pairs)
    except InputError as fault:
        raise content.fault(str(fault), "the file cannot be interpolated") from None
    return brdf, [*pairs.notes, f"{content.path.name}: interpolated from {len(pairs.values):,} pairs; {left}"]


def interpolated(pairs: Pairs, shape: tuple[int, int, int] = SHAPE) -> tuple[Tabulated, str]:
    """A table through scattered pairs of an isotropic, reciprocal surface that is its own mirror image.

    Logarithms of reflectance are interpolated by thin-plate splines of the nearest pairs, over √θ_h, θ_d and
    √θ_h sin θ_d cos 2φ_d, which are the same for all pairs that such a surface cannot tell apart. What is between
    pairs is never beyond the least and the most of those neighbours: so nothing overshoots, and nothing grows where
    nothing was measured, towards grazing angles and in retroreflection. At last the table's entries
    are scaled until its trilinear values at the pairs are those measured, as nearly as pairs closer than entries allow.

    Returns:
        The table, and how nearly it goes through the pairs.

    Raises:
        InputError: if the pairs do not span these coordinates.
    """
    from scipy.interpolate import RBFInterpolator
    from scipy.spatial import KDTree

    angles = _angles(pairs)
    points = _coordinates(*angles)
    # Positive numbers over their own scale have logarithms; a thousandth of the median keeps zeros from going far.
    floor = 1e-3 * np.maximum(np.median(pairs.values, axis=0), 1e-3 * pairs.values.max()) + 1e-30
    logs = np.log(pairs.values + floor)
    theta_h, theta_d, phi_d = entry_angles(shape)
    half = phi_d[: (shape[2] + 1) // 2]  # φ_d and π − φ_d are mirror images
    grid = np.stack([axis.ravel() for axis in np.meshgrid(theta_h, theta_d, half, indexing="ij")])
    wanted = _coordinates(*grid)
    neighbours = min(_NEIGHBOURS, len(points))
    try:
        values = RBFInterpolator(points, logs, neighbors=neighbours)(wanted)
    except (np.linalg.LinAlgError, ValueError):
        raise InputError("its pairs of directions are too much alike") from None
    near = logs[KDTree(points).query(wanted, neighbours)[1]]
    values = np.exp(np.clip(values, near.min(axis=1), near.max(axis=1))) - floor
    first = values.reshape(*shape[:2], len(half), -1)
    table = np.concatenate([first, first[:, :, : shape[2] - len(half)][:, :, ::-1]], axis=2)
    return _through(table, floor, pairs, angles)


def _angles(pairs: Pairs) -> np.ndarray:
    """θ_h, θ_d and φ_d of all pairs, in double precision: [3, n]."""
    with jax.enable_x64(True):
        return np.stack(_half_differences(as_array(pairs.omega_i), as_array(pairs.omega_o)))


_half_differences = jax.jit(jax.vmap(half_difference))


@functools.partial(jax.jit, static_argnames="shape")
def _corners(places, shape: tuple[int, int, int]):
    return jax.vmap(lambda *one: corners(HalfDifference(*one), shape))(*places)


def _coordinates(theta_h, theta_d, phi_d) -> np.ndarray:
    root = np.sqrt(theta_h * (2 / np.pi))
    return np.stack([root, theta_d * (2 / np.pi), 0.5 * root * np.sin(theta_d) * np.cos(2 * phi_d)], axis=-1)


def _through(table: np.ndarray, floor: np.ndarray, pairs: Pairs, angles: np.ndarray) -> tuple[Tabulated, str]:
    """The table, of values above -floor, made to go through the pairs and their mirror images.

    Entries are multiplied by the weighted mean of the factors that the pairs beside them lack, again and again: the
    simultaneous multiplicative reconstruction of tomography, which keeps them positive.
    """
    mirrored = np.stack([angles[0], angles[1], np.mod(-angles[2], np.pi)])
    places = np.concatenate([angles, mirrored], axis=1)
    with jax.enable_x64(True):
        entries, weights = _corners(as_array(places), table.shape[:3])
    rows = np.repeat(np.arange(places.shape[1]), 8)
    used, columns = np.unique(np.ravel(entries), return_inverse=True)
    at_pairs = csr_array((np.ravel(weights), (rows, columns)), shape=(len(rows) // 8, len(used)))
    share = at_pairs.sum(axis=0)[:, None] + 1e-12
    wanted = np.tile(pairs.values, (2, 1))
    flat = table.reshape(-1, table.shape[3])
    logs, aim = np.log(flat[used] + floor), np.log(wanted + floor)
    for _ in range(_ROUNDS):
        logs += at_pairs.T @ (aim - np.log(at_pairs @ np.exp(logs))) / share
    flat[used] = np.maximum(np.exp(logs) - floor, 0)
    apart = np.abs(at_pairs @ flat[used] - wanted) / (wanted + floor)
    close = np.mean(apart < 0.01)
    note = f"goes through {close:.1%} of their values within 1 %, through the others within {apart.max():.0%}"
    return Tabulated(as_array(flat.reshape(table.shape))), note
