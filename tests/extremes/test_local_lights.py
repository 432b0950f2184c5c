"""Extreme local lights: of no size and of any, without soft edges, far from the origin; and their gradients."""

import re
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pytest

import jaxrelight as jr
from jaxrelight import InputError
from jaxrelight.images import image_error
from tests.extremes.scenes import METHODS, ball, picture_of, plain

# Straight above the plain, of which a camera beside it sees a square of 0.35 around the origin.
ABOVE, DOWN = (0.0, 2.0, 0.0), (0.0, 0.0, 0.0)


def seen_places() -> np.ndarray:
    """Where the pixels' rays meet the plain, [h, w, 3]."""
    camera = plain().camera
    directions = camera.directions()
    origin = np.asarray(camera.origin)
    return origin - directions * (origin[1] / directions[..., 1:2])


def point_radiance(intensity: float = 1.0) -> np.ndarray:
    """What the plain reflects of a point light at `ABOVE`: albedo/π I cosθ/r², and its distance, [h, w]."""
    distance = np.linalg.norm(seen_places() - ABOVE, axis=2)
    return 0.5 / np.pi * intensity * 2 / distance**3


def limit_of(method: str) -> float:
    """Pictures of indirect lighting are means of four samples a pixel."""
    return 1e-3 if method == "indirect" else 1e-4


def test_an_area_light_of_no_size_is_refused():
    with pytest.raises(InputError, match="lie along each other, or are 0"):
        jr.area(ABOVE, [0, 0, 0], [0, 0, 1e-10], 1.0)


@pytest.mark.parametrize("method", METHODS)
def test_a_tiny_area_light_is_a_point_with_a_cosine(holds, method, tmp_path):
    """Of its power: radiance times area is 1 along its normal."""
    tiny = jr.area(ABOVE, [1e-10, 0, 0], [0, 0, 1e-10], 1e20)
    image = picture_of(plain(), method, tiny, tmp_path)
    cosine = 2 / np.linalg.norm(seen_places() - ABOVE, axis=2)
    wanted = (point_radiance() * cosine)[..., None]
    holds(f"{method}: an area light of 1e-10", np.abs(image / wanted - 1).max(), limit_of(method))


@pytest.mark.parametrize("method", METHODS)
def test_a_huge_area_light_is_a_half_space(holds, method, tmp_path):
    """E = π L everywhere below."""
    huge = jr.area(ABOVE, [1e10, 0, 0], [0, 0, 1e10], 1.0)
    image = picture_of(plain(), method, huge, tmp_path)
    holds(f"{method}: an area light of 1e10", np.abs(image / 0.5 - 1).max(), 1e-4)


def lit_within(holds, row: str, image: np.ndarray, within: np.ndarray, method: str):
    """A point light within a shape, and nothing beside it; pixels that the shape's edge crosses may be between."""
    wanted = point_radiance()[..., None]
    # A pixel's sides are 0.044.
    inside, outside = within < 1 - 0.15, within > 1 + 0.15
    assert inside.any()
    assert outside.any()
    off = np.abs(image / wanted - np.where(inside, 1, 0)[..., None])[inside | outside]
    holds(f"{method}: {row}", off.max(), limit_of(method))


@pytest.mark.parametrize("method", METHODS)
def test_a_spot_without_a_penumbra(holds, method, tmp_path):
    image = picture_of(plain(), method, jr.spot(ABOVE, DOWN, 1.0, cutoff=6, beam=6), tmp_path)
    radius = np.hypot(*np.moveaxis(seen_places()[..., ::2], -1, 0))
    lit_within(holds, "a spot whose beam is its cutoff", image, radius / (2 * np.tan(np.radians(6))), method)


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("roundness", [0.0, 1.0])
def test_a_shaped_light_without_soft_edges(holds, method, roundness, tmp_path):
    """At roundness 0 a rectangle, at 1 an ellipse."""
    lamp = jr.shaped(ABOVE, DOWN, 1.0, (8.0, 6.0), roundness=roundness, up=(0, 0, -1))
    image = picture_of(plain(), method, lamp, tmp_path)
    across, along = np.abs(np.moveaxis(seen_places()[..., ::2], -1, 0)) / 2
    sides = across / np.tan(np.radians(8)), along / np.tan(np.radians(6))
    within = np.maximum(*sides) if roundness == 0 else np.hypot(*sides)
    lit_within(holds, f"a shaped light of roundness {roundness:g}", image, within, method)


