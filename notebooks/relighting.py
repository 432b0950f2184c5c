# ---
# jupyter:
#   jupytext:
#     formats: py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Relight a scene, then ask the picture where the sun was
#
# The scene and the sky are made by code. Transport is precomputed once; afterwards a change of light is one product
# with a compressed operator, and the picture is differentiable in the light. Run it as a script, or open it as a
# notebook with jupytext.

# %%
import pathlib
import tempfile
import time

import jax
import jax.numpy as jnp
import numpy as np

import jaxrelight as jr
from jaxrelight.scene.demo_scene import demo_scene

scene = demo_scene(detail=0.5, size=120)
folder = pathlib.Path(tempfile.mkdtemp())
start = time.perf_counter()
method = jr.Transport("vertices", resolution=16, terms=4, coefficients=96)
relighter = jr.prepare(scene, method, folder / "store")
print(f"{relighter.transport.receivers.count:,} receivers, {time.perf_counter() - start:.1f} s")

# %% [markdown]
# ## Light and view are apart
#
# `view` is paid when the camera moves, `light` when the light changes, and `shade` for both. The store can be opened
# again at any time.

# %%
relighter = jr.open_store(folder / "store")
view = relighter.view(antialiasing=4)
sky = scene.lights.environment
turned = sky.with_(rotate_y=40.0)
lit = relighter.light(turned)
image = relighter.shade(lit, view)
picture = image.rgba(relighter.background(lit, view))
jr.write_image(folder / "turned.png", picture)
print("picture", folder / "turned.png", picture.shape)

# %% [markdown]
# ## What compression costs
#
# `exact` bakes whole rows from the stored visibility at each use: the reference for the kept coefficients.

# %%
reference = relighter.exact().picture(turned)
print("96 of 1,536 coefficients against all:", jr.image_error(picture, reference))

# %% [markdown]
# ## Where was the sun?
#
# Given the picture alone, turn the sky until its picture is the same. The gradient comes through lat-long rotation,
# resampling, wavelets, the operator and the view.

# %%
seen = image.radiance


def difference(degrees):
    """Squared difference of the two pictures, relative to the one that was seen."""
    radiance = relighter.shade(relighter.light(sky.with_(rotate_y=degrees)), view).radiance
    return jnp.sum((radiance - seen) ** 2) / jnp.sum(seen**2)


slope = jax.value_and_grad(difference)
degrees, step, direction = 20.0, 8.0, 0.0
for _ in range(25):
    value, gradient = slope(degrees)
    # Steps by sign, halved whenever the slope turns: one number needs no more.
    turned_back = direction * gradient > 0
    direction = -np.sign(float(gradient))
    step = step / 2 if turned_back else step
    degrees += step * direction
print(f"found {degrees:.2f}°, true 40°; remaining difference {float(value):.2e}")
assert abs(degrees - 40) < 0.5
