"""All four lighting methods in double precision: output follows the input's dtype."""

import os
import pathlib
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).parents[2]

CHILD = """
import sys
import jax, numpy as np
import jaxrelight as jr

sky = jr.Environment(np.random.default_rng(0).uniform(0.2, 1, (8, 16, 3)), 20.0, 2.0)
scene = jr.Scene(
    [jr.Part(jr.plane((2, 2), 4), "floor"), jr.Part(jr.sphere(0.4, 8), "ball")],
    {"floor": jr.lambert([0.5, 0.4, 0.3]), "ball": jr.phong(0.2, 0.4, 20.0)},
    jr.Camera((0, 1.5, 3), (0, 0.2, 0), width=12, height=10),
    [sky, jr.point([1, 2, 1], 3.0)],
)
assert sky.pixels.dtype == np.float64
stored = jr.Transport(resolution=4), jr.Indirect(gather_samples=64, bounces=1)
for method in (*stored, jr.Prefiltered(), jr.Adaptive(samples=32)):
    store = f"{sys.argv[1]}/{method.name}" if method.is_stored else None
    relighter = jr.prepare(scene, method, store)
    view, lit = relighter.view(), relighter.light(scene.lights)
    traced = relighter.trace(lit, view)

    def picture(scale):
        lights = jr.Lights(sky.with_(scale=scale), scene.lights.local)
        return relighter.shade(relighter.light(lights), view, traced).radiance

    one, two = picture(2.0), picture(2.0 + 2**-30)
    assert one.dtype == np.float64
    # What single precision would lose.
    change = np.asarray(two - one).sum() / np.asarray(one - picture(1.0)).sum()
    np.testing.assert_allclose(change, 2**-30, rtol=1e-3)
"""


@pytest.mark.slow
def test_all_methods_light_in_double_precision(tmp_path):
    command = [sys.executable, "-c", CHILD, str(tmp_path)]
    environment = os.environ | {"JAX_ENABLE_X64": "1"}
    done = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=500, check=False)
    assert done.returncode == 0, done.stderr