LAMPS = {
    "an area light of 1e-10": lambda: jr.area(ABOVE, [1e-10, 0, 0], [0, 0, 1e-10], 1e20),
    "an area light of 1e10": lambda: jr.area(ABOVE, [1e10, 0, 0], [0, 0, 1e10], 1.0),
    "a spot whose beam is its cutoff": lambda: jr.spot(ABOVE, DOWN, 1.0, cutoff=6, beam=6),
    "a shaped light of roundness 0": lambda: jr.shaped(ABOVE, DOWN, 1.0, (8.0, 6.0), roundness=0.0, up=(0, 0, -1)),
}


@pytest.mark.parametrize("method", METHODS)
@pytest.mark.parametrize("name", LAMPS)
def test_gradients_in_extreme_lamps_are_finite(method, name, tmp_path):
    """In all of their numbers but distances that are infinite."""
    relighter = jr.prepare(plain(), METHODS[method], tmp_path if METHODS[method].is_stored else None)
    view, lamp = relighter.view(), LAMPS[name]()
    traced = relighter.trace(relighter.light(lamp), view)

    def brightness(lamp):
        return jnp.mean(relighter.shade(relighter.light(lamp), view, traced).radiance)

    gradient = jax.grad(brightness)(lamp)
    assert all(np.isfinite(slope).all() for slope in jax.tree.leaves(gradient))
    assert any(np.any(slope) for slope in jax.tree.leaves(gradient))


FAR = 1e6 + 0.3
SCENE = """
[camera]
origin = [{0.4}, {1.0}, {2.0}]
target = [{0.0}, {0.2}, {0.0}]
fov_y = 45
width = 24
height = 16
[material.paper]
type = "lambert"
albedo = 0.5
[[mesh]]
file = "ball.obj"
material = "paper"
[[light]]
type = "point"
position = [{0.5}, {1.5}, {0.7}]
intensity = 2
[[light]]
type = "spot"
position = [{-0.5}, {1.5}, {0.7}]
target = [{0.0}, {0.3}, {0.0}]
intensity = 3
cutoff = 20
[[light]]
type = "shaped"
position = [{-0.5}, {1.2}, {-0.4}]
target = [{0.0}, {0.0}, {0.3}]
intensity = 3
inner = 20
outer = 30
[[light]]
type = "area"
centre = [{0.0}, {1.4}, {0.0}]
u = [0.3, 0, 0]
v = [0, 0, 0.3]
radiance = 1
samples = 2
"""


@pytest.mark.parametrize("method", METHODS)
def test_lights_of_scene_files_and_stores_far_away(holds, method, tmp_path):
    """Meshes, cameras and lights of files that are 1e6 from the origin, with lights as a store has kept them."""
    images: list[Any] = []
    for name, away in (("here", 0.0), ("there", FAR)):
        folder = tmp_path / name
        folder.mkdir()
        mesh = ball().parts[1].mesh
        lines = [*(f"v {x!r} {y!r} {z!r}" for x, y, z in (mesh.vertices + away).tolist())]
        lines += [f"f {a} {b} {c}" for a, b, c in mesh.faces + 1]
        (folder / "ball.obj").write_text("\n".join(lines))
        text = re.sub(r"\{(.*?)\}", lambda match, away=away: repr(float(match[1]) + away), SCENE)
        (folder / "scene.toml").write_text(text)
        scene, dials = jr.load_scene(folder / "scene.toml"), METHODS[method]
        relighter = jr.prepare(scene, dials, folder / "store" if dials.is_stored else None)
        relighter = jr.open_store(folder / "store") if dials.is_stored else relighter
        images.append(relighter.picture(background=False)[..., :3])
    holds(f"{method}: a file 1e6 away", image_error(images[1], images[0]).untrimmed, 1e-4)
