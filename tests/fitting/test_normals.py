"""Normals from images: of surfaces whose normals are known."""

import numpy as np
import pytest

from fitting.normals import estimated_normals
from fitting.stack import load_stack, stack_of
from tests.shared_data import shared


def _apart(one, other) -> np.ndarray:
    """Degrees between unit vectors."""
    return np.degrees(np.arccos(np.clip(np.sum(one * other, axis=-1), -1, 1)))


def _ball(size=24):
    x, y = np.meshgrid(*[(np.arange(size) + 0.5) * 2 / size - 1] * 2)
    mask = x * x + y * y < 0.8
    return np.stack([x, -y, np.sqrt(np.maximum(0, 1 - x * x - y * y))], axis=-1), mask


def _lights(count=20):
    angle = np.arange(count) * 2.4
    slant = 0.9 * np.sqrt((np.arange(count) + 0.5) / count)
    return np.stack([slant * np.cos(angle), slant * np.sin(angle), np.sqrt(1 - slant**2)], axis=-1)


def test_a_lambertian_ball_with_attached_shadows_is_found_exactly():
    normals, mask = _ball()
    shading = np.maximum(normals @ _lights().T, 0)
    images = np.moveaxis(shading, -1, 0)[..., None] * [0.5, 0.2, 0.7]
    found = estimated_normals(stack_of(images, _lights(), mask=mask))
    assert _apart(found, normals)[mask].max() < 0.2
    np.testing.assert_allclose(np.linalg.norm(found, axis=-1), 1, atol=1e-6)


def test_highlights_and_cast_shadows_do_little_harm():
    rng = np.random.default_rng(0)
    normals, mask = _ball()
    shading = np.maximum(normals @ _lights().T, 0)
    mirror = 2 * shading[..., None] * normals[..., None, :] - _lights()
    shading = 0.4 * shading + np.maximum(mirror[..., 2], 0) ** 40
    shading[rng.random(shading.shape) < 0.08] = 0
    found = estimated_normals(stack_of(np.moveaxis(shading, -1, 0)[..., None] * np.ones(3), _lights(), mask=mask))
    assert np.median(_apart(found, normals)[mask]) < 3


def test_pixels_of_which_nothing_can_be_said_face_the_camera():
    images = np.full((6, 2, 2, 3), np.nan)
    images[:, 0, 0] = 0
    images[:, 0, 1] = 0.5 * _lights(6)[:, 2:]
    images[:3, 1, 0] = 0.3 * _lights(6)[:3, 2:]
    found = estimated_normals(stack_of(images, _lights(6)))
    np.testing.assert_allclose(found, np.broadcast_to([0, 0, 1], (2, 2, 3)), atol=1e-3)


def test_a_real_ball_of_known_normals():
    stack = load_stack(shared("data", "photometric", "diligent_ball.npz"))
    assert np.mean(_apart(estimated_normals(stack), stack.normals)[stack.mask]) == pytest.approx(1.8, abs=0.4)
