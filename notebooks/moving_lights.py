# ---
# jupyter:
#   jupytext:
#     formats: py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Move a lamp in a room, then ask the picture where it was
#
# The room is made by code. What its surfaces pass on to each other is precomputed once, for one camera; afterwards a
# lamp may stand anywhere, and its light is reflected up to three times before it reaches the surface that is seen. Run
# it as a script, or open it as a notebook with jupytext.

# %%
import dataclasses
import pathlib
import tempfile
import time

import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize

import jaxrelight as jr


def moved(mesh, x, y, z):
    """A mesh at another place."""
    return dataclasses.replace(mesh, vertices=mesh.vertices + np.array([x, y, z]))


def side(width, height, turn, place):
    """One wall: a rectangle that faces +y, turned and put in its place."""
    flat = jr.plane((width, height), 4)
    return dataclasses.replace(flat, vertices=flat.vertices @ turn.T + place, normals=flat.normals @ turn.T)


down = np.diag([1.0, -1, -1])
right = np.array([[0.0, 1, 0], [-1, 0, 0], [0, 0, 1]])  # y → x
front = np.array([[1.0, 0, 0], [0, 0, -1], [0, 1, 0]])  # y → z
parts = [
    jr.Part(side(4, 4, np.eye(3), [0, 0, 0]), "floor"),
    jr.Part(side(4, 4, down, [0, 2.4, 0]), "white"),
    jr.Part(side(2.4, 4, right, [-2, 1.2, 0]), "red"),
    jr.Part(side(2.4, 4, np.diag([-1.0, 1, -1]) @ right, [2, 1.2, 0]), "blue"),
    jr.Part(side(4, 2.4, front, [0, 1.2, -2]), "white"),
    jr.Part(moved(jr.box((0.5, 1.3, 0.5), 4), -0.8, 0.65, -0.9), "white"),
    jr.Part(moved(jr.box((0.7, 0.5, 0.7), 4), 0.9, 0.25, -0.5), "white"),
    jr.Part(moved(jr.sphere(0.35, 12), 0.9, 0.85, -0.5), "gloss"),
]
materials = {
    "floor": jr.lambert([0.45, 0.38, 0.30]),
    "white": jr.lambert([0.72, 0.70, 0.66]),
    "red": jr.lambert([0.60, 0.12, 0.08]),
    "blue": jr.lambert([0.10, 0.20, 0.55]),
    "gloss": jr.phong([0.05, 0.05, 0.05], [0.6, 0.55, 0.45], 60.0),
}
camera = jr.Camera((0, 1.2, 4.2), (0, 1.1, 0), fov_y=38.0, width=240, height=160)
scene = jr.Scene(parts, materials, camera, name="room")
folder = pathlib.Path(tempfile.mkdtemp())
start = time.perf_counter()
relighter = jr.prepare(scene, jr.Indirect(gather_samples=4096, bounces=3), folder / "store")
print(f"precomputed in {time.perf_counter() - start:.1f} s")

# %% [markdown]
# ## Lamps anywhere
#
# `light` casts shadow rays to the points that stand for all surfaces, and adds what these pass on to each other.
# `shade` adds direct light to what the pixels get of it. Without bounces, direct light alone is left.

# %%
view = relighter.view(antialiasing=4)
lamp = jr.point([-1.2, 1.9, 0.2], [3.0, 2.7, 2.2])
behind = jr.point([-1.5, 0.5, -1.5], [3.0, 2.7, 2.2])
upwards = jr.spot([1.4, 0.3, 0.8], [1.6, 2.4, -0.4], [9.0, 8.0, 6.5], 30.0)
direct = relighter.shade(relighter.light(lamp, bounces=0), view)
pictures = [relighter.shade(relighter.light(one), view) for one in (lamp, behind, upwards)]
strip = np.concatenate([image.rgba() for image in (direct, *pictures)], axis=1)
jr.write_image(folder / "moving_lights.png", strip, exposure=0.5)
print("picture", folder / "moving_lights.png", strip.shape)
indirect = 1 - float(direct.radiance.sum() / pictures[0].radiance.sum())
print(f"of the first lamp's picture, {indirect:.0%} is indirect light")

# %% [markdown]
# ## Colours and strengths are a sum
#
# A picture of each light is kept. One that moves is computed; tints, dimmers and switches compute none.

# %%
layers = jr.LightLayers(relighter, [lamp, upwards])
evening = layers.picture([[1.0, 0.7, 0.4], 0.2])
layers.move(1, jr.spot([1.4, 0.3, 0.8], [0.0, 2.4, -1.0], [9.0, 8.0, 6.5], 30.0))
print("mean radiance, tinted", np.asarray(evening.mean(axis=(0, 1))), "moved", np.asarray(layers.picture().mean()))

# %% [markdown]
# ## Where was the lamp?
#
# Given the picture alone, move a lamp until its picture is the same. The gradient comes through all bounces, while
# shadows are traced anew at each step.

# %%
seen = pictures[0].radiance


def difference(place):
    """Squared difference of the two pictures, relative to the one that was seen."""
    found = relighter.shade(relighter.light(dataclasses.replace(lamp, position=place)), view).radiance
    # By root: highlights and what is near the lamp would be all that counts.
    return jnp.sum((jnp.sqrt(found + 1e-4) - jnp.sqrt(seen + 1e-4)) ** 2) / jnp.sum(seen)


slope = jax.value_and_grad(difference)


def both(place):
    """As SciPy asks for it."""
    value, gradient = slope(jnp.asarray(place, jnp.float32))
    return float(value), np.asarray(gradient, float)


found = scipy.optimize.minimize(
    both, [-0.2, 1.2, 0.8], jac=True, method="L-BFGS-B", bounds=[(-1.9, 1.9), (0.1, 2.3), (-1.9, 1.9)]
)
print("found", found.x.round(3), "true", np.asarray(lamp.position), f"remaining difference {found.fun:.1e}")
assert np.linalg.norm(found.x - np.asarray(lamp.position)) < 0.02
