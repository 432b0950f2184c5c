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
# The scene and the sky are made by code. Precomputation runs once; afterwards light is one sparse product, and the
# picture is differentiable in the light. Run it as a script, or open it as a notebook with jupytext.

# %%
import dataclasses
import pathlib
import tempfile

import jax
import jax.numpy as jnp
import numpy as np

import jaxrelight as jr
from jaxrelight.lighting.transport import TransportRelighter
from jaxrelight.precomputation.precompute import precompute
from jaxrelight.scene.demo_scene import demo_scene
from jaxrelight.transport.rebake import exact

scene = demo_scene(detail=0.5, size=120)
folder = pathlib.Path(tempfile.mkdtemp())
made = precompute(scene, jr.Transport("vertices", resolution=16, terms=4, coefficients=96), folder / "store")
print(f"{made.receivers:,} receivers, {made.rays:,} rays, {sum(made.seconds.values()):.1f} s")

# %% [markdown]
# ## Light and view are apart
#
# `light` is paid when the light changes, `shade` when the view does.

# %%
relighter = jr.open_store(made.folder)
view = relighter.view()
sky = scene.environment
turned = dataclasses.replace(sky, rotate_y=40.0)
image = relighter.image(turned, view)
jr.write_image(folder / "turned.png", image)
print("picture", folder / "turned.png", image.shape)

# %% [markdown]
# ## What compression costs
#
# `exact` bakes whole rows from the stored visibility at each use: the reference for the kept coefficients.

# %%
reference = TransportRelighter(exact(relighter.transport)).image(turned, view)
print("96 of 1,536 coefficients against all:", jr.image_error(image, reference))

# %% [markdown]
# ## Where was the sun?
#
# Given the picture alone, turn the sky until its picture is the same. The gradient comes through lat-long rotation,
# resampling, wavelets, the operator and the view.

# %%
pixels = jnp.asarray(sky.pixels)
seen = jnp.asarray(image[..., :3] * view.covered[..., None])


def difference(degrees):
    """Squared difference of the two pictures, relative to the one that was seen."""
    radiance = relighter.shade(relighter.terms(relighter.light_vector(pixels, degrees)), view)
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
