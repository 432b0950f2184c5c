# ---
# jupyter:
#   jupytext:
#     text_representation:
#       extension: .py
#       format_name: percent
# ---

# %% [markdown]
# # Materials from pictures
#
# A picture of a known scene under known lights tells its materials, and how exactly. The picture is a smooth function
# of them without noise, so that a few steps of Gauss and Newton find a dozen numbers, and a linear solve an albedo for
# every texel: light that a shadow takes away does not end up in the texture.

# %%
import os
import pathlib
import tempfile

import jax
import numpy as np

import jaxrelight as jr
from jaxrelight.brdf.material import textured_lambert
from jaxrelight.brdf.texture import Texture
from jaxrelight.geometry.mesh import transformed

short = bool(os.environ.get("SHORT"))
width, height, resolution, texels = (48, 36, 8, 8) if short else (192, 144, 32, 48)
folder = pathlib.Path(tempfile.mkdtemp())

# %% [markdown]
# ## A scene, and what nobody knows of it
#
# A glossy ball over a textured floor, a sky and a lamp. The floor's texture and the ball's lobe made the picture, with
# one percent of noise; what is prepared below knows neither.

# %%
v, u = (np.mgrid[:texels, :texels] + 0.5) / texels
tiles = 0.35 + 0.3 * (np.floor(4 * u) + np.floor(4 * v)) % 2 * 0.5
true_texture = np.stack([tiles, 0.8 * tiles, 0.3 + 0.2 * np.sin(6.28 * u)], axis=-1).astype(np.float32)
true_ball = jr.phong([0.2, 0.1, 0.05], [0.5, 0.4, 0.3], 30.0)

up = np.eye(4)
up[1, 3] = 0.4
parts = [jr.Part(jr.plane((2, 2), 8), "floor"), jr.Part(transformed(jr.sphere(0.35, 12), up), "ball")]
random = np.random.default_rng(0)
lights = jr.Lights(
    jr.environment((0.2 + random.gamma(0.4, size=(16, 32, 3))).astype(np.float32)),
    (jr.point([1.0, 2.0, 1.0], [9.0, 8.0, 7.0]),),
)
camera = jr.Camera((0.4, 1.6, 1.7), (0, 0.15, 0), fov_y=44, width=width, height=height)


def texture(pixels):
    """A texture with its coarser levels."""
    return Texture(jax.device_put(np.asarray(pixels, np.float32))).minified()


grey = {"floor": textured_lambert(texture(np.full((texels, texels, 3), 0.5))), "ball": jr.phong(0.3, 0.2, 8.0)}
scene = jr.Scene(parts, grey, camera, lights)
relighter = jr.prepare(scene, jr.Transport(resolution=resolution), folder / "store")

# %% [markdown]
# `with_materials` is the same prepared scene with other materials: no ray is cast, and it is differentiable in all of
# their numbers. `held` says what stays as it was prepared.

# %%
hidden = relighter.with_materials({"floor": textured_lambert(texture(true_texture)), "ball": true_ball})
view = relighter.view()
exact = np.asarray(hidden.shade(hidden.light(lights), view).radiance)
picture = (exact * (1 + 0.01 * random.normal(size=exact.shape))).astype(np.float32)
print("held:", ", ".join(relighter.held))

# %% [markdown]
# ## The ball's numbers
#
# Its colours and its exponent, from a start that is far off, on the pixels that show it. What reaches the ball does not
# depend on the floor: bounces are not part of this picture.

# %%
number = {material.name: i for i, material in enumerate(relighter.materials)}


def pixels_of(name):
    """Where a material is seen."""
    mask = np.zeros(height * width, bool)
    for part in view.surfaces.parts:
        if part.material == number[name]:
            pixel = np.asarray(part.pixels.pixel)
            mask[pixel[pixel < mask.size]] = True
    return mask.reshape(height, width)


ball = jr.inverse.materials(
    relighter,
    [picture],
    lights=lights,
    unknowns={"ball": jr.phong(0.3, 0.2, 8.0)},
    masks=[pixels_of("ball")],
    deviations=[0.01 * exact + 1e-4],
)
for name, estimate in ball.estimates.items():
    print(f"{name:>14}", estimate.value.round(3).tolist(), "±", estimate.deviation.round(4).tolist())
print(f"residual {ball.residual:.2%}, held out {ball.held_out:.2%}, {ball.steps} steps, {ball.seconds:.1f} s")
assert ball.undetermined == ()
exponent = ball.estimates["ball.exponent"]
assert abs(exponent.value.item() - 30) < 4 * exponent.deviation.item() + 0.1

# %% [markdown]
# ## The floor's texture
#
# The picture is linear in it. Texels under the ball, or that no pixel sees, are counted as not told.

# %%
floor = jr.inverse.materials(
    relighter.with_materials(ball.materials),
    [picture],
    lights=lights,
    unknowns={"floor": jr.inverse.Unknown(jr.lambert(0.5), textures={"albedo": (texels, texels)})},
    masks=[pixels_of("floor")],
)
albedo = floor.estimates["floor.albedo"]
told = albedo.determined.all(axis=-1)
error = np.linalg.norm((albedo.value - true_texture)[told]) / np.linalg.norm(true_texture[told])
print("not told:", ", ".join(floor.undetermined) or "nothing")
print(f"texture off by {error:.2%} where it is told; residual {floor.residual:.2%}, {floor.seconds:.1f} s")
assert error < 0.05

# %% [markdown]
# The picture, and the one that the found materials make.

# %%
found = relighter.with_materials({**ball.materials, **floor.materials})
again = np.asarray(found.shade(found.light(lights), view).radiance)
jr.write_image(folder / "materials_from_pictures.png", np.concatenate([picture, again], axis=1), exposure=0.0)
print("picture (given on the left, found on the right)", folder / "materials_from_pictures.png")
assert (
    jr.image_error(np.dstack([again, np.ones((height, width))]), np.dstack([exact, np.ones((height, width))])).trimmed
    < 0.02
)
