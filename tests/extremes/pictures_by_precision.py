"""Pictures of small scenes in the precision that JAX_ENABLE_X64 asks for: `python -m … FOLDER` writes them there."""

import dataclasses
import pathlib
import sys

import jax
import numpy as np

import jaxrelight as jr
from jaxrelight import Scene
from tests.extremes.scenes import CAMERA, METHODS, ball, plain

ALBEDO, EXPONENT, ANGLE = 0.5, 12.0, np.pi / 4
# A change of the light's scale that single precision loses.
SMALL = 2.0**-30


def skies(dtype) -> dict[str, jr.Environment]:
    """A constant sky, one that is dark on a side, and noise that is turned and scaled; equal in both precisions."""
    half = np.repeat(np.array([2.0, 0.0], np.float32), 16)[None, :, None] * np.ones((16, 1, 3), np.float32)
    noise = np.random.default_rng(0).uniform(0.2, 1, (16, 32, 3)).astype(np.float32)
    return {
        "constant": jr.Environment(np.ones((16, 32, 3), dtype)),
        "half": jr.Environment(half.astype(dtype)),
        "noise": jr.Environment(noise.astype(dtype), 20.0, 2.0),
    }


def scenes() -> dict[str, tuple[Scene, str]]:
    """Scenes, and the sky of each."""
    aslant = jr.Camera((0, 2, 2), (0, 0, 0), fov_y=1, width=16, height=16)
    lamp = jr.point([1, 2, 1], 3.0)
    return {
        "constant": (plain(), "constant"),
        "half": (plain(), "half"),
        "lobe": (plain(jr.phong(0.0, ALBEDO, EXPONENT), aslant), "constant"),
        "ball": (Scene(ball().parts, ball().materials, CAMERA, [lamp]), "noise"),
    }


def main(folder: pathlib.Path):
    """Writes `METHOD.npz`: radiance of each scene, and the share of a small change that a picture shows."""
    dtype = jax.dtypes.canonicalize_dtype(np.float64)
    every = skies(dtype)
    # Which coefficients are kept is a choice that rounding may change where two are about as large.
    methods = METHODS | {"pixels": dataclasses.replace(METHODS["pixels"], coefficients="all")}
    for method, dials in methods.items():
        told = {}
        for name, (scene, sky) in scenes().items():
            relighter = jr.prepare(scene, dials, folder / f"{method}-{name}" if dials.is_stored else None)
            local = relighter.scene_lights().local
            view, lit = relighter.view(), relighter.light(jr.Lights(every[sky], local))
            traced = relighter.trace(lit, view)

            def picture(scale, relighter=relighter, view=view, traced=traced, sky=every[sky], local=local):
                lights = jr.Lights(sky.with_(scale=scale), local)
                return np.asarray(relighter.shade(relighter.light(lights), view, traced).radiance)

            one, two = picture(1.0), picture(2.0)
            assert one.dtype == dtype, (method, name, one.dtype)
            told[name] = one
            told[f"{name}: change"] = (picture(2.0 + SMALL) - two).sum() / (two - one).sum() / SMALL
        np.savez(folder / f"{method}.npz", **told)


if __name__ == "__main__":
    main(pathlib.Path(sys.argv[1]))
