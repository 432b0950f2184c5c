# ---
# jupyter:
#   jupytext:
#     formats: py:percent
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Lamps that light a desk as it should be
#
# An office is made by code, with a desk and a corridor beside it. Sensors say how much light arrives where; a solver
# aims three spots and dims them until the desk has 500 lux that are even, and the corridor between 100 and 200. What
# the walls pass on counts. Run it as a script, or open it as a notebook with jupytext. `SHORT=1` takes few points and
# starts.

# %%
import os
import pathlib
import tempfile

import numpy as np

import jaxrelight as jr
from jaxrelight.images.false_colour import false_colour

short = bool(os.environ.get("SHORT"))
folder = pathlib.Path(tempfile.mkdtemp())


def inward(width, height, depth):
    """The walls, the floor and the ceiling of a room, which face inwards; it stands on y = 0."""
    box = jr.transformed(
        jr.box((width, height, depth), 4), [[1, 0, 0, 0], [0, 1, 0, height / 2], [0, 0, 1, 0], [0, 0, 0, 1]]
    )
    return jr.Mesh(box.vertices, box.faces[:, ::-1], -box.normals)


def table(x, z):
    """A table top, 5 cm thick."""
    place = [[1, 0, 0, x], [0, 1, 0, 0.7], [0, 0, 1, z], [0, 0, 0, 1]]
    return jr.transformed(jr.box((1.6, 0.05, 0.8), 4), place)


parts = [jr.Part(inward(5.0, 2.7, 4.0), "wall"), jr.Part(table(-1.0, -0.6), "wood")]
materials = {"wall": jr.lambert([0.65, 0.63, 0.6]), "wood": jr.lambert([0.35, 0.22, 0.12])}
camera = jr.Camera((0, 1.6, 1.9), (-0.6, 0.8, -1), fov_y=65, width=96, height=64)
cells = (6, 3) if short else (16, 8)
sensors = [
    jr.sensor_grid("desk", (-1.75, 0.74, -0.95), (1.5, 0, 0), (0, 0, 0.7), *cells),
    jr.sensor_grid("corridor", (1.4, 0.01, -1.8), (0.8, 0, 0), (0, 0, 3.6), 3, 9),
]
scene = jr.Scene(parts, materials, camera, name="office", sensors=sensors)
method = jr.Indirect(gather_samples=256 if short else 4096, bounces=3)
relighter = jr.prepare(scene.at_sensors(), method, folder / "store")

# %% [markdown]
# ## What three spots give that look straight down

# %%
colour = np.array([1.0, 0.9, 0.75])
begun = [jr.spot((x, 2.6, z), (x, 0, z), 60 * colour, 50.0, 25.0) for x, z in ((-1.9, 0.4), (-0.2, -0.6), (1.6, 0.6))]
before = jr.measure(relighter, begun)
for name, told in before.summaries().items():
    print(f"{name}: {told.mean:.0f} lux, from {told.min:.0f} to {told.max:.0f}, uniformity {told.uniformity:.2f}")

# %% [markdown]
# ## Aim and dim them
#
# Each keeps its place; its aim, its cone and its intensity are free. Shadow boundaries are held fixed in every step,
# and rays are cast anew after it; several starts tell how far the result depends on where it begins.

# %%
targets = {"desk": jr.inverse.LuxTarget(mean=500, uniformity=0.8), "corridor": jr.inverse.LuxTarget(min=100, max=200)}
found = jr.inverse.lamps(
    relighter,
    targets,
    free=["intensity", "aim", "cone"],
    lights=begun,
    starts=2 if short else 4,
    rounds=10 if short else 30,
)
for fit in found.targets:
    print(f"{fit.what}: {fit.found:.4g} of {fit.target:g}, {fit.error:+.1%}")
print("residuals of the starts", np.round(found.starts, 4))
for one in found.unknowns:
    known = f"± {one.deviation:.2g}" if one.is_determined else "not determined by the targets"
    print(f"{one.name}: {one.value:.3g} {one.unit} {known}")
print("held fixed:", "; ".join(found.held_fixed))

# %% [markdown]
# ## The desk before and after, over its mean

# %%
after = jr.measure(relighter, found.lights)
maps = [np.asarray(measured.of("desk")).reshape(cells[1], cells[0]) for measured in (before, after)]
together = np.concatenate([np.kron(one / one.mean(), np.ones((8, 8))) for one in maps], axis=1)
colours, (low, high) = false_colour(together, np.ones(together.shape, bool))
jr.write_image(folder / "lamps_to_target.png", colours)
print("picture", folder / "lamps_to_target.png", f"from {low:.2f} to {high:.2f} of the mean")
assert abs(found.targets[0].error) < 0.03
assert after.summaries()["desk"].uniformity > before.summaries()["desk"].uniformity
