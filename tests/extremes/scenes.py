"""Small scenes of the extremes, and pictures of them by every method."""

import dataclasses
import pathlib
from typing import Any

import numpy as np
import pytest
from jaxtyping import Float

import jaxrelight as jr
from jaxrelight import Scene
from tests.scenes import ball_over_floor

METHODS: dict[str, jr.Transport | jr.Indirect | jr.Prefiltered | jr.Adaptive] = {
    "pixels": jr.Transport("pixels", resolution=16),
    "vertices": jr.Transport("vertices", receiver_tolerance=0, resolution=16),
    "indirect": jr.Indirect(gather_samples=256, bounces=1, sky_samples=256),
    "prefiltered": jr.Prefiltered(map_rows=64, receiver_tolerance=0),
    "adaptive": jr.Adaptive(samples=64),
}
ONE = jr.environment(np.ones((16, 32, 3), np.float32))
CAMERA = jr.Camera((0.4, 1.0, 2.0), (0, 0.2, 0), fov_y=45, width=24, height=16)
PAINT = jr.phong([0.4, 0.3, 0.2], 0.3, 12.0)


def by(*methods: str) -> pytest.MarkDecorator:
    """Rows by each of these `METHODS`, all without any; the quick suite has those by one of them."""
    of = [pytest.param(name, marks=pytest.mark.quick) if name == "vertices" else name for name in methods or METHODS]
    return pytest.mark.parametrize("method", of)


def ball(gloss: Any = PAINT, camera: jr.Camera = CAMERA) -> Scene:
    """A ball over a floor."""
    return ball_over_floor(gloss, camera, quads=(6, 8), height=0.36)


def plain(paper: Any = None, camera: jr.Camera | None = None) -> Scene:
    """A plain of albedo 0.5, seen from above, with nothing on it."""
    above = jr.Camera((0, 2, 0.01), (0, 0, 0), fov_y=20, width=16, height=16)
    return Scene([jr.Part(jr.plane((8, 8), 8), "paper")], {"paper": paper or jr.lambert(0.5)}, camera or above)


def picture_of(
    scene: Scene, method: str, lights: Any, folder: pathlib.Path, **camera: Any
) -> Float[np.ndarray, "h w 3"]:
    """Radiance of surfaces by one of `METHODS`."""
    scene = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, **camera))
    dials = METHODS[method]
    store = folder / method if dials.is_stored else None
    return jr.prepare(scene, dials, store).picture(lights, background=False)[..., :3]
