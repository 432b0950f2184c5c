"""The cube map against OpenGL's table and exact solid angles."""

from typing import Any

import numpy as np
import pytest

from jaxrelight.basis import cubemap

# OpenGL 4.6 table 8.19: the major axis, and the coordinates that s and t are made of, as signed axis numbers 1, 2, 3.
FACES = {0: (1, -3, -2), 1: (-1, 3, -2), 2: (2, 1, 3), 3: (-2, 1, -3), 4: (3, 1, -2), 5: (-3, -1, -2)}


def signed(vectors: np.ndarray, axis: int) -> np.ndarray:
    return np.sign(axis) * vectors[..., abs(axis) - 1]


def on_face(vectors: np.ndarray, face: int) -> tuple[np.ndarray, np.ndarray]:
    """s and t in −1 … 1 as OpenGL defines them."""
    major, s, t = FACES[face]
    length = signed(vectors, major)
    return signed(vectors, s) / length, signed(vectors, t) / length


def test_solid_angles_are_those_of_the_texels():
    """Midpoint rule for dω = ds dt / (1 + s² + t²)^{3/2} within each texel."""
    n, fine = 4, 64
    centre = (np.arange(n * fine) + 0.5) * 2 / (n * fine) - 1
    density = (1 + centre**2 + centre[:, None] ** 2) ** -1.5 * (2 / (n * fine)) ** 2
    face = density.reshape(n, fine, n, fine).sum(axis=(1, 3))
    np.testing.assert_allclose(cubemap.solid_angles(n).reshape(6, n, n), np.broadcast_to(face, (6, n, n)), rtol=1e-4)


@pytest.mark.parametrize("face", range(6))
def test_faces_are_oriented_as_opengl_does(face):
    n = 4
    directions = cubemap.directions(n).reshape(6, n, n, 3)[face]
    s, t = on_face(directions, face)
    centre = (np.arange(n) + 0.5) * 2 / n - 1
    np.testing.assert_allclose(s, np.broadcast_to(centre, (n, n)), atol=1e-14)
    np.testing.assert_allclose(t, np.broadcast_to(centre[:, None], (n, n)), atol=1e-14)
    assert (signed(directions, FACES[face][0]) > 0).all()


def test_first_texels_spelled_out():
    first = cubemap.directions(2).reshape(6, 4, 3)[:, 0] * np.sqrt(1.5)
    expected = [[1, 0.5, 0.5], [-1, 0.5, -0.5], [-0.5, 1, -0.5], [-0.5, -1, 0.5], [-0.5, 0.5, 1], [0.5, 0.5, -1]]
    np.testing.assert_allclose(first, expected, atol=1e-14)


@pytest.mark.parametrize("resolution", [1, 2, 5, 16, 64])
def test_directions_are_unit_and_found_again(resolution):
    directions = cubemap.directions(resolution)
    np.testing.assert_allclose(np.linalg.norm(directions, axis=-1), 1, atol=1e-14)
    np.testing.assert_array_equal(cubemap.texel_of(directions, resolution), np.arange(6 * resolution**2))
    np.testing.assert_array_equal(cubemap.texel_of(1e-3 * directions, resolution), np.arange(6 * resolution**2))


@pytest.mark.parametrize("resolution", [1, 3, 4, 16])
def test_every_direction_lies_in_its_texel(resolution):
    directions = np.random.default_rng(0).normal(size=(5, 400, 3))
    texel = cubemap.texel_of(directions, resolution)
    assert texel.shape == (5, 400)
    face, row, column = np.unravel_index(texel, (6, resolution, resolution))
    for number in range(6):
        mine = face == number
        s, t = on_face(directions[mine], number)
        assert np.abs(s).max() <= 1
        assert np.abs(t).max() <= 1
        assert np.abs(s - ((column[mine] + 0.5) * 2 / resolution - 1)).max() <= 1 / resolution + 1e-12
        assert np.abs(t - ((row[mine] + 0.5) * 2 / resolution - 1)).max() <= 1 / resolution + 1e-12


def test_axes_and_diagonals_have_a_texel():
    corners = np.array(
        [[x, y, z] for x in (-1, 0, 1) for y in (-1, 0, 1) for z in (-1, 0, 1) if (x, y, z) != (0, 0, 0)]
    )
    texel = cubemap.texel_of(corners.astype(float), 4)
    assert ((texel >= 0) & (texel < 96)).all()
    axes = np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0], [0, 0, 1], [0, 0, -1]], float)
    np.testing.assert_array_equal(cubemap.texel_of(axes, 1), np.arange(6))


def test_cached_tables_cannot_be_changed():
    for table in (cubemap.directions(4), cubemap.solid_angles(4)):
        with pytest.raises(ValueError, match="read-only"):
            table[0] = 1


def test_texels_are_their_own_basis():
    texels: Any = np.arange(96.0)
    basis = cubemap.Texels(4)
    assert basis.encode(texels) is texels
    assert basis.decode(texels) is texels
