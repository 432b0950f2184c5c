"""The tangent frame: orthonormal, right-handed, smooth."""

import jax
import numpy as np
import pytest

from jaxrelight.geometry import frame

_frames = jax.jit(frame.tangent_frame)


def tangent_frame(normals, dtype=np.float32) -> np.ndarray:
    """Of up to 721 normals: the same program for all."""
    padded = np.pad(np.asarray(normals, dtype), [(0, 721 - len(normals)), (0, 0)], mode="edge")
    return np.asarray(_frames(padded))[: len(normals)]


def normals(count: int = 500) -> np.ndarray:
    vectors = np.random.default_rng(0).normal(size=(count, 3))
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    return np.concatenate([axes, vectors / np.linalg.norm(vectors, axis=-1, keepdims=True)])


def near_minus_y(angle: float) -> np.ndarray:
    """Normals all around −y at an angle from it."""
    azimuth = np.linspace(0, 2 * np.pi, 12, endpoint=False)
    sine, cosine = np.sin(angle), np.cos(angle)
    return np.stack([sine * np.cos(azimuth), -cosine + 0 * azimuth, sine * np.sin(azimuth)], axis=-1)


@pytest.mark.parametrize(("dtype", "tolerance"), [(np.float32, 2e-5), (np.float64, 1e-12)])
def test_is_a_rotation_that_takes_the_normal_to_z(x64, dtype, tolerance):
    n = normals()
    frames = tangent_frame(n, dtype)
    assert frames.shape == (len(n), 3, 3)
    assert frames.dtype == dtype
    frames = np.asarray(frames, float)
    np.testing.assert_allclose(
        frames @ frames.transpose(0, 2, 1), np.broadcast_to(np.eye(3), frames.shape), atol=tolerance
    )
    np.testing.assert_allclose(np.linalg.det(frames), 1, atol=tolerance)
    np.testing.assert_allclose(np.einsum("nij,nj->ni", frames, n), np.tile([0, 0, 1], (len(n), 1)), atol=tolerance)


@pytest.mark.parametrize("angle", [0.1, 0.01, 0.003])
def test_stays_a_rotation_close_to_minus_y(angle):
    frames = tangent_frame(near_minus_y(angle)).astype(float)
    np.testing.assert_allclose(frames @ frames.transpose(0, 2, 1), np.broadcast_to(np.eye(3), frames.shape), atol=1e-3)


def test_known_frames():
    """At +y and at −y the tangent is +x; at +z too, from s = ((y+1)² + z² − x², …) = (2, 0, 0)."""
    frames = tangent_frame([[0.0, 1, 0], [0, -1, 0], [0, 0, 1]])
    np.testing.assert_allclose(frames[0], [[1, 0, 0], [0, 0, -1], [0, 1, 0]], atol=1e-7)
    np.testing.assert_allclose(frames[1], [[1, 0, 0], [0, 0, 1], [0, -1, 0]], atol=1e-7)
    np.testing.assert_allclose(frames[2], [[1, 0, 0], [0, 1, 0], [0, 0, 1]], atol=1e-7)


def test_is_smooth_but_at_minus_y():
    """Normals a small step apart have frames not much further apart, on a whole circle through +y and two others."""
    angle = np.linspace(0, 2 * np.pi, 721)
    zero = 0 * angle
    circles = [(np.cos(angle), zero, np.sin(angle)), (np.cos(angle), 0.6 + zero, np.sin(angle))]
    upper = angle / 2 - np.pi / 2
    circles.append((np.sin(upper), np.cos(upper), zero))
    for circle in circles:
        n = np.stack(circle, axis=-1)
        n /= np.linalg.norm(n, axis=-1, keepdims=True)
        frames = tangent_frame(n).astype(float)
        step = np.linalg.norm(np.diff(n, axis=0), axis=-1).max()
        assert np.linalg.norm(np.diff(frames, axis=0), axis=(1, 2)).max() < 4 * step


@pytest.mark.parametrize("derivative", [jax.jacfwd, jax.jacrev])
def test_gradients_are_finite_everywhere(derivative):
    n = np.concatenate([normals(20), near_minus_y(1e-2), near_minus_y(1e-5), np.zeros((1, 3))])
    slopes = jax.jit(jax.vmap(derivative(frame.tangent_frame)))(n.astype(np.float32))
    assert np.isfinite(np.asarray(slopes)).all()


@pytest.mark.parametrize("tilt", [0, 1e-5, 5e-4, 9e-4, 1.1e-3])
def test_frames_are_orthonormal_close_to_minus_y(tilt):
    normal = np.array([tilt, -1, tilt / 3])
    (frame,) = tangent_frame([normal / np.linalg.norm(normal)])
    np.testing.assert_allclose(frame @ frame.T, np.eye(3), atol=1e-6)
