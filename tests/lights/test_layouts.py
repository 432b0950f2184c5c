"""Cube maps in strips and crosses: each face in its place, and light that is that of the sphere they show."""

import numpy as np
import pytest

from jaxrelight.basis import cubemap, latlong
from jaxrelight.errors import InputError
from jaxrelight.lights.environment import environment, load_environment
from jaxrelight.lights.layouts import faces_of


def smooth(direction: np.ndarray) -> np.ndarray:
    """A radiance that differs in all directions, without edges."""
    x, y, z = np.moveaxis(direction, -1, 0)
    return np.stack([2 + x + 0.5 * y * z, 2 + y - 0.5 * x, 2 + z + 0.3 * x * y], axis=-1).astype(np.float32)


def faces(n: int) -> np.ndarray:
    return smooth(cubemap.directions(n)).reshape(6, n, n, 3)


def pictures(cube: np.ndarray) -> dict[str, np.ndarray]:
    """All layouts of six faces; what no face covers is black."""
    px, nx, py, ny, pz, nz = cube
    none = np.zeros_like(px)
    across = [[none, py, none, none], [nx, pz, px, nz], [none, ny, none, none]]
    down = [[none, py, none], [nx, pz, px], [none, ny, none], [none, np.rot90(nz, 2), none]]
    return {
        "row": np.concatenate(cube, axis=1),
        "column": np.concatenate(cube, axis=0),
        "across": _tiled(across),
        "down": _tiled(down),
    }


def _tiled(cells) -> np.ndarray:
    return np.concatenate([np.concatenate(row, axis=1) for row in cells], axis=0)


LAYOUT = {"row": "strip", "column": "strip", "across": "cross", "down": "cross"}


@pytest.mark.parametrize("kind", LAYOUT)
@pytest.mark.parametrize("n", [1, 2, 5, 16])
def test_faces_are_found_by_sides_or_by_name(kind, n):
    cube = faces(n)
    for layout in ("auto", LAYOUT[kind]):
        unfolded, note = faces_of(pictures(cube)[kind], layout, "sky")
        assert unfolded is not None
        np.testing.assert_array_equal(unfolded, cube)
        assert (LAYOUT[kind] in note) == (layout == "auto")
    assert faces_of(pictures(cube)[kind], "latlong", "sky") == (None, "")


@pytest.mark.parametrize("kind", ["across", "down"])
def test_faces_that_touch_in_a_cross_touch_on_the_cube(kind):
    """Neighbouring pixels of two faces of a smooth radiance differ by no more than neighbours of one face do."""
    n = 32
    picture = pictures(faces(n))[kind]
    covered = picture.max(axis=-1) > 0
    for axis in (0, 1):
        both = covered & np.roll(covered, -1, axis=axis)
        step = np.abs(np.roll(picture, -1, axis=axis) - picture).max(axis=-1)
        edge = np.zeros_like(both)
        edge[(slice(None),) * axis + (slice(n - 1, -1, n),)] = True
        assert (both & edge).sum() >= 2 * n
        assert step[both & edge].max() <= 1.1 * step[both & ~edge].max()


@pytest.mark.parametrize("kind", LAYOUT)
def test_light_is_that_of_the_sphere_shown(kind):
    """Each pixel of the lat-long map against the radiance in its direction."""
    made = environment(pictures(faces(32))[kind])
    height, width = made.pixels.shape[:2]
    u, v = np.meshgrid((np.arange(width) + 0.5) / width, (np.arange(height) + 0.5) / height)
    error = made.pixels - smooth(latlong.directions(u, v))
    assert np.abs(error).max() < 0.1  # texels of 2.8°, and the steepest slope is 1.6 per radian
    assert np.abs(error).mean() < 0.02
    assert np.abs(error.mean()) < 1e-4


@pytest.mark.parametrize("n", [1, 2, 3, 7, 16, 64])
def test_a_constant_cube_stays_constant_and_a_hot_texel_keeps_its_energy(n):
    np.testing.assert_allclose(environment(np.full((n, 6 * n, 3), 0.7)).pixels, np.float32(0.7), rtol=1e-6)
    for face, row, column in ((0, 0, 0), (2, n // 2, n // 2), (5, n - 1, 0)):
        cube = np.zeros((6, n, n, 3), np.float32)
        cube[face, row, column] = [1e5, 1, 0]
        pixels = environment(np.concatenate(cube, axis=1)).pixels
        energy = np.einsum("hwc,h->c", pixels.astype(float), latlong.solid_angles(*pixels.shape[:2]))
        area = cubemap.solid_angles(n).reshape(6, n, n)[face, row, column]
        np.testing.assert_allclose(energy, area * cube[face, row, column], rtol=1e-5)


def test_a_picture_of_four_to_three_is_a_cross_only_if_its_corners_are_empty():
    picture = pictures(faces(4))["across"]
    picture[0, 0] = 1
    made = environment(picture, name="sky.png")
    np.testing.assert_array_equal(made.pixels, picture)
    assert "16 × 12 pixels are not 2:1" in made.notes[0]
    assert environment(picture, layout="cross").pixels.shape == (32, 64, 3)
    picture[:] += 1
    assert environment(pictures(faces(4))["down"] + np.float32(1)).pixels.shape == (32, 64, 3)  # of any one colour


@pytest.mark.parametrize(
    ("shape", "layout", "words"),
    [
        ((4, 8), "strip", "6:1 or 1:6"),
        ((4, 24), "cross", "4:3 or 3:4"),
        ((0, 6), "strip", "shape"),
        ((4, 8), "cube", "use one of auto, latlong, strip, cross, openexr_cube, probe, mirror_ball"),
    ],
)
def test_a_layout_that_does_not_fit_is_refused(shape, layout, words):
    with pytest.raises(InputError, match=words) as caught:
        environment(np.ones((*shape, 3)), layout=layout, name="sky.exr")
    assert "sky.exr" in str(caught.value)


def test_a_strip_from_a_file(tmp_path):
    from jaxrelight.images import write_image

    cube = faces(8)
    write_image(tmp_path / "sky.exr", np.concatenate(cube, axis=1))
    made = load_environment(tmp_path / "sky.exr", layout="strip")
    np.testing.assert_array_equal(made.pixels, latlong.from_cube(cube))
    assert made.notes == ()
