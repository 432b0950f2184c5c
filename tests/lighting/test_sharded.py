"""A scene lit by an operator that is spread over devices."""

import os
import pathlib
import subprocess
import sys

import pytest

ROOT = pathlib.Path(__file__).parents[2]

CHILD = """
import sys
import equinox as eqx
import jax, numpy as np
import jaxrelight as jr

parts = [jr.Part(jr.plane((2, 2), 4), "paper"), jr.Part(jr.sphere(0.35, 4), "wall")]
materials = {"paper": jr.lambert([0.7, 0.6, 0.5]), "wall": jr.lambert(0.3)}
scene = jr.Scene(parts, materials, jr.Camera((0.4, 1.2, 2.2), (0.1, 0.2, 0), width=16, height=12))
sky = np.random.default_rng(0).gamma(0.4, size=(8, 16, 3)).astype(np.float32)

def lit(relighter):
    view = relighter.view()
    def picture(sky):
        return relighter.shade_terms(relighter.terms(relighter.light_vector(sky)), view)
    gradient = jax.grad(lambda sky: (picture(sky) ** 2).sum())(sky)
    return relighter.terms(relighter.light_vector(sky)), picture(sky), gradient

for coefficients in "shared", 48:
    dials = {"receiver_tolerance": 0, "reflection": "factors", "resolution": 8}
    method = jr.Transport("vertices", **dials, coefficients=coefficients)
    relighter = jr.prepare(scene, method, f"{sys.argv[1]}/{coefficients}")
    mesh = jax.make_mesh((4,), ("groups",))
    spread = eqx.tree_at(
        lambda of: [block.operator for block in of.transport.blocks],
        relighter,
        [jr.sharded(block.operator, mesh) for block in relighter.transport.blocks],
    )
    one, many = lit(relighter), lit(spread)
    assert all(len(terms.sharding.device_set) == 4 for terms in many[0])
    for wanted, leaf in zip(*map(jax.tree.leaves, (one, many)), strict=True):
        assert wanted.shape == leaf.shape
        np.testing.assert_allclose(leaf, wanted, rtol=1e-5, atol=1e-5 * np.abs(wanted).max())
"""


@pytest.mark.slow
def test_light_on_four_devices_is_that_on_one(tmp_path):
    """Light terms, pictures and gradients."""
    environment = os.environ | {"XLA_FLAGS": "--xla_force_host_platform_device_count=4", "JAX_PLATFORMS": "cpu"}
    command = [sys.executable, "-c", CHILD, str(tmp_path)]
    done = subprocess.run(command, env=environment, cwd=ROOT, capture_output=True, text=True, timeout=120)
    assert done.returncode == 0, done.stderr
