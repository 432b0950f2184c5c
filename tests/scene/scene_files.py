"""Scene files that tests write."""

import pathlib

import jax.numpy as jnp
import numpy as np

# As little as a scene can have.
SMALL = """
[camera]
origin = [0, 1, 3]
target = [0, 0, 0]
[material.paper]
type = "lambert"
albedo = 0.5
[[mesh]]
primitive = "plane"
resolution = 2
material = "paper"
"""


def write_scene(folder: pathlib.Path, text: str) -> pathlib.Path:
    path = folder / "scene.toml"
    path.write_text(text, encoding="utf-8")
    return path


def values_of(brdf) -> np.ndarray:
    """A BRDF at twenty pairs of directions."""
    directions = np.random.default_rng(1).normal(size=(2, 20, 3))
    directions[..., 2] = np.abs(directions[..., 2])
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    pairs = zip(*jnp.asarray(directions, jnp.float32), strict=True)
    return np.stack([np.asarray(brdf.evaluate(omega_i, omega_o)) for omega_i, omega_o in pairs])
