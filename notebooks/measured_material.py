# ---
# jupyter:
#   jupytext:
#     formats: py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Fit a measured material, and look at it from anywhere
#
# A table of measurements has no highlights that a vertex could keep. Lafortune lobes are fitted to it once; from then
# on each lobe is filtered light times filtered visibility, as sharp as the lobe from any view. Beside it stands the
# table itself, exactly, which needs its rays anew for each view.
#
# Give it a file of your own: `MEASURED_BRDF=paint.bsdf python notebooks/measured_material.py`, a MERL `.binary`, an RGL
# `_rgb.bsdf` or a Cornell `.brdf`. Without one, the material is an Ashikhmin–Shirley BRDF, a formula that is no sum of
# lobes either. `SHORT=1` makes small pictures of few rays.

# %%
import dataclasses
import os
import pathlib
import tempfile
import time

import jax
import jax.numpy as jnp
import numpy as np

import fitting
import jaxrelight as jr
from jaxrelight.scene.demo_scene import demo_scene

short = bool(os.environ.get("SHORT"))
file = os.environ.get("MEASURED_BRDF")
brdf = jr.load_brdf(file).brdf if file else jr.ashikhmin_shirley([0.25, 0.05, 0.03], [0.08, 0.08, 0.08], 80.0, 80.0)

size, resolution = (48, 16) if short else (192, 64)
scene = demo_scene(detail=0.5, size=size)
(glossy,) = {part.material for part in scene.parts if part.name == "knot"}
scene = dataclasses.replace(scene, materials={**scene.materials, glossy: brdf})
sky = scene.lights.environment
folder = pathlib.Path(tempfile.mkdtemp())

# %% [markdown]
# ## The fit
#
# Optimistix fits three lobes, and says how far they are from the table. The scene that comes back holds them in the
# table's place; a fit is kept, so that the next time it costs nothing.

# %%
start = time.perf_counter()
fitted, accounts = fitting.with_lobes(scene)
print(f"{time.perf_counter() - start:.1f} s:", *accounts)
lobes = fitted.materials[glossy]
print("exponents", np.asarray(lobes.exponent).round(1).tolist())

# %% [markdown]
# ## Any view, any light
#
# Vertices are precomputed once. A view traces its own rays alone, and a change of light filters the sky.

# %%
relighter = jr.prepare(fitted, jr.Transport("vertices", resolution=resolution), folder / "vertices")
eyes = [scene.camera.origin, tuple(np.multiply(scene.camera.origin, (-1, 1, 1)))]
cameras = [dataclasses.replace(scene.camera, origin=eye) for eye in eyes]
rows, errors = [], []
for number, camera in enumerate(cameras):
    # The table, exactly: receivers are the pixels of this camera alone.
    method = jr.Transport("pixels", resolution=resolution, coefficients="all")
    exact = jr.prepare(dataclasses.replace(scene, camera=camera), method, folder / f"pixels-{number}")
    of_table = exact.picture(sky)
    start = time.perf_counter()
    of_lobes = relighter.picture(sky, camera)
    errors.append(jr.image_error(of_lobes, of_table))
    print(f"view {number}: {time.perf_counter() - start:.2f} s with what is compiled;", errors[-1])
    rows.append(np.concatenate([of_table, of_lobes], axis=1))
jr.write_image(folder / "measured_material.png", np.concatenate(rows), exposure=-0.3)
print("picture (table on the left, lobes on the right)", folder / "measured_material.png")

# %% [markdown]
# ## The lobes are parameters
#
# `replace_lobes` exchanges them without precomputing anything, and the picture is differentiable in them: here in the
# largest exponent, against a difference quotient.

# %%
view, lit = relighter.view(), relighter.light(sky)
own = [part.brdf for part in relighter.transport.lobes]
(which,) = (number for number, part in enumerate(relighter.transport.lobes) if part.material == glossy)


def brightness(factor):
    """Mean square of the picture where all exponents of the fitted lobes are multiplied."""
    changed = dataclasses.replace(own[which], exponent=own[which].exponent * factor)
    other = relighter.replace_lobes([*own[:which], changed, *own[which + 1 :]])
    return jnp.mean(other.shade(lit, view).radiance ** 2)


slope = float(jax.grad(brightness)(jnp.float32(1.0)))
quotient = float(brightness(jnp.float32(1.01)) - brightness(jnp.float32(0.99))) / 0.02
print(f"gradient {slope:.4g}, difference quotient {quotient:.4g}")
assert abs(slope - quotient) < 0.05 * abs(quotient) + 1e-5
assert max(error.trimmed for error in errors) < 0.15
