"""Extreme geometry and cameras: sizes, places, tiny and single triangles, views from inside, pictures of any shape."""

import dataclasses

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import Mesh, Part, Scene
from jaxrelight.images import image_error
from tests.extremes.scenes import METHODS, ONE, ball, by, picture_of, plain
from tests.scenes import raised

SKY = jr.environment(np.random.default_rng(0).uniform(0.2, 1, (16, 32, 3)).astype(np.float32))
# A few directions stand for the sky of indirect lighting.
FEW = 0.02


def placed(scene: Scene, size: float, away: float) -> Scene:
    """The scene so many times as large, and so far away."""

    def there(points):
        return np.asarray(points, float) * size + away

    parts = [
        dataclasses.replace(p, mesh=dataclasses.replace(p.mesh, vertices=there(p.mesh.vertices))) for p in scene.parts
    ]
    origin, target = (tuple(there(point)) for point in (scene.camera.origin, scene.camera.target))
    return dataclasses.replace(
        scene, parts=parts, camera=dataclasses.replace(scene.camera, origin=origin, target=target)
    )


def sky_and_lamp(size: float, away: float) -> list:
    """A sky, and a lamp that lights the scene of that size and place as it would near the origin."""
    return [SKY, jr.point(np.array([0.5, 1.5, 0.7]) * size + away, np.array([4.0, 3, 2]) * size**2)]


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize(
    ("size", "away"), [(1e-3, 0.0), (2.0**-10, 0.0), (1e6, 0.0), (2.0**20, 0.0), (1.0, 1e6 + 0.3), (2.0, 2.0**20)]
)
def test_pictures_do_not_depend_on_size_and_place(holds, method, size, away, tmp_path):
    here = picture_of(ball(), method, sky_and_lamp(1, 0), tmp_path / "here")
    there = picture_of(placed(ball(), size, away), method, sky_and_lamp(size, away), tmp_path / "there")
    holds(f"{method}: × {size:g}, {away:g} away", image_error(there, here).untrimmed, 1e-4)


@by()
def test_a_single_triangle_is_seen_and_lit(holds, method, tmp_path):
    corners = np.array([[-3.0, 0, 3], [3, 0, 3], [0, 0, -4]])
    triangle = Mesh(corners, np.array([[0, 1, 2]]), np.tile([0.0, 1, 0], (3, 1)))
    scene = dataclasses.replace(plain(), parts=[Part(triangle, "paper")])
    image = picture_of(scene, method, ONE, tmp_path)
    holds(f"{method}: a single triangle", np.abs(image / 0.5 - 1).max(), FEW if method == "indirect" else 5e-3)


def patch_in_the_air() -> Scene:
    """100,352 triangles of a millionth of the scene's size, all of the picture, over a plain."""
    patch = raised(jr.plane((1e-3, 1e-3), 224), 0.5)
    camera = jr.Camera((0, 2, 1e-4), (0, 0.5, 0), fov_y=0.02, width=16, height=16)
    return dataclasses.replace(plain(camera=camera), parts=[*plain().parts, Part(patch, "paper")])


def slivers() -> Scene:
    """A plain of 100,000 triangles that are 50,000 times as long as wide."""
    x = np.linspace(-4, 4, 50_001)
    vertices = np.concatenate([np.stack([x, 0 * x, np.full_like(x, z)], axis=1) for z in (-4.0, 4.0)])
    i, n = np.arange(len(x) - 1), len(x)
    faces = np.concatenate([np.stack([i, i + n, i + 1], axis=1), np.stack([i + 1, i + n, i + n + 1], axis=1)])
    strip = Mesh(vertices, faces, np.tile([0.0, 1, 0], (len(vertices), 1)))
    return dataclasses.replace(plain(), parts=[Part(strip, "paper")])


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("scene", [patch_in_the_air, slivers])
def test_tiny_triangles_are_a_surface_as_any(holds, method, scene, tmp_path):
    image = picture_of(scene(), method, ONE, tmp_path)
    row = f"{method}: 100,000 {'tiny triangles' if scene is patch_in_the_air else 'slivers'}"
    holds(row, np.abs(image / 0.5 - 1).max(), FEW if method == "indirect" else 5e-3)


INSIDE = jr.Camera((0.1, 0.05, 0.0), (1, 0.2, 0.3), fov_y=60, width=24, height=16)


@pytest.mark.parametrize("method", METHODS)
def test_from_inside_of_a_one_sided_ball_all_is_black(holds, method, tmp_path):
    scene = Scene([Part(jr.sphere(1.0, 8), "paper")], {"paper": jr.lambert(0.5)}, INSIDE)
    image = picture_of(scene, method, [ONE, jr.point([0, 0, 0], 1.0)], tmp_path)
    holds(f"{method}: from inside of a one-sided ball", np.abs(image).max(), 0.0)


@pytest.mark.parametrize("method", METHODS)
def test_a_lamp_in_a_two_sided_ball_lights_it_from_inside(holds, method, tmp_path):
    """L = ρ I/πr², and that times ρ for a bounce; nothing of the sky comes in."""
    shell = dataclasses.replace(jr.sphere(1.0, 24), two_sided=True)
    scene = Scene([Part(shell, "paper")], {"paper": jr.lambert(0.5)}, INSIDE)
    image = picture_of(scene, method, [ONE, jr.point([0, 0, 0], 1.0)], tmp_path)
    wanted = 0.5 / np.pi * (1.5 if method == "indirect" else 1)
    holds(f"{method}: from inside of a two-sided ball", np.abs(image / wanted - 1).max(), 0.02)


@by()
@pytest.mark.parametrize("shape", [(1, 1), (2, 500)], ids=str)
def test_pictures_of_any_shape(holds, method, shape, tmp_path):
    _open_plain(holds, method, shape, 0.2, tmp_path)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("shape", [(10, 4000), (4000, 10)], ids=str)
def test_pictures_of_thousands_of_pixels_by_ten(holds, method, shape, tmp_path):
    _open_plain(holds, method, shape, 0.05 if shape[0] == 10 else 20.0, tmp_path)


def _open_plain(holds, method: str, shape: tuple[int, int], fov_y: float, folder):
    height, width = shape
    image = picture_of(plain(), method, ONE, folder, height=height, width=width, fov_y=fov_y)
    assert image.shape == (height, width, 3)
    assert image.all()
    limit = FEW if method == "indirect" else 5e-3
    holds(f"{method}: a picture of {width} × {height}", np.abs(image / 0.5 - 1).max(), limit)


@by("vertices", "prefiltered", "adaptive")
@pytest.mark.parametrize("fov_y", [0.01, 179.0])
def test_fields_of_view(holds, method, fov_y, tmp_path):
    image = picture_of(plain(), method, ONE, tmp_path, fov_y=fov_y, height=17, width=17)
    shown = image[image.sum(axis=2) > 0]
    assert len(shown)
    holds(f"{method}: a field of view of {fov_y:g}°", np.abs(shown / 0.5 - 1).max(), 5e-3)
