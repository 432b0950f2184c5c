"""Parts of faces, from which it is proved where the sky is open."""

import numpy as np
import pytest

from jaxrelight.geometry import occluders
from jaxrelight.geometry.occluders import _in_parts


def area(corners: np.ndarray) -> float:
    return float(np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1).sum())


def radii(corners: np.ndarray) -> np.ndarray:
    middle = (corners.min(axis=1) + corners.max(axis=1)) / 2
    return np.linalg.norm(corners - middle[:, None], axis=2).max(axis=1)


@pytest.mark.parametrize("width", [1.0, 1e-6])
def test_parts_cover_a_face_by_as_few_as_are_small(width):
    face = np.array([[[-0.5, 0, 0], [0.5, 0, 0], [0.4, width, 0]]])
    parts = _in_parts(face)
    np.testing.assert_allclose(area(parts), area(face))
    assert radii(parts).max() <= 1 / 16
    # A sliver is divided along its length alone.
    assert len(parts) <= (512 if width == 1 else 64)


def test_many_large_faces_are_not_all_divided(monkeypatch):
    monkeypatch.setattr(occluders, "_MAX_PARTS", 500)
    faces = np.random.default_rng(0).uniform(-1, 1, (100, 3, 3))
    parts = _in_parts(faces)
    assert 100 <= len(parts) <= 500
    np.testing.assert_allclose(area(parts), area(faces))
