# ---
# jupyter:
#   jupytext:
#     formats: py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # The light of a room from one picture
#
# A few objects on a table, photographed under light that nobody measured. Their shapes and materials are known, so the
# picture tells where light comes from: by highlights, by the side of a shadow, by colours. Run it as a script, or open
# it as a notebook with jupytext.

# %%
import os
import pathlib
import tempfile

import numpy as np

import jaxrelight as jr
from jaxrelight.inverse.light_report import write_light_report

SHORT = bool(os.environ.get("SHORT"))


def raised(mesh, x, y, z):
    """A mesh at another place."""
    return jr.transformed(mesh, np.array([[1, 0, 0, x], [0, 1, 0, y], [0, 0, 1, z], [0, 0, 0, 1.0]]))


parts = [
    jr.Part(jr.plane((2.4, 2.4), 8), "table"),
    jr.Part(raised(jr.sphere(0.3, 16), -0.3, 0.3, 0), "ball"),
    jr.Part(raised(jr.box((0.3, 0.6, 0.3), 8), 0.4, 0.3, -0.1), "paper"),
]
materials = {
    "table": jr.lambert([0.5, 0.45, 0.4]),
    "ball": jr.phong([0.1, 0.1, 0.12], [0.6, 0.6, 0.6], 40.0),
    "paper": jr.lambert(0.7),
}
size = 48 if SHORT else 160
camera = jr.Camera((0.3, 1.1, 2.3), (0, 0.2, 0), fov_y=42, width=size, height=size)
scene = jr.Scene(parts, materials, camera)

# %% [markdown]
# The light of the room: a window on the left, a lamp on the ceiling, dim walls. In practice the picture would be a
# photograph in linear radiance; here it is rendered, with noise.

# %%
rows, columns = np.mgrid[0:32, 0:64]
room = np.full((32, 64, 3), 0.15, np.float32) * np.array([1.0, 0.9, 0.8], np.float32)
room[10:18, 6:14] = [3.0, 3.6, 4.5]  # the window
room[1:4, 30:44] = [6.0, 4.5, 3.0]  # the lamp
relighter = jr.prepare(scene, jr.Transport(resolution=16 if SHORT else 32, coefficients="all"))
view = relighter.view()
clean = np.asarray(relighter.shade(relighter.light(jr.Environment(room)), view).radiance)
noise = np.random.default_rng(0).normal(size=clean.shape) * 0.01 * clean.mean()
picture = (clean + noise).astype(np.float32)

# %% [markdown]
# Least squares through products with the map from light to picture, and with its adjoint.

# %%
found = jr.inverse.environment(relighter, [picture], [view], unknowns=8 if SHORT else 16)
print(f"misses {found.residual:.2%}, and {found.held_out:.2%} of pixels that were held out")
print(f"tells {min(found.certainty.told)} of {found.certainty.grid.size} numbers, {found.seconds:.1f} s")

# %% [markdown]
# What does the picture tell? The window's mean radiance, to within its deviation; nothing below the table.

# %%
grid = found.certainty.grid
window = np.zeros((32, 64, 1), np.float32)
window[10:18, 6:14] = 1
weights = grid.on_grid(window)[:, 0] * grid.solid_angles
estimate, below = found.estimate(weights), found.estimate((grid.directions[:, 1] < -0.6).astype(float))
print("the window:", estimate.value, "±", estimate.deviation, "told" if estimate.determined else "not told")
print("below the table:", "told" if below.determined else "not told")

# %%
folder = pathlib.Path(tempfile.mkdtemp())
for name, what in write_light_report(folder, found, [picture]).items():
    print(f"{folder / name}: {what}")

# %%
assert found.held_out < 0.1
assert not below.determined
assert estimate.value[2] > estimate.value[0]  # the window is bluish
