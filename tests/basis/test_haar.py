"""Haar wavelets against PyWavelets, and their laws."""

import functools

import jax
import numpy as np
import pytest
import pywt

from jaxrelight.basis import haar

_forward, _inverse = jax.jit(haar.forward), jax.jit(haar.inverse)


def _in_sixes(transform, arrays) -> np.ndarray:
    """Six faces in every call: one program for each size."""
    arrays = np.asarray(arrays)
    flat = arrays.reshape(-1, *arrays.shape[-2:])
    padded = np.pad(flat, [(0, -len(flat) % 6), (0, 0), (0, 0)])
    parts = [transform(padded[start : start + 6].reshape(2, 3, *flat.shape[1:])) for start in range(0, len(padded), 6)]
    return np.concatenate([np.asarray(part).reshape(6, *flat.shape[1:]) for part in parts])[: len(flat)].reshape(
        arrays.shape
    )


forward, inverse = (functools.partial(_in_sixes, transform) for transform in (_forward, _inverse))


def faces(n: int, *lead: int, seed: int = 0) -> np.ndarray:
    return np.random.default_rng(seed).normal(size=(*lead, n, n))


def pyramid(face: np.ndarray) -> np.ndarray:
    """PyWavelets' transform in its array layout."""
    if face.shape[0] == 1:
        return face
    return pywt.coeffs_to_array(pywt.wavedec2(face, "haar", mode="periodization"))[0]


@pytest.mark.parametrize("n", [1, 2, 8, 32])
def test_is_pywavelets_in_float64(x64, n):
    data = faces(n)
    coefficients = forward(data)
    assert coefficients.dtype == np.float64
    np.testing.assert_allclose(coefficients, pyramid(data), atol=1e-12)
    np.testing.assert_allclose(inverse(coefficients), data, atol=1e-12)
    np.testing.assert_allclose(np.sum(coefficients**2), np.sum(data**2), rtol=1e-12)


def test_layout_of_details():
    """A step to the right is horizontal detail, a step down vertical, a chessboard diagonal."""
    n, m = 4, 2
    right, down = np.tile([1.0, 0], (n, n // 2)), np.tile([[1.0], [0]], (n // 2, n))
    quarters = {"average": np.s_[:m, :m], "right": np.s_[:m, m:], "down": np.s_[m:, :m], "both": np.s_[m:, m:]}
    for data, quarter in [(right, "right"), (down, "down"), (2 * np.abs(right - down) - 1, "both")]:
        coefficients = forward(data.astype(np.float32))
        for name, part in quarters.items():
            if name == quarter:
                assert (np.abs(coefficients[part]) > 0.5).all()
            elif name != "average":
                np.testing.assert_array_equal(coefficients[part], 0)
    constant = forward(np.ones((n, n), np.float32))
    assert constant[0, 0] == n
    assert np.count_nonzero(constant) == 1


@pytest.mark.parametrize("n", [2, 4])
def test_inverse_is_the_transpose(x64, n):
    size = n * n
    basis = np.eye(size).reshape(size, n, n)
    matrix, back = (side(basis).reshape(size, size) for side in (forward, inverse))
    np.testing.assert_allclose(back, matrix.T, atol=1e-15)
    np.testing.assert_allclose(matrix @ matrix.T, np.eye(size), atol=1e-14)
    derivative = np.asarray(jax.jit(jax.jacrev(haar.forward))(basis[0])).reshape(size, size)
    np.testing.assert_allclose(derivative, matrix.T, atol=1e-15)


def test_adjoint_identity_and_linearity():
    x, y = (faces(16, seed=seed).astype(np.float32) for seed in (0, 1))
    size = np.linalg.norm(x) * np.linalg.norm(y)
    assert abs(np.vdot(forward(x), y) - np.vdot(x, inverse(y))) < 1e-6 * size
    together = forward(2 * x - 3 * y)
    np.testing.assert_allclose(together, 2 * forward(x) - 3 * forward(y), atol=1e-5)


@jax.jit
def _encode(basis, vectors):
    return basis.encode(vectors)


@jax.jit
def _decode(basis, vectors):
    return basis.decode(vectors)


@pytest.mark.parametrize("lead", [(), (2,), (2, 3)])
def test_haar_faces_treat_each_face_by_itself(lead):
    n = 4
    basis = haar.HaarFaces(n)
    vectors = np.random.default_rng(0).normal(size=(*lead, 6 * n * n)).astype(np.float32)
    coefficients = np.asarray(_encode(basis, vectors))
    assert coefficients.shape == vectors.shape
    each = [pyramid(face) for face in vectors.astype(float).reshape(-1, n, n)]
    np.testing.assert_allclose(coefficients, np.reshape(each, vectors.shape), atol=1e-6)
    np.testing.assert_allclose(_decode(basis, coefficients), vectors, atol=1e-6)


def test_haar_faces_pass_through_jit_as_a_static_part():
    traces = []

    @jax.jit
    def encode(basis, x):
        traces.append(basis.resolution)
        return basis.encode(x)

    x = np.arange(96, dtype=np.float32)
    for factor in (1, 2):
        np.testing.assert_allclose(
            encode(haar.HaarFaces(4), factor * x), _encode(haar.HaarFaces(4), factor * x), rtol=1e-6
        )
    assert traces == [4]


def test_levels_are_those_of_the_pyramid():
    """What varies at one scale alone has coefficients of that level alone."""
    n, level = 16, haar.levels(16).reshape(6, 16, 16)
    assert level[0].tolist() == level[5].tolist()
    np.testing.assert_array_equal(np.bincount(level[0].ravel()), [1, 3, 12, 48, 192])
    place = np.arange(n)
    for number in range(1, 5):
        stripes = 1.0 - 2 * (place // (n >> number) % 2)
        coefficients = forward(np.outer(stripes, np.ones(n)).astype(np.float32))
        assert set(level[0][np.abs(coefficients) > 1e-6]) == {number}
