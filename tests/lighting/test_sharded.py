"""A scene lit by an operator that is spread over devices."""

import os
import pathlib
import subprocess
import sys

ROOT = pathlib.Path(__file__).parents[2]

CHILD = """
import dataclasses, sys
import jax, numpy as np
import jaxrelight as jr
from jaxrelight.operators.sharded import sharded

parts = [jr.Part(jr.plane((2, 2), 4), "paper"), jr.Part(jr.sphere(0.35, 4), "wall")]
materials = {"paper": jr.lambert([0.7, 0.6, 0.5]), "wall": jr.lambert(0.3)}
scene = jr.Scene(parts, materials, jr.Camera((0.4, 1.2, 2.2), (0.1, 0.2, 0), width=16, height=12))
settings = jr.Settings(resolution=8, operator=sys.argv[1], coefficients=48)
jr.precompute(scene, settings, sys.argv[2])
transport = jr.load(sys.argv[2])
mesh = jax.make_mesh((4,), ("groups",))
spread = dataclasses.replace(transport, operator=sharded(transport.operator, mesh))
sky = np.random.default_rng(0).gamma(0.4, size=(8, 16, 3)).astype(np.float32)
found = []
for relighter in jr.Relighter(transport), jr.Relighter(spread):
    view = relighter.view()
    light = lambda sky: relighter.terms(relighter.light_vector(sky))
    gradient = jax.grad(lambda sky: (relighter.shade(light(sky), view) ** 2).sum())(sky)
    found.append((light(sky), relighter.shade(light(sky), view), gradient))
for one, many in zip(*map(jax.tree.leaves, found), strict=True):
    assert len(many.sharding.device_set) == 4 or many is found[1][2]
    assert one.shape == many.shape
    np.testing.assert_allclose(many, one, rtol=1e-5, atol=1e-5 * np.abs(one).max())
"""


def _run(operator: str, folder: pathlib.Path) -> None:
    environment = os.environ | {"XLA_FLAGS": "--xla_force_host_platform_device_count=4", "JAX_PLATFORMS": "cpu"}
    command = [sys.executable, "-c", CHILD, operator, str(folder)]
    done = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr


def test_clusters_on_four_devices_light_as_on_one(tmp_path):
    _run("clusters", tmp_path)


def test_rows_on_four_devices_light_as_on_one(tmp_path):
    _run("rows", tmp_path)
