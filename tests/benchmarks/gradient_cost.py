"""What gradients by light cost: reverse and forward mode of light → picture against the picture, by method."""

import argparse
import dataclasses
import pathlib
import tempfile
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

import jaxrelight as jr
from tests.benchmarks.measuring import Report, interleaved, megabytes, shared

WAYS = {
    "vertices, Lambert": ("bunny_lambert", jr.Transport("vertices")),
    "vertices, Phong": ("bunny_phong", jr.Transport("vertices")),
    "pixels, Lambert": ("bunny_lambert", jr.Transport("pixels")),
    "pixels, Phong": ("bunny_phong", jr.Transport("pixels")),
    "indirect, sky": ("bunny_lambert", jr.Indirect(bounces=1, sky=True)),
    "prefiltered, Phong": ("bunny_phong", jr.Prefiltered()),
    "adaptive, Phong": ("bunny_phong", jr.Adaptive(samples=64)),
}


def main():
    parser = argparse.ArgumentParser(prog="python -m tests.benchmarks.gradient_cost", description=__doc__)
    parser.add_argument("--quick", action="store_true", help="two ways, small; RESULTS.md is left as it is")
    parser.add_argument("--only", choices=WAYS, help="one way; RESULTS.md is left as it is")
    arguments = parser.parse_args()
    quick, only = arguments.quick, arguments.only
    parameters = "the bunny on a floor, 256×256, Grace of 512×1024 pixels, default dials"
    with Report("gradient_cost", "Gradients by light", parameters, not (quick or only)) as report:
        report.text(
            "From the pixels of a map to a picture, in one program: the picture; its derivative in a direction "
            "(forward mode); the gradient of its product with a cotangent (reverse mode), which makes no picture where "
            "it needs none. Medians of ratios of interleaved runs; memory is what XLA's programs take beside arguments "
            "and results."
        )
        names = [only] if only else list(WAYS)[:: 5 if quick else 1]
        rows = [row(name, quick=quick) for name in names]
        heads = "way", "picture", "forward, ×", "reverse, ×", "memory of picture", "of forward", "of reverse"
        report.table(heads, rows)


def row(name: str, *, quick: bool) -> list[str]:
    """One way to light."""
    file, method = WAYS[name]
    scene = jr.load_scene(shared("reference", f"{file}.toml"))
    if quick:
        scene = dataclasses.replace(scene, camera=dataclasses.replace(scene.camera, width=32, height=32))
        if "resolution" in {field.name for field in dataclasses.fields(method)}:
            method = dataclasses.replace(method, resolution=16)
    with tempfile.TemporaryDirectory() as folder:
        store = None if method.name in ("prefiltered", "adaptive") else pathlib.Path(folder) / "store"
        relighter = jr.prepare(scene, method, store)
        environment = scene.lights.environment
        assert environment is not None
        view = relighter.view()
        traced = relighter.trace(relighter.light(environment), view)
        pixels = jnp.asarray(np.asarray(environment.pixels))
        arrays, static = eqx.partition((relighter, view, traced), eqx.is_array)

        def picture(pixels, arrays):
            relighter, view, traced = eqx.combine(arrays, static)
            lit = relighter.light(eqx.tree_at(lambda of: of.pixels, environment, pixels))
            return relighter.shade(lit, view, traced).radiance

        def along(pixels, arrays):
            return jax.jvp(lambda x: picture(x, arrays), (pixels,), (pixels,))[1]

        def back(pixels, cotangent, arrays):
            return jax.vjp(lambda x: picture(x, arrays), pixels)[1](cotangent)[0]

        made = jax.jit(picture).lower(pixels, arrays).compile()
        forward = jax.jit(along).lower(pixels, arrays).compile()
        cotangent = made(pixels, arrays)
        reverse = jax.jit(back).lower(pixels, cotangent, arrays).compile()
        sides = {
            "picture": lambda: made(pixels, arrays),
            "forward": lambda: forward(pixels, arrays),
            "reverse": lambda: reverse(pixels, cotangent, arrays),
        }
        timings = interleaved(sides, 3 if quick else 9)
        memory = [megabytes(_temporary(one)) for one in (made, forward, reverse)]
    base = timings["picture"]
    ratios = [f"{timings[mode].over(base):.2f}" for mode in ("forward", "reverse")]
    return [name, str(base), *ratios, *memory]


def _temporary(program: Any) -> int:
    """Bytes of a compiled program beside its arguments and results."""
    return program.memory_analysis().temp_size_in_bytes


if __name__ == "__main__":
    main()
