"""A thousand lights, or steps of gradients, by one method: what the process holds, traces and compiles meanwhile.

`python -m tests.extremes.long_use METHOD FOLDER STEPS lights|gradients` prints it.
"""

import contextlib
import gc
import sys
from typing import Any

import jax
import jax.monitoring
import jax.numpy as jnp
import numpy as np

import jaxrelight as jr
from jaxrelight.lighting import shadows
from tests.benchmarks.measuring import answer, resident_memory
from tests.extremes.scenes import METHODS, ball

# Steps from one count of memory to the next.
SETTLED = 100


@contextlib.contextmanager
def events():
    """Counts what is traced and what is compiled within the block, by name."""
    counts: dict[str, int] = {}

    def listen(event: str, duration_secs: float, **details):
        del duration_secs
        kind = {"jaxpr_trace_duration": "traced", "backend_compile_duration": "compiled"}.get(event.rpartition("/")[2])
        if kind:
            name = f"{kind} {details.get('fun_name', '')}"
            counts[name] = counts.get(name, 0) + 1

    jax.monitoring.register_event_duration_secs_listener(listen)
    try:
        yield counts
    finally:
        jax.monitoring.unregister_event_duration_listener(listen)


def lights(number: int, local: bool) -> list[Any]:
    """A sky with a sun elsewhere, turned, and a lamp elsewhere: none of them comes again."""
    generator = np.random.default_rng(number)
    pixels = generator.uniform(0.2, 1, (32, 64, 3)).astype(np.float32)
    pixels[generator.integers(4, 12), generator.integers(64)] = 1e4
    sky = jr.environment(pixels, rotate_y=float(generator.uniform(0, 360)), scale=float(generator.uniform(1, 2)))
    return [sky, jr.point([*generator.uniform(-1, 1, 2), 2.0], float(generator.uniform(1, 3)))] if local else [sky]


def _held() -> dict[str, int]:
    """Bytes of the process, of JAX's arrays, and objects of Python."""
    gc.collect()
    arrays = sum(array.nbytes for array in jax.live_arrays())
    return {"resident": resident_memory(), "arrays": arrays, "objects": sys.getallocatedblocks()}


def main(method: str, folder: str, steps: int, what: str):
    """Takes the steps and prints what was counted."""
    # What is remembered of rays is bounded by bytes: by so few that 100 steps reach them.
    shadows._MAX_REMEMBERED = 1 << 18
    dials = METHODS[method]
    relighter: Any = jr.prepare(ball(), dials, folder if dials.is_stored else None)
    view = relighter.view()
    fixed = relighter.trace(relighter.light(lights(0, False)), view) if method == "adaptive" else None
    target = np.asarray(relighter.shade(relighter.light(lights(1, False)), view, fixed).radiance)
    (sky,) = lights(0, False)

    @jax.value_and_grad
    def loss(variables):
        lit = relighter.light(jr.Environment(variables["pixels"], 20.0, variables["scale"]))
        return jnp.mean((relighter.shade(lit, view, fixed).radiance - target) ** 2)

    def relight(number: int) -> float:
        image = relighter.shade(relighter.light(lights(number, True)), view)
        return float(np.mean(image.radiance))

    variables = {"pixels": np.asarray(sky.pixels), "scale": np.float32(1)}

    def descend(number: int) -> float:
        value, slope = loss({name: jax.device_put(one) for name, one in variables.items()})
        for name, one in slope.items():
            # So small a step that the light stays positive.
            largest = float(np.abs(one).max()) or 1.0
            variables[name] = np.asarray(variables[name] - np.float32(1e-4 / largest) * np.asarray(one))
        return float(value)

    step = relight if what == "lights" else descend
    held, values = [], [step(0), step(1)]
    with events() as counts:
        for number in range(2, steps + 1):
            values.append(step(number))
            if number % SETTLED == 0:
                held.append(_held())
    answer({"held": held, "counts": counts, "values": [values[0], values[-1]]})


if __name__ == "__main__":
    main(sys.argv[1], sys.argv[2], int(sys.argv[3]), sys.argv[4])
