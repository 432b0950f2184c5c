"""Extreme geometry and cameras: sizes, places, single triangles, pictures of any shape."""

import dataclasses

import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import Part, Scene
from jaxrelight.geometry.mesh import Mesh
from jaxrelight.images import image_error
from tests.extremes.scenes import METHODS, ball, picture_of, plain

SKY = jr.environment(np.random.default_rng(0).uniform(0.2, 1, (16, 32, 3)).astype(np.float32))


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


@pytest.mark.parametrize("method", ["vertices", "prefiltered"])
@pytest.mark.parametrize(
    ("size", "away"), [(2.0**-10, 0.0), (2.0**20, 0.0), (2.0, 2.0**20)], ids=["small", "large", "away"]
)
def test_pictures_do_not_depend_on_size_and_place(holds, method, size, away, tmp_path):
    here = picture_of(ball(), method, SKY, tmp_path / "here")
    there = picture_of(placed(ball(), size, away), method, SKY, tmp_path / "there")
    holds(f"{method}: × {size:g}, {away:g} away", image_error(there, here).untrimmed, 1e-4 if not away else 1e-3)


@pytest.mark.parametrize("method", METHODS)
def test_a_single_triangle_is_seen_and_lit(holds, method, tmp_path):
    corners = np.array([[-3.0, 0, 3], [3, 0, 3], [0, 0, -4]])
    triangle = Mesh(corners, np.array([[0, 1, 2]]), np.tile([0.0, 1, 0], (3, 1)))
    scene = dataclasses.replace(plain(), parts=[Part(triangle, "paper")])
    image = picture_of(scene, method, jr.environment(np.ones((16, 32, 3), np.float32)), tmp_path)
    holds(f"{method}: a single triangle", np.abs(image / 0.5 - 1).max(), 0.02 if method == "indirect" else 5e-3)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("shape", [(1, 1), (2, 500)], ids=str)
def test_pictures_of_any_shape(holds, method, shape, tmp_path):
    height, width = shape
    image = picture_of(
        plain(),
        method,
        jr.environment(np.ones((16, 32, 3), np.float32)),
        tmp_path,
        height=height,
        width=width,
        fov_y=0.2,
    )
    assert image.shape == (*shape, 3)
    shown = image[image.sum(axis=2) > 0]
    holds(
        f"{method}: a picture of {width} × {height}",
        np.abs(shown / 0.5 - 1).max(),
        0.02 if method == "indirect" else 5e-3,
    )


@pytest.mark.parametrize("method", ["vertices", "prefiltered", "adaptive"])
@pytest.mark.parametrize("fov_y", [0.01, 179.0])
def test_fields_of_view(holds, method, fov_y, tmp_path):
    image = picture_of(
        plain(), method, jr.environment(np.ones((16, 32, 3), np.float32)), tmp_path, fov_y=fov_y, height=17, width=17
    )
    shown = image[image.sum(axis=2) > 0]
    assert len(shown)
    holds(f"{method}: a field of view of {fov_y:g}°", np.abs(shown / 0.5 - 1).max(), 5e-3)
