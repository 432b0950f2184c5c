# ---
# jupyter:
#   jupytext:
#     formats: py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Waves under a sky, with nothing precomputed
#
# A glossy sheet of water swells from frame to frame, and a ball swims on it. Transport would have to be computed anew
# for every frame; shading by predicted bandwidth asks only what this frame needs: which pixels, and how many samples
# of the sky in each. Run it as a script, or open it as a notebook with jupytext.

# %%
import dataclasses
import pathlib
import tempfile
import time

import jax
import numpy as np

import jaxrelight as jr
from jaxrelight.images.false_colour import false_colour

folder = pathlib.Path(tempfile.mkdtemp())
camera = jr.Camera((0, 1.0, 3.2), (0, 0.05, 0), fov_y=36.0, width=320, height=200)
materials = {"water": jr.phong([0.01, 0.03, 0.04], 0.45, 400.0), "ball": jr.phong([0.5, 0.12, 0.05], 0.15, 60.0)}


WAVES = ((3.1, 1.2, 2.0, 0.05), (-1.7, 4.3, 2.6, 0.03), (6.0, -2.2, 3.7, 0.015))


def height(x, z, t):
    """Three waves that travel."""
    return sum(a * np.sin(p * x + q * z - w * t) for p, q, w, a in WAVES)


def displaced(t, steps=160):
    """A grid of the waves' heights, and their normals."""
    flat = jr.plane((5, 5), steps)
    x, _, z = flat.vertices.T
    slopes = [sum(a * wave[k] * np.cos(wave[0] * x + wave[1] * z - wave[2] * t) for *wave, a in WAVES) for k in (0, 1)]
    normals = np.stack([-slopes[0], np.ones_like(x), -slopes[1]], axis=1)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return dataclasses.replace(flat, vertices=np.stack([x, height(x, z, t), z], axis=1), normals=normals)


def scene_at(t):
    """The sheet and the ball at a time."""
    ball = jr.sphere(0.28, 24)
    place = np.array([0.1, 0.15 + height(0.1, 0.3, t), 0.3])
    ball = dataclasses.replace(ball, vertices=ball.vertices + place)
    return jr.Scene([jr.Part(displaced(t), "water"), jr.Part(ball, "ball")], materials, camera, name="waves")


# %% [markdown]
# ## A sky
#
# Blue above, bright at the horizon, a row of clouds, and a sun: that one is split off and lit by shadow rays.

# %%
v, u = (np.indices((256, 512)) + 0.5) / np.array([[[256]], [[512]]])
blue = np.array([0.25, 0.45, 0.9]) * (0.4 + 0.6 * v[..., None]) + 0.5 * np.exp(-((v[..., None] - 0.5) ** 2) / 0.003)
cloud = np.clip(np.sin(40 * u + 3 * np.sin(17 * v)) * np.sin(30 * v) - 0.3, 0, 1)[..., None]
pixels = np.where(v[..., None] < 0.5, blue + 1.6 * cloud, 0.06)
pixels[70:72, 200:202] = 4e3
sky = jr.environment(pixels.astype(np.float32))

# %% [markdown]
# ## Frame after frame
#
# `prepare` has nothing to precompute: it is called for every frame. `trace` plans where to shade and by how many
# samples, and casts their shadow rays; `shade` lights them. What is compiled for the first frame serves all others.

# %%
frames, maps = [], []
for number in range(6):
    start = time.perf_counter()
    relighter = jr.prepare(scene_at(0.35 * number), jr.Adaptive(tolerance=0.015))
    view, lit = relighter.view(), relighter.light(sky)
    viewed = time.perf_counter()
    traced = relighter.trace(lit, view)
    planned = time.perf_counter()
    frames.append(np.asarray(jax.block_until_ready(relighter.shade(lit, view, traced).radiance)))
    done = time.perf_counter()
    plan, covered = traced.plan, np.asarray(view.surfaces.covered)
    maps.append(false_colour(plan.maps()["samples"], covered, octaves=True)[0][..., :3])
    print(
        f"frame {number}: {plan.samples / covered.sum():.0f} samples a pixel, "
        f"{plan.shaded / covered.sum():.0%} shaded; "
        f"view {viewed - start:.2f} s, trace {planned - viewed:.2f} s, shade {done - planned:.2f} s"
    )

# %% [markdown]
# Above the frames, below them the samples that each pixel got.

# %%
rows = [np.concatenate(row[::2], axis=1) for row in (frames, maps)]
strip = np.concatenate(rows).astype(np.float32)
jr.write_image(folder / "moving_surfaces.png", strip)
print("picture", folder / "moving_surfaces.png", strip.shape)

# %% [markdown]
# Against 512 samples in every pixel, the last frame. The sun, which shadow rays light in every pixel, is the same in
# both.

# %%
sun = frames[-1] - relighter.shade_plan(lit, view, plan)
even = np.asarray(relighter.shade_uniform(lit, view, 512) + sun)
wanted, found = (np.clip(x[covered], 0, 1) ** (1 / 2.2) for x in (even, frames[-1]))
error = np.sqrt(np.mean((wanted - found) ** 2))
print(f"error of displayed values {error:.4f}")
assert error < 0.03
